"""How a body may move relative to the world: free, with a joint, or as a function of time says."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.lazy_catalogue import lazy_names
from warpcontact.kernels.joints.base import Motion

if TYPE_CHECKING:
    from warpcontact.kernels.joints.joints import Ball, Fixed, Free, Hinge, Planar, Slider, Translation
    from warpcontact.kernels.joints.prescribed import Harmonic, Prescribed, Table

    CATALOGUE: tuple[type[Motion], ...]

# Modules of all motions that come with the library.
_CATALOGUE = {
    "Free": "joints",
    "Fixed": "joints",
    "Translation": "joints",
    "Planar": "joints",
    "Hinge": "joints",
    "Slider": "joints",
    "Ball": "joints",
    "Prescribed": "prescribed",
    "Harmonic": "prescribed",
    "Table": "prescribed",
}

#: The names of all motions.
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
