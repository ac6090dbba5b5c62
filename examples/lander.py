"""The landings of lander.toml: quantiles of their loads with confidence intervals, and the rate of tipping.

    python examples/lander.py
    python examples/lander.py --envs 65536 --out results/many_landings

Some of the landings run again with recording, which gives the spread of the total leg load over time.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

import warpcontact as wc

FILE = Path(__file__).with_name("lander.toml")
QUANTILES = (0.5, 0.95, 0.99)
RECORDED = 512  # environments


def tilts(orientation: np.ndarray) -> np.ndarray:
    """Returns the angle between the axes of landers and the vertical (n,) [deg], from quaternions (n, 4)."""
    x, y = orientation[:, 0], orientation[:, 1]
    return np.degrees(np.arccos(1.0 - 2.0 * (x**2 + y**2)))


def recorded(run: wc.Run, envs: int, out: Path, device: str) -> wc.Run:
    """Runs the first landings of a run again, up to their median end time, and records their loads."""
    content = run.settings.model_dump(exclude_none=True) | {
        "envs": envs,
        "duration": float(np.round(run.outcome["end_time"].median(), 2)),
        "record": {"every": 0.01, "sensors": ["lander.force"]},
    }
    return wc.Experiment.from_dict(content, run.folder).run(out, device=device, overwrite=True)


def plot(settled: dict[float, xr.Dataset], path: Path) -> None:
    """Plots the convergence of the quantiles of the peak load with the number of landings."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.0), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for i, (q, found) in enumerate(settled.items()):
        color = f"C{i}"
        axes.fill_between(found["n"], found["low"] / 1e3, found["high"] / 1e3, color=color, alpha=0.25, lw=0)
        axes.plot(found["n"], found["estimate"] / 1e3, ".-", color=color, label=f"{100 * q:g} %")
    axes.set(xscale="log", xlabel="landings", ylabel="peak load of all legs [kN]")
    axes.set_title("Quantiles of the peak load, with intervals of 95 % confidence")
    axes.grid(alpha=0.3)
    axes.legend(title="quantile")
    figure.savefig(path)


def main(argv: Sequence[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="Landings on rough ground, and the quantiles of their loads.")
    parser.add_argument("--envs", type=int, help="number of landings (default: that of the file)")
    parser.add_argument("--out", type=Path, default=Path("results/lander"), help="folder (default: %(default)s)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    options = parser.parse_args(argv)

    run = wc.Experiment.from_toml(FILE).run(options.out, envs=options.envs, device=options.device, overwrite=True)
    print(run)
    outcome, landings = run.outcome, run.outcome.sizes["env"]

    settled = {q: wc.convergence(run, "peak_load", "quantile", q) for q in QUANTILES}
    result = {}
    print("\npeak load of all legs [kN], with intervals of 95 % confidence")
    for q, found in settled.items():
        estimate, low, high = (float(found[key][-1]) / 1e3 for key in ("estimate", "low", "high"))
        print(f"  {100 * q:3g} %  {estimate:6.2f}   {low:6.2f} … {high:6.2f}")
        result[f"load {q}"] = estimate
    stopped = outcome["stopped_by"].values
    names = dict(zip(outcome["stopped_by"].flag_meanings.split(), outcome["stopped_by"].flag_values, strict=True))
    tipped, rested = stopped == names["tipped"], stopped == names["rest"]
    result["tipped"] = float(tipped.mean())
    result["tilt"] = float(np.quantile(tilts(outcome["attitude"].values[rested]), 0.95))
    print(f"{tipped.sum()} of {landings} tipped over: {100 * result['tipped']:.2f} %")
    print(f"{rested.sum()} came to rest; 95 % of these within {result['tilt']:.1f}° of upright")
    plot(settled, options.out / "peak_load.png")

    few = recorded(
        run, min(RECORDED, landings), options.out.with_name(f"{options.out.name}_recorded"), options.device
    )
    fan = wc.quantile_fan(few, "lander.force").sel(axis="z")
    wc.write_fan(options.out / "load_over_time.png", fan, f"load of all legs, {few.settings.envs} landings")
    result["fan"] = float(fan.max())
    print(f"pictures: {options.out}/picture.png, peak_load.png and load_over_time.png")
    return result


if __name__ == "__main__":
    main()
