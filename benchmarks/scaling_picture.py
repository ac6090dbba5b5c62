"""Plots the figures of ``scaling.py``: step time over environments, points, triangles and threads.

    python benchmarks/scaling_picture.py benchmarks/results/scaling-cpu.json --plot scaling.png

Figures of ``compare.py nonsmooth`` are plotted as step time over the number of contacts.
"""

import argparse
import json
import math
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from nonsmooth_benchmark_scenes import SCENES

from warpcontact.files.picture_file import check_path, save

# Series of the figures: title and x-axis label of the panel.
TITLES = {
    "environments": ("Step of all environments", "environments"),
    "points": ("Points of a body", "points"),
    "triangles": ("Triangles of the same terrain", "triangles"),
    "threads": ("Threads", "threads"),
}
LABELS = {"W1": "sphere", "W2p8": "box of 8 points", "W2p64": "box of 64 points"}
# Scenes of nonsmooth contact by the start of their names: title of the panel.
NONSMOOTH_TITLES = {"table": "One box on many feet", "stack": "Stacked boxes, four feet each"}


def draw(figures: Path, picture: Path) -> None:
    """Plots a file of figures."""
    check_path(picture)
    report = json.loads(figures.read_text(encoding="utf-8"))
    measured, about = report["measured"], report["facts"]
    if "scene" in measured[0]:
        draw_contacts(measured, picture)
        return
    names = [name for name in TITLES if any(entry["series"] == name for entry in measured)]
    columns = min(2, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(5.6 * columns, 4.0 * rows + 0.7), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    for axes, name in zip(panels, names, strict=False):
        fits = {fit["line"]: fit for fit in report["fits"] if fit["series"] == name}
        panel(axes, name, [entry for entry in measured if entry["series"] == name], fits)
    have = report["versions"]
    cores = "" if "processor" in about else f", {about['cores']} cores"
    # One panel is too narrow for the title in one line.
    on = " " if columns > 1 else "\n"
    figure.suptitle(
        f"Cost of a step: warpcontact {have['warpcontact']}, Warp {have['warp-lang']},{on}"
        f"on {about['device']}{cores}"
    )
    figure.supxlabel(
        f"median of {report['rounds']} rounds of runs of {report['steps']} steps from rest through contact,{on}"
        f"lowest to highest shaded; {about['date']}",
        fontsize="small",
        color="0.3",
    )
    save(figure, picture)


def draw_contacts(measured: list[dict[str, Any]], picture: Path) -> None:
    """Plots the step time of nonsmooth contact over the number of contacts."""
    figure = Figure(figsize=(10.0, 4.4), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (start, title) in zip(figure.subplots(1, 2), NONSMOOTH_TITLES.items(), strict=True):
        curves: dict[str, list[tuple[int, float]]] = {}
        for entry in measured:
            if entry["scene"].startswith(start):
                point = (SCENES[entry["scene"]].contacts, 1e6 / statistics.median(entry["env_steps_per_s"]))
                curves.setdefault(entry["engine"], []).append(point)
        for index, (engine, points) in enumerate(curves.items()):
            axes.loglog(*zip(*sorted(points), strict=True), "osv^D"[index % 5] + "-", label=engine)
        counts = sorted({count for points in curves.values() for count, _ in points})
        axes.set_title(title, fontsize="medium")
        axes.set_xlabel("contacts of an environment")
        axes.set_ylabel("time per environment and step [µs], all threads")
        axes.set_xticks(counts, [str(count) for count in counts])
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize="small")
    save(figure, picture)


def panel(axes: Any, series: str, entries: list[dict[str, Any]], fits: dict[str, dict[str, Any]]) -> None:
    """Plots one series, its lower bound and a reference growth; ``fits`` by the names of its lines."""
    curves = {}
    for entry in entries:
        curves.setdefault(entry["line"], []).append(entry)
    for index, (line, own) in enumerate(curves.items()):
        values = [entry["value"] for entry in own]
        middle, lowest, highest = (ordinates(series, own, key) for key in ("ns_per_env_step", "lowest", "highest"))
        axes.fill_between(values, lowest, highest, color=f"C{index}", alpha=0.25, linewidth=0)
        axes.plot(values, middle, color=f"C{index}", marker="o", markersize=4, label=label(line, fits.get(line)))
        if series != "threads":
            limit = ordinates(series, own, "ns_bare_query")
            axes.plot(values, limit, color=f"C{index}", linestyle="--", linewidth=0.9, alpha=0.7)
        apart = fits.get(line, {}).get("times_one_thread_in_processes")
        if apart:
            axes.plot(values[-1], apart, color=f"C{index}", marker="x", markersize=7)
    values = sorted({entry["value"] for entry in entries})
    reference(axes, series, values, [ordinates(series, own, "ns_per_env_step") for own in curves.values()])
    if series != "threads":
        axes.plot([], [], color="0.4", linestyle="--", linewidth=0.9, label="bare query of every point")
    if any("times_one_thread_in_processes" in fit for fit in fits.values()):
        axes.plot([], [], color="0.4", linestyle="", marker="x", label="same number of processes")
    title, across = TITLES[series]
    axes.set_title(title, fontsize="medium")
    axes.set_xlabel(across)
    axes.set_ylabel(
        {"environments": "time of a step [µs]", "threads": "speedup over one thread"}.get(
            series, "time of an environment-step [ns]"
        )
    )
    axes.set_xscale("log", base=2 if series in ("threads", "points") else 10)
    axes.set_yscale("log", base=2 if series == "threads" else 10)
    if series in ("threads", "points"):
        axes.set_xticks(values, [str(value) for value in values])
    if series == "threads":
        axes.set_yticks(values, [str(value) for value in values])
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize="small")


def label(line: str, fit: dict[str, Any] | None) -> str:
    """Returns the legend entry of a line, with its fit."""
    name = LABELS.get(line, line)
    if fit is None:
        return name
    if "times_one_thread" in fit:
        most, times = list(fit["times_one_thread"].items())[-1]
        return f"{name}: {times:.2f} × with {most}"
    if "ns_per_decade" in fit:
        return f"{name}: {fit['ns_per_decade']:+.3g} ns per decade, R² = {fit['explained_by_logarithm']:.2f}"
    return f"{name}: n^{fit['upper_exponent']:.2f} in the upper half"


def ordinates(series: str, own: list[dict[str, Any]], key: str) -> list[float]:
    """Returns the y-values of a line: µs per step, speedup over one thread, or ns per environment-step."""
    if series == "environments":
        return [1e-3 * entry[key] * entry["envs"] for entry in own]
    if series == "threads":
        one = next(entry["ns_per_env_step"] for entry in own if entry["value"] == 1)
        return [one / entry[key] for entry in own]
    return [entry[key] for entry in own]


def reference(axes: Any, series: str, values: Sequence[float], curves: Sequence[Sequence[float]]) -> None:
    """Plots a reference line: growth proportional to the value, or to its logarithm."""
    growth: Callable[[float], float] = math.log if series == "triangles" else float
    if series == "threads":
        start, label = 1.0, "proportional"
    elif series == "triangles":
        start, label = curves[0][0] / growth(values[0]), "growth as log n"
    else:
        # At the largest value the device is fully occupied; smaller ones are dominated by constant cost.
        start, label = max(curve[-1] for curve in curves) / growth(values[-1]), "growth as n"
    axes.plot(values, [start * growth(value) for value in values], color="0.4", linestyle=":", label=label)


def main() -> None:
    """Plots the given file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figures", type=Path, help="file of figures from scaling.py or compare.py nonsmooth")
    parser.add_argument("--plot", type=Path, help="plot, .svg or .png (default: next to the figures)")
    options = parser.parse_args()
    picture = options.plot or options.figures.with_suffix(".svg")
    draw(options.figures, picture)
    print(f"picture: {picture}")


if __name__ == "__main__":
    main()
