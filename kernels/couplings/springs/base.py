"""Base classes of the models of a spring-damper: elastic force over the distance, and damping."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula


class AlongLine(Formula):
    """Base of springs and dampers: a force along the line between two points."""

    whole: ClassVar[str] = "spring"
    may_have_table: ClassVar[bool] = True

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if cls.memories:
            raise TypeError(f"{cls.__name__} must not declare history variables: spring-dampers have none")

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        """Returns df/dx of a spring, df/dẋ of a damper, for estimates of the time step; ``None``: unknown.

        Args:
            values: Parameters and ``rest_length``, (n,) each.
            lengths: Distances, (n,) [m].
        """
        return None


class Spring(AlongLine):
    """Elastic force f(x) between two points, positive if attractive.

    A subclass declares its parameters and a device function::

        class Hardening(wc.Spring):
            \"\"\"f = F₀ sinh((x − x₀)/L).\"\"\"

            force_scale: float = wc.parameter("N", "force F₀", above=0.0)
            length_scale: float = wc.parameter("m", "length L", above=0.0)

            @wp.func
            def force(p: Any, s: Any):
                return p.force_scale * wp.sinh(s.extension / p.length_scale)

    ``p`` holds the coefficients of this spring in this environment; ``s`` has the distance ``length`` x ≥ 0 [m],
    the ``rest_length`` x₀ [m], the ``extension`` x − x₀ [m] and the ``rate`` ẋ [m/s], > 0 apart. Constants take
    the precision of the simulation when written as ``type(s.length)(1.5)``. With a ``wc.table`` there is a third
    argument, the row of the table for this distance.
    """

    part: ClassVar[str] = "spring"


class Damper(AlongLine):
    """Damping force between two points, positive if attractive: k_d ẋ with k_d ≥ 0.

    Declared like a ``Spring``; its ``force`` uses ``s.rate``.
    """

    part: ClassVar[str] = "damper"


@wp.func
def polynomial(a: Any, b: Any, c: Any, e: Any):
    """Returns a e + b e² + c e³."""
    return e * (a + e * (b + e * c))


@wp.func
def area_below(row: Any, length: Any):
    """Returns the integral of a table from its first distance to ``length``, for which ``row`` is valid."""
    d = length - row.start
    return row.integral + d * (row.value + type(d)(0.5) * row.slope * d)


@wp.func
def value_at(row: Any, length: Any):
    """Returns the value of a table at ``length``, for which ``row`` is valid."""
    return row.value + row.slope * (length - row.start)
