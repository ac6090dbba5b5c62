"""How a body may move relative to the world: free, with a joint, or as a function of time says."""

from warpcontact.kernels.motions.base import Motion
from warpcontact.kernels.motions.joints import Ball, Fixed, Free, Hinge, Planar, Slider, Translation
from warpcontact.kernels.motions.prescribed import Harmonic, Prescribed, Table

#: Every motion that comes with the library.
CATALOGUE: tuple[type[Motion], ...] = (
    Free,
    Fixed,
    Translation,
    Planar,
    Hinge,
    Slider,
    Ball,
    Prescribed,
    Harmonic,
    Table,
)

__all__ = [
    "CATALOGUE",
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
