"""Renders records of a drawing with a fixed camera and fixed light: panels, arrows and labels."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.drawing.colors import Scale, pressure_scale
from warpcontact.drawing.drawing import Drawing, Figure
from warpcontact.validation import safe_text
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.camera import (
    LEAST,
    Camera,
    Visibility,
    best_camera,
    bounding_spheres,
    direction,
    find_targets,
    frame_spheres,
    moving,
)
from warpcontact.visualize.rendering.painter import Painter, Picture
from warpcontact.visualize.rendering.render_style import RenderStyle
from warpcontact.visualize.rendering.stage import (
    Items,
    Stage,
    curve_tube,
    force_arrows,
    patch_figure,
    place_figure,
)

Place = tuple[int, int, int, int]

# Space between panels [pixels], and its color.
GAP = 3
GAP_COLOR = (255, 255, 255)
# Preferred ratio of panel width to height.
_SHAPE = 1.4
# Letter height as a fraction of the picture height; preferred minimum and readable minimum [pixels].
_LETTERS, _SMALLEST, _READABLE = 0.034, 13, 7
# Largest width of a text, as a fraction of the panel width.
_WIDEST = 0.45
# Largest number of letters in the name of a color scale.
_LONGEST = 24

# Width of arrows and lines, as a multiple of the size, and its range, in half heights of the view.
WIDTH = 0.03
MIN_WIDTH, MAX_WIDTH = 0.007, 0.02
# Largest length of arrows, in half heights of the view.
MAX_ARROW = 0.6


def panel_places(count: int, width: int, height: int) -> list[Place]:
    """Returns equally sized panels of a picture, row by row: left, top, right, bottom [pixels].

    Raises:
        ValueError: If they do not fit.
    """

    def side(total: int, parts: int) -> int:
        return (total - GAP * (parts - 1)) // parts

    def mismatch(columns: int) -> float:
        rows = math.ceil(count / columns)
        wide, high = side(width, columns), side(height, rows)
        if wide < 16 or high < 16:
            return math.inf
        # Empty cells are penalized as well.
        return abs(math.log(wide / high / _SHAPE)) + 0.3 * (rows * columns - count) / count

    columns = min(range(1, count + 1), key=mismatch)
    rows = math.ceil(count / columns)
    wide, high = side(width, columns), side(height, rows)
    if mismatch(columns) == math.inf:
        raise ValueError(
            f"size must be sufficient for {count} panels, got {width} × {height} pixels; "
            "together=True draws all environments in one panel"
        )
    # Center the panels in the picture.
    left = (width - columns * wide - GAP * (columns - 1)) // 2
    top = (height - rows * high - GAP * (rows - 1)) // 2
    corners = [divmod(panel, columns) for panel in range(count)]
    starts = [(left + column * (wide + GAP), top + row * (high + GAP)) for row, column in corners]
    return [(x, y, x + wide, y + high) for x, y in starts]


def write_labels(picture: NDArray[np.uint8], panels: list[Place], texts: list[str], last: str) -> None:
    """Writes a text into the upper left corner of each panel, and ``last`` into the lower left of the first.

    Nothing is written if the letters would be too small to read.
    """
    from PIL import Image, ImageDraw

    if not any(texts) and not last:
        return
    letters = _letters(panels[0], [*texts, last])
    if letters < _READABLE:
        return
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for (left, top, _, bottom), text in zip(panels, texts, strict=True):
        edge = letters // 2
        ink = _ink(picture, left, top, letters)
        draw.text((left + edge, top + edge), text, fill=ink, font=_font(letters))
        if last:
            ink = _ink(picture, left, bottom - 2 * letters, letters)
            draw.text((left + edge, bottom - edge), last, fill=ink, font=_font(letters), anchor="ls")
            last = ""
    picture[:] = np.asarray(image)


def write_scale(picture: NDArray[np.uint8], name: str, scale: Scale, row: int = 0) -> None:
    """Draws the color scale in the upper right corner, with its lowest and highest number; ``row``: below so many others."""
    from PIL import Image, ImageDraw

    height, width = picture.shape[:2]
    low, high = (scale.low, scale.high) if scale.low <= scale.high else (math.nan, math.nan)
    name, ends = (
        safe_text.truncate(safe_text.single_line(name), _LONGEST, middle=True),
        (f"{low:.3g}", f"{high:.3g}"),
    )
    letters = _letters((0, 0, width, height), [name, "  ".join(ends)])
    if letters < _READABLE:
        return
    font = _font(letters)
    long = max(width // 5, math.ceil(font.getlength("  ".join(ends))))
    thick, edge = max(letters // 2, 4), letters
    right, top = width - edge, edge // 2 + row * (4 * letters + thick)
    ink = _ink(picture, right - long, top, letters)
    bar = Scale(0.0, 1.0, scale.colormap).colors(np.linspace(0.0, 1.0, long))
    below = top + int(1.5 * letters)
    picture[below : below + thick, right - long : right] = (255.0 * bar + 0.5).astype(np.uint8)
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    draw.text((right, top), name, fill=ink, font=font, anchor="ra")
    draw.text((right - long, below + thick + edge // 4), ends[0], fill=ink, font=font)
    draw.text((right, below + thick + edge // 4), ends[1], fill=ink, font=font, anchor="ra")
    picture[:] = np.asarray(image)


def _letters(panel: Place, texts: list[str]) -> int:
    """Returns the letter height at which each of the texts fits into a panel [pixels]."""
    left, top, right, bottom = panel
    wanted = max(_SMALLEST, round(_LETTERS * min(bottom - top, right - left)))
    longest = max(_font(wanted).getlength(text) for text in texts)
    return int(wanted * min(1.0, _WIDEST * (right - left) / max(longest, 1.0)))


def _ink(picture: NDArray[np.uint8], left: int, top: int, letters: int) -> tuple[int, int, int]:
    """Returns a dark or light color, whichever has more contrast with the picture at a position."""
    under = picture[max(top, 0) : top + 2 * letters, max(left, 0) : left + 8 * letters]
    return (25, 28, 32) if under.mean() > 110.0 else (240, 242, 245)


@functools.cache
def _font(letters: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(letters)


@dataclass(frozen=True, eq=False)
class Coloring:
    """Colors of environments by one number each.

    Attributes:
        name: Name of the quantity.
        scale: Color scale.
        colors: sRGB colors, (env, 3).
    """

    name: str
    scale: Scale
    colors: Array

    @classmethod
    def of(cls, name: str, values: Array) -> "Coloring":
        """Returns the colors of one number per environment, (env,); gray for NaN."""
        scale = Scale().widened(values)
        return cls(name, scale, scale.colors(values))


class FrameRenderer:
    """Renders records of a drawing.

    Args:
        drawing: Drawing to render.
        style: Style of the pictures.
        coloring: Colors of moving items by environment; ``None``: their own colors.
        overview: Indices of the records that determine camera and arrow length; ``None``: all.
        shown: Indices of the records that determine the color scale of pressure; ``None``: all.
    """

    def __init__(
        self,
        drawing: Drawing,
        style: RenderStyle,
        coloring: Coloring | None = None,
        overview: Sequence[int] | None = None,
        shown: Sequence[int] | None = None,
    ) -> None:
        self.drawing = drawing
        self._style = style
        self._coloring = coloring
        self._stage = Stage(drawing, style.find_device())
        self._painter = Painter(self._stage, style.background_colors(), style.threads)
        self._moves = moving(drawing)
        rows = list(range(len(drawing.envs)))
        # Environment rows of each panel.
        self._panels = [rows] if style.together else [[row] for row in rows]
        width, height = style.size
        self._places = panel_places(len(self._panels), width, height)
        left, top, right, bottom = self._places[0]
        overview = range(len(drawing.times)) if overview is None else overview
        self._force_scale = (
            _force_scale(drawing, overview) if style.force_scale is None else float(style.force_scale)
        )
        self.camera = self._camera(overview, (right - left) / (bottom - top))
        reach = self.camera.reach
        self._width = min(max(WIDTH * drawing.size, MIN_WIDTH * reach), MAX_WIDTH * reach)
        if style.force_scale is None and (largest := _largest(drawing, range(len(drawing.times)))) > 0.0:
            self._force_scale = min(self._force_scale, MAX_ARROW * reach / largest)
        self._pressure = self._pressure_scale(range(len(drawing.times)) if shown is None else shown)

    def picture(self, record: int, time: float | None = None, samples: int | None = None) -> Picture:
        """Renders a record; returns a picture, (height, width, 3) sRGB.

        Args:
            record: Index of the record in the drawing.
            time: Time to write into the picture [s]; ``None``: none.
            samples: Largest number of rays per pixel; ``None``: that of the style.
        """
        samples = self._style.samples if samples is None else samples
        width, height = self._style.size
        image = np.empty((height, width, 3), dtype=np.uint8)
        image[:] = GAP_COLOR
        for rows, (left, top, right, bottom) in zip(self._panels, self._places, strict=True):
            items = [group for group, _ in self._items(record, rows, self._width)]
            marks = self._arrows(record, rows) if self._style.forces else []
            patches = self._patches(record, rows)
            mark_stage = Stage(replace(self.drawing, figures=patches), self._stage.device) if patches else None
            marks += [replace(place_figure(patch, 0, 0), unlit=True) for patch in patches]
            image[top:bottom, left:right] = self._painter.paint(
                items, marks, self.camera, (right - left, bottom - top), samples, mark_stage
            )
        if self._style.labels:
            names = [f"environment {self.drawing.envs[rows[0]]}" for rows in self._panels]
            texts = names if len(self._panels) > 1 else [""]
            write_labels(image, self._places, texts, "" if time is None else f"{time:.3f} s")
            if self._coloring is not None:
                write_scale(image, self._coloring.name, self._coloring.scale)
            if self._pressure is not None:
                write_scale(image, "pressure [Pa]", self._pressure, 0 if self._coloring is None else 1)
        return image

    def _items(self, record: int, rows: list[int], width: float) -> list[tuple[Items, bool]]:
        """Returns the items of some environments, and whether they move; static ones once. ``width``: of lines [m]."""
        found = []
        for figure, moves in zip(self.drawing.figures, self._moves, strict=True):
            for row in rows if moves else rows[:1]:
                color = self._coloring.colors[row] if self._coloring is not None and moves else None
                found.append(
                    (place_figure(figure, record, row, color=color, has_grid=not moves, least=width), moves)
                )
        for curve in self.drawing.curves:
            for row in rows:
                found += [(group, True) for group in curve_tube(curve, record, row, width)]
        return found

    def _arrows(self, record: int, rows: list[int]) -> list[Items]:
        return [
            group
            for contact in self.drawing.contact_forces
            for row in rows
            for group in force_arrows(contact, record, row, self._force_scale, self._width)
        ]

    def _pressure_scale(self, shown: Sequence[int]) -> Scale | None:
        """Returns the color scale of pressure; ``None`` if no contact has a pressure in the shown records."""
        pressure, style = self.drawing.pressure, self._style
        if pressure is None or not style.pressure:
            return None
        if style.max_pressure is not None:
            return pressure_scale(float(style.max_pressure))
        largest = pressure.peak(shown, range(len(self.drawing.envs)))
        return pressure_scale(largest) if largest > 0.0 else None

    def _patches(self, record: int, rows: list[int]) -> list[Figure]:
        """Returns the areas of body contacts of some environments, colored by pressure."""
        pressure = self.drawing.pressure
        if pressure is None or self._pressure is None:
            return []
        figures = (patch_figure(one, self._pressure) for row in rows for one in pressure.at(record, row))
        return [one for one in figures if one is not None]

    def _camera(self, overview: Sequence[int], aspect: float) -> Camera:
        rows = list(range(len(self.drawing.envs)))
        items = [
            (group, moves)
            for record in overview
            for group, moves in self._items(record, rows, WIDTH * self.drawing.size)
            if moves or record == overview[0]
        ]
        centers, radii = bounding_spheres(self.drawing, items)
        if self._style.forces:
            tips = [
                (points + self._force_scale * forces)[(forces != 0.0).any(axis=-1)]
                for contact in self.drawing.contact_forces
                for points, forces in [(contact.points[list(overview)], contact.forces[list(overview)])]
            ]
            centers = np.concatenate([centers, *tips])
            radii = np.concatenate([radii, np.zeros(len(centers) - len(radii))])
        target = None if self._style.look_at is None else np.array(self._style.look_at, dtype=np.float64)
        cameras = [
            frame_spheres(
                centers,
                radii,
                direction(azimuth, elevation),
                math.radians(float(self._style.fov)),
                aspect,
                target=target,
                distance=None if self._style.distance is None else float(self._style.distance),
                least=LEAST * self.drawing.size,
            )
            for azimuth, elevation in self._style.view_directions
        ]
        if len(cameras) == 1:
            return cameras[0]
        panels = find_targets(self.drawing, self._panels, overview)
        return best_camera(Visibility(self._stage, panels, cameras[0]), cameras, aspect)


def _largest(drawing: Drawing, records: Sequence[int]) -> float:
    """Returns the largest force in some records [N]."""
    forces = (np.linalg.norm(contact.forces[list(records)], axis=-1) for contact in drawing.contact_forces)
    return max((float(sizes.max(initial=0.0)) for sizes in forces), default=0.0)


def _force_scale(drawing: Drawing, records: Sequence[int]) -> float:
    """Returns the arrow length per force [m/N] at which the largest force in some records has the default length."""
    largest, of_all = (_largest(drawing, some) for some in (records, range(len(drawing.times))))
    return drawing.force_scale * of_all / largest if largest > 0.0 else drawing.force_scale
