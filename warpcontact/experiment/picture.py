"""Draws the picture of a run: tracks of the bodies over the surfaces, and sensors over time.

Tracks are projected onto the xy plane, or onto the xz plane if their extent along y is small. Without series, the
picture shows histograms of the outcomes. It is drawn without a display and without the global state of matplotlib.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, LogNorm, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from warpcontact.drawing.reduction import evenly, merged_items
from warpcontact.experiment.curves import bin_edges, has_integer_bins
from warpcontact.experiment.ground import (
    GroundSurface,
    contour_step,
    draw_from_above,
    draw_section,
    ground_surfaces,
    legend_entries,
)
from warpcontact.experiment.sensor_panels import CURVES, draw_panel, make_panels
from warpcontact.files.picture_file import save
from warpcontact.files.run_folder import RunPath
from warpcontact.model.health import Health
from warpcontact.scene.elements import Body
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.status import EnvironmentStatus
from warpcontact.stepping.outcomes.watch import RESERVED
from warpcontact.stepping.recording import Recording
from warpcontact.storage.memory_estimate import env_count_text
from warpcontact.validation.safe_text import single_line, truncate

# Largest number of histograms.
MAX_HISTOGRAMS = 6
COLUMNS = 3
QUANTILES = (0.05, 0.5, 0.95)
# First characters of an additive offset of ticks, as matplotlib writes it.
_SIGNS = "+-\N{MINUS SIGN}"

# Number of sensor panels: in a column next to the tracks; in a row if the tracks have the whole width.
PANELS, WIDE_PANELS = 3, 2
# Largest number of tracks.
TRACKS = 200
# Color map without its bright end, which is hard to see on white.
COLORS = ListedColormap(mpl.colormaps["plasma"](np.linspace(0.0, 0.9, 256)), "plasma to 0.9")
# Largest number of characters of the title, and of the name of a parameter.
TITLE, NAME = 60, 40
# Color of couplings.
COUPLING_COLOR = "0.45"
# Values that span more than this factor are colored on a logarithmic scale.
LOGARITHMIC = 30.0
# Tracks whose extent along y is at most this fraction of the largest extent are viewed from the side.
FLAT = 0.02
# Tracks wider than this times their height get the whole width.
WIDE = 1.8
# The window has at least this fraction of the size of couplings: cables may be far longer than the tracks.
MAX_COUPLINGS = 0.25
# Distance from both ends of the color bar without other ticks, as a fraction.
MARGIN = 0.15
# Smallest ratio of the shorter to the longer side of the window.
MIN_WIDTH = 0.3


def write_outcome_picture(path: Path | RunPath, outcome: xr.Dataset, title: str) -> bool:
    """Draws histograms of the first scalar outcomes; frozen environments are excluded, their number is in the title.

    Args:
        path: The .png file.
        outcome: Outcomes and status of environments, as ``Simulation.outcomes`` returns them.
        title: Title of the picture.

    Returns:
        Whether the picture was written; False: there is no scalar outcome.
    """
    drawn = list(_scalar_outcomes(outcome))[:MAX_HISTOGRAMS]
    if not drawn:
        return False
    frozen = outcome["status"].values == EnvironmentStatus.FROZEN
    columns = min(len(drawn), COLUMNS)
    rows = -(-len(drawn) // columns)
    figure = Figure(figsize=(1.0 + 4.2 * columns, 0.8 + 3.2 * rows), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    left_out = f", {frozen.sum()} frozen excluded" if frozen.any() else ""
    title = f"{truncate(single_line(title), TITLE)}: {env_count_text(len(frozen))}"
    figure.suptitle(f"{title}{left_out}", parse_math=False)
    for i, (name, label, values) in enumerate(drawn):
        axes = figure.add_subplot(rows, columns, i + 1)
        _draw_histogram(axes, values[~frozen])
        axes.set_title(name)
        axes.set_xlabel(f"{label}{_offset_of_ticks(axes)}", fontsize="small")
        if i % columns == 0:
            axes.set_ylabel("environments")
    save(figure, path)
    return True


def _scalar_outcomes(outcome: xr.Dataset) -> Iterator[tuple[str, str, NDArray[np.float64]]]:
    """Iterates over the outcomes with one number per environment: name, label of the axis, values."""
    for name, array in outcome.data_vars.items():
        if name in RESERVED or array.dims != ("env",):
            continue
        unit = array.attrs.get("units", "-")
        about = str(array.attrs.get("long_name", name))
        yield str(name), about if unit == "-" else f"{about} [{unit}]", array.values.astype(np.float64)


def _offset_of_ticks(axes: Axes) -> str:
    """Returns factor and offset of the ticks, for the axis label, and hides the text that matplotlib would draw."""
    formatter = axes.xaxis.get_major_formatter()
    formatter.format_ticks(axes.xaxis.get_majorticklocs().tolist())
    axes.xaxis.offsetText.set_visible(False)
    offset = formatter.get_offset()
    if offset and offset[0] not in _SIGNS:
        offset = f"×{offset}"
    return f" ({offset})" if offset else ""


def _draw_histogram(axes: Axes, values: NDArray[np.float64]) -> None:
    """Draws a histogram of the finite values, and states the number of values that are not finite."""
    finite = values[np.isfinite(values)]
    if len(finite):
        axes.hist(finite, bins=bin_edges(finite).tolist(), color="C0", alpha=0.75)
        axes.xaxis.set_major_locator(MaxNLocator(5, integer=has_integer_bins(finite)))
        marks = np.quantile(finite, QUANTILES)
        for q, mark, line in zip(QUANTILES, marks, (":", "-", ":"), strict=True):
            axes.axvline(mark, color="C1", linestyle=line, label=f"{100 * q:g} %: {mark:.4g}")
        # Below the axis label, where the legend hides nothing.
        layout = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16), "ncols": 3}
        axes.legend(**layout, fontsize="small", frameon=False, handlelength=1.2, columnspacing=1.0)
    else:
        axes.set(xticks=(), yticks=())
    if len(finite) < len(values) or not len(values):
        text = f"{len(values) - len(finite)} without a finite value" if len(values) else "all are frozen"
        axes.text(0.02, 0.98, text, transform=axes.transAxes, va="top", fontsize="small", color="C3")
    axes.set_axisbelow(True)
    axes.grid(alpha=0.3)


def write_picture(
    path: Path | RunPath, recording: Recording, title: str, varied: list[str], health: Health
) -> None:
    """Draws a recording with the poses of the bodies.

    Environments that are stopped or frozen are drawn in their last state until the end, and counted in the title.

    Args:
        path: The .png file.
        recording: Recording from ``Simulation.run``, with the varied parameters.
        title: Title of the picture.
        varied: Names of the varied parameters; the first that differs in one number colors the tracks.
        health: Numbers of stopped and frozen environments.
    """
    envs, times = recording.sizes["env"], recording["time"].values
    chosen = evenly(envs, TRACKS)
    # ``_tracks`` limits the number of bodies of a set.
    tracks = [_tracks(recording, body, chosen) for body in recording.scene.bodies]
    plane, lower, upper = _extent(tracks)
    shapes = _coupling_shapes(recording)
    # First pass: the part of a half-space that the tracks need; second pass: the part that the window shows.
    reach = float(np.abs([lower, upper]).max() + np.max(upper - lower)) or 1.0
    window = _window(recording.scene, ground_surfaces(recording, reach), shapes, lower, upper, plane)
    grounds = ground_surfaces(recording, 2.0 * float(np.abs(window).max()))
    width, height = window[1] - window[0]
    wide = bool(width > WIDE * height)
    panels = make_panels(recording, health.frozen, WIDE_PANELS if wide else PANELS)
    size = (13.0, 4.2 + 10.8 * height / width if wide else 4.8 + 1.1 * len(panels))
    figure = Figure(figsize=size, dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    held = [
        f"{len(numbers)} {state}"
        for state, numbers in (("stopped", health.stopped), ("frozen", health.frozen))
        if len(numbers)
    ]
    dotted = " (dotted)" if len(health.frozen) and envs <= CURVES else ""
    after = f"; {' and '.join(held)}{dotted}, shown in their last state" if held else ""
    title = f"{truncate(single_line(title), TITLE)}: {env_count_text(envs)}"
    figure.suptitle(f"{title}, {times[-1]:g} s, {recording.attrs['precision']}{after}", parse_math=False)
    if wide:
        grid = figure.add_gridspec(2, len(panels), height_ratios=(size[1] - 3.9, 3.1))
        above, below = grid[0, :], [grid[1, i] for i in range(len(panels))]
    else:
        ratios = float(np.clip(width / height, 0.6, 1.15)), 1.0
        grid = figure.add_gridspec(len(panels), 2, width_ratios=ratios)
        above, below = grid[:, 0], [grid[i, 1] for i in range(len(panels))]
    values, label = _color_values(recording, varied)
    norm = _norm(values)
    coloring = values, label, norm
    axes_above = figure.add_subplot(above)
    _draw_tracks(figure, axes_above, recording, chosen, tracks, grounds, shapes, coloring, plane, window, wide)
    rest = [figure.add_subplot(cell) for cell in below]
    colors = COLORS(norm(values)) if 1 < envs <= CURVES else np.array([to_rgba("C0")]) if envs == 1 else None
    for axes, panel in zip(rest, panels, strict=True):
        draw_panel(axes, panel, colors)
        axes.set_xlabel("time [s]")
    if not wide:
        for axes in rest[:-1]:
            axes.sharex(rest[-1])
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
    if colors is None:
        handles, labels = rest[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower right", ncols=3, fontsize="small")
    save(figure, path)


def _extent(tracks: list[NDArray[Any]]) -> tuple[list[int], NDArray[Any], NDArray[Any]]:
    """Returns the axes of the plane of projection, and the lower and upper corner of the tracks in it."""
    points = np.concatenate([track.reshape(-1, 3) for track in tracks])
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    plane = [0, 2] if high[1] - low[1] <= FLAT * (high - low).max() else [0, 1]
    return plane, low[plane], high[plane]


def _draw_tracks(
    figure: Figure,
    axes: Any,
    recording: Recording,
    chosen: NDArray[np.int_],
    tracks: list[NDArray[Any]],
    grounds: list[GroundSurface],
    shapes: list[NDArray[Any]],
    coloring: tuple[NDArray[Any], str, Normalize],
    plane: list[int],
    window: tuple[NDArray[Any], NDArray[Any]],
    wide: bool,
) -> None:
    scene = recording.scene
    envs = recording.sizes["env"]
    lower, upper = window
    from_above = plane == [0, 1]
    step = contour_step(grounds, lower, upper) if from_above else 0.0
    for ground in grounds:
        if from_above:
            draw_from_above(axes, ground, lower, upper, step)
        else:
            draw_section(axes, ground, float(np.mean([track[..., 1].mean() for track in tracks])))
    for shape in shapes:
        axes.plot(*shape[:, plane].T, color=COUPLING_COLOR, lw=0.8, zorder=1.5)
    if not all(ground.active.all() for ground in grounds):
        # Below the axes, where the legend hides no track.
        figure.legend(handles=legend_entries(from_above), loc="outside lower left", ncols=2, fontsize="small")
    values, label, norm = coloring
    for track in tracks:
        track_values = np.repeat(values[chosen], track.shape[1] // len(chosen))
        lines = LineCollection(
            list(track[:, :, plane].swapaxes(0, 1)), linewidths=1.0, alpha=0.85, cmap=COLORS, norm=norm
        )
        lines.set_array(track_values)
        axes.add_collection(lines)
        ends = track[-1][:, plane].T
        axes.scatter(*ends, c=track_values, cmap=COLORS, norm=norm, s=22, edgecolors="black", lw=0.6, zorder=3)
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel=f"{'xyz'[plane[1]]} [m]")
    view = "from above" if from_above else "from the side"
    which = f"{len(chosen)} of {envs} environments" if len(chosen) < envs else f"all {envs} environments"
    which = "one environment" if envs == 1 else which
    shown = sum(track.shape[1] for track in tracks) // len(chosen)
    if shown < (bodies := sum(body.count for body in scene.bodies)):
        which = f"{shown} of {bodies} bodies of {which}"
    # Surfaces and couplings that differ between environments are shown as in environment 0.
    first = [] if all(ground.shared for ground in grounds) else ["surfaces"]
    first += ["couplings"] if shapes else []
    as_first = f"; {' and '.join(first)} as in environment 0" if first else ""
    contours = f"; contours every {step:g} m" if step else ""
    # Left-aligned, because the title may be wider than the axes.
    axes.set_title(f"tracks {view}, {which}; dots: end{contours}{as_first}", fontsize="medium", loc="left")
    if envs > 1:
        # Next to the tracks if they are wide, otherwise below.
        bar: dict[str, Any] = (
            {"location": "right", "aspect": 25} if wide else {"location": "bottom", "shrink": 0.7, "aspect": 40}
        )
        drawn = figure.colorbar(ScalarMappable(norm, COLORS), ax=axes, label=label, pad=0.01, **bar)
        drawn.minorticks_off()
        ticks, names = _ticks(norm, integers=bool((values == np.round(values)).all()))
        drawn.set_ticks(ticks, labels=names)


def _tracks(recording: Recording, body: Body, chosen: NDArray[np.int_]) -> NDArray[Any]:
    """Returns the positions of a body, or of several of a set, in the chosen environments (time, track, 3)."""
    position = recording[f"{body.name}.position"].isel(env=chosen)
    if body.single:
        return np.asarray(position.values)
    some = evenly(body.count, max(1, TRACKS // len(chosen)))
    values = position.isel({position.dims[2]: some}).values
    return np.asarray(values.reshape(len(values), -1, 3))


def _coupling_shapes(recording: Recording) -> list[NDArray[Any]]:
    """Returns the curves of the couplings in the first environment at the end, (n, 3) each, world frame [m]."""
    from warpcontact.drawing.lines import CouplingCurve
    from warpcontact.drawing.replay import Replay

    shown = [coupling for coupling in recording.scene.couplings if coupling.visible]
    if not shown:
        return []
    last = Replay.of(recording.isel(time=[-1]), recording.scene, [int(recording["env"].values[0])])
    curves = [CouplingCurve(last, coupling) for coupling in shown]
    return [curve.points[0, 0] for curve in curves if curve.shown[0, 0]]


def _window(
    scene: SceneData,
    grounds: list[GroundSurface],
    shapes: list[NDArray[Any]],
    lower: NDArray[Any],
    upper: NDArray[Any],
    plane: list[int],
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Returns the lower left and upper right corner of the window: the tracks with a margin."""
    radius = max((float(contact.radius.max()) for contact in scene.contacts), default=0.0)
    sizes = [
        values
        for shape in scene.shapes
        if shape.body is not None
        for key, values in shape.sizes.items()
        if shape.kind.limits(key)["unit"] == "m"
    ]
    radius = max([radius, *(float(np.abs(values).max()) for values in sizes)])
    spans = [np.ptp(ground.corners[..., plane].reshape(-1, 2), axis=0).max() for ground in grounds]
    lengths = [np.ptp(shape[:, plane], axis=0).max() for shape in shapes]
    # A vertical track still needs a visible piece of the ground, and a suspended body one of its cable.
    least = max(
        10.0 * radius,
        0.05 * max(spans, default=0.0),
        MAX_COUPLINGS * max(lengths, default=0.0),
        1.0e-3,
    )
    half = 0.5 * np.maximum(1.12 * (upper - lower), least)
    half = np.maximum(half, MIN_WIDTH * half.max())
    center = 0.5 * (lower + upper)
    return center - half, center + half


def _color_values(recording: Recording, varied: list[str]) -> tuple[NDArray[Any], str]:
    """Returns one number per environment and its label: of the first parameter that differs in one component."""
    names = [one for name in varied for one in (name, f"{name}.initial") if one in recording]
    found: tuple[NDArray[Any], str] | None = None
    count = 0
    for name in (one for one in names if "time" not in recording[one].dims):
        array = merged_items(recording[name]).transpose("env", ...)
        values = array.values.reshape(array.sizes["env"], -1)
        differ = np.flatnonzero((values != values[:1]).any(axis=0))
        count += bool(len(differ))
        if found is None and len(differ) == 1 and set(array.dims) <= {"env", "axis"}:
            component = f".{'xyz'[differ[0]]}" if "axis" in array.dims else ""
            label = _label(f"{truncate(name, NAME, middle=True)}{component}", array)
            found = values[:, differ[0]], label
    if found is None:
        return recording["env"].values, "environment"
    return found[0], found[1] + (f"\none of {count} varied parameters" if count > 1 else "")


def _norm(values: NDArray[Any]) -> Normalize:
    low, high = float(values.min()), float(values.max())
    return LogNorm(low, high) if low > 0.0 and high > LOGARITHMIC * low else Normalize(low, high)


def _ticks(norm: Normalize, integers: bool) -> tuple[list[float], list[str]]:
    """Returns ticks of a color bar with labels: both ends, and round numbers at a distance from these."""
    ends = norm.vmin, norm.vmax
    low, high = (0.0 if end is None else float(end) for end in ends)
    if not 0.0 < high - low < math.inf:
        return [low], [f"{low:.4g}"]
    digits = 3
    if isinstance(norm, LogNorm):
        between = 10.0 ** np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1.0)
        between = between[:: math.ceil(len(between) / 4) or 1]
    else:
        between = np.asarray(
            MaxNLocator(4, steps=[1.0, 2.0, 2.5, 5.0, 10.0], integer=integers).tick_values(low, high)
        )
        # Enough digits that labels differ, also for values with a large offset.
        digits += max(math.ceil(np.log10(max(abs(low), abs(high)) / (high - low))), 0)
    positions = np.asarray(norm(between))
    inner = between[(positions > MARGIN) & (positions < 1.0 - MARGIN)].tolist()
    ticks = [low, *inner, high]
    # Numbers below a million are written without exponents.
    digits = max(digits, min(math.floor(np.log10(max(abs(low), abs(high)))) + 1, 6))
    return ticks, [f"{tick:.{digits}g}" for tick in ticks]


def _label(name: str, array: xr.DataArray) -> str:
    unit = array.attrs.get("units", "-")
    return name if unit == "-" else f"{name} [{unit}]"
