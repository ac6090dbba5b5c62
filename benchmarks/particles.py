"""Measures particle contact: ten spheres in each of many environments, and many spheres in one.

    python benchmarks/particles.py --device cuda:0 --envs 4096 32768 131072 --spheres 1000 100000 --out particles.json

W3 is ten spheres in a bowl per environment; its stages are timed at rest. Then spheres fall into a tube and
settle. Reported are the time of a step, the time to rebuild all neighbor lists, and the packing fraction of the
bulk. A random packing at rest has a fraction of 0.59 to 0.64.
"""

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from benchmark_scenes import DT, SCENES, STEPS
from result_file import write
from scipy.spatial import cKDTree
from stages import stages

import warpcontact as wc
from warpcontact.benchmark.facts import facts
from warpcontact.benchmark.simulation import simulation
from warpcontact.system.resources import available_threads

DIAMETER, DENSITY, GRAVITY = 0.01, 2500.0, 9.81
MASS = DENSITY * np.pi / 6 * DIAMETER**3
# Per layer of the packing, so that the overlap at the bottom does not depend on the number of layers.
LAYER_STIFFNESS = 600 * MASS * GRAVITY / DIAMETER  # N/m
UNIT = np.sqrt(DIAMETER / GRAVITY)


def tube(radius: float, height: float, sides: int = 64) -> wc.Mesh:
    """Returns a tube about z whose outer side faces the axis."""
    angle = 2 * np.pi * np.arange(sides) / sides
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    vertices = np.concatenate([np.stack([x, y, np.full(sides, z)], 1) for z in (-0.1 * height, height)])
    low = np.arange(sides)
    beside = (low + 1) % sides
    up, up_beside = low + sides, beside + sides
    return wc.Mesh(
        vertices, np.concatenate([np.stack([low, up, beside], 1), np.stack([up, up_beside, beside], 1)])
    )


def packing(spheres: int, friction: float = 0.3) -> tuple[wc.Scene, float, float]:
    """Returns a scene of equal spheres in a tube as high as wide, the tube's radius [m], and a time step [s]."""
    rng = np.random.default_rng(4)
    width = max((spheres / 6.0) ** (1 / 3), 6.5) * DIAMETER
    pitch = 1.12 * DIAMETER
    line = np.arange(-width, width, pitch)
    row = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    row = row[np.linalg.norm(row, axis=1) < width - 0.6 * DIAMETER]
    heights = pitch * (0.6 + np.arange(-(-spheres // len(row))))
    places = np.concatenate([np.insert(row, 2, height, axis=1) for height in heights])[:spheres]
    places += 0.05 * DIAMETER * rng.uniform(-1, 1, places.shape)
    layers = 0.27 * spheres / (width / DIAMETER) ** 2
    stiffness = layers * LAYER_STIFFNESS
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    # Initial speeds of a few diameters per unit of time destroy the initial lattice.
    speeds = 2 * DIAMETER / UNIT * rng.uniform(-1, 1, places.shape)
    balls = scene.add_bodies(places, MASS, [0.1 * MASS * DIAMETER**2] * 3, linear_velocities=speeds, name="ball")
    material = wc.ContactMaterial(
        law=wc.laws.KelvinVoigt(stiffness=stiffness, restitution=0.5),
        friction=wc.friction.Tanh(mu=friction, velocity_scale=0.002),
    )
    point = scene.add_point(balls, (0, 0, 0))
    walls = scene.add_surface(tube(width, heights[-1] + 8 * DIAMETER), name="tube")
    floor = scene.add_surface(wc.meshes.grid((2.4 * width, 2.4 * width)), name="floor")
    # Limits penetration, so that spheres above or outside the tube are not in contact with its wall.
    sizes = {"radius": 0.5 * DIAMETER, "max_depth": 0.5 * DIAMETER}
    for surface in (walls, floor):
        scene.add_contact(point, surface, material, name=f"on_{surface.name}", **sizes)
    scene.add_particle_contact(scene.add_shape(balls, wc.shapes.Sphere(0.5 * DIAMETER)), material, name="pile")
    return scene, width, np.pi * np.sqrt(MASS / (2 * stiffness)) / 15


def bulk_fraction(places: np.ndarray, width: float) -> float:
    """Returns the packing fraction of the bulk, at least two diameters from its boundaries."""
    rng = np.random.default_rng(2)
    inner = width - 2.5 * DIAMETER
    high = np.quantile(places[:, 2], 0.97) - 2 * DIAMETER
    low = 2.5 * DIAMETER
    points = rng.uniform(-1, 1, (400_000, 3))
    points = points[np.linalg.norm(points[:, :2], axis=1) < 1] * [inner, inner, 0.5 * (high - low)]
    points[:, 2] += 0.5 * (high + low)
    distance, _ = cKDTree(places).query(points)
    return float((distance < 0.5 * DIAMETER).mean())


def settle(spheres: int, device: str, most: float = 60.0) -> dict[str, Any]:
    """Lets spheres settle for at most ``most`` times √(d/g); returns the figures."""
    scene, width, dt = packing(spheres)
    model = scene.build(device=device)
    sim = wc.Simulation(model, dt=dt)
    steps = round(UNIT / dt)
    energies, costs = [], []
    at_rest = 1e-4 * spheres * MASS * GRAVITY * DIAMETER
    while len(energies) < most:
        wp.synchronize_device(device)
        start = time.perf_counter()
        sim.step(steps)
        wp.synchronize_device(device)
        costs.append((time.perf_counter() - start) / steps)
        energies.append(float(model.sensor("scene.kinetic_energy")[0]))
        if energies[-1] < at_rest:
            break
    made = int(model.of_family("particle contact")[0].cell_list.build_count.numpy()[0])
    return {
        "spheres": spheres,
        "fraction": bulk_fraction(model.sensor("ball.position")[0], width),
        "kinetic_energy": energies,
        "coordination": float(model.sensor("pile.coordination")[0].mean()),
        "max_penetration_in_diameters": float(model.sensor("pile.max_penetration")[0]) / DIAMETER,
        "step_s": statistics.median(costs[1:]),
        "step_ns_per_sphere": 1e9 * statistics.median(costs[1:]) / spheres,
        "steps": sim.steps,
        "lists_made": made,
        "rebuild_ns_per_sphere": rebuild(sim, spheres, device),
    }


def rebuild(sim: wc.Simulation, spheres: int, device: str, count: int = 20) -> float:
    """Returns the time to rebuild all neighbor lists [ns per sphere], as a difference of steps with and without."""

    def run(anew: bool) -> float:
        total = 0.0
        for _ in range(count):
            if anew:
                sim.model.of_family("particle contact")[0].invalidate_caches()
            wp.synchronize_device(device)
            start = time.perf_counter()
            sim.step(2)
            wp.synchronize_device(device)
            total += time.perf_counter() - start
        return total / count

    run(True)
    return 1e9 * (run(True) - run(False)) / spheres


def bowl(envs: int, device: str, repeats: int) -> dict[str, Any]:
    """Returns the rate of W3, and the time of its stages at rest."""
    sim = simulation(SCENES["W3"], envs, device)
    sim.step(100)
    rates = []
    for _ in range(repeats):
        sim.reset()
        wp.synchronize_device(device)
        start = time.perf_counter()
        sim.step(STEPS)
        wp.synchronize_device(device)
        rates.append(STEPS * envs / (time.perf_counter() - start))
    return {
        "env_steps_per_s": statistics.median(rates),
        "dt": DT,
        "contacts": float(sim.model.sensor("pile.contacts").mean()),
        "ns_per_env": stages(sim, envs),
    }


def main() -> None:
    """Prints the figures and writes them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, nargs="*", default=[1024])
    parser.add_argument("--spheres", type=int, nargs="*", default=[2000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--most", type=float, default=60.0, help="longest time to settle, in √(d/g)")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    found: dict[str, Any] = {"bowl": {}, "packing": {}}
    for envs in options.envs:
        result = bowl(envs, options.device, options.repeats)
        found["bowl"][str(envs)] = result
        row = ", ".join(f"{stage} {cost:.3g}" for stage, cost in result["ns_per_env"].items())
        print(f"W3, {envs} environments: {result['env_steps_per_s']:.3g} env-steps/s\n  ns: {row}", flush=True)
    for spheres in options.spheres:
        result = settle(spheres, options.device, options.most)
        found["packing"][str(spheres)] = result
        energy = result["kinetic_energy"]
        print(
            f"{spheres} spheres: step {1e3 * result['step_s']:.3g} ms, {result['step_ns_per_sphere']:.3g} ns per "
            f"sphere; lists {result['rebuild_ns_per_sphere']:.3g} ns per sphere, made {result['lists_made']} "
            f"times in {result['steps']} steps"
        )
        print(
            f"  fraction {result['fraction']:.4f}, {result['coordination']:.2f} contacts each, kinetic energy "
            f"{energy[-1]:.3g} J after {energy[0]:.3g} J",
            flush=True,
        )
    if options.out:
        write(options.out, {"facts": facts(options.device, available_threads()), **found})


if __name__ == "__main__":
    main()
