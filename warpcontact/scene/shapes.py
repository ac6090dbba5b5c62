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
    """An analytic shape fixed to a body or to the world, or one shape on each body of a set.

    Positions, orientations and sizes have one entry per shape, (n, …).
    """

    name: str
    body: Body | None
    kind: type[Form]
    sizes: dict[str, Array]  # parameters of its form by name
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
        """Whether it is a single shape, without an item axis."""
        return self.body is None or self.body.single

    @property
    def body_numbers(self) -> NDArray[np.int32]:
        """Body index of each shape on the device (n,), or ``WORLD``."""
        if self.body is None:
            return np.full(1, WORLD, dtype=np.int32)
        return np.arange(self.body.items.start, self.body.items.stop, dtype=np.int32)

    def may_touch(self, other: "Shape") -> bool:
        """Returns whether groups and masks allow contact: each shape is in a group of the mask of the other."""
        return bool(self.group & other.mask) and bool(other.group & self.mask)

    def form(self, item: int = 0) -> Form:
        """Returns the form of one item."""
        return self.kind(**{key: _plain(values[item]) for key, values in self.sizes.items()})


def _plain(value: Array) -> Any:
    return tuple(value.tolist()) if np.ndim(value) else float(value)


@dataclass(frozen=True, eq=False)
class ShapeContact:
    """Contact of two shapes, or of the shapes of a set with one shape or with those of another set."""

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
        """Classes of its forms, for which the narrow phase is compiled."""
        return self.shape.kind, self.other_shape.kind

    @property
    def parts(self) -> ContactModel:
        """The contact model: classes of law and friction models, for which a kernel is compiled."""
        return self.material.parts

    @property
    def count(self) -> int:
        """Number of contacts."""
        return max(self.shape.count, self.other_shape.count)

    @property
    def single(self) -> bool:
        """Whether it is a single contact, without an item axis."""
        return self.shape.single and self.other_shape.single

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """Its shapes."""
        return self.shape, self.other_shape

    @property
    def bodies(self) -> tuple[Body | None, Body | None]:
        """Bodies of its shapes; ``None``: the world."""
        return self.shape.body, self.other_shape.body

    @property
    def formulas(self) -> dict[str, Formula]:
        """Its law and friction models, by name of the part."""
        return self.material.formulas
