"""One picture of what happened: tracks of the bodies over the ground, and two readings over time.

Tracks are seen from above, or from the side if they run in the plane of x and z.

The picture is made of what the recording has. Without a display, and without matplotlib's global state.
"""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from warpcontact.frames import placed
from warpcontact.recorder import Recording
from warpcontact.scene import Scene, Surface

# More tracks would hide each other.
TRACKS = 200
# Quantiles of more environments than this look the same and take longer.
SAMPLE = 4096
COLORS = "plasma"
# Direction of the light on the ground, from the upper left.
LIGHT = np.array([-0.5, 0.5, 0.7]) / np.linalg.norm([-0.5, 0.5, 0.7])
# Values that span more than this factor are coloured on a logarithmic scale.
LOGARITHMIC = 30.0
# Tracks with a smaller extent along y, as part of the largest, are seen from the side.
FLAT = 0.02
# Where what is shown is wider than this times its height, it gets the whole width.
WIDE = 1.8
# The shorter side is at least this part of the longer.
NARROWEST = 0.3


def write_picture(path: Path, recording: Recording, title: str, varied: list[str]) -> None:
    """Draws a recording with the poses of the bodies.

    Args:
        path: The .png file.
        recording: From ``Simulation.run``, with the parameters that varied.
        title: Title of the picture.
        varied: Names of the parameters that varied; the first that is one number colours the tracks.
    """
    envs, times = recording.sizes["env"], recording["time"].values
    tracks = [recording[f"{body.name}.position"].values for body in recording.scene.bodies]
    plane = _plane(tracks)
    window = _window(recording.scene, [track[..., plane] for track in tracks], plane)
    width, height = window[1] - window[0]
    wide = bool(width > WIDE * height)
    size = (13.0, 4.0 + 10.8 * height / width) if wide else (13.0, 6.8)
    figure = Figure(figsize=size, dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{title}: {envs} environments, {times[-1]:g} s, {recording.attrs['precision']}")
    if wide:
        grid = figure.add_gridspec(2, 2, height_ratios=(size[1] - 3.7, 2.9))
        places = grid[0, :], grid[1, 0], grid[1, 1]
    else:
        grid = figure.add_gridspec(2, 2, width_ratios=(float(np.clip(width / height, 0.6, 1.15)), 1.0))
        places = grid[:, 0], grid[0, 1], grid[1, 1]
    above, first, second = (figure.add_subplot(place) for place in places)
    _draw_tracks(figure, above, recording, varied, plane, window, wide)
    for axes, (values, label) in zip((first, second), _chosen_readings(recording), strict=True):
        _draw_quantiles(axes, times, values, label)
        axes.set_xlabel("time [s]")
    if not wide:
        first.sharex(second)
        first.tick_params(labelbottom=False)
        first.set_xlabel("")
    first.legend(loc="best", fontsize="small")
    figure.savefig(path)


def _plane(tracks: list[NDArray[Any]]) -> list[int]:
    """Returns the two axes of the plane in which the tracks are shown."""
    points = np.concatenate([track.reshape(-1, 3) for track in tracks])
    extent = np.ptp(points, axis=0)
    return [0, 2] if extent[1] < FLAT * extent.max() else [0, 1]


def _draw_tracks(
    figure: Figure,
    axes: Any,
    recording: Recording,
    varied: list[str],
    plane: list[int],
    window: tuple[NDArray[Any], NDArray[Any]],
    wide: bool,
) -> None:
    scene = recording.scene
    envs = recording.sizes["env"]
    chosen = np.unique(np.linspace(0, envs - 1, min(envs, TRACKS)).astype(int))
    tracks = [recording[f"{body.name}.position"].isel(env=chosen).values for body in scene.bodies]
    lower, upper = window
    for surface in scene.surfaces:
        if surface.body is None and surface.visible:
            if plane == [0, 2]:
                _draw_section(axes, surface, float(np.mean([track[..., 1].mean() for track in tracks])))
            else:
                _draw_ground(axes, surface, lower, upper)
    values, label = _color_values(recording, varied)
    norm = _norm(values)
    for track in tracks:
        lines = LineCollection(
            list(track[:, :, plane].swapaxes(0, 1)), linewidths=1.0, alpha=0.85, cmap=COLORS, norm=norm
        )
        lines.set_array(values[chosen])
        axes.add_collection(lines)
        ends = track[-1][:, plane].T
        axes.scatter(*ends, c=values[chosen], cmap=COLORS, norm=norm, s=22, edgecolors="black", lw=0.6, zorder=3)
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel=f"{'xyz'[plane[1]]} [m]")
    view = "from above" if plane == [0, 1] else "from the side"
    which = f"{len(chosen)} of {envs} environments" if len(chosen) < envs else "all environments"
    axes.set_title(f"tracks {view}, {which}; dots: the end", fontsize="medium")
    if envs > 1:
        # Beside the tracks if they are wide, otherwise below.
        bar: dict[str, Any] = (
            {"location": "right", "aspect": 25} if wide else {"location": "bottom", "shrink": 0.7, "aspect": 40}
        )
        figure.colorbar(ScalarMappable(norm, COLORS), ax=axes, label=label, pad=0.01, **bar)


def _window(scene: Scene, tracks: list[NDArray[Any]], plane: list[int]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Returns the lower left and upper right corner of what is shown: the tracks with some room around them."""
    points = np.concatenate([track.reshape(-1, 2) for track in tracks])
    points = points[np.isfinite(points).all(axis=1)]
    lower, upper = points.min(axis=0), points.max(axis=0)
    radius = max((float(contact.radius) for contact in scene.contacts), default=0.0)
    spans = [np.ptp(_vertices(s)[:, plane], axis=0).max() for s in scene.surfaces if s.body is None]
    # A drop straight down still needs some ground to be seen on.
    least = max(10.0 * radius, 0.05 * max(spans, default=0.0), 1.0e-3)
    half = 0.5 * np.maximum(1.12 * (upper - lower), least)
    half = np.maximum(half, NARROWEST * half.max())
    centre = 0.5 * (lower + upper)
    return centre - half, centre + half


def _vertices(surface: Surface) -> NDArray[Any]:
    """Returns the vertices of a surface of the world, in the world [m]."""
    return placed(surface.scale * surface.mesh.vertices, surface.position, surface.orientation)


def _draw_ground(axes: Any, surface: Surface, lower: NDArray[Any], upper: NDArray[Any]) -> None:
    """Draws the faces within the window, lower ones first, grey by height and by their slope to the light."""
    corners = _vertices(surface)[surface.mesh.faces]
    near = (corners[..., :2].max(axis=1) >= lower).all(axis=1) & (corners[..., :2].min(axis=1) <= upper).all(
        axis=1
    )
    corners = corners[near]
    if not len(corners):
        return
    height = corners[..., 2].mean(axis=1)
    corners, height = corners[np.argsort(height)], np.sort(height)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # Seen from above whatever its outer side.
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0)
    level = (height - height[0]) / max(float(height[-1] - height[0]), 1.0e-9)
    grey = np.clip(0.45 + 0.25 * level + 0.35 * (normal @ LIGHT - LIGHT[2]) + 0.2, 0.0, 1.0)
    polygons = PolyCollection(
        list(corners[..., :2]), facecolors=grey[:, None].repeat(3, axis=1), edgecolors="face"
    )
    # Smoothed edges would leave a seam between neighbours.
    polygons.set(linewidth=0.5, antialiased=False)
    axes.add_collection(polygons)


def _draw_section(axes: Any, surface: Surface, y: float) -> None:
    """Draws where the plane of the tracks, at ``y``, cuts the surface."""
    corners = _vertices(surface)[surface.mesh.faces]
    # Not through vertices and along edges.
    y += 1.0e-6 * float(np.ptp(corners[..., 1]) or 1.0)
    side = corners[..., 1] > y
    cut = side.any(axis=1) & ~side.all(axis=1)
    corners, side = corners[cut], side[cut]
    if not len(corners):
        return
    ends = np.roll(corners, -1, axis=1)
    crossing = side != np.roll(side, -1, axis=1)  # two of the three edges
    start, end = corners[crossing], ends[crossing]
    part = (y - start[:, 1]) / (end[:, 1] - start[:, 1])
    points = (start + part[:, None] * (end - start))[:, [0, 2]]
    axes.add_collection(LineCollection(list(points.reshape(-1, 2, 2)), colors="0.45", linewidths=2.0, zorder=0))


def _color_values(recording: Recording, varied: list[str]) -> tuple[NDArray[Any], str]:
    """Returns one number per environment and what it is."""
    for name in varied:
        # What was set alike for all items of a set is one number as well.
        array = recording.get(name)
        if array is None or array.dims[0] != "env" or not set(array.dims).isdisjoint(("axis", "component", "row")):
            continue
        values = array.values.reshape(array.sizes["env"], -1)
        if (values == values[:, :1]).all():
            return values[:, 0], _label(name, array)
    return recording["env"].values, "environment"


def _norm(values: NDArray[Any]) -> Normalize:
    low, high = float(values.min()), float(values.max())
    return LogNorm(low, high) if low > 0.0 and high > LOGARITHMIC * low else Normalize(low, high)


def _label(name: str, array: xr.DataArray) -> str:
    unit = array.attrs.get("units", "-")
    return name if unit == "-" else f"{name} [{unit}]"


def _chosen_readings(recording: Recording) -> list[tuple[NDArray[Any], str]]:
    """Returns two readings (time, env) that tell most, with their labels."""
    scene, bodies = recording.scene, [body.name for body in recording.scene.bodies]
    contacts = [contact.name for contact in scene.contacts]
    found = []
    for name in (*(f"{c}.gap" for c in contacts), f"{bodies[0]}.position"):
        if name in recording:
            found.append(_per_environment(name, recording[name], smallest=True))
            break
    forces = [f"{c}.normal_force" for c in contacts]
    energies = ["scene.kinetic_energy", *(f"{body}.kinetic_energy" for body in bodies)]
    for name in (*energies, *forces):
        if name in recording:
            found.append(_per_environment(name, recording[name], smallest=False))
            break
    if len(found) < 2:
        position = recording[f"{bodies[0]}.position"].values
        way = np.linalg.norm(position - position[0], axis=-1)
        found.append((way, f"distance of {bodies[0]} from its start [m]"))
    return found


def _per_environment(name: str, array: xr.DataArray, smallest: bool) -> tuple[NDArray[Any], str]:
    """Returns a reading as (time, env): of sets the smallest or the sum, of positions the height."""
    label, values = _label(name, array), array.values
    if "axis" in array.dims:
        return values[..., 2], f"height of {name.partition('.')[0]} [m]"
    if values.ndim > 2:
        return (values.min(axis=2), f"smallest {label}") if smallest else (values.sum(axis=2), f"sum of {label}")
    return values, label


def _draw_quantiles(axes: Any, times: NDArray[Any], values: NDArray[Any], label: str) -> None:
    envs = values.shape[1]
    if envs == 1:
        axes.plot(times, values[:, 0], color="C0", label="the environment")
    else:
        sample = values[:, np.unique(np.linspace(0, envs - 1, min(envs, SAMPLE)).astype(int))]
        q05, q25, q50, q75, q95 = np.quantile(sample, (0.05, 0.25, 0.5, 0.75, 0.95), axis=1)
        axes.fill_between(times, q05, q95, color="C0", alpha=0.2, lw=0, label="5 % to 95 % of the environments")
        axes.fill_between(times, q25, q75, color="C0", alpha=0.35, lw=0, label="25 % to 75 %")
        axes.plot(times, q50, color="C0", label="median")
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)
    axes.margins(x=0.0)
