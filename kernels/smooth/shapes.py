"""Surfaces of analytic form. A shape is one file; a line here puts it into the catalogue."""

from warpcontact.kernels.smooth.base import Shape
from warpcontact.kernels.smooth.capsule import Capsule
from warpcontact.kernels.smooth.cone import Cone
from warpcontact.kernels.smooth.cylinder import Cylinder
from warpcontact.kernels.smooth.ellipsoid import Ellipsoid
from warpcontact.kernels.smooth.plane import Plane
from warpcontact.kernels.smooth.rounded_box import RoundedBox
from warpcontact.kernels.smooth.sphere import Sphere
from warpcontact.kernels.smooth.superellipsoid import Superellipsoid
from warpcontact.kernels.smooth.torus import Torus

#: Every shape that comes with the library.
CATALOGUE: tuple[type[Shape], ...] = (
    Sphere,
    Plane,
    Ellipsoid,
    Superellipsoid,
    Cylinder,
    Capsule,
    Cone,
    RoundedBox,
    Torus,
)

__all__ = [
    "CATALOGUE",
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
