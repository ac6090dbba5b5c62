"""Plots of normal laws: loops, force over time, and effective restitution."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from warpcontact.analysis.compare import figures, instances
from warpcontact.analysis.compare.impact import RESTITUTIONS, check_restitutions, impacts, rebounds
from warpcontact.analysis.compare.instances import number, prefixed, titled
from warpcontact.files.picture_file import check_path, save
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.laws.base import Law

# Time shown after the end of the longest contact, as a fraction of its duration.
AFTER = 0.06

#: Default restitutions whose loops are drawn.
LOOPS = (0.2, 0.4, 0.6, 0.8, 1.0)
# Color of loops that do not depend on the prescribed restitution; different from the colors of restitutions.
UNVARIED = "0.25"


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


@explain_keywords
def plot_laws(
    laws: Any,
    path: Any = None,
    *,
    restitution: Any = LOOPS,
    mass: float = 1.0,
    speed: float = 1.0,
    depth: float | None = None,
    device: str = "cpu",
) -> Figure:
    """Plots one law, or compares several, in the same impact; see ``impacts`` and ``rebounds``.

    Args:
        laws: A law, several, or a mapping from labels to laws; instances, or classes with or without values.
        path: The .svg or .png file; ``None``: writes none.
        restitution: Coefficients of restitution whose loops are drawn [-]. Panels that compare several laws use the
            middle one.
        mass: Mass of the sphere [kg].
        speed: Impact speed [m/s].
        depth: Largest penetration of the undamped impact for laws given as a class [m]; default: that of the first
            instance, or 1 mm.
        device: Warp device.

    Returns:
        The matplotlib figure.

    Raises:
        TypeError: If an entry is not a law.
        ValueError: If a value is out of range, the file cannot be written, or there are more than ``MOST`` laws.
    """
    file = None if path is None else check_path(path)
    given = instances.named(Law, laws)
    figures.check_count("laws", list(given))
    options: dict[str, Any] = {"mass": mass, "speed": speed, "depth": depth, "device": device}
    drawn = np.unique(check_restitutions(restitution))
    data = impacts(given, np.union1d(RESTITUTIONS, drawn), **options)
    note = _impact(data, [label for label, entry in given.items() if instances.is_modulus_given(entry)])
    if len(given) == 1:
        kind = instances.class_of(next(iter(given.values())))
        below = drawn[drawn < 1.0]
        over_speed = rebounds(given, below if len(below) else drawn, **options)
        heading = figures.heading(_titles(data)[0], kind.formula)
        footer = [note, data["settings"].item(), f"valid: {kind.validity}" if kind.validity else ""]
        figure = _one(heading, footer, data.isel(law=0), drawn, over_speed)
    else:
        figure = _several(note, data, drawn, rebounds(given, drawn[(len(drawn) - 1) // 2], **options))
    if file is not None:
        save(figure, file)
    return figure


def _one(heading: list[str], footer: list[str], law: xr.Dataset, drawn: Any, over_speed: xr.Dataset) -> Figure:
    """Plots one law with its loops for the restitutions ``drawn``, or the only loop if it does not depend on them."""
    cases = law.sel(restitution=drawn if law["varied"].item() else drawn[-1:])
    sheet = figures.sheet(12.0, 9.5, heading, footer)
    (figure,) = figures.parts(sheet, 1.0)
    panels = figure.subplots(2, 2)
    scales, colors = Scales(cases), figures.shades(cases.sizes["restitution"])
    for k, shade in enumerate(colors):
        case = cases.isel(restitution=k)
        draw_loop(panels[0, 0], case, scales, color=shade)
        draw_force(panels[0, 1], case, scales, color=shade)
    label_loops(panels[0, 0], scales, "force over penetration")
    label_forces(panels[0, 1], cases, scales, "force over time")
    draw_restitution(panels[1, 0], law, cases["restitution"].values.tolist(), colors)
    for shade, prescribed in zip(colors, over_speed["restitution"].values, strict=False):
        values = over_speed["effective_restitution"].isel(law=0).sel(restitution=prescribed)
        draw_over_speed(panels[1, 1], values, color=shade)
    label_over_speed(panels[1, 1], "restitution over impact speed")
    figures.legend_below(figure, colors, [_case_name(cases.isel(restitution=k)) for k in range(len(colors))])
    return sheet


def _several(note: str, data: xr.Dataset, drawn: Any, over_speed: xr.Dataset) -> Figure:
    """Plots laws together for one restitution, and the loops of each in its own panel."""
    labels = data["law"].values.tolist()
    middle = over_speed["restitution"].item()
    loops, same = data.sel(restitution=drawn), data.sel(restitution=middle)
    rows = -(-len(labels) // figures.COLUMNS)
    footer = [note, *(_settings(loops.isel(law=k), title) for k, title in enumerate(_titles(data)))]
    height = 5.6 + 3.2 * rows + 0.15 * len(footer)
    figure = figures.sheet(16.0, height, ["Same impact:  " + ", ".join(labels)], footer)
    upper, lower = figures.parts(figure, 4.2, 0.6 + 3.2 * rows)
    panels = upper.subplots(1, 4)
    scales, colors = Scales(loops), [figures.color(k) for k in range(len(labels))]
    for k, shade in enumerate(colors):
        style = {"color": shade, "linewidth": figures.width(k, len(labels))}
        draw_loop(panels[0], same.isel(law=k), scales, **style)
        draw_force(panels[1], same.isel(law=k), scales, **style)
        draw_over_speed(panels[3], over_speed["effective_restitution"][k, 0], **style)
        line = "-" if same["varied"].values[k] else "--"
        draw_asked(panels[2], data["effective_restitution"].isel(law=k), linestyle=line, **style)
    e = f"e = {middle:g}" if any(same["varied"].values) else "e as below"
    label_loops(panels[0], scales, f"force over penetration, {e}")
    label_forces(panels[1], same, scales, f"force over time, {e}")
    label_asked(panels[2])
    label_over_speed(panels[3], f"over speed, {e} at {_speed(data)}")
    figures.legend_below(upper, colors, [_name(same.isel(law=k)) for k in range(len(labels))])
    _draw_families(lower, loops, scales)
    return figure


def _draw_families(figure: Any, loops: xr.Dataset, scales: Scales) -> None:
    """Draws the loops of each law in its own panel, all with the same axes."""
    colors = figures.shades(loops.sizes["restitution"])
    for k, axes in enumerate(figures.panel_grid(figure, loops.sizes["law"])):
        law = loops.isel(law=k)
        if law["varied"].item():
            for j, shade in enumerate(colors):
                draw_loop(axes, law.isel(restitution=j), scales, color=shade)
        else:
            draw_loop(axes, law.isel(restitution=-1), scales, color=UNVARIED)
        label_loops(axes, scales, _name(law.isel(restitution=-1)))
        axes.title.set_color(figures.color(k))
        if k % figures.COLUMNS:
            axes.set_ylabel("")
    if any(loops["varied"].values):
        figures.legend_below(figure, colors, [f"e = {value:g}" for value in loops["restitution"].values])


def _case_name(case: xr.Dataset) -> str:
    """Returns the legend entry of a loop: its restitution, and the damping used."""
    if case["varied"].item() == "restitution":
        return f"e = {case['restitution'].item():g}"
    if not case["varied"].item():
        return _effective(case)
    value = number(case["parameter"].item(), case["unit"].item())
    return f"{_effective(case)}: {case['varied'].item()} {value}"


def _effective(case: xr.Dataset) -> str:
    """Returns the effective restitution of one impact as text."""
    value = case["effective_restitution"].item()
    return "no rebound" if np.isnan(value) else f"e = {value:.2g}"


def _name(case: xr.Dataset) -> str:
    """Returns the label of a law, with its restitution if that is constant."""
    label = str(case["law"].item())
    return label if case["varied"].item() else f"{label}, {_effective(case)}"


def _titles(data: xr.Dataset) -> list[str]:
    return [titled(*pair) for pair in zip(data["law"].values, data["class"].values, strict=True)]


def _settings(law: xr.Dataset, title: str) -> str:
    """Returns the parameters of a law, with the dampings found for its loops."""
    varied = law["varied"].item()
    texts = [law["settings"].item()]
    if varied and varied != "restitution":
        values = ", ".join(number(value, "") for value in law["parameter"].values)
        found = ", ".join(f"{value:.2g}" for value in law["effective_restitution"].values)
        unit = "" if law["unit"].item() == "-" else f" {law['unit'].item()}"
        texts.append(f"{varied} {values}{unit} for e = {found}")
    return f"{title}: {'; '.join(text for text in texts if text)}"


def _speed(data: xr.Dataset) -> str:
    return number(data.attrs["speed"], "m/s")


def _impact(data: xr.Dataset, stiff: list[str]) -> str:
    """Returns the common conditions of all laws as text; ``stiff``: laws with a given elastic parameter."""
    text = f"sphere of {number(data.attrs['mass'], 'kg')} on a plate at {_speed(data)}"
    depth, of = data.attrs["depth"], data.attrs["depth_of"]
    if np.isnan(depth):
        return text
    text += f", undamped penetration {number(depth, 'm')}"
    if of:
        return f"{text}, as for {of}"
    return f"{text}; for {' and '.join(stiff)} as given by the stiffness" if stiff else text
