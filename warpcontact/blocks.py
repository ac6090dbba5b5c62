"""Contacts in blocks that are near each other: what a thread works on, and leaves alone while all are far away."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.arrays import Layout
from warpcontact.checks import Array
from warpcontact.parameters import Parameters
from warpcontact.scene import Body, Contact

# Contacts of a block: so few that looking through them costs little, so many that a block is worth it.
LARGEST_BLOCK = 16


@dataclass(frozen=True)
class Blocks:
    """The blocks of all contacts.

    Attributes:
        set_start: First block of each set of contacts, and the end, (sets + 1,).
        start: First place of each block in the list of contacts, and the end, (blocks + 1,).
        contact: Contacts by block, (contacts,).
    """

    set_start: NDArray[np.int32]
    start: NDArray[np.int32]
    contact: NDArray[np.int32]

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.start) - 1

    def of_contacts(self, first: int, count: int) -> tuple[int, int]:
        """Returns the first block, and the number of blocks, of contacts side by side that make up whole sets."""
        begin, end = np.searchsorted(self.start, [first, first + count])
        return int(begin), int(end - begin)


def make_blocks(contacts: list[Contact]) -> Blocks:
    """Returns the blocks of contacts in the order of the device."""
    set_start, members = [0], []
    first = 0
    for contact in contacts:
        own = _neighbourhoods(contact.points.places)
        members += [first + block for block in own]
        first += contact.count
        set_start.append(len(members))
    start = np.cumsum([0] + [len(block) for block in members])
    empty = np.zeros(0, dtype=np.int32)
    return Blocks(
        np.array(set_start, dtype=np.int32),
        start.astype(np.int32),
        np.concatenate([empty, *members]).astype(np.int32),
    )


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
    bodies: list[Body],
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
        bodies: All bodies.
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

    sizes = np.diff(blocks.set_start)
    firsts = np.cumsum([0] + [contact.count for contact in contacts])
    send("set_contact", firsts[:-1])
    send("contact_set", np.repeat(np.arange(len(contacts)), np.diff(firsts)))
    send("set_block_start", blocks.set_start)
    send("block_set", np.repeat(np.arange(len(contacts)), sizes))
    send("block_start", blocks.start)
    send("block_contact", blocks.contact)
    of_body: list[list[int]] = [[] for _ in bodies]
    for number, contact in enumerate(contacts):
        for block in range(blocks.set_start[number], blocks.set_start[number + 1]):
            for side, body in enumerate((contact.points.body, contact.surface.body)):
                if body is not None:
                    of_body[body.index].append(2 * block + side)
    send("body_block_start", np.cumsum([0] + [len(own) for own in of_body]))
    send("body_block", [entry for own in of_body for entry in own])

    by_set = [contact.points.start + np.arange(contact.count) for contact in contacts]
    by_block = [
        contact.points.start + blocks.contact[blocks.start[block] : blocks.start[block + 1]] - first
        for number, (contact, first) in enumerate(zip(contacts, firsts, strict=False))
        for block in range(blocks.set_start[number], blocks.set_start[number + 1])
    ]

    def middles(members: Sequence[NDArray[np.integer]]) -> Array:
        values = places()
        if not members:
            return np.zeros((1, 0, 3))
        ends = [(values[:, own].min(axis=1), values[:, own].max(axis=1)) for own in members]
        return np.stack([0.5 * (low + high) for low, high in ends], axis=1)

    def extents() -> Array:
        values, middle = places(), middles(by_set)
        if not by_set:
            return np.zeros((1, 0))
        far = [
            np.linalg.norm(values[:, own] - middle[:, number, None], axis=2).max(axis=1)
            for number, own in enumerate(by_set)
        ]
        # A little more, for the rounding of both.
        return (1.0 + 1.0e-5) * np.stack(far, axis=1)

    return [
        parameters.upload(model, "set_center", t.vec3, lambda: middles(by_set)),
        parameters.upload(model, "set_extent", t.real, extents),
        parameters.upload(model, "block_center", t.vec3, lambda: middles(by_block)),
    ]
