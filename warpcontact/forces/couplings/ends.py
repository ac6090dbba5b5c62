"""The ends of couplings and shape contacts on a device, listed by the bodies that they act on."""

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
    """Declares where the ends of couplings and shape contacts are, and lists them by their bodies."""
    points = np.array([point for one in couplings for point in one.end_points()], dtype=np.int32)
    numbers = [np.array([n for one in couplings for n in one.end_bodies()], dtype=np.int32)]
    numbers += [one.bodies.reshape(-1) for one in shape_contact_sets]
    starts, ends = ends_of_bodies(np.concatenate(numbers), bodies)
    for name, values in (("end_point", points), ("body_end_start", starts), ("body_end", ends)):
        layout.constant("couplings", model, name, values, wp.int32)


def ends_of_bodies(numbers: NDArray[np.int32], bodies: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns where the ends of each body start in a list (bodies + 1), and the list, in the order of the ends.

    ``numbers`` are the bodies of all ends, or ``WORLD``.
    """
    held = np.flatnonzero(numbers >= 0)
    order = np.argsort(numbers[held], kind="stable")
    starts = np.searchsorted(numbers[held][order], np.arange(bodies + 1))
    return starts, held[order]
