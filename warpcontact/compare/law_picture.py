"""Pictures of laws: loops, force over time, and the restitution that comes out."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from warpcontact.compare import figures, law_panels, samples
from warpcontact.compare.impact import RESTITUTIONS, asked_restitutions, impacts, rebounds
from warpcontact.compare.labels import number
from warpcontact.compare.law_panels import Scales
from warpcontact.kernels.laws.base import Law

#: Restitutions whose loops are drawn.
LOOPS = (0.2, 0.4, 0.6, 0.8, 1.0)


def plot_laws(
    laws: Any,
    path: Any = None,
    *,
    restitution: ArrayLike = LOOPS,
    mass: float = 1.0,
    speed: float = 1.0,
    depth: float = 1.0e-3,
    device: str = "cpu",
) -> Figure:
    """Draws one law, or several side by side, in the same impact; see ``impacts`` and ``rebounds``.

    Args:
        laws: A law, several, or a mapping from labels to laws; instances or classes.
        path: The .svg or .png file; ``None``: none is written.
        restitution: Coefficients of restitution whose loops are drawn [-]; where several laws lie over each
            other it is the one in the middle.
        mass: Mass of the sphere [kg].
        speed: Its speed at touch [m/s].
        depth: Greatest depth of the undamped impact on a law that is given as a class [m].
        device: Warp device.

    Returns:
        The matplotlib figure.

    Raises:
        TypeError: If a law is none.
        ValueError: If a value is out of range, the file cannot be written there, or there are too many laws.
    """
    file = None if path is None else figures.check_path(path)
    given = samples.named(Law, laws)
    figures.check_count("laws", list(given))
    options: dict[str, Any] = {"mass": mass, "speed": speed, "depth": depth, "device": device}
    drawn = np.unique(asked_restitutions(restitution))
    data = impacts(given, np.union1d(RESTITUTIONS, drawn), **options)
    if len(given) == 1:
        (entry,) = given.values()
        below = drawn[drawn < 1.0]
        lossy = bool(data["varied"].item())
        over_speed = rebounds(given, below if len(below) else drawn, **options) if lossy else None
        figure = _one(entry.formula, entry.validity, data, drawn, over_speed)
    else:
        middle = drawn[(len(drawn) - 1) // 2]
        figure = _several(data, drawn, rebounds(given, middle, **options))
    if file is not None:
        figures.save(figure, file)
    return figure


def _one(formula: str, validity: str, data: xr.Dataset, drawn: Any, over_speed: xr.Dataset | None) -> Figure:
    """Draws one law; ``over_speed`` is missing for an elastic one, whose loops are all the same."""
    law = data.isel(law=0)
    cases = law.sel(restitution=drawn if over_speed is not None else drawn[-1:])
    rows = 1 if over_speed is None else 2
    foot = [_impact(data), *law["settings"].values.ravel(), f"valid: {validity}" if validity else ""]
    sheet = figures.sheet(12.0, 1.7 + 3.9 * rows, figures.heading(law["law"].item(), formula), foot)
    (figure,) = figures.parts(sheet, 1.0)
    panels = figure.subplots(rows, 2, squeeze=False)
    scales, colors = Scales(cases), figures.shades(cases.sizes["restitution"])
    for k, shade in enumerate(colors):
        case = cases.isel(restitution=k)
        law_panels.draw_loop(panels[0, 0], case, scales, color=shade)
        law_panels.draw_force(panels[0, 1], case, scales, color=shade)
    law_panels.finish_loops(panels[0, 0], scales, "force over penetration")
    law_panels.finish_forces(panels[0, 1], scales, "force over time")
    if over_speed is None:
        return sheet
    law_panels.draw_restitution(panels[1, 0], law, drawn, colors)
    for shade, asked in zip(colors, over_speed["restitution"].values, strict=False):
        values = over_speed["effective_restitution"].isel(law=0).sel(restitution=asked)
        law_panels.draw_over_speed(panels[1, 1], values, color=shade)
    law_panels.finish_over_speed(panels[1, 1], "restitution over impact speed")
    figures.legend_below(figure, colors, [_case_name(cases.isel(restitution=k)) for k in range(len(colors))])
    return sheet


def _several(data: xr.Dataset, drawn: Any, over_speed: xr.Dataset) -> Figure:
    """Draws laws over each other for one restitution, and the loops of each beside each other."""
    labels = data["law"].values.tolist()
    middle = over_speed["restitution"].item()
    rows = -(-len(labels) // figures.COLUMNS)
    foot = [_impact(data), *figures.lines_of(labels, data["settings"].values)]
    height = 5.6 + 3.2 * rows + 0.15 * len(foot)
    figure = figures.sheet(16.0, height, ["The same impact:  " + ", ".join(labels)], foot)
    upper, lower = figures.parts(figure, 4.2, 0.6 + 3.2 * rows)
    panels = upper.subplots(1, 4)
    same, colors = data.sel(restitution=middle), [figures.color(k) for k in range(len(labels))]
    scales = Scales(same)
    for k, shade in enumerate(colors):
        style = {"color": shade, "linewidth": figures.width(k, len(labels))}
        law_panels.draw_loop(panels[0], same.isel(law=k), scales, **style)
        law_panels.draw_force(panels[1], same.isel(law=k), scales, **style)
        if same["varied"].values[k] == "restitution":
            law_panels.draw_asked(panels[2], data["effective_restitution"].isel(law=k), **style)
        if same["varied"].values[k]:
            values = over_speed["effective_restitution"].isel(law=k, restitution=0)
            law_panels.draw_over_speed(panels[3], values, **style)
    law_panels.finish_loops(panels[0], scales, f"force over penetration, e = {middle:g}")
    law_panels.finish_forces(panels[1], scales, f"force over time, e = {middle:g}")
    law_panels.finish_asked(panels[2])
    law_panels.finish_over_speed(panels[3], f"over speed, e = {middle:g} at {data.attrs['speed']:g} m/s")
    figures.legend_below(upper, colors, labels)
    _draw_families(lower, data.sel(restitution=drawn))
    return figure


def _draw_families(figure: Any, loops: xr.Dataset) -> None:
    """Draws the loops of every law in a panel of its own, all with the same axes."""
    scales, colors = Scales(loops), figures.shades(loops.sizes["restitution"])
    for k, axes in enumerate(figures.family(figure, loops.sizes["law"])):
        law = loops.isel(law=k)
        elastic = not law["varied"].item()
        for j, shade in list(enumerate(colors))[-1 if elastic else 0 :]:
            law_panels.draw_loop(axes, law.isel(restitution=j), scales, color=shade)
        law_panels.finish_loops(axes, scales, str(law["law"].item()))
        axes.title.set_color(figures.color(k))
        if k % figures.COLUMNS:
            axes.set_ylabel("")
    figures.legend_below(figure, colors, [f"e = {value:g}" for value in loops["restitution"].values])


def _case_name(case: xr.Dataset) -> str:
    """Returns what sets a loop apart: the restitution, and the damping that it took."""
    if case["varied"].item() == "restitution":
        return f"e = {case['restitution'].item():g}"
    value = number(case["parameter"].item(), case["unit"].item())
    return f"e = {case['effective_restitution'].item():.2g}: {value}"


def _impact(data: xr.Dataset) -> str:
    return f"sphere of {number(data.attrs['mass'], 'kg')} on a plate at {number(data.attrs['speed'], 'm/s')}"
