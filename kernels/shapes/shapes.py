"""Catalogue of analytic shapes. Each shape is one file; `_CATALOGUE` lists it."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names
from warpcontact.kernels.shapes.base import Shape

if TYPE_CHECKING:
    from warpcontact.kernels.shapes.capsule import Capsule
    from warpcontact.kernels.shapes.cone import Cone
    from warpcontact.kernels.shapes.cylinder import Cylinder
    from warpcontact.kernels.shapes.ellipsoid import Ellipsoid
    from warpcontact.kernels.shapes.plane import Plane
    from warpcontact.kernels.shapes.rounded_box import RoundedBox
    from warpcontact.kernels.shapes.sphere import Sphere
    from warpcontact.kernels.shapes.superellipsoid import Superellipsoid
    from warpcontact.kernels.shapes.torus import Torus

    CATALOGUE: tuple[type[Shape], ...]

# Modules of all built-in shapes.
_CATALOGUE = {
    "Sphere": "sphere",
    "Plane": "plane",
    "Ellipsoid": "ellipsoid",
    "Superellipsoid": "superellipsoid",
    "Cylinder": "cylinder",
    "Capsule": "capsule",
    "Cone": "cone",
    "RoundedBox": "rounded_box",
    "Torus": "torus",
}

#: The names of all shapes.
NAMES = tuple(_CATALOGUE)

__all__ = [
    "CATALOGUE",
    "NAMES",
    "Capsule",
    "Cone",
    "Cylinder",
    "Ellipsoid",
    "Plane",
    "RoundedBox",
    "Shape",
    "Sphere",
    "Superellipsoid",
    "Torus",
]

if not TYPE_CHECKING:  # a type checker would accept any name
    __getattr__, __dir__ = lazy_names(__name__, _CATALOGUE, {"CATALOGUE": tuple(_CATALOGUE)})
