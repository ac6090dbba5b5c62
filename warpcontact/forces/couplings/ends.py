"""Ends of couplings and shape contacts on the device, listed by body."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

if TYPE_CHECKING:
    from warpcontact.forces.couplings.coupling_set import CouplingSet
    from warpcontact.forces.shape_contact.contact_sets import ShapeContactSet
    from warpcontact.storage.allocation_plan import AllocationPlan


def add_ends(
    couplings: "Sequence[CouplingSet]",
    shape_contact_sets: "Sequence[ShapeContactSet]",
    bodies: int,
    model: Any,
    layout: "AllocationPlan",
) -> None:
    """Declares the points of the ends of couplings, and the lists of ends of each body."""
    points = np.array([point for one in couplings for point in one.end_points()], dtype=np.int32)
    numbers = [np.array([n for one in couplings for n in one.end_bodies()], dtype=np.int32)]
    numbers += [one.bodies.reshape(-1) for one in shape_contact_sets]
    starts, ends = ends_of_bodies(np.concatenate(numbers), bodies)
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
