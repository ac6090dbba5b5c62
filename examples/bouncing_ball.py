"""A ball bounces on rigid ground until it rests: event-driven, and by time stepping through its Zeno point.

Dropped from the height h with restitution e, it hits the ground infinitely often in a finite time:

    t_n = t_1 (1 + 2 (e + e² + … + eⁿ⁻¹)),   t_∞ = t_1 (1 + e)/(1 − e),   t_1 = √(2h/g)

The event-driven run locates impacts to rounding and sums the last ones as a geometric series. Time stepping by the
Moreau–Jean scheme locates no impacts. It passes the point of accumulation like any impact, with an error of first
order in its step.
"""

import argparse
import math

import numpy as np
from numpy.typing import NDArray

import warpcontact as wc

HEIGHT, RESTITUTION, GRAVITY = 1.0, 0.8, 9.81  # m, -, m/s²
RADIUS = 0.1  # m
DURATION = 5.0  # s
STEPS = (1e-2, 1e-3, 1e-4)  # s
IMPACTS = 5


def ball(device: str) -> wc.Model:
    """Returns the model of the ball above the ground."""
    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    ground = scene.add_surface(wc.meshes.grid((2.0, 2.0)), name="ground")
    body = scene.add_body(
        mass=1.0, inertia=[0.4 * RADIUS**2] * 3, position=(0.0, 0.0, HEIGHT + RADIUS), name="ball"
    )
    hard = wc.ContactMaterial(law=wc.laws.Rigid(restitution=RESTITUTION))
    scene.add_contact(scene.add_point(body, (0.0, 0.0, 0.0)), ground, hard, radius=RADIUS, name="touch")
    return scene.build(device=device, precision="float64")


def impact_times(count: int) -> NDArray[np.float64]:
    """Returns the times of the first impacts in closed form [s]."""
    first = math.sqrt(2.0 * HEIGHT / GRAVITY)
    return first * (2.0 * np.cumsum(RESTITUTION ** np.arange(count)) - 1.0)


def stepped_times(recording: wc.Recording, dt: float) -> NDArray[np.float64]:
    """Returns the times at which the velocity of a stepped ball turned upwards [s], as middles of steps."""
    speed = recording["ball.linear_velocity"].values[:, 0, 2]
    turned = np.flatnonzero((speed[:-1] < 0.0) & (speed[1:] > 0.0))
    return (recording["time"].values[turned] + 0.5 * dt)[:IMPACTS]


def plot(run: wc.unilateral.EventRun, stepped: dict[float, wc.Recording], errors: dict[float, float], path: str):
    """Plots height over time, also around the Zeno point, and the error of impact times over the step."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.2, 1.0))
    whole, close, order = (
        figure.add_subplot(grid[0, :]),
        figure.add_subplot(grid[1, 0]),
        figure.add_subplot(grid[1, 1]),
    )
    zeno = run.events_of("REST")[0].time
    coarse, middle = stepped[STEPS[0]], stepped[STEPS[1]]
    exact = run.times, 1e3 * (run["ball.position"].values[:, 2] - RADIUS)
    for ax, recording, label in ((whole, coarse, "10 ms"), (close, middle, "1 ms")):
        ax.plot(*exact, color="C0", linewidth=1.4, label="event-driven")
        height = 1e3 * (recording["ball.position"].values[:, 0, 2] - RADIUS)
        ax.plot(recording["time"], height, "o", color="C1", markersize=2.2, label=f"Moreau–Jean, {label}")
        ax.axvline(zeno, color="C3", linestyle="--", label=f"Zeno point, {zeno:.4f} s")
        ax.set(xlabel="time [s]", ylabel="height [mm]")
        ax.grid(alpha=0.3)
        ax.legend(loc="upper right")
    whole.set(xlim=(0.0, DURATION), ylim=(-40.0, 1050.0))
    whole.set_title(f"A ball dropped from {HEIGHT:g} m with restitution {RESTITUTION:g}")
    close.set(xlim=(zeno - 0.35, zeno + 0.15), ylim=(-1.0, 10.0), title="around its Zeno point")
    order.loglog(list(errors), list(errors.values()), "o-", color="C1", label=f"first {IMPACTS} impact times")
    order.loglog(STEPS, [4.0 * dt for dt in STEPS], ":", color="0.4", label="first order")
    order.set(xlabel="step [s]", ylabel="largest error [s]", title="Moreau–Jean")
    order.grid(alpha=0.3, which="both")
    order.legend()
    figure.savefig(path, dpi=120)


def main(argv: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="A bouncing ball, event-driven and stepped.")
    parser.add_argument("--picture", metavar="FILE", help="draw it, such as ball.png")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    options = parser.parse_args(argv)
    model = ball(options.device)
    times = impact_times(IMPACTS)

    # A state per millisecond resolves the lowest positions.
    run = wc.unilateral.EventDriven(model).run(DURATION, every=1e-3)
    found = np.array([event.time for event in run.events_of("IMPACT")[:IMPACTS]])
    rest = run.events_of("REST")[0].time
    zeno = math.sqrt(2.0 * HEIGHT / GRAVITY) * (1.0 + RESTITUTION) / (1.0 - RESTITUTION)
    print(run)
    print(f"impacts at {', '.join(f'{time:.12f}' for time in found)} s, at rest from {rest:.12f} s on")

    stepped, errors = {}, {}
    for dt in STEPS:
        model.reset()
        sim = wc.Simulation(model, dt=dt, integrator=wc.integrators.MoreauJean())
        duration = DURATION if dt > STEPS[-1] else times[-1] + 10.0 * dt
        stepped[dt] = sim.run(duration, ["ball.linear_velocity"])
        errors[dt] = float(np.abs(stepped_times(stepped[dt], dt) - times).max())
        print(f"Moreau–Jean, dt = {dt:g} s: impact times to {errors[dt]:.2e} s")
    speed = float(np.abs(stepped[STEPS[1]]["ball.linear_velocity"].values[-1]).max())
    order = math.log10(errors[STEPS[0]] / errors[STEPS[-1]]) / math.log10(STEPS[0] / STEPS[-1])
    print(f"order of convergence {order:.2f}; speed at {DURATION:g} s {speed:.1e} m/s")
    if options.picture:
        plot(run, stepped, errors, options.picture)
        print(f"picture: {options.picture}")
    return {
        "event-driven": float(np.abs(found - times).max()),
        "zeno": abs(rest - zeno),
        "order": order,
        "largest error": errors[STEPS[-1]],
        "last speed": speed,
    }


if __name__ == "__main__":
    main()
