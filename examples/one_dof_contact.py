"""A mass on a spring is pushed against a wall: six formulations of one contact.

The mass is at u, the spring force is k u, the load is f, and the wall at u = d exerts the force λ ≥ 0::

    k u + λ = f,    u ≤ d,    λ ≥ 0,    (u − d) λ = 0

Run it with ``python examples/one_dof_contact.py --picture one_dof.png``.
"""

import argparse

import numpy as np
from numpy.typing import NDArray

import warpcontact as wc

STIFFNESS, WALL = 1000.0, 0.01  # N/m, m
LOADS = {"pulled off": -5.0, "open": 5.0, "grazing": 10.0, "closed": 25.0}  # N

# Formulation by the method that implements it.
FORMULATIONS = {
    "enumeration": "try open, then closed",
    "energy": "least ½ k u² − f u with u ≤ d",
    "inequality": "k u (v − u) ≥ f (v − u) for all v ≤ d",
    "projection": "λ = max(0, λ + c (u − d))",
    "prox": "f − k u in the normal cone of u ≤ d",
    "gauss_seidel": "λ from its own gap",
}


def closed_form(load: float) -> tuple[float, float]:
    """Returns u and λ."""
    return min(load / STIFFNESS, WALL), max(0.0, load - STIFFNESS * WALL)


def by_inequality(load: float) -> tuple[float, float, int]:
    """Solves the variational inequality by its fixed point u = min(u − ρ (k u − f), d), which does not contain λ."""
    u, rho = 0.0, 0.5 / STIFFNESS
    taken, before = 0, np.inf
    while u != before and taken < 200:
        before, u = u, min(u - rho * (STIFFNESS * u - load), WALL)
        taken += 1
    return u, load - STIFFNESS * u, taken


def solved(formulation: str, load: float) -> tuple[float, float, int]:
    """Returns u [m], λ [N] and the number of iterations."""
    if formulation == "inequality":
        return by_inequality(load)
    solution = wc.unilateral.solve(STIFFNESS, load, 1.0, WALL, method=formulation, tolerance=1e-14)
    if not solution.converged:
        raise RuntimeError(f"{formulation} did not converge at f = {load} N")
    return float(solution.u[0]), float(solution.lam[0]), int(solution.iterations)


def draw(loads: NDArray[np.float64], u: NDArray[np.float64], lam: NDArray[np.float64], path: str) -> None:
    """Plots u and λ over f, the energy of the closed contact over u, and the law of the wall."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    response, energy, law = figure.subplots(1, 3)

    response.plot(loads, 1e3 * u, color="C0", label="u [mm]")
    response.plot(loads, lam, color="C3", label="λ [N]")
    response.axvline(STIFFNESS * WALL, color="0.6", linewidth=0.8, linestyle=":")
    response.annotate(
        "grazing: f = k d", (STIFFNESS * WALL, -4.0), (5, 0), textcoords="offset points", color="0.4"
    )
    response.set(xlabel="load f [N]", title="Response: u = min(f/k, d), λ = max(0, f − k d)")
    response.legend(loc="upper left")

    load = LOADS["closed"]
    places = np.linspace(-0.005, 0.035, 200)
    values = 0.5 * STIFFNESS * places**2 - load * places
    admissible = places <= WALL
    energy.axvspan(1e3 * places[0], 1e3 * WALL, color="C0", alpha=0.12, label="admissible: u ≤ d")
    energy.plot(1e3 * places, values, color="0.7")
    energy.plot(1e3 * places[admissible], values[admissible], color="C0")
    least, free = WALL, load / STIFFNESS
    energy.plot(1e3 * least, 0.5 * STIFFNESS * least**2 - load * least, "o", color="C3", label="least admissible")
    energy.plot(1e3 * free, -0.5 * load * free, "o", color="0.7", label="least without the wall")
    slope = STIFFNESS * least - load
    ends = np.array([least - 0.007, least + 0.007])
    energy.plot(
        1e3 * ends,
        0.5 * STIFFNESS * least**2 - load * least + slope * (ends - least),
        "--",
        color="C3",
        label="slope −λ",
    )
    energy.set(xlabel="u [mm]", ylabel="½ k u² − f u [J]", title=f"Energy at f = {load:g} N", xlim=(-5, 35))
    energy.legend(loc="upper right")

    law.plot([-26.0, 10.0, 10.0], [0.0, 0.0, 26.0], color="0.5", linewidth=4.0, alpha=0.5, label="law of the wall")
    displacements = np.array([-6.0, 30.0])
    for number, (name, load) in enumerate(LOADS.items()):
        law.plot(displacements, load - STIFFNESS * 1e-3 * displacements, color=f"C{number}", linewidth=1.0)
        place, force = closed_form(load)
        law.plot(1e3 * place, force, "o", color=f"C{number}", label=f"{name}: f = {load:g} N")
    law.set(xlabel="u [mm]", ylabel="λ [N]", title="λ = f − k u meets the law once", xlim=(-26, 16), ylim=(-4, 26))
    law.legend(loc="center left", fontsize="small")
    figure.savefig(path, dpi=120)


def main(argv: list[str] | None = None) -> float:
    """Prints the result of each formulation; returns the largest error, of u in 10 mm or of λ in 10 N."""
    parser = argparse.ArgumentParser(description="One contact by six formulations.")
    parser.add_argument("--picture", metavar="FILE", help="file to draw to, such as one_dof.png")
    options = parser.parse_args(argv)

    worst = 0.0
    for formulation, words in FORMULATIONS.items():
        print(f"{formulation}: {words}")
        for name, load in LOADS.items():
            u, lam, taken = solved(formulation, load)
            exact_u, exact_lam = closed_form(load)
            worst = max(worst, abs(u - exact_u) / WALL, abs(lam - exact_lam) / (STIFFNESS * WALL))
            print(
                f"    {name:10}  f {load:6.1f} N    u {1e3 * u:7.3f} mm    λ {lam:7.3f} N    {taken:3} iterations"
            )
    if options.picture:
        # A batch of loads with one stiffness and one wall.
        loads = np.linspace(-5.0, 25.0, 301)
        many = wc.unilateral.solve([[STIFFNESS]], loads[:, None], [[1.0]], [WALL])
        draw(loads, many.u[:, 0], many.lam[:, 0], options.picture)
        print(f"wrote {options.picture}")
    print(f"largest error: {worst:.1e}")
    return worst


if __name__ == "__main__":
    main()
