"""Plot of a quantile fan."""

from os import PathLike

import xarray as xr

from warpcontact.files.picture_file import check_path, save
from warpcontact.kernels.catalogue.keywords import explain_keywords


@explain_keywords
def write_fan(path: str | PathLike[str], fan: xr.DataArray, title: str | None = None) -> None:
    """Draws a quantile fan: bands between symmetric quantiles, and the median.

    Args:
        path: The .svg or .png file.
        fan: Result of ``quantile_fan``, (quantile, time); for a vector, one component: ``fan.sel(axis="z")``.
        title: Title; ``None``: the name of the sensor.

    Raises:
        ValueError: If the fan has more dimensions, or the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    file = check_path(path)
    if set(fan.dims) != {"quantile", "time"}:
        raise ValueError(f"fan must have the dimensions quantile and time, got {', '.join(map(str, fan.dims))}")
    fan = fan.transpose("quantile", "time")
    levels, times, values = fan["quantile"].values, fan["time"].values, fan.values
    figure = Figure(figsize=(8.0, 4.5), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    bands = len(levels) // 2
    for i in range(bands):
        shade = 0.15 + 0.3 * (i + 1) / bands
        label = f"{levels[i]:.3g} to {levels[-1 - i]:.3g}"
        axes.fill_between(times, values[i], values[-1 - i], color="C0", alpha=shade, lw=0, label=label)
    if len(levels) % 2:
        axes.plot(times, values[bands], color="C0", label=f"{levels[bands]:.3g}")
    unit = fan.attrs.get("units", "-")
    axes.set(xlabel="time [s]", ylabel=str(fan.name) if unit == "-" else f"{fan.name} [{unit}]")
    axes.set_title(str(fan.name) if title is None else title)
    axes.margins(x=0.0)
    count = fan.attrs.get("stopped_environments", 0)
    after = {"hold": "hold their last values", "drop": "count until their stop"}.get(
        fan.attrs.get("stopped", ""), ""
    )
    note = f"\n{count} stopped environments\n{after}" if count else ""
    axes.legend(title=f"quantiles{note}", title_fontsize="small", fontsize="small")
    save(figure, file)
