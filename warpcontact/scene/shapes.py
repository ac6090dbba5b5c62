"""Shapes and shape contacts of a scene."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.types import WORLD
from warpcontact.scene.elements import Body, ContactMaterial
from warpcontact.validation.checks import Array

#: All groups.
ALL = 0xFFFFFFFF


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape of analytic form fixed to a body or to the world, or one on each body of a set.

    Positions, orientations and sizes have one entry for each, (n, …).
    """

    name: str
    body: Body | None
    kind: type[Form]
    sizes: dict[str, Array]  # the parameters of its form by name
    positions: Array  # (n, 3) origin of its frame in the frame of the body [m]
    orientations: Array  # (n, 4) rotation of its frame to that of the body, quaternion
    group: int  # bits
    mask: int  # bits
    color: Array | None
    visible: bool

    @property
    def count(self) -> int:
        """Number of shapes."""
        return len(self.positions)

    @property
    def single(self) -> bool:
        """Whether it is one, without an item axis."""
        return self.body is None or self.body.single

    @property
    def body_numbers(self) -> NDArray[np.int32]:
        """Body of each on the device (n,), or ``WORLD``."""
        if self.body is None:
            return np.full(1, WORLD, dtype=np.int32)
        return np.arange(self.body.items.start, self.body.items.stop, dtype=np.int32)

    def may_touch(self, other: "Shape") -> bool:
        """Whether groups and masks let it touch ``other``: each is in a group that the mask of the other has."""
        return bool(self.group & other.mask) and bool(other.group & self.mask)

    def form(self, item: int = 0) -> Form:
        """Returns the form of one of them."""
        return self.kind(**{key: _plain(values[item]) for key, values in self.sizes.items()})


def _plain(value: Array) -> Any:
    return tuple(value.tolist()) if np.ndim(value) else float(value)


@dataclass(frozen=True, eq=False)
class ShapeContact:
    """The contact of two shapes, or of the shapes of a set with one or with those of another set."""

    name: str
    shape: Shape
    other_shape: Shape
    material: ContactMaterial
    kappa: Array
    max_depth: Array
    torsion_radius: Array | None
    force_scale: Array
    enabled: Array
    color: Array | None
    visible: bool

    @property
    def kinds(self) -> tuple[type[Form], type[Form]]:
        """The classes of its shapes: contacts that agree in them share the code that finds where they meet."""
        return self.shape.kind, self.other_shape.kind

    @property
    def parts(self) -> ContactModel:
        """The classes of its law and friction models: contacts that agree in them share the code of their forces."""
        return self.material.parts

    @property
    def count(self) -> int:
        """Number of contacts."""
        return max(self.shape.count, self.other_shape.count)

    @property
    def single(self) -> bool:
        """Whether it is one, without an item axis."""
        return self.shape.single and self.other_shape.single

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """Its shapes."""
        return self.shape, self.other_shape

    @property
    def bodies(self) -> tuple[Body | None, Body | None]:
        """What its shapes are fixed to; ``None``: the world."""
        return self.shape.body, self.other_shape.body

    @property
    def formulas(self) -> dict[str, Formula]:
        """Its law and friction models by the name of their part."""
        return self.material.formulas
