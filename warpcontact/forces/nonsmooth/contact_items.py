"""Items of nonsmooth contacts: lists and ranges of their numbers, working memory, and pairs of bodies with several contacts."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.types import WORLD
from warpcontact.scene.body_contact import BodyContact
from warpcontact.scene.elements import Contact
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.shapes import ShapeContact


@dataclass(eq=False)
class Scratch:
    """Working memory of a solver.

    Attributes:
        rows: Data of each row [env, row]; ``None`` before allocation.
    """

    rows: Any = None


@dataclass
class ItemList:
    """List of the nonsmooth items of an array of contacts.

    Attributes:
        first: Contact number of the first item of the array.
        numbers: Indices of the nonsmooth items.
        items: These indices, on the device.
    """

    first: int
    numbers: NDArray[np.int_]
    items: Any = None

    @property
    def count(self) -> int:
        """Number of nonsmooth items."""
        return len(self.numbers)


def slice_of(first: int, count: int) -> slice:
    """Returns the range of ``count`` items from ``first``."""
    return slice(first, first + count)


def runs_of(ranges: Iterable[slice]) -> list[tuple[int, int]]:
    """Returns ascending ranges as (first, count), with adjacent ones merged."""
    runs: list[tuple[int, int]] = []
    for own in ranges:
        if runs and sum(runs[-1]) == own.start:
            runs[-1] = (runs[-1][0], own.stop - runs[-1][0])
        else:
            runs.append((own.start, own.stop - own.start))
    return runs


def share_loads(contacts: Collection[Contact | ShapeContact | BodyContact | ParticleContact]) -> bool:
    """Returns whether two bodies may have several contacts, between which equilibrium does not determine the loads."""
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for contact in contacts:
        if isinstance(contact, BodyContact):
            return True
        if isinstance(contact, ParticleContact):
            # Each pair of particles has one contact.
            numbers = np.concatenate([shape.body_numbers for shape in contact.shapes])
            if len(np.unique(numbers)) < len(numbers):
                return True
            continue
        if isinstance(contact, ShapeContact):
            sides = [contact.shape.body_numbers, contact.other_shape.body_numbers]
        else:
            surface = contact.surface.body
            sides = [contact.points.body_numbers, np.array([WORLD if surface is None else surface.index])]
        pairs.append(np.stack([np.broadcast_to(side, contact.count) for side in sides], axis=1))
    every = np.sort(np.concatenate(pairs), axis=1)
    return len(np.unique(every, axis=0)) < len(every)
