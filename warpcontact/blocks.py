"""Contacts in blocks that are near each other: what a thread works on, and leaves alone while all are far away."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.arrays import Layout
from warpcontact.checks import Array
from warpcontact.kernels.types import WORLD
from warpcontact.parameters import Parameters
from warpcontact.scene import Contact

# Contacts of a block: so few that looking through them costs little, so many that a block is worth it.
LARGEST_BLOCK = 16


@dataclass(frozen=True)
class Blocks:
    """The blocks of all contacts.

    Attributes:
        set_contact: First contact of each set, and the end, (sets + 1,).
        set_start: First block of each set of contacts, and the end, (sets + 1,).
        start: First place of each block in the list of contacts, and the end, (blocks + 1,).
        contact: Contacts by block, (contacts,).
        body_start: First entry of each body in the next, and the end, (bodies + 1,).
        of_bodies: The blocks of each body, each 2 × block + 0 as the points' body, 1 as the surface's.
    """

    set_contact: NDArray[np.int32]
    set_start: NDArray[np.int32]
    start: NDArray[np.int32]
    contact: NDArray[np.int32]
    body_start: NDArray[np.int32]
    of_bodies: NDArray[np.intp]

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.start) - 1

    @property
    def width(self) -> int:
        """Contacts that a block has room for: the next power of two after the largest."""
        return 1 << int(np.diff(self.start).max(initial=1) - 1).bit_length()

    @property
    def most_of_a_body(self) -> int:
        """Blocks of the body that has the most of them."""
        return int(np.diff(self.body_start).max(initial=0))

    @property
    def set_count(self) -> int:
        """Number of sets: what moves as one."""
        return len(self.set_start) - 1

    @property
    def of_set(self) -> NDArray[np.int32]:
        """Set of each block, (blocks,)."""
        return np.repeat(np.arange(self.set_count, dtype=np.int32), np.diff(self.set_start))

    def of_contacts(self, first: int, count: int) -> tuple[int, int]:
        """Returns the first block, and the number of blocks, of contacts side by side that make up whole sets."""
        return _between(self.start, first, count)

    def sets_of_contacts(self, first: int, count: int) -> tuple[int, int]:
        """Returns the first set, and the number of sets, of such contacts."""
        return _between(self.set_contact, first, count)


def make_blocks(contacts: list[Contact], body_count: int) -> Blocks:
    """Returns the blocks of contacts in the order of the device, among so many bodies."""
    empty = [np.zeros(0, dtype=np.intp)]
    members, sizes, blocks_of_sets, sets = list(empty), list(empty), list(empty), list(empty)
    first = 0
    for contact in contacts:
        if contact.points.spread:  # a set for each body
            ones = np.ones(contact.count, dtype=np.intp)
            members.append(first + np.arange(contact.count))
            sizes.append(ones)
            blocks_of_sets.append(ones)
            sets.append(ones)
        else:
            own = _neighbourhoods(contact.points.places)
            members += [first + block for block in own]
            sizes.append(np.array([len(block) for block in own]))
            blocks_of_sets.append(np.array([len(own)]))
            sets.append(np.array([contact.count]))
        first += contact.count
    of_sets = np.concatenate(blocks_of_sets)
    body_start, of_bodies = _blocks_by_body(of_sets, contacts, body_count)
    return Blocks(
        set_contact=_starts(np.concatenate(sets)),
        set_start=_starts(of_sets),
        start=_starts(np.concatenate(sizes)),
        contact=np.concatenate(members).astype(np.int32),
        body_start=body_start,
        of_bodies=of_bodies,
    )


def _between(starts: NDArray[np.int32], first: int, count: int) -> tuple[int, int]:
    begin, end = np.searchsorted(starts, [first, first + count])
    return int(begin), int(end - begin)


def _starts(counts: NDArray[np.integer]) -> NDArray[np.int32]:
    """Returns where each of some lists begins that lie one behind the other, and where the last ends."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)


def _neighbourhoods(positions: Array) -> list[NDArray[np.intp]]:
    """Cuts points across their longest direction until few enough are together; indices ascend in each."""
    whole = [np.arange(len(positions))]
    done: list[NDArray[np.intp]] = []
    while whole:
        some = whole.pop()
        if len(some) <= LARGEST_BLOCK:
            done.append(np.sort(some))
            continue
        along = int(np.ptp(positions[some], axis=0).argmax())
        order = some[np.argsort(positions[some, along], kind="stable")]
        # Halves of whole blocks, so that most are full.
        middle = LARGEST_BLOCK * -(-len(order) // (2 * LARGEST_BLOCK))
        whole += [order[middle:], order[:middle]]
    return done


def upload_blocks(
    blocks: Blocks,
    contacts: list[Contact],
    model: Any,
    layout: Layout,
    parameters: Parameters,
    t: Any,
    places: Callable[[], Array],
) -> list[Any]:
    """Fills the sets and blocks of ``model``.

    Args:
        blocks: What ``make_blocks`` returned for ``contacts``.
        contacts: The contacts in the order of the device.
        model: The struct.
        layout: For what is the same in all environments.
        parameters: For the middle and extent of the sets, which follow the points.
        t: Structs.
        places: Returns where all points are in their bodies, (1 or envs, points, 3).

    Returns:
        The uploads that have to follow when points are moved.
    """

    def send(name: str, values: Any) -> None:
        layout.content("contacts", model, name, values, wp.int32)

    firsts, sizes = blocks.set_contact[:-1], np.diff(blocks.set_contact)
    send("set_contact", firsts)
    send("contact_set", np.repeat(np.arange(blocks.set_count), sizes))
    send("set_block_start", blocks.set_start)
    send("block_set", blocks.of_set)
    send("block_start", blocks.start)
    send("block_contact", blocks.contact)
    send("body_block_start", blocks.body_start)
    send("body_block", blocks.of_bodies)
    empty = np.zeros(0, dtype=np.intp)
    points = [contact.points.start + np.arange(contact.count) for contact in contacts]
    by_set = np.concatenate([empty, *points])
    by_block = by_set[blocks.contact]

    def middles(points: NDArray[np.intp], starts: NDArray[np.int32]) -> Array:
        if not len(points):
            return np.zeros((1, 0, 3))
        values = places()[:, points]
        low, high = (end.reduceat(values, starts, axis=1) for end in (np.minimum, np.maximum))
        return np.asarray(0.5 * (low + high), dtype=np.float64)

    def extents() -> Array:
        if not len(by_set):
            return np.zeros((1, 0))
        middle = np.repeat(middles(by_set, firsts), sizes, axis=1)
        far = np.linalg.norm(places()[:, by_set] - middle, axis=2)
        # A little more, for the rounding of both.
        return np.asarray((1.0 + 1.0e-5) * np.maximum.reduceat(far, firsts, axis=1), dtype=np.float64)

    return [
        parameters.upload(model, "set_center", t.vec3, lambda: middles(by_set, firsts)),
        parameters.upload(model, "set_extent", t.real, extents),
        parameters.upload(model, "block_center", t.vec3, lambda: middles(by_block, blocks.start[:-1])),
    ]


def _blocks_by_body(
    of_sets: NDArray[np.intp], contacts: list[Contact], body_count: int
) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    """Returns where the blocks of each body start in a list (bodies + 1), and the list of 2 × block + side.

    ``of_sets`` is how many blocks each set has.
    """
    empty = np.zeros(0, dtype=np.int32)
    on_points = [
        contact.points.body_numbers[:: 1 if contact.points.spread else contact.count] for contact in contacts
    ]
    on_surface = [
        np.full(contact.set_count, WORLD if contact.surface.body is None else contact.surface.body.index)
        for contact in contacts
    ]
    of_set = np.stack([np.concatenate([empty, *on_points]), np.concatenate([empty, *on_surface])], axis=1)
    bodies = np.repeat(of_set, of_sets, axis=0).ravel()
    entries = np.argsort(bodies, kind="stable")
    return _starts(np.bincount(bodies[bodies >= 0], minlength=body_count)), entries[(bodies < 0).sum() :]
