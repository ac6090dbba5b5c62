"""Shapes with curved surfaces as solids of body contacts: their geometry and scale."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.body_contact.curved_solids import CAPSULE, CONE, CYLINDER, ELLIPSOID
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.revolution import Cone, Cylinder
from warpcontact.kernels.shapes.rounded_box import RoundedBox
from warpcontact.kernels.shapes.spheres import Capsule, Ellipsoid, Sphere
from warpcontact.scene.body_contact import Solid
from warpcontact.scene.shapes import Shape
from warpcontact.validation.checks import Array

_ONES = np.ones(3)


class CurvedKind(NamedTuple):
    """How a class of shapes is described on the device."""

    flag: int  # of its geometry
    sizes: tuple[str, ...]  # parameters from which its scale follows
    lower: Array  # of its bounding box, in units of its scale (3,)
    upper: Array


#: Classes of curved shapes.
CURVED_KINDS: dict[type[Form], CurvedKind] = {
    Sphere: CurvedKind(ELLIPSOID, ("radius",), -_ONES, _ONES),
    Ellipsoid: CurvedKind(ELLIPSOID, ("semi_axes",), -_ONES, _ONES),
    Cylinder: CurvedKind(CYLINDER, ("radius", "half_length"), -_ONES, _ONES),
    Cone: CurvedKind(CONE, ("radius", "height"), np.array([-1.0, -1.0, 0.0]), _ONES),
    Capsule: CurvedKind(CAPSULE, ("radius", "half_length"), -_ONES, _ONES),
}


def is_curved(solid: Solid) -> bool:
    """Returns whether a solid has a curved surface."""
    return isinstance(solid, Shape) and solid.kind in CURVED_KINDS


def size_names(kind: type[Form]) -> list[str]:
    """Returns the parameters from which the scale of a shape follows, without the radius of the edges of a box."""
    if kind in CURVED_KINDS:
        return list(CURVED_KINDS[kind].sizes)
    return ["half_extents"] if kind is RoundedBox else []


def curved_scale(kind: type[Form], sizes: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Returns the scale of a curved shape, (env, 3), with one row if all environments share its sizes [m].

    Args:
        kind: Class of the shape.
        sizes: Values of its parameters, (env, 1) or (env, 3) each [m].
    """
    envs = max(len(one) for one in sizes)
    if len(sizes) == 1:
        return np.broadcast_to(sizes[0], (envs, 3))
    radius, length = (np.broadcast_to(one, (envs, 1)) for one in sizes)
    if kind is Capsule:
        length = length + radius
    return np.concatenate([radius, radius, length], axis=1)
