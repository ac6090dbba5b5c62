"""Ends of force elements on the device, listed by body: forces at the ends are summed per body in their order."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpcontact.storage.allocation_plan import AllocationPlan

#: Point index of an end that is not at a point of the scene.
NO_POINT = -1


class Ends:
    """Pairs of ends of all force elements of a model; pair i has the ends 2 i and 2 i + 1."""

    def __init__(self) -> None:
        self._bodies: list[NDArray[np.int32]] = []
        self._points: list[NDArray[np.int32]] = []

    @property
    def count(self) -> int:
        """Number of ends."""
        return sum(map(len, self._bodies))

    def add(self, bodies: ArrayLike, points: ArrayLike | None = None) -> int:
        """Adds pairs of ends and returns the number of the first pair.

        Args:
            bodies: Body indices, or ``WORLD``, (pairs, 2).
            points: Indices of their points, (pairs, 2). ``None``: the ends are not at points of the scene.
        """
        first = self.count // 2
        numbers = np.array(bodies, dtype=np.int32).reshape(-1)
        self._bodies.append(numbers)
        self._points.append(
            np.full(len(numbers), NO_POINT, dtype=np.int32)
            if points is None
            else np.array(points, dtype=np.int32).reshape(-1)
        )
        return first

    def declare(self, body_count: int, model: Any, layout: AllocationPlan) -> None:
        """Declares the points of the ends, and the lists of ends of each body, in the struct ``model``."""
        empty = np.zeros(0, dtype=np.int32)
        starts, ends = ends_of_bodies(np.concatenate([empty, *self._bodies]), body_count)
        points = np.concatenate([empty, *self._points])
        for name, values in (("end_point", points), ("body_end_start", starts), ("body_end", ends)):
            layout.constant("couplings", model, name, values, wp.int32)


def ends_of_bodies(numbers: NDArray[np.int32], bodies: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the start of each body in a list of ends (bodies + 1), and the list, in ascending order per body.

    ``numbers`` are the body indices of all ends, or ``WORLD``.
    """
    held = np.flatnonzero(numbers >= 0)
    order = np.argsort(numbers[held], kind="stable")
    starts = np.searchsorted(numbers[held][order], np.arange(bodies + 1))
    return starts, held[order]
