"""Force over penetration of contacts: the loop that a law draws, and the area that it takes from the motion."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from warpcontact.checks import Array
from warpcontact.run_report import chart
from warpcontact.run_report.markup import Markup, element, joined, name
from warpcontact.run_report.words import quantity, several

CHARTS = 6
# Records of one environment, from the first in contact on.
RECORDS = 2000
# Numbers of one environment that are read at once: of more items the largest force is looked for among the first.
NUMBERS = 8_000_000


@dataclass(frozen=True, eq=False)
class Loop:
    """What one environment does in a contact, (record,): penetration [m] and normal force [N].

    Of a set it is the item with the largest force.
    """

    env: int
    penetration: Array
    force: Array


def pairs_of(series: xr.Dataset) -> list[tuple[str, str, str]]:
    """Returns contacts with normal force, and penetration or gap: name, reading of depth, reading of force."""
    found = []
    for key in series.data_vars:
        element_name, _, last = str(key).rpartition(".")
        if last != "normal_force":
            continue
        depth = next((d for d in ("penetration", "gap") if f"{element_name}.{d}" in series), None)
        if depth and series[f"{element_name}.{depth}"].dims == series[key].dims:
            found.append((element_name, f"{element_name}.{depth}", str(key)))
    return found


def section(series: xr.Dataset | None, chosen: list[int]) -> Markup | None:
    """Returns the section of the page, ``None``: there is nothing to draw."""
    pairs = [] if series is None else pairs_of(series)
    if series is None or not pairs:
        return None
    there = [env for env in chosen if env in series["env"].values]
    drawn = [(*pair, _loops(series.sel(env=there), *pair[1:])) for pair in pairs[:CHARTS]]
    pictures = [
        _picture(title, loops, series[force].isel(time=0, env=0).size) for title, _, force, loops in drawn if loops
    ]
    told = [f"Normal force over penetration at the records of {several(len(there), 'environment')}."]
    told.append("Records farther apart than a contact lasts show dots, not its loop: [record] every sets it.")
    if len(pairs) > CHARTS:
        told.append(f"{several(len(pairs) - CHARTS, 'further contact')} left out.")
    if not pictures:
        told = ["No record of the chosen environments is in contact."]
    return joined([element("p", " ".join(told), class_="note"), element("div", joined(pictures), class_="charts")])


def _loops(series: xr.Dataset, depth: str, force: str) -> list[Loop]:
    found = []
    for env in series["env"].values:
        # One environment at a time: sets may have many items.
        own = series[[depth, force]].sel(env=env)
        items = [dim for dim in own[force].dims if dim != "time"]
        own = own.isel({dim: slice(0, max(1, NUMBERS // own.sizes["time"])) for dim in items})
        forces = own[force].values.astype(np.float64).reshape(own.sizes["time"], -1)
        depths = own[depth].values.astype(np.float64).reshape(forces.shape)
        finite = np.isfinite(forces) & np.isfinite(depths)
        size = np.where(finite, np.abs(forces), 0.0)
        if not size.any():
            continue
        item = int(size.max(axis=0).argmax())
        through = np.maximum(0.0, depths[:, item] if depth.endswith("penetration") else -depths[:, item])
        good = finite[:, item]
        touching = np.flatnonzero(good & ((through > 0.0) | (forces[:, item] != 0.0)))
        some = slice(max(0, touching[0] - 1), touching[0] + RECORDS)
        known = good[some]
        found.append(
            Loop(int(env), np.where(known, through[some], np.nan), np.where(known, forces[some, item], np.nan))
        )
    return found


def _picture(title: str, loops: list[Loop], items: int) -> Markup:
    depths = np.concatenate([loop.penetration for loop in loops])
    forces = np.concatenate([loop.force for loop in loops])
    deepest, largest = float(np.nanmax(depths)), float(np.nanmax(forces))
    x = chart.horizontal(0.0, deepest * 1.05, "m")
    y = chart.vertical(min(0.0, float(np.nanmin(forces))) * 1.05, largest * 1.05, "N")
    marks: list[Markup] = []
    for loop in loops:
        across, up = x.place(loop.penetration), y.place(loop.force)
        touching = (loop.penetration > 0.0) | (np.nan_to_num(loop.force) != 0.0)
        marks.append(
            element(
                "g",
                chart.polyline(across, up, "loop"),
                chart.dots(across[touching], up[touching], "dots"),
                data_env=loop.env,
            )
        )
    what = "normal force over penetration"
    if items > 1:
        what += f" of one point of {items}, in each environment that with the largest force"
    about = f"{title}, {what}: up to {quantity(largest, 'N')}, {quantity(deepest, 'm')} deep"
    caption = element(
        "figcaption",
        element("strong", name(title, 40), " ", element("span", f"[{y.label}]", class_="unit")),
        element("span", what),
    )
    force, depth = quantity(y.factor * largest, y.label), quantity(x.factor * deepest, x.label)
    told = f"{several(len(loops), 'environment')} in contact; largest force {force}, {depth} deep"
    drawing = chart.chart(x, y, marks, about, "penetration", data_loops=True)
    return element("figure", caption, drawing, element("p", told, class_="note"), class_="chart")
