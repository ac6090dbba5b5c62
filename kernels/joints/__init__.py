"""Joints of bodies relative to the world, and prescribed motion as a function of time."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names
from warpcontact.kernels.joints.base import Motion

if TYPE_CHECKING:
    from warpcontact.kernels.joints.base import Ball, Fixed, Free, Hinge, Planar, Slider, Translation
    from warpcontact.kernels.joints.prescribed import Harmonic, Prescribed, Table

    CATALOGUE: tuple[type[Motion], ...]

# Modules of the motions of the library.
_CATALOGUE = {
    "Free": "base",
    "Fixed": "base",
    "Translation": "base",
    "Planar": "base",
    "Hinge": "base",
    "Slider": "base",
    "Ball": "base",
    "Prescribed": "prescribed",
    "Harmonic": "prescribed",
    "Table": "prescribed",
}

#: Names of all motions.
NAMES = tuple(_CATALOGUE)

__all__ = [
    "CATALOGUE",
    "NAMES",
    "Ball",
    "Fixed",
    "Free",
    "Harmonic",
    "Hinge",
    "Motion",
    "Planar",
    "Prescribed",
    "Slider",
    "Table",
    "Translation",
]

if not TYPE_CHECKING:  # there it would know every name
    __getattr__, __dir__ = lazy_names(__name__, _CATALOGUE, {"CATALOGUE": NAMES})
