"""Films of a recording: frames from one camera position, encoded as they are rendered."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from warpcontact.building.scene import Scene
from warpcontact.files.picture_file import check_path
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits
from warpcontact.validation.safe_text import escape_controls, terminal
from warpcontact.visualize.rendering.frame_renderer import Coloring, FrameRenderer
from warpcontact.visualize.rendering.painter import Picture
from warpcontact.visualize.rendering.records import Source
from warpcontact.visualize.rendering.render_style import RenderOptions, RenderStyle
from warpcontact.visualize.rendering.writers import GIF_FASTEST, write_gif, write_mp4

#: Largest number of frames; more would take days and are likely mistakes.
MOST_PICTURES = 100_000

FILMS = (".gif", ".mp4")
# Largest number of frames per second.
FASTEST = 240.0
# Number of frames from which the palette of a GIF is chosen.
_PALETTE_PICTURES = 6


@dataclass(frozen=True)
class Film:
    """Result of ``film``.

    Attributes:
        path: The file.
        envs: Numbers of the environments.
        times: Simulated time of the record shown in each frame, (frame,) [s].
        duration: Playing time [s].
        forces: Whether the drawing has contact forces.
        partial: Whether later records are missing, because the run is not finished.
    """

    path: Path
    envs: list[int]
    times: Array
    duration: float
    forces: bool
    partial: bool


@explain_keywords
def film(
    recording: Any,
    path: str | PathLike[str],
    *,
    env: int | Iterable[int] | None = None,
    time: tuple[float, float] | None = None,
    fps: float = 25.0,
    speed: float = 1.0,
    scene: Scene | None = None,
    progress: bool | None = None,
    **style: Unpack[RenderOptions],
) -> Film:
    """Films a recording. Each frame shows the record nearest to its time, without interpolation.

    Args:
        recording: Result of ``wc.open_run`` or ``Simulation.run``, with the poses of all bodies.
        path: A .gif file, or an .mp4 file, which needs the program ffmpeg.
        env: Numbers of the environments, shown side by side; ``None``: the first.
        time: First and last simulated time [s]; ``None``: the whole recording, or, for an unfinished run, the records
            that all of these environments have.
        fps: Frames per second.
        speed: Simulated time per playing time; 0.1 is ten times slower than real time.
        scene: Scene of the recording; ``None``: the scene stored with the recording.
        progress: Whether to show a progress bar; ``None``: in a terminal.
        **style: Size, camera and more; see ``RenderOptions`` and docs/pictures.md.

    Raises:
        ValueError: If the file cannot be written, an environment, time or pose is missing in the recording, an option
            is invalid, or ffmpeg is missing or fails.
        TypeError: If ``recording`` is not a recording.
        OSError: If writing fails.
    """
    return shoot(
        recording,
        path,
        env=env,
        time=time,
        fps=fps,
        speed=speed,
        scene=scene,
        progress=progress,
        style=RenderStyle(**style),
    )


def shoot(
    recording: Any,
    path: str | PathLike[str],
    *,
    env: int | Iterable[int] | None,
    time: tuple[float, float] | None,
    fps: float,
    speed: float,
    scene: Scene | None,
    progress: bool | None,
    style: RenderStyle,
) -> Film:
    """Films a recording with a validated style; see ``film``."""
    from tqdm import tqdm

    file = check_path(path, FILMS)
    is_gif = file.suffix.lower() == ".gif"
    fps = float(
        checks.numbers("fps", fps, (), limits("1/s", above=0.0, at_most=GIF_FASTEST if is_gif else FASTEST))
    )
    speed = float(checks.numbers("speed", speed, (), limits("-", above=0.0)))
    if not is_gif and (style.size[0] % 2 or style.size[1] % 2):
        raise ValueError(f"size must be even for an .mp4 file, got {style.size[0]} × {style.size[1]} pixels")
    source = Source.of(recording, scene, env)
    moments = _moments(source, time, speed / fps)
    shown = source.nearest(moments)
    overview = source.overview()
    records = sorted({*overview, *shown.tolist()})
    drawing = source.drawing(records)
    coloring = None
    if style.color_by is not None:
        coloring = Coloring.of(style.color_by, source.numbers(style.color_by, drawing.envs))
    frame_renderer = FrameRenderer(drawing, style, coloring, [records.index(number) for number in overview])
    order = np.searchsorted(records, shown)

    def pictures() -> Iterator[Picture]:
        last, picture = -1, None
        bar = tqdm(
            order.tolist(),
            unit="picture",
            desc=escape_controls(file.name),
            disable=None if progress is None else not progress,
            file=terminal(),
        )
        with bar:
            for number in bar:
                if picture is None or number != last:
                    last, picture = number, frame_renderer.picture(number, float(drawing.times[number]))
                yield picture

    if is_gif:
        palette_pictures = np.unique(np.linspace(0, len(order) - 1, _PALETTE_PICTURES).round().astype(int))
        colors = [frame_renderer.picture(int(order[i]), samples=1)[::2, ::2] for i in palette_pictures]
        write_gif(file, pictures(), len(order), fps, colors)
    else:
        write_mp4(file, pictures(), fps, style.size)
    return Film(
        file, drawing.envs, drawing.times[order], len(order) / fps, bool(drawing.contact_forces), source.partial
    )


def _moments(source: Source, time: tuple[float, float] | None, step: float) -> Array:
    """Returns the simulated time of each frame, ``step`` apart, (frame,) [s]."""
    first, last = float(source.times[0]), float(source.times[-1])
    if time is not None:
        first, last = checks.numbers("time", time, (2,)).tolist()
        source.nearest(np.array([first, last]))
        if last <= first:
            raise ValueError(f"time must be two ascending times [s], got {first:g} and {last:g}")
    # The tolerance includes the last frame despite rounding.
    count = math.floor((last - first) / step + 1.0e-6) + 1
    if count > MOST_PICTURES:
        raise ValueError(
            f"a film must have at most {MOST_PICTURES} frames, got {count} of {first:g} to {last:g} s; "
            "decrease fps, increase speed, or pass a shorter time"
        )
    return np.minimum(first + step * np.arange(count), last)
