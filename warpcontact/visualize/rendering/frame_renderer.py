"""Renders records of a drawing with a fixed camera and fixed light."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpcontact.drawing.colors import Scale
from warpcontact.drawing.drawing import Drawing
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering import sheet
from warpcontact.visualize.rendering.camera import (
    LEAST,
    Camera,
    bounding_spheres,
    direction,
    frame_spheres,
    moving,
)
from warpcontact.visualize.rendering.items import Items, curve_tube, force_arrows, place_figure
from warpcontact.visualize.rendering.painter import Painter, Picture
from warpcontact.visualize.rendering.render_style import RenderStyle
from warpcontact.visualize.rendering.sight import Visibility, best_camera, find_targets
from warpcontact.visualize.rendering.stage import Stage

# Width of arrows and lines, as a multiple of the size, and its range, in half heights of the view.
WIDTH = 0.03
MIN_WIDTH, MAX_WIDTH = 0.007, 0.02
# Largest length of arrows, in half heights of the view.
MAX_ARROW = 0.6


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
    """

    def __init__(
        self,
        drawing: Drawing,
        style: RenderStyle,
        coloring: Coloring | None = None,
        overview: Sequence[int] | None = None,
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
        self._places = sheet.places(len(self._panels), width, height)
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
        image[:] = sheet.GAP_COLOR
        for rows, (left, top, right, bottom) in zip(self._panels, self._places, strict=True):
            items = [group for group, _ in self._items(record, rows, self._width)]
            marks = self._arrows(record, rows) if self._style.forces else []
            image[top:bottom, left:right] = self._painter.paint(
                items, marks, self.camera, (right - left, bottom - top), samples
            )
        if self._style.labels:
            names = [f"environment {self.drawing.envs[rows[0]]}" for rows in self._panels]
            texts = names if len(self._panels) > 1 else [""]
            sheet.write(image, self._places, texts, "" if time is None else f"{time:.3f} s")
            if self._coloring is not None:
                sheet.write_scale(image, self._coloring.name, self._coloring.scale)
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
