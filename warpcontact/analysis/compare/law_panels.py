"""Panels of the plots of laws; each shows one quantity of a data set of ``impacts`` or ``rebounds``."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from warpcontact.analysis.compare import figures
from warpcontact.analysis.compare.labels import prefixed

# Time shown after the end of the longest contact, as a fraction of its duration.
AFTER = 0.06


class Scales:
    """Factors and axis labels for penetration, force and time of a data set, with prefixed units."""

    def __init__(self, data: xr.Dataset) -> None:
        self.depth, depth = prefixed(float(data["greatest_penetration"].max()), "m")
        self.force, force = prefixed(float(data["greatest_force"].max()), "N")
        self.time, time = prefixed(float(data["contact_time"].max()), "s")
        self.depth_label = f"penetration δ [{depth}]"
        self.force_label = f"normal force N [{force}]"
        self.time_label = f"time since first contact [{time}]"


def draw_loop(axes: Any, case: xr.Dataset, scales: Scales, **style: Any) -> None:
    """Draws force over penetration in one impact."""
    delta, force = _closed(case)
    axes.plot(scales.depth * delta, scales.force * force, **style)


def draw_force(axes: Any, case: xr.Dataset, scales: Scales, **style: Any) -> None:
    """Draws force over time in one impact."""
    axes.plot(scales.time * case["time"], scales.force * case["normal_force"], **style)


def label_loops(axes: Any, scales: Scales, title: str) -> None:
    """Labels a panel of loops."""
    figures.label_axes(axes, title, scales.depth_label, scales.force_label)


def label_forces(axes: Any, cases: xr.Dataset, scales: Scales, title: str) -> None:
    """Labels a panel of forces over time; the time axis ends shortly after the longest contact of ``cases``."""
    end = scales.time * float(cases["contact_time"].max())
    axes.set_xlim(-0.5 * AFTER * end, (1.0 + AFTER) * end)
    figures.label_axes(axes, title, scales.time_label, scales.force_label)


def draw_restitution(axes: Any, law: xr.Dataset, marked: Sequence[float], colors: Any) -> None:
    """Draws effective restitution of one law over the varied parameter, with dots at the ``marked`` restitutions."""
    varied, unit = law["varied"].item(), law["unit"].item()
    over = law["parameter"] if varied not in ("", "restitution") else law["restitution"]
    axes.plot(over, law["effective_restitution"], color="0.4", zorder=1)
    points = law.sel(restitution=list(marked))
    x_values = points[str(over.name)]
    axes.scatter(x_values, points["effective_restitution"], c=colors, s=45, edgecolors="black", lw=0.6, zorder=3)
    axes.set_ylim(0.0, 1.04)
    if over.name == "restitution":
        axes.plot([0.0, 1.0], [0.0, 1.0], color="0.5", linestyle=":", zorder=0)
        axes.set_xlim(0.0, 1.04)
        title, x = "effective restitution (dotted: prescribed)", "prescribed restitution [-]"
    else:
        title, x = f"effective restitution over {varied}", f"{varied} [{unit}]"
    figures.label_axes(axes, title, x, "effective restitution [-]")


def draw_over_speed(axes: Any, rebound: xr.DataArray, **style: Any) -> None:
    """Draws effective restitution over impact speed."""
    axes.plot(rebound["speed"], rebound, **style, marker=".", markersize=4)


def label_over_speed(axes: Any, title: str) -> None:
    """Labels a panel of effective restitution over impact speed."""
    axes.set(xscale="log", ylim=(0.0, 1.04))
    figures.label_axes(axes, title, "impact speed [m/s]", "effective restitution [-]")


def draw_asked(axes: Any, effective: xr.DataArray, **style: Any) -> None:
    """Draws effective over prescribed restitution."""
    axes.plot(effective["restitution"], effective, **style)


def label_asked(axes: Any) -> None:
    """Labels a panel of effective over prescribed restitution."""
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.5", linestyle=":", zorder=0)
    axes.set(xlim=(0.0, 1.04), ylim=(0.0, 1.04))
    title = "effective restitution (dotted: prescribed)"
    figures.label_axes(axes, title, "prescribed restitution [-]", "effective restitution [-]")


def _closed(case: xr.Dataset) -> tuple[Any, Any]:
    """Returns penetration and force of a loop from first contact to the end of the force."""
    delta, force = case["penetration"].values, case["normal_force"].values
    acting = np.flatnonzero(force)
    part = slice(max(int(acting[0]) - 1, 0), int(acting[-1]) + 2) if len(acting) else slice(0, 1)
    return delta[part], force[part]
