"""Contact between analytic shapes: shape classes, which `_CATALOGUE` lists, pair algorithms and kernels."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names
from warpcontact.kernels.shapes.base import Shape

if TYPE_CHECKING:
    from warpcontact.kernels.shapes.base import Plane
    from warpcontact.kernels.shapes.revolution import Cone, Cylinder, Torus
    from warpcontact.kernels.shapes.rounded_box import RoundedBox
    from warpcontact.kernels.shapes.spheres import Capsule, Ellipsoid, Sphere
    from warpcontact.kernels.shapes.superellipsoid import Superellipsoid

    CATALOGUE: tuple[type[Shape], ...]

# Modules of all built-in shapes.
_CATALOGUE = {
    "Sphere": "spheres",
    "Plane": "base",
    "Ellipsoid": "spheres",
    "Superellipsoid": "superellipsoid",
    "Cylinder": "revolution",
    "Capsule": "spheres",
    "Cone": "revolution",
    "RoundedBox": "rounded_box",
    "Torus": "revolution",
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
