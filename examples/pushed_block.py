"""A pushed block sticks, slides or tips: maps of many environments, compared with the boundaries of statics.

A block of 10 kg, 1 m wide and 2 m high, stands on rough ground and is pushed at the height z. It slides if the
push exceeds μ m g, and tips over its front edge if it exceeds m g b/(2 z) with the width b. In the first map a
constant push acts on each block. In the second the push grows until the block moves: it slides if μ < b/(2 z), and
tips otherwise. Beyond both boundaries dynamics decides: friction on a sliding block is limited to μ m g, so it may
stay upright; a tipping block has a larger normal force at its edge, so it may not slide. Dashed lines are these
boundaries.

Run it with ``python examples/pushed_block.py --picture pushed_block.png``.
"""

import argparse

import numpy as np

import warpcontact as wc

GRAVITY = 9.81  # m/s²
MASS, WIDTH, HEIGHT = 10.0, 1.0, 2.0  # kg, m, m
WEIGHT = MASS * GRAVITY
INERTIA = MASS / 12.0 * (WIDTH**2 + HEIGHT**2)  # about the axis into the picture
MU, LARGEST = 0.35, 0.82 * WEIGHT  # first map: friction, and largest push [N]
DT = 1e-3  # s
INTEGRATOR = wc.integrators.MoreauJean()
STICKS, SLIDES, TIPS, TIPS_AND_SLIDES = range(4)
NAMES = ("sticks", "slides", "tips", "tips and slides")
COLORS = ("#d9d9d9", "#7fb3d5", "#f0b27a", "#c39bd3")


def block(envs: int, device: str) -> wc.Model:
    """Returns a model with a block on its four lower corners in each environment."""
    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    ground = scene.add_surface(wc.meshes.grid((20.0, 20.0)), name="ground")
    moments = MASS / 12.0 * np.array([1.0 + HEIGHT**2, WIDTH**2 + HEIGHT**2, WIDTH**2 + 1.0])
    body = scene.add_body(MASS, moments, position=(0.0, 0.0, 0.5 * HEIGHT), name="block")
    corners = [(x, y, -0.5 * HEIGHT) for x in (-0.5 * WIDTH, 0.5 * WIDTH) for y in (-0.5, 0.5)]
    material = wc.ContactMaterial(law=wc.laws.Rigid(), friction=wc.friction.Coulomb(mu=MU))
    scene.add_contact(scene.add_points(body, corners), ground, material, name="feet")
    return scene.build(envs, device, precision="float64")


def push(model: wc.Model, height: np.ndarray, force: np.ndarray) -> None:
    """Pushes each block to the right, ``height`` above the ground; forces act at the center of mass."""
    none = np.zeros_like(force)
    model["block.external_force"] = np.stack([force, none, none], axis=-1)
    model["block.external_torque"] = np.stack([none, force * (height - 0.5 * HEIGHT), none], axis=-1)


def observed_mode(model: wc.Model) -> np.ndarray:
    """Returns the mode of motion of each block."""
    turning = model.sensor("block.angular_velocity")[:, 1]
    # The front feet stay on the ground when the block tips.
    slip = model.sensor("feet.slip_speed")[:, 2:].max(axis=1)
    return np.where(turning > 1e-7, TIPS, STICKS) + np.where(slip > 1e-7, SLIDES, STICKS)


def expected(height: np.ndarray, force: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Returns the mode of a block at rest under a push, from rigid-body dynamics."""
    slides = force > mu * WEIGHT
    tips = force > WEIGHT * WIDTH / (2.0 * height)
    # Friction on a sliding block is μ m g; its moment and that of the push may exceed that of the weight.
    tips_in_sliding = force * (height - 0.5 * HEIGHT) + 0.5 * mu * WEIGHT * HEIGHT > 0.5 * WEIGHT * WIDTH
    # Tipping about the front edge, friction and weight accelerate the center along an arc.
    about_edge = INERTIA + 0.25 * MASS * (WIDTH**2 + HEIGHT**2)
    turning = (force * height - 0.5 * WEIGHT * WIDTH) / about_edge
    friction = force - 0.5 * MASS * HEIGHT * turning
    slides_in_tipping = np.abs(friction) > mu * (WEIGHT + 0.5 * MASS * WIDTH * turning)
    both = np.where(slides_in_tipping & (tips_in_sliding | ~slides), TIPS_AND_SLIDES, TIPS)
    only_slides = slides & ~tips_in_sliding
    return np.where(only_slides, SLIDES, np.where(tips, both, STICKS))


def at_once(side: int, device: str) -> dict[str, np.ndarray]:
    """Returns the map over height and size of a constant push."""
    height, force = (grid.ravel() for grid in np.meshgrid(_cells(0.0, HEIGHT, side), _cells(0.0, LARGEST, side)))
    model = block(side * side, device)
    simulation = wc.Simulation(model, DT, INTEGRATOR)
    simulation.step(5)  # onto the ground
    push(model, height, force)
    simulation.step(3)
    theory = expected(height, force, np.full_like(height, MU))
    return {"height": height, "force": force, "seen": observed_mode(model), "expected": theory}


def growing(side: int, steps: int, device: str) -> dict[str, np.ndarray]:
    """Returns the map over height of a growing push and friction: first mode of motion, and push at its start."""
    height, mu = (grid.ravel() for grid in np.meshgrid(_cells(0.0, HEIGHT, side), _cells(0.0, 1.0, side)))
    model = block(side * side, device)
    model["feet.friction.mu"] = mu[:, None]
    simulation = wc.Simulation(model, DT, INTEGRATOR)
    simulation.step(5)
    first, limit = np.full(len(mu), STICKS), np.zeros(len(mu))
    # The largest push moves every block: with the largest μ, and at any height, the limit is below the weight.
    for force in np.linspace(0.0, WEIGHT, steps + 1)[1:]:
        push(model, height, np.full_like(mu, force))
        simulation.step(1)
        now = observed_mode(model)
        limit[first == STICKS] = force
        first[first == STICKS] = now[first == STICKS]
        if (first != STICKS).all():
            break
    theory = np.where(mu < WIDTH / (2.0 * height), SLIDES, TIPS)
    exact = np.minimum(mu, WIDTH / (2.0 * height)) * WEIGHT
    return {"height": height, "mu": mu, "seen": first, "expected": theory, "limit": limit, "exact": exact}


def draw(one: dict[str, np.ndarray], two: dict[str, np.ndarray], file: str) -> None:
    """Plots both maps with the boundaries of statics."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(12.5, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    z = np.linspace(0.01, HEIGHT, 400)
    for axes, data, key, top in ((left, one, "force", LARGEST), (right, two, "mu", 1.0)):
        side = round(len(data["seen"]) ** 0.5)
        axes.imshow(
            data["seen"].reshape(side, side),
            extent=(0.0, HEIGHT, 0.0, top),
            origin="lower",
            aspect="auto",
            cmap=ListedColormap(COLORS),
            vmin=-0.5,
            vmax=3.5,
        )
        wrong = data["seen"] != data["expected"]
        axes.plot(data["height"][wrong], data[key][wrong], "rx", markersize=4)
        axes.set(xlim=(0.0, HEIGHT), ylim=(0.0, top), xlabel="height of the push z [m]")
    fine = np.meshgrid(z, np.linspace(0.0, LARGEST, 800))
    modes = expected(*fine, np.full_like(fine[0], MU))
    for mode in (SLIDES, TIPS):
        left.contour(*fine, modes == mode, levels=[0.5], colors="0.3", linewidths=0.8, linestyles="--")
    left.axhline(MU * WEIGHT, color="C0", label="μ m g")
    left.plot(z, WEIGHT * WIDTH / (2.0 * z), color="C3", label="m g b/(2 z)")
    left.set(ylabel="push [N]", title=f"a push from rest, μ = {MU}")
    right.plot(z, WIDTH / (2.0 * z), color="C3", label="μ = b/(2 z)")
    side = round(len(two["seen"]) ** 0.5)
    grid = [two[key].reshape(side, side) for key in ("height", "mu", "limit")]
    lines = right.contour(*grid, levels=np.arange(40.0, 100.0, 10.0), colors="0.25", linewidths=0.7)
    right.clabel(lines, fmt="%g N", fontsize=8)
    right.set(ylabel="μ", title="what ends its rest under a growing push, and at which push")
    patches = [Patch(color=color, label=name) for color, name in zip(COLORS, NAMES, strict=True)]
    for axes, shown in ((left, patches), (right, patches[1:3])):
        axes.legend(handles=[*shown, *axes.get_legend_handles_labels()[0]], loc="lower left", framealpha=0.95)
    figure.savefig(file, dpi=120)


def main(argv: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="Blocks that stick, slide or tip under a push.")
    parser.add_argument("--side", type=int, default=60, help="environments along each axis of a map (default: 60)")
    parser.add_argument("--steps", type=int, default=1000, help="steps in which the push grows (default: 1000)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--picture", metavar="FILE", help="draw the maps, such as pushed_block.png")
    options = parser.parse_args(argv)
    one = at_once(options.side, options.device)
    two = growing(options.side, options.steps, options.device)
    result = {
        "push": float((one["seen"] == one["expected"]).mean()),
        "growing": float((two["seen"] == two["expected"]).mean()),
        "limit": float(np.abs(two["limit"] - two["exact"]).max()),
    }
    if options.picture:
        draw(one, two, options.picture)
        print(f"picture: {options.picture}")
    counts = ", ".join(f"{(one['seen'] == mode).sum()} {name}" for mode, name in enumerate(NAMES))
    print(f"{len(one['seen'])} blocks under a push of one size: {counts}")
    print(f"largest error of the push that ends the rest: {result['limit']:.3f} N of {WEIGHT:g} N")
    print(
        f"agree with the theory: {100.0 * result['push']:.2f} % under a push of one size, "
        f"{100.0 * result['growing']:.2f} % under a growing one"
    )
    return result


def _cells(low: float, high: float, count: int) -> np.ndarray:
    """Returns the centers of ``count`` equal intervals."""
    return low + (high - low) * (np.arange(count) + 0.5) / count


if __name__ == "__main__":
    main()
