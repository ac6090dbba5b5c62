"""Draws the picture of a run without series: histograms of outcomes over the environments.

The picture is drawn without a display and without the global state of matplotlib.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from warpcontact.experiment.bars import bin_edges, has_integer_bins
from warpcontact.files.picture_file import save
from warpcontact.files.run_folder import RunPath
from warpcontact.scene.status import EnvironmentStatus
from warpcontact.stepping.outcomes.watch import RESERVED
from warpcontact.storage.memory_estimate import env_count_text
from warpcontact.validation.safe_text import single_line, truncate

# Largest number of histograms.
MOST = 6
# Largest number of characters of the title.
TITLE = 60
COLUMNS = 3
QUANTILES = (0.05, 0.5, 0.95)
# First characters of an additive offset of ticks, as matplotlib writes it.
_SIGNS = "+-\N{MINUS SIGN}"


def write_outcome_picture(path: Path | RunPath, outcome: xr.Dataset, title: str) -> bool:
    """Draws histograms of the first scalar outcomes; frozen environments are excluded, their number is in the title.

    Args:
        path: The .png file.
        outcome: Outcomes and status of environments, as ``Simulation.outcomes`` returns them.
        title: Title of the picture.

    Returns:
        Whether the picture was written; False: there is no scalar outcome.
    """
    drawn = list(_numbers(outcome))[:MOST]
    if not drawn:
        return False
    frozen = outcome["status"].values == EnvironmentStatus.FROZEN
    columns = min(len(drawn), COLUMNS)
    rows = -(-len(drawn) // columns)
    figure = Figure(figsize=(1.0 + 4.2 * columns, 0.8 + 3.2 * rows), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    left_out = f", {frozen.sum()} frozen excluded" if frozen.any() else ""
    title = f"{truncate(single_line(title), TITLE)}: {env_count_text(len(frozen))}"
    figure.suptitle(f"{title}{left_out}", parse_math=False)
    for i, (name, label, values) in enumerate(drawn):
        axes = figure.add_subplot(rows, columns, i + 1)
        _draw_histogram(axes, values[~frozen])
        axes.set_title(name)
        axes.set_xlabel(f"{label}{_offset_of_ticks(axes)}", fontsize="small")
        if i % columns == 0:
            axes.set_ylabel("environments")
    save(figure, path)
    return True


def _numbers(outcome: xr.Dataset) -> Iterator[tuple[str, str, NDArray[np.float64]]]:
    """Iterates over the outcomes with one number per environment: name, label of the axis, values."""
    for name, array in outcome.data_vars.items():
        if name in RESERVED or array.dims != ("env",):
            continue
        unit = array.attrs.get("units", "-")
        about = str(array.attrs.get("long_name", name))
        yield str(name), about if unit == "-" else f"{about} [{unit}]", array.values.astype(np.float64)


def _offset_of_ticks(axes: Axes) -> str:
    """Returns factor and offset of the ticks, for the axis label, and hides the text that matplotlib would draw."""
    formatter = axes.xaxis.get_major_formatter()
    formatter.format_ticks(axes.xaxis.get_majorticklocs().tolist())
    axes.xaxis.offsetText.set_visible(False)
    offset = formatter.get_offset()
    if offset and offset[0] not in _SIGNS:
        offset = f"×{offset}"
    return f" ({offset})" if offset else ""


def _draw_histogram(axes: Axes, values: NDArray[np.float64]) -> None:
    """Draws a histogram of the finite values, and states the number of values that are not finite."""
    finite = values[np.isfinite(values)]
    if len(finite):
        axes.hist(finite, bins=bin_edges(finite).tolist(), color="C0", alpha=0.75)
        axes.xaxis.set_major_locator(MaxNLocator(5, integer=has_integer_bins(finite)))
        marks = np.quantile(finite, QUANTILES)
        for q, mark, line in zip(QUANTILES, marks, (":", "-", ":"), strict=True):
            axes.axvline(mark, color="C1", linestyle=line, label=f"{100 * q:g} %: {mark:.4g}")
        # Below the axis label, where the legend hides nothing.
        layout = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16), "ncols": 3}
        axes.legend(**layout, fontsize="small", frameon=False, handlelength=1.2, columnspacing=1.0)
    else:
        axes.set(xticks=(), yticks=())
    if len(finite) < len(values) or not len(values):
        text = f"{len(values) - len(finite)} without a finite value" if len(values) else "all are frozen"
        axes.text(0.02, 0.98, text, transform=axes.transAxes, va="top", fontsize="small", color="C3")
    axes.set_axisbelow(True)
    axes.grid(alpha=0.3)
