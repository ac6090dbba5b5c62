"""Report sections on contacts: force over penetration, and contact couplings."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from warpcontact.drawing.reduction import kept_samples
from warpcontact.scene.contact_coupling import CouplingReport
from warpcontact.validation.checks import Array
from warpcontact.validation.number_format import count, number, quantity, several
from warpcontact.visualize.report import chart
from warpcontact.visualize.report.markup import Markup, element, joined, name, table

CHARTS = 6
# Largest number of samples per loop.
SAMPLES = 600
# Significant digits of extremes.
DIGITS = 5
# Largest number of values of one environment that are read in one block.
NUMBERS = 8_000_000


@dataclass(frozen=True, eq=False)
class Loop:
    """Loop of one environment in a contact, (record,); for a set, of the point with the largest force.

    Attributes:
        env: Number of the environment.
        penetration: Penetration [m], NaN in gaps.
        force: Normal force [N], NaN in gaps.
        largest: Largest force of all records [N].
        time: Time of the first record with this force [s].
    """

    env: int
    penetration: Array
    force: Array
    largest: float
    time: float


def contact_sensors(series: xr.Dataset) -> list[tuple[str, str, str]]:
    """Returns contacts with normal force and penetration or gap: name, penetration sensor, force sensor."""
    found = []
    for key in series.data_vars:
        element_name, _, last = str(key).rpartition(".")
        if last != "normal_force":
            continue
        depth = next((d for d in ("penetration", "gap") if f"{element_name}.{d}" in series), None)
        if depth and series[f"{element_name}.{depth}"].dims == series[key].dims:
            found.append((element_name, f"{element_name}.{depth}", str(key)))
    return found


def loops_section(series: xr.Dataset | None, chosen: list[int]) -> Markup | None:
    """Returns the section of the page; ``None`` if there are no such contacts."""
    pairs = [] if series is None else contact_sensors(series)
    if series is None or not pairs:
        return None
    available = [env for env in chosen if env in series["env"].values]
    drawn = [(*pair, _loops(series.sel(env=available), *pair[1:])) for pair in pairs[:CHARTS]]
    pictures = [
        _picture(title, loops, series[force].isel(time=0, env=0).size) for title, _, force, loops in drawn if loops
    ]
    sentences = [f"Normal force over penetration at the records of {several(len(available), 'environment')}."]
    sentences.append("If the record interval ([record] every) exceeds the contact time, only dots are visible.")
    if len(pairs) > CHARTS:
        sentences.append(f"{several(len(pairs) - CHARTS, 'further contact')} omitted.")
    if not pictures:
        sentences = ["No record of the chosen environments is in contact."]
    return joined(
        [element("p", " ".join(sentences), class_="note"), element("div", joined(pictures), class_="charts")]
    )


def _loops(series: xr.Dataset, depth: str, force: str) -> list[Loop]:
    seconds = series["time"].values
    found = []
    for env in series["env"].values:
        # Read one environment and one point at a time, because sets may have many points.
        env_series = series[[depth, force]].sel(env=env)
        items = [dim for dim in env_series[force].dims if dim != "time"]
        if items:
            env_series = env_series.isel(dict(zip(items, _strongest(env_series[force], items), strict=True)))
        forces, depths = env_series[force].values.astype(np.float64), env_series[depth].values.astype(np.float64)
        depths_inside = np.maximum(0.0, depths if depth.endswith("penetration") else -depths)
        good = np.isfinite(forces) & np.isfinite(depths)
        in_contact = good & ((depths_inside > 0.0) | (forces != 0.0))
        if not forces[in_contact].any():
            continue
        # Keep contact phases with the adjacent records, and gaps within.
        in_contact_or_next = in_contact.copy()
        in_contact_or_next[1:] |= in_contact[:-1]
        in_contact_or_next[:-1] |= in_contact[1:]
        values = np.where(good[:, None], np.stack([depths_inside, forces], axis=1), np.nan)[in_contact_or_next]
        some = values[kept_samples(values, SAMPLES, _length(values))]
        peak = int(np.where(good, forces, -np.inf).argmax())
        found.append(Loop(int(env), some[:, 0], some[:, 1], float(forces[peak]), float(seconds[peak])))
    return found


def _length(values: Array) -> Array:
    """Returns the arc length of a loop (record, 2) up to each record, normalized with the size of the loop.

    Sampling by arc length preserves short impacts among long contacts at rest.
    """
    sizes = np.nanmax(np.abs(values), axis=0)
    scaled = values / np.where(sizes > 0.0, sizes, 1.0)
    return np.cumsum(np.nan_to_num(np.hypot(*np.diff(scaled, axis=0, prepend=scaled[:1]).T)))


def _strongest(forces: xr.DataArray, items: list[Hashable]) -> tuple[int, ...]:
    """Returns the indices of the item with the largest force of one environment, (time, …)."""
    sizes = [forces.sizes[dim] for dim in items]
    rows = max(1, NUMBERS // int(np.prod(sizes)))
    largest = np.zeros(sizes)
    for first in range(0, forces.sizes["time"], rows):
        block = forces.isel(time=slice(first, first + rows)).transpose("time", *items).values
        sizes_of = np.where(np.isfinite(block), np.abs(block), 0.0)
        largest = np.maximum(largest, sizes_of.max(axis=0))
    return tuple(int(place) for place in np.unravel_index(int(largest.argmax()), largest.shape))


def _picture(title: str, loops: list[Loop], items: int) -> Markup:
    depths = np.concatenate([loop.penetration for loop in loops])
    forces = np.concatenate([loop.force for loop in loops])
    deepest, strongest = float(np.nanmax(depths)), max(loops, key=lambda loop: loop.largest)
    x = chart.horizontal(0.0, deepest * 1.05, "m")
    y = chart.vertical(min(0.0, float(np.nanmin(forces))) * 1.05, max(0.0, strongest.largest) * 1.05, "N")
    marks: list[Markup] = []
    for loop in loops:
        across, up = x.place(loop.penetration), y.place(loop.force)
        in_contact = (loop.penetration > 0.0) | (np.nan_to_num(loop.force) != 0.0)
        marks.append(
            element(
                "g",
                chart.polyline(across, up, "loop"),
                chart.dots(across[in_contact], up[in_contact], "dots"),
                data_env=loop.env,
            )
        )
    what = "normal force over penetration"
    if items > 1:
        what += f" of the point with the largest force in each environment, out of {items}"
    about = f"{title}, {what}: up to {quantity(strongest.largest, 'N')}, {quantity(deepest, 'm')} deep"
    caption = element(
        "figcaption",
        element("strong", name(title, 40), " ", element("span", f"[{y.label}]", class_="unit")),
        element("span", what),
    )
    force = quantity(y.factor * strongest.largest, y.label, DIGITS)
    depth = quantity(x.factor * deepest, x.label, DIGITS)
    sentences = (
        f"{several(len(loops), 'environment')} in contact; largest force {force} at "
        f"{quantity(strongest.time, 's', DIGITS)} in environment {strongest.env}; largest penetration {depth}"
    )
    drawing = chart.chart(x, y, marks, about, "penetration", data_loops=True)
    return element("figure", caption, drawing, element("p", sentences, class_="note"), class_="chart")


def couplings_section(reports: Sequence[CouplingReport]) -> Markup | None:
    """Returns the section of the page; ``None`` if there are no contact couplings."""
    if not reports:
        return None
    rows = []
    expected = []
    for report in reports:
        reached = report.in_range
        closest = report.minimum_distance[reached]
        area = report.effective_area[reached]
        rows.append(
            (
                name(report.name),
                f"{count(int(reached.sum()))} of {count(len(reached))}",
                _span(closest),
                _span(area),
                count(int(report.touched.sum())),
                "–" if report.impact is None else count(int(report.passed.sum())),
            )
        )
        if report.impact is not None:
            expected_gap, expected_area = quantity(report.impact.closest, "m"), quantity(report.impact.area, "m²")
            sentences = f": the range was designed for a closest distance of {expected_gap} and an area of {expected_area}."
            expected.append(element("p", name(report.name), sentences, class_="note"))
    head = (
        "coupling",
        "in range",
        "smallest distance [m]",
        "largest area [m²]",
        "in contact",
        "closer than expected",
    )
    return joined([table(head, rows, numbers=range(1, 6)), *expected])


def _span(values: np.ndarray) -> str:
    if not len(values):
        return "–"
    low, high = number(values.min()), number(values.max())
    return low if low == high else f"{low} to {high}"
