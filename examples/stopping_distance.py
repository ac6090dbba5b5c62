"""Effect of speed and friction on the stopping distance of a block: Sobol' indices against their closed form.

    python examples/stopping_distance.py
    python examples/stopping_distance.py --envs 65536 --out results/stopping_distance

A block of speed v stops after d = v²/(2 μ g), a product of f = v² and h = 1/μ. For independent v and μ, the
variance of d has a part of f only, a part of h only, and a part of their interaction:

    Var d ∝ E[f²] E[h²] − E[f]² E[h]²,   S_v = Var f E[h]² / Var d,   S_μ = Var h E[f]² / Var d

The total indices are S_Tv = 1 − S_μ and S_Tμ = 1 − S_v.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import warpcontact as wc

FILE = Path(__file__).with_name("stopping_distance.toml")
SPEED, FRICTION = "block.linear_velocity", "slide.friction.mu"
GRAVITY = 9.81  # m/s²


def moments(low: float, high: float, power: int) -> tuple[float, float]:
    """Returns mean and mean square of x^power for x uniform from low to high."""

    def mean(p: int) -> float:
        if p == -1:
            return float(np.log(high / low) / (high - low))
        return (high ** (p + 1) - low ** (p + 1)) / (p + 1) / (high - low)

    return mean(power), mean(2 * power)


def closed_form(speeds: tuple[float, float], coefficients: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the first-order and total indices of speed and friction with the given ranges."""
    f, ff = moments(*speeds, 2)
    h, hh = moments(*coefficients, -1)
    first = np.array([(ff - f**2) * h**2, (hh - h**2) * f**2]) / (ff * hh - (f * h) ** 2)
    return first, 1.0 - first[::-1]


def main(argv: Sequence[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="Indices of sensitivity of a stopping distance.")
    parser.add_argument("--envs", type=int, help="4 times a power of two (default: that of the file)")
    parser.add_argument(
        "--out", type=Path, default=Path("results/stopping_distance"), help="folder (default: %(default)s)"
    )
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    options = parser.parse_args(argv)

    experiment = wc.Experiment.from_toml(FILE)
    run = experiment.run(options.out, envs=options.envs, device=options.device, overwrite=True)
    print(run)
    table = run.to_dataframe()
    speed, mu = table[f"{SPEED}.initial.x"], table[FRICTION]
    # In two steps, at first contact and at rest, the speed has an error of at most μ g dt.
    error = float((table["distance"] - speed**2 / (2.0 * mu * GRAVITY)).abs().max())

    indices = wc.sensitivity(run, "distance")
    low, high = experiment.settings.variation[SPEED].uniform
    exact = closed_form((low[0], high[0]), experiment.settings.variation[FRICTION].uniform)
    result = {"distance": error, "speed": float(table["speed"].max()), "index": 0.0, "outside": 0}
    print(f"\nlargest deviation from v²/(2 μ g): {1e3 * error:.1f} mm of up to {table['distance'].max():.1f} m")
    print("share of the variance, with intervals of 95 % confidence      closed form")
    titles = {"first_order": "alone", "total_order": "with the other"}
    for (key, title), expected in zip(titles.items(), exact, strict=True):
        for i, name in enumerate(indices["parameter"].values):
            value, low, high = (float(indices[f"{key}{end}"][i]) for end in ("", "_low", "_high"))
            print(f"  {name:<26}{title:<16}{value:7.4f}   {low:.4f} … {high:.4f}   {expected[i]:7.4f}")
            result["index"] = max(result["index"], abs(value - expected[i]))
            result["outside"] += not low <= expected[i] <= high
    print(f"largest deviation of an index from its closed form: {result['index']:.4f}")
    return result


if __name__ == "__main__":
    main()
