"""Restitution over mass and speed for five contact laws: 65 536 environments, compared with closed forms.

    python examples/restitution_map.py
    python examples/restitution_map.py --side 64 --out results/small_map

In every environment five strikers of the same mass m and speed v hit a plate, one per law. By dimensional analysis
the restitution e depends on:

* Kelvin–Voigt, N = K δ + c δ̇: mass only, by the damping ratio ξ = c/(2 √(K m));
* Hunt–Crossley, N = K δ^1.5 (1 + χ δ̇): speed only, by d = χ v: d (1 + e) = ln[(1 + d)/(1 − d e)];
* Kuwabara–Kono, N = K (δ^1.5 + 1.5 A √δ δ̇): both, by A (K/m)^0.4 v^0.2; e is a Padé approximant with an error of
  7e-4;
* Lankarani–Nikravesh and Flores: neither, by design. It is not the prescribed value, but e of their d(e) from the
  Hunt–Crossley equation.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from warpcontact.kernels.laws.hunt_crossley import restitution_of_damping_factor
from warpcontact.kernels.laws.linear_dashpot import restitution_of_damping_ratio
from warpcontact.kernels.laws.nonlinear_dashpot import restitution_of_viscosity

import warpcontact as wc

MASSES, SPEEDS = (0.5, 5.0), (0.1, 3.0)  # kg, m/s
HERTZ, LINEAR = 1e6, 1e5  # N/m^1.5, N/m
DASHPOT, CHI, VISCOSITY, RESTITUTION = 100.0, 0.3, 4e-4, 0.5  # N s/m, s/m, s, -
LAWS: dict[str, dict[str, Any]] = {
    "kelvin_voigt": {"type": "KelvinVoigt", "stiffness": LINEAR, "damping": DASHPOT},
    "hunt_crossley": {"type": "HuntCrossley", "stiffness": HERTZ, "damping": CHI},
    "kuwabara_kono": {"type": "KuwabaraKono", "stiffness": HERTZ, "viscosity": VISCOSITY},
    "lankarani_nikravesh": {"type": "LankaraniNikravesh", "stiffness": HERTZ, "restitution": RESTITUTION},
    "flores": {"type": "Flores", "stiffness": HERTZ, "restitution": RESTITUTION},
}
TITLES = ("Kelvin–Voigt", "Hunt–Crossley", "Kuwabara–Kono", "Lankarani–Nikravesh", "Flores")


def experiment(masses: np.ndarray, speeds: np.ndarray) -> wc.Experiment:
    """Returns the experiment of impacts of all masses [kg] with all speeds [m/s], the speed varying fastest."""
    variation: dict[str, Any] = {}
    for name in LAWS:
        variation[f"{name}.mass"] = {"grid": masses.tolist(), "group": "mass"}
        variation[f"{name}.linear_velocity"] = {"grid": [[0, 0, -v] for v in speeds.tolist()], "group": "speed"}
    bodies = [
        {"name": name, "mass": 1, "inertia": [1e-3] * 3, "position": [0.3 * i, 0, 1e-6]}
        for i, name in enumerate(LAWS)
    ]
    return wc.Experiment.from_dict(
        {
            "name": "restitution map",
            # Longest contact (heaviest, slowest striker): 39 ms without loss. Shortest contact: 31 steps.
            "duration": 0.06,
            "dt": 2.5e-4,
            "gravity": [0, 0, 0],
            "surface": [{"name": "plate", "mesh": {"shape": "grid", "size": [4, 4]}}],
            "body": bodies,
            "point": [{"name": f"{name}_tip", "body": name, "position": [0, 0, 0]} for name in LAWS],
            "material": [{"name": f"{name}_law", "law": law} for name, law in LAWS.items()],
            "contact": [
                {"name": f"{name}_hit", "points": f"{name}_tip", "surface": "plate", "material": f"{name}_law"}
                for name in LAWS
            ],
            "variation": variation,
            "outcome": {name: {"type": "Restitution", "of": f"{name}_hit"} for name in LAWS},
            "record": {"series": False},
        }
    )


def closed_forms(mass: np.ndarray, speed: np.ndarray) -> dict[str, np.ndarray]:
    """Returns the restitution of each law at masses [kg] and speeds [m/s] of the same shape."""
    same = np.ones_like(mass)
    return {
        "kelvin_voigt": restitution_of_damping_ratio(DASHPOT / (2.0 * np.sqrt(LINEAR * mass))),
        "hunt_crossley": restitution_of_damping_factor(CHI * speed),
        "kuwabara_kono": restitution_of_viscosity(VISCOSITY * (HERTZ / mass) ** 0.4 * speed**0.2),
        "lankarani_nikravesh": restitution_of_damping_factor(0.75 * (1.0 - RESTITUTION**2) * same),
        "flores": restitution_of_damping_factor(1.6 * (1.0 - RESTITUTION) / RESTITUTION * same),
    }


def plot(
    masses: np.ndarray,
    speeds: np.ndarray,
    found: dict[str, np.ndarray],
    closed_form_values: dict[str, np.ndarray],
    path: Path,
) -> None:
    """Plots a map (mass, speed) of each law with the contours of its closed form, and curves over the speed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.0, 8.0), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    levels = np.arange(0.4, 1.0, 0.05)
    for ax, (name, values), title in zip(axes.flat, found.items(), TITLES, strict=False):
        image = ax.pcolormesh(speeds, masses, values, vmin=levels[0], vmax=1.0, cmap="viridis", rasterized=True)
        if np.ptp(closed_form_values[name]) > 0.0:
            lines = ax.contour(speeds, masses, closed_form_values[name], levels, colors="white", linewidths=1.0)
            ax.clabel(lines, fontsize="small")
        else:
            text = f"{closed_form_values[name].flat[0]:.3f} everywhere, {RESTITUTION:g} asked"
            ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", color="white")
        error = np.abs(values - closed_form_values[name]).max()
        ax.set(xscale="log", yscale="log", title=f"{title}: to {error:.1g}")
        ax.set(xlabel="speed [m/s]", ylabel="mass [kg]")
        ax.set_yticks([0.5, 1, 2, 5], ["0.5", "1", "2", "5"])
        ax.set_yticks([], minor=True)
    figure.suptitle("Simulated restitution; lines and numbers: closed form")
    figure.colorbar(image, ax=axes, label="restitution", shrink=0.6)
    curves, row = axes[1, 2], len(masses) // 2
    some = np.unique(np.linspace(0, len(speeds) - 1, 16).astype(int))
    for i, (name, title) in enumerate(zip(LAWS, TITLES, strict=True)):
        curves.plot(speeds, closed_form_values[name][row], color=f"C{i}", label=title)
        curves.plot(speeds[some], found[name][row][some], "o", color=f"C{i}", markersize=4)
    curves.set(xscale="log", xlabel="speed [m/s]", ylabel="restitution", ylim=(0.2, 1.0))
    curves.set_title(f"at {masses[row]:.2f} kg; dots: simulated")
    curves.grid(alpha=0.3)
    curves.legend(fontsize="small", loc="lower left", ncols=2)
    figure.savefig(path)


def main(argv: Sequence[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="Restitution against mass and speed for five contact laws.")
    parser.add_argument("--side", type=int, default=256, help="masses, and speeds of each (default: %(default)s)")
    parser.add_argument(
        "--out", type=Path, default=Path("results/restitution_map"), help="folder (default: %(default)s)"
    )
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    options = parser.parse_args(argv)

    masses, speeds = np.geomspace(*MASSES, options.side), np.geomspace(*SPEEDS, options.side)
    run = experiment(masses, speeds).run(options.out, device=options.device, overwrite=True)
    print(run)
    shape = len(masses), len(speeds)
    found = {name: run.outcome[name].values.reshape(shape) for name in LAWS}
    closed_form_values = closed_forms(*np.meshgrid(masses, speeds, indexing="ij"))
    errors = {name: float(np.abs(found[name] - closed_form_values[name]).max()) for name in LAWS}
    print("\nlaw                    restitution        largest deviation from its closed form")
    for name, title in zip(LAWS, TITLES, strict=True):
        print(f"{title:<20}  {found[name].min():.4f} … {found[name].max():.4f}   {errors[name]:.1e}")
    print(f"largest deviation of all: {max(errors.values()):.1e}")
    picture = options.out / "restitution_map.png"
    plot(masses, speeds, found, closed_form_values, picture)
    print(f"picture: {picture}")
    return errors


if __name__ == "__main__":
    main()
