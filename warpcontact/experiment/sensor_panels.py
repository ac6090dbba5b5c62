"""Panels of sensors over time in the picture of a run.

Up to ``CURVES`` environments are drawn as one curve each, more as quantiles. Sensors of contacts come first, then
those of couplings, joints and bodies. Headings contain the extreme values.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.algebra.quantiles import quantiles_over
from warpcontact.drawing.reduction import evenly, kept_samples
from warpcontact.experiment.curves import (
    DISTANCE,
    MAGNITUDE,
    Extreme,
    SensorCurves,
    is_drawable,
    read_curves,
    sample_size,
)
from warpcontact.stepping.recording import Recording
from warpcontact.validation.checks import Array
from warpcontact.validation.number_format import quantity, scaled
from warpcontact.validation.safe_text import truncate

#: Largest number of environments with one curve each; more are drawn as quantiles.
CURVES = 12
# Samples per curve, and number of contacts that are searched for one with a varying force.
SAMPLES = 4000
TRIED = 8
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
# Largest number of characters of a heading.
HEADING = 70
# Significant digits of extreme values.
DIGITS = 5

_FORCES = ("normal_force", "force", "impulse")
_DISTANCES = ("gap", "penetration", "minimum_distance", "max_penetration")
_TENSIONS = ("force", "tension_b", "tension_a")
_COORDINATES = ("angle", "displacement")


@dataclass(frozen=True, eq=False)
class Panel:
    """A sensor over time.

    Attributes:
        heading: Name of the sensor, and the reduction of the items of a set.
        label: Label of the axis: the last part of the name, or the component.
        curves: The sensor in a sample of the environments.
        frozen: Which of these are frozen, (env,).
        total: Number of all environments.
    """

    heading: str
    label: str
    curves: SensorCurves
    frozen: NDArray[np.bool_]
    total: int

    @property
    def counted(self) -> Array:
        """Values of the environments that are not frozen (time, env); of all if all are frozen."""
        return self.curves.values if self.frozen.all() else self.curves.values[:, ~self.frozen]

    @property
    def varies(self) -> bool:
        """Whether the sensor has more than one value."""
        low, high = self.curves.smallest, self.curves.largest
        return low is not None and high is not None and low.value < high.value


def make_panels(recording: Recording, frozen: NDArray[np.int_], most: int) -> list[Panel]:
    """Returns panels of recorded sensors, at least two and at most ``most``.

    If there are fewer sensors, height and distance of the first body are added.

    Args:
        recording: The recording.
        frozen: Numbers of the frozen environments, which are excluded from quantiles and extreme values.
        most: Number of panels, at least two.
    """
    ranks = _ranks(recording)
    forces = [name for name in ranks if ranks[name] == 0][:TRIED]
    panels = {name: _panel(recording, name, frozen) for name in forces}
    first = next((name for name in forces if panels[name].varies), forces[0] if forces else None)
    chosen = _choose_sensors(ranks, first, most)
    found = [panels.get(name) or _panel(recording, name, frozen) for name in chosen]
    body = recording.scene.bodies[0].name
    for component in ("z", DISTANCE)[: max(0, 2 - len(found))]:
        found.append(_panel(recording, f"{body}.position", frozen, component))
    return found


def draw_panel(axes: Any, panel: Panel, colors: NDArray[Any] | None) -> None:
    """Draws a panel, without a label on the time axis.

    Args:
        axes: Axes of Matplotlib.
        panel: The panel.
        colors: RGBA of each environment; ``None``: draw quantiles.
    """
    curves = panel.curves
    good = panel.counted[np.isfinite(panel.counted)]
    factor, unit = scaled(curves.unit, float(np.abs(good).max(initial=0.0)))
    if colors is None:
        _draw_quantiles(axes, panel, factor)
    else:
        for values, color, frozen in zip(curves.values.T, colors, panel.frozen, strict=True):
            kept_rows = kept_samples(values, SAMPLES)
            axes.plot(
                curves.seconds[kept_rows], factor * values[kept_rows], ":" if frozen else "-", color=color, lw=1.2
            )
        _limit(axes, factor * good)
    axes.set_title(f"{panel.heading}\n{_extremes(panel, factor, unit)}", fontsize="small", loc="left")
    axes.set_ylabel(f"{panel.label} [{unit}]" if unit else panel.label)
    axes.grid(alpha=0.3)
    axes.margins(x=0.0)


def _choose_sensors(ranks: dict[str, int], first: str | None, most: int) -> list[str]:
    """Returns the sensors to draw, ordered by rank; ``first`` is one of them.

    Sensors of the same contact are preferred, and sensors of different kinds over several of the same kind.
    """
    element = first.rpartition(".")[0] if first else None
    chosen = [first] if first else []

    def priority(name: str) -> tuple[int, int, bool]:
        element_name, _, kind = name.rpartition(".")
        alike = [other for other in chosen if other.rpartition(".")[2] == kind]
        return len(alike), ranks[name], element_name != element

    while len(chosen) < most and (rest := [name for name in ranks if name not in chosen]):
        chosen.append(min(rest, key=priority))
    return sorted(chosen, key=lambda name: (ranks[name], name != first))


def _ranks(recording: Recording) -> dict[str, int]:
    """Returns the sensors that can be drawn, without positions of bodies, with their ranks; 0 comes first."""
    scene = recording.scene
    touching: list[Any] = [*scene.contacts, *scene.shape_contacts, *scene.particle_contacts, *scene.body_contacts]
    contacts = {one.name for one in (*touching, *scene.contact_couplings)}
    couplings = {coupling.name for coupling in scene.couplings}

    def rank(name: str) -> int:
        element, _, last = name.rpartition(".")
        if element in contacts:
            return 0 if last in _FORCES else 1 if last in _DISTANCES else 2
        if element in couplings:
            return 3 if last in _TENSIONS else 4
        return 5 if last in _COORDINATES else 6

    names = [str(name) for name, array in recording.data_vars.items() if is_drawable(str(name), array)]
    poses = {f"{body.name}.position" for body in scene.bodies}
    return {name: rank(name) for name in names if name not in poses}


def _panel(recording: xr.Dataset, name: str, frozen: NDArray[np.int_], component: str | None = None) -> Panel:
    array = recording[name]
    if "axis" in array.dims and component is None:
        component = MAGNITUDE
    envs = np.asarray(array["env"].values)
    halted = np.isin(envs, frozen)
    rows = evenly(len(envs), max(CURVES, sample_size(array)))
    curves = read_curves(array, rows, halted, component)
    element, _, last = name.rpartition(".")
    what, label = {
        "z": (f"height of {element}", "height"),
        DISTANCE: (f"distance of {element} from its start", "distance"),
        MAGNITUDE: (f"magnitude of {name}", last),
        None: (name, last),
    }[component]
    items = f" over {curves.items} items" if curves.reduction else ""
    heading = f"{curves.reduction} {what}".strip()
    return Panel(truncate(heading, HEADING, middle=True) + items, label, curves, halted[rows], len(envs))


def _extremes(panel: Panel, factor: float, unit: str) -> str:
    """Returns the extreme values of a sensor with their times and environments, as text."""
    low, high = panel.curves.smallest, panel.curves.largest
    if low is None or high is None:
        return "no finite value"

    def extreme_text(word: str, extreme: Extreme) -> str:
        where = "" if panel.total == 1 else f" (env {extreme.env})"
        value = quantity(factor * extreme.value, unit, DIGITS)
        return f"{word} {value} at {quantity(extreme.time, 's', DIGITS)}{where}"

    sampled = len(panel.curves.envs) < panel.total and panel.curves.searched == panel.counted.shape[1]
    among = f", of {panel.curves.searched} environments" if sampled else ""
    return f"{extreme_text('min', low)}, {extreme_text('max', high)}{among}"


def _limit(axes: Any, counted: Array) -> None:
    """Limits the extension of the vertical axis by frozen environments to the span of the others."""
    if len(counted) and (span := float(np.ptp(counted))) > 0.0:
        low, high = axes.get_ylim()
        axes.set_ylim(max(low, float(counted.min()) - span), min(high, float(counted.max()) + span))


def _draw_quantiles(axes: Any, panel: Panel, factor: float) -> None:
    curves = panel.curves
    fan = factor * quantiles_over(panel.counted, LEVELS)
    kept_rows = kept_samples(fan.T, SAMPLES)
    seconds, (q05, q25, q50, q75, q95) = curves.seconds[kept_rows], fan[:, kept_rows]
    sampled = "" if len(curves.envs) == panel.total else f" of {panel.total}"
    axes.fill_between(seconds, q05, q95, color="C0", alpha=0.2, lw=0, label="5 % to 95 %")
    axes.fill_between(seconds, q25, q75, color="C0", alpha=0.35, lw=0, label="25 % to 75 %")
    axes.plot(seconds, q50, color="C0", label=f"median of {panel.counted.shape[1]}{sampled} environments")
