"""Shared parts of the plots of laws and friction models: figure with heading, colors and legends."""

import re
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

#: Largest number of laws or friction models that can be distinguished in one plot.
MOST = 8
#: Number of panels per row.
COLUMNS = 4
DPI = 120
# Width of a legend per letter, and of the line sample of an entry [in].
LETTER, LINE = 0.085, 0.7
# Characters per inch of the heading and of the footer.
HEADING, FOOT = 8.0, 13.0


def check_count(kind: str, labels: Sequence[str]) -> None:
    """Raises ``ValueError`` if there are more ``labels`` than one plot can show."""
    if len(labels) > MOST:
        raise ValueError(f"a plot shows at most {MOST} {kind}, got {len(labels)}: {', '.join(labels)}")


def sheet(width: float, height: float, heading: Sequence[str], footer: Sequence[str]) -> Figure:
    """Returns an empty figure of ``width`` × ``height`` [in] with wrapped heading and footer."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    # Break formulas between their parts only.
    tied = [re.sub(r"(?<![,;:]) (?! )", "\N{NO-BREAK SPACE}", line) for line in heading]
    lines = [part for line in tied for part in textwrap.wrap(line, int(HEADING * width))]
    below = [part for line in footer if line for part in textwrap.wrap(line, int(FOOT * width))]
    figure.suptitle("\n".join(lines), fontsize="large")
    figure.supxlabel("\n".join(below), fontsize="small", color="0.3")
    return figure


def heading(label: str, formula: str) -> list[str]:
    """Returns the heading of one law or friction model: its name, and its formula if there is one."""
    return [f"{label}:  {formula}" if formula else label]


def parts(figure: Figure, *heights: float) -> list[Any]:
    """Returns subfigures of relative ``heights``; a legend below one does not overlap the footer."""
    made: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)
    return list(made[:, 0])


def shades(count: int) -> Any:
    """Returns ``count`` colors from dark to light, all visible on white."""
    return mpl.colormaps["plasma"](np.linspace(0.0, 0.85, count))


def color(index: int) -> str:
    """Returns the color of law or friction model ``index``."""
    return f"C{index}"


def width(index: int, count: int) -> float:
    """Returns the width of line ``index``; lower lines are wider, so that coincident lines stay visible."""
    return 1.2 + min(0.9, 2.4 / max(count - 1, 1)) * (count - 1 - index)


def legend_below(figure: Any, colors: Sequence[Any], names: Sequence[str]) -> None:
    """Adds a legend below all panels of ``figure``, with as few rows as fit."""
    lines = [Line2D([], [], color=shade) for shade in colors]
    widest = LETTER * max(map(len, names)) + LINE
    max_columns = max(1, int(figure.bbox.width / figure.dpi / widest))
    # Balance the rows: five entries in two rows are three and two, not four and one.
    columns = -(-len(names) // -(-len(names) // max_columns))
    figure.legend(lines, names, loc="outside lower center", ncols=columns, frameon=False)


def label_axes(axes: Any, title: str, x: str, y: str) -> None:
    """Labels a panel."""
    axes.set_title(title, fontsize="medium")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)


def panel_grid(figure: Any, count: int) -> Any:
    """Returns ``count`` panels with common axes, in rows of ``COLUMNS``."""
    rows = -(-count // COLUMNS)
    panels = figure.subplots(rows, min(count, COLUMNS), squeeze=False, sharex=True, sharey=True).ravel()
    for axes in panels[count:]:
        axes.set_visible(False)
    for axes in panels[:count]:
        # Show tick labels also if the panel below is missing.
        axes.xaxis.set_tick_params(labelbottom=True)
    return panels[:count]
