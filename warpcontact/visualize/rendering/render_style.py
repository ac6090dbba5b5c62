"""Style of pictures: the validated options shared by stills and films."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
import warp as wp

from warpcontact.system.devices import find_device
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

#: sRGB colors at top and bottom of the background.
BACKGROUNDS = {
    "light": ((0.80, 0.85, 0.90), (0.96, 0.97, 0.98)),
    "white": ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0)),
    "dark": ((0.05, 0.06, 0.08), (0.16, 0.18, 0.21)),
}
#: Range of the sides of a picture [pixels], and of the number of rays per pixel.
SIDES = (16, 8192)
SAMPLES = (1, 1024)
# Candidate camera directions [°]: from the front, then from the sides, each with rising elevation; then from above.
_FRONT, _SIDES, _SLOPES = -60.0, (30.0, -150.0, 120.0), (22.0, 35.0, 50.0)
_VIEW_DIRECTIONS = [
    *((_FRONT, elevation) for elevation in _SLOPES),
    *((side, elevation) for elevation in _SLOPES for side in _SIDES),
    *((_FRONT, elevation) for elevation in (65.0, 80.0, 90.0)),
]
_HEX = re.compile(r"#([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})")


class RenderOptions(TypedDict, total=False):
    """Options of ``RenderStyle``; all are optional."""

    size: tuple[int, int]
    view_from: tuple[float, float] | None
    look_at: Sequence[float] | None
    distance: float | None
    fov: float
    forces: bool
    force_scale: float | None
    pressure: bool
    max_pressure: float | None
    together: bool
    color_by: str | None
    labels: bool
    background: str
    samples: int
    device: str
    threads: int | None


@dataclass(frozen=True)
class RenderStyle:
    """Style of pictures of a recording.

    Args:
        size: Width and height [pixels].
        view_from: Direction of the camera: azimuth, from the x axis towards the y axis, and elevation above the
            horizontal [degrees]. ``None``: −60 and 22, or a direction from which static items hide no moving bodies.
        look_at: Point at the center of the picture, world [m]; ``None``: the center of the moving bodies.
        distance: Distance from this point to the camera [m]; ``None``: so that all moving bodies are in the picture.
        fov: Vertical angle of view [degrees].
        forces: Whether to draw contact forces as arrows, for contacts with recorded normal force, normal and point.
        force_scale: Arrow length per force [m/N]; ``None``: the largest force is 1.5 times the largest body, or
            shorter if the picture is too small.
        pressure: Whether to color the areas of body contacts by pressure.
        max_pressure: Pressure of the upper end of the color scale [Pa]; ``None``: the largest one of the still or film.
        together: Whether to draw several environments in one panel instead of side by side.
        color_by: Parameter or outcome that colors the moving bodies, with one number per environment, or one equal
            for all items of a set.
        labels: Whether to write environment numbers, the time of a film, and the scales of ``color_by`` and pressure.
        background: ``"light"``, ``"white"``, ``"dark"`` or a color such as ``"#20242c"``.
        samples: Largest number of rays per pixel; fewer are used where they agree.
        device: Device for rendering: ``"auto"``, ``"cpu"``, ``"cuda:0"``, …
        threads: Number of CPU threads; ``None``: one per core. Does not change the picture.

    Raises:
        ValueError: If a value is invalid.
    """

    size: tuple[int, int] = (1280, 720)
    view_from: tuple[float, float] | None = None
    look_at: Sequence[float] | None = None
    distance: float | None = None
    fov: float = 30.0
    forces: bool = True
    force_scale: float | None = None
    pressure: bool = True
    max_pressure: float | None = None
    together: bool = False
    color_by: str | None = None
    labels: bool = True
    background: str = "light"
    samples: int = 16
    device: str = "auto"
    threads: int | None = None

    def __post_init__(self) -> None:
        sides = checks.numbers("size", self.size, (2,), limits("pixels", at_least=SIDES[0], at_most=SIDES[1]))
        checks.integers("size", sides)
        if self.view_from is not None:
            checks.numbers("view_from", self.view_from, (2,))
            checks.numbers("view_from[1]", self.view_from[1], (), limits("degrees", at_least=-90.0, at_most=90.0))
        if self.look_at is not None:
            checks.numbers("look_at", self.look_at, (3,))
        if self.distance is not None:
            checks.numbers("distance", self.distance, (), limits("m", above=0.0))
        if self.force_scale is not None:
            checks.numbers("force_scale", self.force_scale, (), limits("m/N", above=0.0))
        checks.numbers("fov", self.fov, (), limits("degrees", at_least=1.0, at_most=120.0))
        for name, least, most in (("samples", *SAMPLES), ("threads", 1, 4096)):
            value = getattr(self, name)
            if value is not None:
                number = checks.numbers(name, value, (), limits("-", at_least=least, at_most=most))
                checks.integers(name, number)
        if self.max_pressure is not None:
            checks.numbers("max_pressure", self.max_pressure, (), limits("Pa", above=0.0))
        for name in ("forces", "pressure", "together", "labels"):
            checks.switch(name, getattr(self, name))
        self.background_colors()

    def background_colors(self) -> Array:
        """Returns the sRGB colors at top and bottom, (2, 3) in 0…1."""
        if isinstance(self.background, str) and (found := _HEX.fullmatch(self.background)):
            return np.array([[int(part, 16) / 255.0 for part in found.groups()]] * 2)
        if self.background not in BACKGROUNDS:
            named = ", ".join(map(repr, BACKGROUNDS))
            raise ValueError(
                f"background must be one of {named}, or a color such as #20242c, got {self.background!r}"
            )
        return np.array(BACKGROUNDS[self.background])

    def find_device(self) -> wp.Device:
        """Returns the device for rendering."""
        return find_device(self.device)

    @property
    def view_directions(self) -> list[tuple[float, float]]:
        """Candidate azimuths and elevations of the camera [rad]; the first with a clear view is chosen."""
        view_directions = _VIEW_DIRECTIONS if self.view_from is None else [self.view_from]
        return [
            (math.radians(float(azimuth)), math.radians(float(elevation)))
            for azimuth, elevation in view_directions
        ]


def environment_numbers(env: Any) -> list[int] | None:
    """Returns the selected environments as a list; ``None``: the first of the recording."""
    return None if env is None else checks.entries(env)
