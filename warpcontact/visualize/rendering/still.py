"""Stills: one picture of a recording."""

from collections.abc import Iterable
from dataclasses import dataclass
from os import PathLike
from typing import Any, Unpack

from PIL import Image

from warpcontact.building.scene import Scene
from warpcontact.files.atomic_files import atomic_file
from warpcontact.files.picture_file import check_path
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks
from warpcontact.visualize.rendering.frame_renderer import Coloring, FrameRenderer
from warpcontact.visualize.rendering.painter import Picture
from warpcontact.visualize.rendering.records import Source
from warpcontact.visualize.rendering.render_style import RenderOptions, RenderStyle

STILL = (".png",)


@dataclass(frozen=True, eq=False)
class Still:
    """Picture with information about it.

    Attributes:
        picture: (height, width, 3) sRGB.
        envs: Numbers of the environments.
        time: Simulated time of the record [s].
        forces: Whether the drawing has contact forces.
        partial: Whether later records are missing, because the run is not finished.
    """

    picture: Picture
    envs: list[int]
    time: float
    forces: bool
    partial: bool


@explain_keywords
def render(
    recording: Any,
    path: str | PathLike[str] | None = None,
    *,
    env: int | Iterable[int] | None = None,
    time: float | None = None,
    scene: Scene | None = None,
    **style: Unpack[RenderOptions],
) -> Picture:
    """Renders one record of a recording.

    Args:
        recording: Result of ``wc.open_run`` or ``Simulation.run``, with the poses of all bodies.
        path: A .png file to write; ``None``: writes none.
        env: Numbers of the environments, shown side by side; ``None``: the first.
        time: Simulated time [s]; the nearest record is drawn. ``None``: the last record, or, for an unfinished run, the
            last that all of these environments have.
        scene: Scene of the recording; ``None``: the scene stored with the recording.
        **style: Size, camera and more; see ``RenderOptions`` and docs/pictures.md.

    Returns:
        The picture, (height, width, 3) sRGB in 0…255.

    Raises:
        ValueError: If the file cannot be written, an environment, time or pose is missing in the recording, or an
            option is invalid.
        TypeError: If ``recording`` is not a recording.
        OSError: If writing fails.
    """
    return still(recording, path, env=env, time=time, scene=scene, style=RenderStyle(**style)).picture


def still(
    recording: Any,
    path: str | PathLike[str] | None,
    *,
    env: int | Iterable[int] | None,
    time: float | None,
    scene: Scene | None,
    style: RenderStyle,
) -> Still:
    """Renders one record with a validated style, and returns it with information; see ``render``."""
    file = None if path is None else check_path(path, STILL)
    source = Source.of(recording, scene, env)
    requested = source.times[-1] if time is None else checks.numbers("time", time, ())
    record = int(source.nearest(requested))
    overview = source.overview()
    records = sorted({*overview, record})
    drawing = source.drawing(records)
    coloring = None
    if style.color_by is not None:
        coloring = Coloring.of(style.color_by, source.numbers(style.color_by, drawing.envs))
    frame_renderer = FrameRenderer(drawing, style, coloring, [records.index(number) for number in overview])
    picture = frame_renderer.picture(records.index(record))
    if file is not None:
        with atomic_file(file) as opened:
            Image.fromarray(picture).save(opened, format="png")
    time = float(drawing.times[records.index(record)])
    return Still(picture, drawing.envs, time, bool(drawing.contact_forces), source.partial)
