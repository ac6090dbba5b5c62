"""Base classes of the spring and damper models of a spring-damper, and tables over the distance."""

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


def rows_of(pairs: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Returns (n + 1, 4) rows start, value, slope, integral: one before the table, one per interval, one after."""
    x, y = np.array(pairs).T
    slope = np.diff(y) / np.diff(x)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])
    starts = np.concatenate([x[:1], x])
    return np.column_stack(
        [
            starts,
            np.concatenate([y[:1], y]),
            np.concatenate([[0.0], slope, [0.0]]),
            np.concatenate([[0.0], integral]),
        ]
    )


def row_at(pairs: tuple[tuple[float, float], ...], lengths: np.ndarray) -> np.ndarray:
    """Returns the row for each of ``lengths``, (…, 4)."""
    x = np.array(pairs)[:, 0]
    return rows_of(pairs)[np.searchsorted(x, lengths, side="right")]


def area_to(pairs: tuple[tuple[float, float], ...], lengths: np.ndarray) -> np.ndarray:
    """Returns the integral from the first distance of a table to each of ``lengths``; constant value outside."""
    start, value, slope, integral = np.moveaxis(row_at(pairs, lengths), -1, 0)
    d = lengths - start
    return integral + d * (value + 0.5 * slope * d)


def value_of(pairs: tuple[tuple[float, float], ...], lengths: np.ndarray) -> np.ndarray:
    """Returns the value of a table at each of ``lengths``; constant outside."""
    start, value, slope, _ = np.moveaxis(row_at(pairs, lengths), -1, 0)
    return value + slope * (lengths - start)
