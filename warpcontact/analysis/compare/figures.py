"""What all pictures of laws and friction models share: a sheet with a heading, colours, and the file it goes to."""

import re
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from warpcontact.files.picture_file import check_path, save

__all__ = ["check_path", "save"]  # and what follows

#: More laws or friction models than this in one picture cannot be told apart.
MOST = 8
#: Panels beside each other.
COLUMNS = 4
DPI = 120
# Room that a legend takes for a letter, and for a line beside its text [in].
LETTER, LINE = 0.085, 0.7
# Characters per inch of the heading and of what stands at the foot.
HEADING, FOOT = 8.0, 13.0


def check_count(kind: str, labels: Sequence[str]) -> None:
    """Raises ``ValueError`` if there are more ``labels`` than one picture can show."""
    if len(labels) > MOST:
        raise ValueError(f"a picture shows at most {MOST} {kind}, got {len(labels)}: {', '.join(labels)}")


def sheet(width: float, height: float, heading: Sequence[str], footer: Sequence[str]) -> Figure:
    """Returns an empty figure of ``width`` and ``height`` [in] with lines above and below, wrapped to fit."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    # A formula is broken between its parts only, not inside of one.
    tied = [re.sub(r"(?<![,;:]) (?! )", "\N{NO-BREAK SPACE}", line) for line in heading]
    lines = [part for line in tied for part in textwrap.wrap(line, int(HEADING * width))]
    below = [part for line in footer if line for part in textwrap.wrap(line, int(FOOT * width))]
    figure.suptitle("\n".join(lines), fontsize="large")
    figure.supxlabel("\n".join(below), fontsize="small", color="0.3")
    return figure


def heading(label: str, formula: str) -> list[str]:
    """Returns the heading of one law or friction: its name, and the formula if it says one."""
    return [f"{label}:  {formula}" if formula else label]


def parts(figure: Figure, *heights: float) -> list[Any]:
    """Returns parts of a figure of relative ``heights``; a legend below one stays clear of what is at the foot."""
    made: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)
    return list(made[:, 0])


def shades(count: int) -> Any:
    """Returns ``count`` colours in order, dark to light; none so light that it is lost on white."""
    return mpl.colormaps["plasma"](np.linspace(0.0, 0.85, count))


def color(index: int) -> str:
    """Returns the colour of law or friction ``index``."""
    return f"C{index}"


def width(index: int, count: int) -> float:
    """Returns the width of line ``index``: one below another shows at both sides of it."""
    return 1.2 + min(0.9, 2.4 / max(count - 1, 1)) * (count - 1 - index)


def legend_below(figure: Any, colors: Sequence[Any], names: Sequence[str]) -> None:
    """Puts a legend of lines below all panels of ``figure``, in as few rows as it fits into."""
    lines = [Line2D([], [], color=shade) for shade in colors]
    widest = LETTER * max(map(len, names)) + LINE
    most = max(1, int(figure.bbox.width / figure.dpi / widest))
    # As even as it gets: five in two rows are three and two, not four and one.
    columns = -(-len(names) // -(-len(names) // most))
    figure.legend(lines, names, loc="outside lower center", ncols=columns, frameon=False)


def label_axes(axes: Any, title: str, x: str, y: str) -> None:
    """Labels a panel."""
    axes.set_title(title, fontsize="medium")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)


def panel_grid(figure: Any, count: int) -> Any:
    """Returns ``count`` panels with common axes, in rows."""
    rows = -(-count // COLUMNS)
    panels = figure.subplots(rows, min(count, COLUMNS), squeeze=False, sharex=True, sharey=True).ravel()
    for axes in panels[count:]:
        axes.set_visible(False)
    for axes in panels[:count]:
        # Also where the panel below is not there.
        axes.xaxis.set_tick_params(labelbottom=True)
    return panels[:count]
