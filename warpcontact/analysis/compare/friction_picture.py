"""Plots of friction models: coefficient over slip speed, and loops under oscillating slip."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from warpcontact.analysis.compare import figures, instances
from warpcontact.analysis.compare.friction_tests import breakaway_coefficients, friction_speeds, slips, swings
from warpcontact.analysis.compare.instances import number, prefixed, titled
from warpcontact.files.picture_file import check_path, save
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.friction.base import Friction

# Largest slip speed of the linear panel, as a multiple of the largest speed parameter.
LINEAR = 4.0
# Slip directions shown for anisotropic friction models [°], and their line styles.
DIRECTIONS = {0: "-", 45: "--", 90: ":"}
# The breakaway coefficient is shown if it exceeds the largest coefficient in steady slip by this factor.
HOLDS = 1.02
HELD = "-."
# Relative margin around the curves.
ROOM = 0.08
# Smallest upper end of the coefficient axis, so that a frictionless model appears as zero.
LEAST = 0.1


@explain_keywords
def plot_friction_models(
    friction_models: Any, path: Any = None, *, load: float = 10.0, device: str = "cpu"
) -> Figure:
    """Plots one friction model, or compares several; see ``slips`` and ``swings``.

    Args:
        friction_models: A friction model, several, or a mapping from labels to friction models; instances, or classes
            with or without values.
        path: The .svg or .png file; ``None``: writes none.
        load: Normal force [N].
        device: Warp device.

    Returns:
        The matplotlib figure.

    Raises:
        TypeError: If an entry is not a friction model.
        ValueError: If a value is out of range, the file cannot be written, or there are more than ``MOST`` models.
    """
    file = None if path is None else check_path(path)
    given = instances.named(Friction, friction_models)
    figures.check_count("friction models", list(given))
    options: dict[str, Any] = {"load": load, "device": device}
    swinging = swings(given, **options)
    # Linear spacing for the panel with a linear speed axis.
    near_zero = np.linspace(0.0, LINEAR * friction_speeds(given, load)[1], 301)[1:]
    held = breakaway_coefficients(given, load, device)
    kinds = [instances.class_of(entry) for entry in given.values()]
    if len(given) == 1:
        turns = list(DIRECTIONS) if kinds[0].directional else [0]
        evenly, steadily = (
            [slips(given, speeds, direction=np.radians(turn), **options) for turn in turns]
            for speeds in (near_zero, None)
        )
        figure = _one(kinds[0], evenly, steadily, swinging, held)
    else:
        chosen = instances.coefficients_chosen(given.values())
        note = _slip(swinging) + (f"; default values: {chosen}" if chosen else "")
        steered = [label for label, kind in zip(given, kinds, strict=True) if kind.directional]
        figure = _several(
            note, slips(given, near_zero, **options), slips(given, **options), swinging, held, steered
        )
    if file is not None:
        save(figure, file)
    return figure


def _one(
    kind: type[Friction],
    even: list[xr.Dataset],
    steady: list[xr.Dataset],
    swinging: xr.Dataset,
    held: dict[str, float],
) -> Figure:
    """Plots one friction model, with steady slip in one direction or in all of ``DIRECTIONS``."""
    footer = [_slip(swinging), *swinging["settings"].values, f"valid: {kind.validity}" if kind.validity else ""]
    sheet = figures.sheet(15.0, 5.6, figures.heading(_titles(swinging)[0], kind.formula), footer)
    (figure,) = figures.parts(sheet, 1.0)
    panels = figure.subplots(1, 3)
    for measured, axes in ((even, panels[0]), (steady, panels[1])):
        for data, (turn, line) in zip(measured, DIRECTIONS.items(), strict=False):
            curve = data["coefficient"].isel(friction=0)
            axes.plot(data["speed"], curve, color=figures.color(0), linestyle=line, label=f"{turn}° from x")
    for greatest in _holding(held, steady).values():
        for axes in panels[:2]:
            line = axes.axhline(greatest, color=figures.color(0), linestyle=HELD)
            axes.legend([line], [f"breakaway: {greatest:.2g}"], loc="lower right", fontsize="small")
    if len(even) > 1:
        panels[1].legend(title="direction of slip", loc="upper left", fontsize="small")
    colors = figures.shades(swinging.sizes["amplitude"])
    _draw_swings(panels[2], swinging.isel(friction=0), colors)
    _finish(panels, even, steady, swinging, held, along=" along x" if len(even) > 1 else "")
    figures.legend_below(figure, colors, _amplitudes(swinging))
    return sheet


def _several(
    note: str,
    even: xr.Dataset,
    steady: xr.Dataset,
    swinging: xr.Dataset,
    held: dict[str, float],
    directional: list[str],
) -> Figure:
    """Plots friction models together, and the loops of each in its own panel; ``directional`` ones slip along x."""
    labels = steady["friction"].values.tolist()
    rows = -(-len(labels) // figures.COLUMNS)
    holding = _holding(held, [steady])
    footer = [note, *_lines(swinging)]
    if holding:
        footer.insert(1, "dash-dotted: breakaway coefficient, the largest in slow slip from rest")
    if directional:
        names = " and ".join(directional)
        footer.insert(1, f"slip is along the x axis of the surface; for {names} other directions differ")
    height = 5.6 + 3.2 * rows + 0.15 * len(footer)
    sheet = figures.sheet(16.0, height, ["Same slip:  " + ", ".join(labels)], footer)
    upper, lower = figures.parts(sheet, 4.2, 0.6 + 3.2 * rows)
    panels = upper.subplots(1, 3)
    colors = [figures.color(k) for k in range(len(labels))]
    largest = swinging.isel(amplitude=[-1])
    for k, shade in enumerate(colors):
        style = {"color": shade, "linewidth": figures.width(k, len(labels))}
        panels[0].plot(even["speed"], even["coefficient"].isel(friction=k), **style)
        panels[1].plot(steady["speed"], steady["coefficient"].isel(friction=k), **style)
        _draw_swings(panels[2], largest.isel(friction=k), [shade], linewidth=style["linewidth"])
        for axes in panels[:2] if labels[k] in holding else ():
            axes.axhline(holding[labels[k]], linestyle=HELD, **style)
    _finish(panels, [even], [steady], largest, holding, along=" along x" if directional else "")
    figures.legend_below(upper, colors, labels)
    shades = figures.shades(swinging.sizes["amplitude"])
    for k, axes in enumerate(figures.panel_grid(lower, len(labels))):
        _draw_swings(axes, swinging.isel(friction=k), shades)
        _finish_swings(axes, swinging, labels[k])
        axes.title.set_color(colors[k])
        if k % figures.COLUMNS:
            axes.set_ylabel("")
    figures.legend_below(lower, shades, _amplitudes(swinging))
    return sheet


def _draw_swings(axes: Any, friction: xr.Dataset, colors: Any, **style: Any) -> None:
    """Draws the loops of one friction model, small ones above large ones."""
    factor, _ = prefixed(float(friction["amplitude"].max()), "m")
    for k in reversed(range(friction.sizes["amplitude"])):
        swing = friction.isel(amplitude=k)
        axes.plot(factor * swing["displacement"], swing["coefficient"], color=colors[k], **style)


def _holding(held: dict[str, float], steady: list[xr.Dataset]) -> dict[str, float]:
    """Returns the breakaway coefficients that exceed the largest coefficient in steady slip by factor ``HOLDS``."""
    most = {label: max(float(data["coefficient"].sel(friction=label).max()) for data in steady) for label in held}
    return {label: greatest for label, greatest in held.items() if greatest > HOLDS * most[label]}


def _finish(
    panels: Any,
    even: list[xr.Dataset],
    steady: list[xr.Dataset],
    swinging: xr.Dataset,
    held: dict[str, float],
    along: str,
) -> None:
    """Labels the three panels."""
    y = "friction coefficient F/N [-]"
    greatest = max(LEAST, *held.values(), *(float(data["coefficient"].max()) for data in (*even, *steady)))
    top = (1.0 + ROOM) * greatest
    panels[0].set(xlim=(0.0, float(even[0]["speed"].max())), ylim=(-0.02 * top, top))
    panels[0].locator_params(axis="x", nbins=6)
    panels[1].set(xscale="log", ylim=(-0.02 * top, top))
    # A single anisotropic model is shown in several slip directions.
    steadily = "steady slip" + (along if len(even) == 1 else "")
    figures.label_axes(panels[0], steadily, "slip speed [m/s]", y)
    figures.label_axes(panels[1], f"{steadily}, logarithmic", "slip speed [m/s]", y)
    _finish_swings(panels[2], swinging, f"oscillating slip{along}")


def _finish_swings(axes: Any, swinging: xr.Dataset, title: str) -> None:
    _, unit = prefixed(float(swinging["amplitude"].max()), "m")
    top = max(float(np.abs(swinging["coefficient"]).max()), LEAST) * (1.0 + ROOM)
    axes.set_ylim(-top, top)
    axes.locator_params(axis="x", nbins=6)
    figures.label_axes(axes, title, f"displacement [{unit}]", "friction force F/N against +x [-]")


def _amplitudes(swinging: xr.Dataset) -> list[str]:
    factor, unit = prefixed(float(swinging["amplitude"].max()), "m")
    largest, fast = float(swinging["amplitude"].max()), float(swinging.attrs["speed"])
    return [
        f"amplitude {number(factor * value, unit)}, up to {number(fast * value / largest, 'm/s')}"
        for value in swinging["amplitude"].values
    ]


def _titles(data: xr.Dataset) -> list[str]:
    return [titled(*pair) for pair in zip(data["friction"].values, data["class"].values, strict=True)]


def _lines(data: xr.Dataset) -> list[str]:
    """Returns one line of parameters for each friction model that has some."""
    return [f"{title}: {text}" for title, text in zip(_titles(data), data["settings"].values, strict=True) if text]


def _slip(swinging: xr.Dataset) -> str:
    return f"pressed on a plate with {number(swinging.attrs['load'], 'N')}"
