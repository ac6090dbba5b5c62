"""Base class of normal force laws, and the law of nonsmooth contact."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula, parameter


class Law(Formula):
    """Normal force N(δ, δ̇, …) of a contact.

    A subclass declares its parameters and a device function::

        class Cubic(wc.Law):
            \"\"\"N = k δ³.\"\"\"

            stiffness: float = wc.parameter("N/m³", "stiffness k", above=0.0)

            @wp.func
            def force(p: Any, c: Any):
                return p.stiffness * c.delta * c.delta * c.delta

    ``p`` holds the coefficients of this contact in this environment; ``c`` has ``delta`` > 0 [m], ``delta_dot`` (>
    0 on approach) [m/s], ``entry_speed`` (δ̇ at entry, or the largest since) [m/s] and, with ``needs_mass``, the
    effective ``mass`` along the normal [kg] and its inverse ``inverse_mass``, and with ``needs_curvature`` the
    principal relative curvatures ``curvature_1`` ≤ ``curvature_2`` [1/m]; ``dt`` is the step over which the force
    acts [s], 0 for the force at an instant (a sensor). Constants take the precision of the simulation when written
    as ``type(c.delta)(1.5)``. The force must depend on these values only. An optional parameter ``area`` in m²
    with the default ``None`` is set to the area of each point if it is omitted.

    A law with adhesion or suction (``pulls = True``) has friction under the load N + F_p, with the pull-off force
    F_p: Coulomb friction including the adhesive force. By default F_p is the tension at first touch and at rest,
    max(0, −N(δ → 0, δ̇ = 0)). A law with a larger tension elsewhere defines ``pull_off(p, c)``, a ``wp.func`` with
    the arguments of ``force``, which returns F_p [N].

    A law with history variables, such as the largest penetration or creep, declares them by ``wc.history`` and has
    two functions of ``(p, c, m)``: ``advance`` returns the variables ``m`` after the time ``m.elapsed`` [s] since
    the last advance, and ``force`` the force for these variables.
    """

    #: Whether ``c.mass`` is computed.
    needs_mass: ClassVar[bool] = False
    #: Whether ``c.curvature_1`` and ``c.curvature_2`` are computed; a point without a radius has none.
    needs_curvature: ClassVar[bool] = False
    #: Whether the force may be tensile; otherwise it is clipped at zero.
    pulls: ClassVar[bool] = False
    #: Device function of the pull-off force; ``None``: the tension at first touch. Only with ``pulls``.
    pull_off: ClassVar[wp.Function | None] = None
    #: Whether the force is a product of linear functions of δ and of δ̇, so that quadrature over an area is exact.
    bilinear: ClassVar[bool] = False
    #: Device function of the coefficients: fraction of δ in the second body, at which the forces of body contact act; ``None``:
    #: it is the parameter ``kappa`` of the contact.
    second_fraction: ClassVar[wp.Function | None] = None
    #: Exponent of the elastic part if it is fixed. Laws with a parameter ``exponent`` do not set it.
    power: ClassVar[float | None] = None

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        for name, field in cls.memories.items():
            if field.tangent:
                raise TypeError(f"{cls.__name__}.{name}: a law acts along the normal and has no tangent vectors")
        if "pull_off" in vars(cls) and cls.pull_off is not None:
            if not cls.pulls:
                raise TypeError(f"{cls.__name__}.pull_off is for a law that pulls; set pulls = True")
            if not isinstance(cls.pull_off, wp.Function):
                raise TypeError(f"{cls.__name__}.pull_off must be a wp.func of (coefficients, state)")
            cls._check_function("pull_off", ("coefficients", "state"))

    @classmethod
    def elastic(cls, values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
        """Returns K [N/mⁿ] and n of the elastic part K δⁿ, for estimates; ``None``: unknown."""
        exponent = values.get("exponent", cls.power)
        if "stiffness" not in values or exponent is None:
            return None
        return values["stiffness"], np.asarray(exponent, dtype=np.float64)

    @classmethod
    def dashpot(cls, values: dict[str, np.ndarray], mass: np.ndarray) -> np.ndarray | None:
        """Returns c [N·s/m] of a part c δ̇ that does not vanish at small penetration, for estimates; ``None``: there is none.

        Args:
            values: Parameters of the law.
            mass: Effective mass [kg].
        """
        return None


class Rigid(Law):
    """Contact without compliance, for nonsmooth contact; it has no force function."""

    formula = "g ≥ 0, N ≥ 0, g N = 0; u_n⁺ = −e u_n⁻"
    reference = "Signorini's condition and Newton's impact law"
    provenance = "S"
    validity = "bodies whose deformation does not matter"
    rigid = True

    restitution: float = parameter("-", "Newton's restitution e", default=0.0, at_least=0.0, at_most=1.0)
    compliance: float = parameter(
        "m/N", "compliance along the normal; then e is not used", default=0.0, at_least=0.0
    )

    @wp.func
    def force(p: Any, c: Any):
        return type(c.delta)(0.0)
