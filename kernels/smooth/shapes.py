"""Surfaces of analytic form. A shape is one file; `_CATALOGUE` puts it into the catalogue."""

from typing import TYPE_CHECKING

from warpcontact.kernels.on_demand import lazy_names
from warpcontact.kernels.smooth.base import Shape

if TYPE_CHECKING:
    from warpcontact.kernels.smooth.capsule import Capsule
    from warpcontact.kernels.smooth.cone import Cone
    from warpcontact.kernels.smooth.cylinder import Cylinder
    from warpcontact.kernels.smooth.ellipsoid import Ellipsoid
    from warpcontact.kernels.smooth.plane import Plane
    from warpcontact.kernels.smooth.rounded_box import RoundedBox
    from warpcontact.kernels.smooth.sphere import Sphere
    from warpcontact.kernels.smooth.superellipsoid import Superellipsoid
    from warpcontact.kernels.smooth.torus import Torus

    CATALOGUE: tuple[type[Shape], ...]

# Modules of all shapes that come with the library.
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

if not TYPE_CHECKING:  # there it would know every name
    __getattr__, __dir__ = lazy_names(__name__, _CATALOGUE, {"CATALOGUE": tuple(_CATALOGUE)})
