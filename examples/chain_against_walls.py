"""A chain of five masses is pressed against walls; solved by every method.

Springs of 1000 N/m connect the first mass to the ground and the masses to each other. Chain A has one wall, at its
last mass. Chain B has a wall at each mass; of the 32 states of its contacts one is admissible. Run it with
``python examples/chain_against_walls.py --picture chain.png``.
"""

import argparse
from typing import Any

import numpy as np

import warpcontact as wc

MASSES, STIFFNESS = 5, 1000.0  # N/m
METHODS = ("enumeration", "energy", "projection", "prox", "gauss_seidel")

# Load of each mass [N], mass at each wall, distance of each wall [m], and expected forces on the walls [N].
CHAINS: dict[str, dict[str, Any]] = {
    "A": {"load": [2, 4, 6, 8, 10], "at": [4], "wall": [0.05], "force": [12.0]},
    "B": {
        "load": [30, -5, 12, 4, 18],
        "at": [0, 1, 2, 3, 4],
        "wall": [0.020, 0.060, 0.055, 0.080, 0.070],
        "force": [25.0, 0.0, 1.5, 0.0, 12.5],
    },
}


def problem(chain: dict[str, Any]) -> wc.unilateral.Problem:
    """Returns K u + Gᵀλ = f with u ≤ d at the walls."""
    K = STIFFNESS * (2.0 * np.eye(MASSES) - np.eye(MASSES, k=1) - np.eye(MASSES, k=-1))
    K[-1, -1] = STIFFNESS  # the last mass has one neighbor
    return wc.unilateral.Problem(K, chain["load"], np.eye(MASSES)[chain["at"]], chain["wall"])


def draw(path: str) -> None:
    """Plots displacements of both chains with and without walls, and the convergence of the methods."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3)
    masses = np.arange(1, MASSES + 1)
    for panel, (name, chain) in zip(axes, CHAINS.items(), strict=False):
        posed = problem(chain)
        solution = posed.solve()
        free = np.linalg.solve(posed.K, posed.f)
        panel.plot(masses, 1e3 * free, "o--", color="0.7", label="without walls")
        panel.plot(masses, 1e3 * solution.u, "o-", color="C0", label="with walls")
        for at, wall, force in zip(chain["at"], chain["wall"], solution.lam, strict=True):
            color = "C3" if force > 0.0 else "0.4"
            panel.plot([at + 0.7, at + 1.3], [1e3 * wall] * 2, color=color, linewidth=3.0)
            if force > 0.0:
                panel.annotate(f"{force:.4g} N", (at + 1.0, 1e3 * wall), (0, 5), textcoords="offset points",
                               color="C3", ha="center")  # fmt: skip
        panel.plot([], [], color="C3", linewidth=3.0, label="wall that presses")
        panel.plot([], [], color="0.4", linewidth=3.0, label="wall that does not")
        panel.set(xlabel="mass", ylabel="u [mm]", title=f"Chain {name}", xticks=masses, ylim=(0.0, 220.0))
        panel.legend(loc="upper left")
    posed = problem(CHAINS["B"])
    for number, method in enumerate(("projection", "gauss_seidel", "energy", "prox")):
        steps = np.unique(np.geomspace(1, 600, 60).astype(int))
        residuals = []
        for count in steps:
            residuals.append(posed.solve(method, iterations=int(count), tolerance=1e-15).residual)
            if residuals[-1] < 1e-15:
                break
        kept = steps[: len(residuals)]
        axes[2].loglog(kept, np.maximum(residuals, 1e-16), ".-", color=f"C{number}", label=method)
    axes[2].set(xlabel="iterations", ylabel="residual", title="Chain B: convergence", ylim=(3e-17, 1e6))
    axes[2].legend(loc="upper right")
    figure.savefig(path, dpi=120)


def main(argv: list[str] | None = None) -> float:
    """Prints the result of each method and returns the largest error of a force [N]."""
    parser = argparse.ArgumentParser(description="Two chains against walls, by all methods.")
    parser.add_argument("--picture", metavar="FILE", help="file to draw to, such as chain.png")
    options = parser.parse_args(argv)

    worst = 0.0
    for name, chain in CHAINS.items():
        posed = problem(chain)
        print(f"chain {name}: {posed.diagnose()}".replace("\n", " "))
        for method in METHODS:
            solution = posed.solve(method, tolerance=1e-13)
            if not solution.converged:
                raise RuntimeError(f"{method} did not converge for chain {name}")
            worst = max(worst, float(np.abs(solution.lam - chain["force"]).max()))
            forces = "  ".join(f"{force:5.2f}" for force in solution.lam)
            print(f"    {method:12}  λ  {forces} N    {solution.iterations:4} iterations")
    if options.picture:
        draw(options.picture)
        print(f"wrote {options.picture}")
    print(f"largest error of a force: {worst:.1e} N")
    return worst


if __name__ == "__main__":
    main()
