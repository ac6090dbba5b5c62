"""Base class of friction models, a hyperbolic tangent for several of them, and the model without friction."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula


class Friction(Formula):
    """Friction force of a contact, opposed to the velocity of the point's body relative to the surface.

    A subclass declares its parameters and ``force(p, s)``, which returns the force on the point's body as a
    vector in W [N]. ``p`` holds the coefficients; ``s`` has ``velocity`` [m/s], its length ``speed``, the
    ``normal_force`` N ≥ 0 [N], the ``normal``, the ``patch_radius`` √(R δ) of a sphere [m] and, for a
    ``directional`` model, the ``axis``: the x axis of the surface projected into the tangent plane, a unit vector.
    Divide by ``speed`` only where it cannot be zero.

    A model with history declares its variables by ``wc.history`` and has two functions of ``(p, s, m)``:
    ``advance`` returns the variables ``m`` after the time ``m.elapsed`` [s] with the constant state ``s``, and
    ``force`` the force for these variables.

    The same model can be used for sliding, rolling and torsion; see ``ContactMaterial``.
    """

    part: ClassVar[str] = "friction"

    #: Whether it depends on the direction in the tangent plane and needs ``s.axis``.
    directional: ClassVar[bool] = False
    #: Whether it needs ``s.patch_radius`` and so a contact with a radius.
    needs_radius: ClassVar[bool] = False

    @classmethod
    def cone_coefficients(cls) -> tuple[str, str] | None:
        """Returns the names of its static and dynamic coefficients of friction.

        ``None``: it has none, such as an elliptic or viscous model, and does not correspond to a Coulomb cone.
        """
        names = set(cls.varying())
        for pair in (("mu", "mu"), ("mu_static", "mu_dynamic")):
            if names.issuperset(pair):
                return pair
        return None


class Frictionless(Friction):
    """No tangential force."""

    formula = "F = 0"
    reference = "elementary"
    provenance = "R"
    validity = "always dissipation free"

    @wp.func
    def force(p: Any, s: Any):
        return type(s.velocity)()


@wp.func
def fast_tanh(x: wp.float32):
    """Returns tanh(x) with an error of at most three units in the last place, in a third of the time of ``wp.tanh``.

    Below 5/8 a polynomial, above an exponential, as in Cephes (S. L. Moshier), tanhf.c.
    """
    if wp.abs(x) < 0.625:
        z = x * x
        p = (((-5.70498872745e-3 * z + 2.06390887954e-2) * z - 5.37397155531e-2) * z + 1.33314422036e-1) * z
        return x + x * z * (p - 3.33332819422e-1)
    return 1.0 - 2.0 / (wp.exp(2.0 * x) + 1.0)


@wp.func
def fast_tanh(x: wp.float64):  # noqa: F811 - of the other precision
    """Returns tanh(x)."""
    return wp.tanh(x)
