"""Stills and films of a recording or run."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import xarray as xr
from PIL import Image

from warpcontact.building.scene import Scene
from warpcontact.drawing.colors import per_environment_number
from warpcontact.drawing.drawing import Drawing, drawing_of
from warpcontact.experiment.run import Run
from warpcontact.files.atomic_files import atomic_file
from warpcontact.files.picture_file import check_path
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits
from warpcontact.validation.safe_text import escape_controls, terminal
from warpcontact.visualize.rendering.frame_renderer import Coloring, FrameRenderer
from warpcontact.visualize.rendering.painter import Picture
from warpcontact.visualize.rendering.render_style import RenderOptions, RenderStyle, environment_numbers
from warpcontact.visualize.rendering.writers import GIF_FASTEST, write_gif, write_mp4

# Number of records of an overview: that with about this number of poses, within limits.
_POSES = 500_000
_FEWEST, _MOST = 2, 48

STILL = (".png",)

#: Largest number of frames; more would take days and are likely mistakes.
MOST_PICTURES = 100_000

FILMS = (".gif", ".mp4")
# Largest number of frames per second.
FASTEST = 240.0
# Number of frames from which the palette of a GIF is chosen.
_PALETTE_PICTURES = 6


@dataclass(frozen=True, eq=False)
class Source:
    """Recording with its scene, and its run, if there is one.

    Attributes:
        recording: Data set up to the last record that all selected environments have.
        scene: Scene of the recording.
        run: Run with outcomes; ``None`` for a recording alone.
        envs: Numbers of the selected environments.
        partial: Whether later records are missing, because the run is not finished.
    """

    recording: xr.Dataset
    scene: Scene
    run: Run | None
    envs: list[int]
    partial: bool

    @classmethod
    def of(cls, recording: Any, scene: Scene | None, env: Any = None) -> "Source":
        """Returns the source for a recording or run; arguments and errors as for ``render``."""
        run = recording if isinstance(recording, Run) else None
        if run is not None:
            recording = run.recording
            run.check_series()
        if not isinstance(recording, xr.Dataset):
            raise TypeError(
                f"recording must be the result of Simulation.run or wc.open_run, got {type(recording).__name__}"
            )
        if scene is None:
            scene = getattr(recording, "scene", None)  # operations of xarray drop it
        if scene is None:
            raise ValueError("the recording has no scene (xarray operations drop it): pass scene=")
        for dim in ("time", "env"):
            if not recording.sizes.get(dim):
                raise ValueError(f"the recording must have at least one entry along {dim!r}")
        labels, count = recording["env"].values, recording.sizes["time"]
        envs = environment_numbers(env)
        if envs is None:
            envs = (labels if run is None else labels[run.frames > 0])[:1].tolist()
        # Missing environments are reported later, by ``Replay.of``.
        numbers = [one for one in envs if isinstance(one, int | np.integer)]
        last = count if run is None else run.records_of(numbers)
        return cls(recording.isel(time=slice(0, last)), scene, run, envs, last < count)

    @property
    def times(self) -> Array:
        """Simulated time of each record [s]."""
        return np.asarray(self.recording["time"].values, dtype=np.float64)

    def nearest(self, wanted: Array, name: str = "time") -> Any:
        """Returns the indices of the records nearest to times [s].

        Raises:
            ValueError: If a time is NaN, or outside the recording.
        """
        times = self.times
        allowed = 1.0e-9 * max(abs(times[0]), abs(times[-1]))
        for time in np.atleast_1d(wanted).tolist():
            if not times[0] - allowed <= time <= times[-1] + allowed:
                raise ValueError(
                    f"{name} must be within the recording, {times[0]:g} to {times[-1]:g} s, got {time:g}"
                )
        after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1) if len(times) > 1 else np.array(0)
        before = np.maximum(after - 1, 0)
        return np.where(np.abs(wanted - times[before]) <= np.abs(times[after] - wanted), before, after)

    def drawing(self, records: Sequence[int]) -> Drawing:
        """Returns the drawing of some records of the selected environments."""
        return drawing_of(self.recording.isel(time=list(records)), self.scene, self.envs)

    def overview(self) -> list[int]:
        """Returns evenly spaced records that determine camera and arrow length."""
        poses = sum(body.count for body in self.scene.bodies) * len(self.envs)
        count = int(np.clip(_POSES // max(poses, 1), _FEWEST, _MOST))
        return sorted(set(np.linspace(0, len(self.times) - 1, count).round().astype(int).tolist()))

    def numbers(self, name: str, envs: Sequence[int]) -> Array:
        """Returns a parameter or outcome of environments, (env,); NaN for unfinished ones.

        Raises:
            ValueError: If there is no such quantity with one number per environment.
        """
        tables = [self.recording] if self.run is None else [self.recording, self.run.outcome]
        named = [table.data_vars[name] for table in reversed(tables) if name in table.data_vars]
        found = next((one for one in map(_number_of_each, named) if one is not None), None)
        if found is None:
            variables = [(str(key), one) for table in tables for key, one in table.data_vars.items()]
            available = sorted({key for key, one in variables if _number_of_each(one) is not None})
            hint = suggestion(name, available) or f"; there are: {', '.join(available) or 'none'}"
            raise ValueError(f"color_by must be one number for each environment, got {name!r}{hint}")
        return found.reindex(env=list(envs)).values.astype(np.float64)


def _number_of_each(array: xr.DataArray) -> xr.DataArray | None:
    return None if "time" in array.dims else per_environment_number(array)


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
    frame_renderer, records = _make_renderer(source, [record], style)
    drawing = frame_renderer.drawing
    picture = frame_renderer.picture(records.index(record))
    if file is not None:
        with atomic_file(file) as opened:
            Image.fromarray(picture).save(opened, format="png")
    time = float(drawing.times[records.index(record)])
    return Still(picture, drawing.envs, time, bool(drawing.contact_forces), source.partial)


def _make_renderer(source: Source, shown: Sequence[int], style: RenderStyle) -> tuple[FrameRenderer, list[int]]:
    """Returns the renderer of some records of a recording, and the records of its drawing, ascending."""
    overview = source.overview()
    records = sorted({*overview, *shown})
    drawing = source.drawing(records)
    coloring = None
    if style.color_by is not None:
        coloring = Coloring.of(style.color_by, source.numbers(style.color_by, drawing.envs))
    numbers = {record: number for number, record in enumerate(records)}
    overview_numbers = [numbers[record] for record in overview]
    shown_numbers = sorted({numbers[record] for record in shown})
    return FrameRenderer(drawing, style, coloring, overview_numbers, shown_numbers), records


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
    from tqdm import tqdm

    options = RenderStyle(**style)
    file = check_path(path, FILMS)
    is_gif = file.suffix.lower() == ".gif"
    fps = float(
        checks.numbers("fps", fps, (), limits("1/s", above=0.0, at_most=GIF_FASTEST if is_gif else FASTEST))
    )
    speed = float(checks.numbers("speed", speed, (), limits("-", above=0.0)))
    if not is_gif and (options.size[0] % 2 or options.size[1] % 2):
        raise ValueError(f"size must be even for an .mp4 file, got {options.size[0]} × {options.size[1]} pixels")
    source = Source.of(recording, scene, env)
    moments = _moments(source, time, speed / fps)
    shown = source.nearest(moments)
    frame_renderer, records = _make_renderer(source, shown.tolist(), options)
    drawing = frame_renderer.drawing
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
        write_mp4(file, pictures(), fps, options.size)
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
