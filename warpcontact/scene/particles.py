"""Particle contacts of a scene."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.scene.elements import ContactMaterial
from warpcontact.scene.shapes import Shape
from warpcontact.validation.checks import Array


@dataclass(frozen=True, eq=False)
class ParticleContact:
    """Contact between all pairs of spheres and capsules (particles).

    Particles are numbered in the order of ``shapes``, those of a set consecutively.
    """

    name: str
    shapes: tuple[Shape, ...]
    material: ContactMaterial
    excluded: tuple[tuple[Shape, Shape], ...]
    skin: float  # extra distance of the neighbor lists [m]
    max_neighbors: int | None  # maximum number of neighbors; None: the number that fits around a particle
    kappa: Array
    max_depth: Array
    torsion_radius: Array | None
    force_scale: Array
    enabled: Array
    color: Array | None
    visible: bool
    # Number of the first particle of each element of ``shapes``, and the total number.
    starts: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        starts = np.cumsum([0, *(shape.count for shape in self.shapes)]).tolist()
        object.__setattr__(self, "starts", tuple(starts))

    @property
    def count(self) -> int:
        """Number of particles."""
        return self.starts[-1]

    @property
    def parts(self) -> ContactModel:
        """The classes of law and friction models."""
        return self.material.parts

    @property
    def formulas(self) -> dict[str, Formula]:
        """The law and the friction models, by name of the part."""
        return self.material.formulas

    @cached_property
    def bodies(self) -> NDArray[np.int32]:
        """Body index of each particle on the device (n,)."""
        return np.concatenate([shape.body_numbers for shape in self.shapes])

    @cached_property
    def kinds(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """A kind for each particle (n,), and whether two kinds can be in contact, 0 or 1 (kinds, kinds)."""
        named = {shape for pair in self.excluded for shape in pair}
        keys = [(shape.group, shape.mask, shape if shape in named else None) for shape in self.shapes]
        number = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        example = {number[key]: shape for key, shape in zip(reversed(keys), reversed(self.shapes), strict=True)}
        allowed = np.array(
            [[example[i].may_touch(example[j]) for j in range(len(number))] for i in range(len(number))]
        )
        for one, other in self.excluded:
            i, j = (number[one.group, one.mask, one], number[other.group, other.mask, other])
            allowed[i, j] = allowed[j, i] = False
        each = [number[key] for key in keys]
        counts = [shape.count for shape in self.shapes]
        return np.repeat(np.array(each, dtype=np.int32), counts), allowed.astype(np.int32)

    def label(self, number: int) -> str:
        """Returns the label of a particle by its number: the name of its shape, with the item for a set."""
        which = int(np.searchsorted(self.starts, number, side="right")) - 1
        shape = self.shapes[which]
        return shape.name if shape.single else f"{shape.name}[{number - self.starts[which]}]"
