"""Environment-steps per second of this engine, by scene and number of environments.

    python benchmarks/step_rate.py --device cuda:0 --envs 8192 65536 262144 --out benchmarks/results/h200.json

Scenes (dt = 1 ms, start 0.4 m above the surface, k = 1e5 N/m, c = 400 N·s/m, μ = 0.5, density 1000 kg/m³, a
10 × 10 m terrain of 20 000 triangles): W1 a sphere of 0.1 m; W2p8 and W2p64 a 0.2 m box as 8 or 64 points.
Numbers of one machine are comparable within one run only.
"""

import argparse
import datetime
import json
import platform
import statistics
import time
from pathlib import Path

import numpy as np
import warp as wp

import warpcontact as wc

TERRAIN = wc.meshes.sinusoidal_terrain((10, 10), (100, 100), amplitude=0.2, wavelength=2.5)
TEMPLATE = wc.Template(
    law=wc.laws.KelvinVoigt(stiffness=1e5, damping=400.0), friction=wc.frictions.Tanh(mu=0.5, velocity_scale=0.01)
)


def box_points(count: int) -> np.ndarray:
    """Returns a grid over a 0.2 m cube: its 8 corners, or 4 × 4 × 4 points."""
    ticks = np.linspace(-0.1, 0.1, round(count ** (1 / 3)))
    return np.array(np.meshgrid(ticks, ticks, ticks)).reshape(3, -1).T


def build(
    scene_name: str,
    envs: int,
    device: str,
    precision: str = "float32",
    crossing_steps: int = 1,
    **contact: object,
) -> wc.Simulation:
    """Returns a simulation of one of the scenes, its environments spread over the terrain."""
    scene = wc.Scene()
    ground = scene.add_surface(TERRAIN, name="ground")
    if scene_name == "W1":
        mass = 1000 * 4 / 3 * np.pi * 0.1**3
        body = scene.add_body(mass, [0.4 * mass * 0.01] * 3, name="body")
        scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, TEMPLATE, radius=0.1, name="touch", **contact)
    else:
        mass = 1000 * 0.2**3
        body = scene.add_body(mass, [mass * 0.2**2 / 6] * 3, name="body")
        points = scene.add_points(body, box_points(int(scene_name.removeprefix("W2p"))))
        scene.add_contact(points, ground, TEMPLATE, name="touch", **contact)
    model = scene.build(envs=envs, device=device, precision=precision)
    rng = np.random.default_rng(1)
    model["body.position"] = np.column_stack([rng.uniform(-4.5, 4.5, (envs, 2)), np.full(envs, 0.7)])
    return wc.Simulation(model, dt=1e-3, crossing_steps=crossing_steps)


def rate(scene_name: str, envs: int, device: str, steps: int, repeats: int) -> dict[str, float]:
    """Returns environment-steps per second, median and spread over ``repeats`` runs of ``steps`` steps."""
    sim = build(scene_name, envs, device)
    sim.step(2)
    wp.synchronize_device(device)
    rates = []
    for _ in range(repeats):
        sim.reset()
        wp.synchronize_device(device)
        start = time.perf_counter()
        sim.step(steps)
        wp.synchronize_device(device)
        rates.append(envs * steps / (time.perf_counter() - start))
    return {"median": statistics.median(rates), "lowest": min(rates), "highest": max(rates)}


def device_facts(device: str) -> dict[str, str]:
    """Returns what the figures depend on."""
    found = wp.get_device(device)
    facts = {
        "device": found.name or platform.processor(),
        "warp": wp.__version__,
        "warpcontact": wc.__version__,
        "python": platform.python_version(),
        "date": datetime.date.today().isoformat(),
    }
    if found.is_cuda:
        facts["cuda driver"] = ".".join(map(str, wp.get_cuda_driver_version()))
    return facts


def main() -> None:
    """Prints a table and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, nargs="+", default=[1, 64, 1024])
    parser.add_argument("--scenes", nargs="+", default=["W1", "W2p8", "W2p64"])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    results: dict[str, dict[str, dict[str, float]]] = {}
    for scene_name in options.scenes:
        for envs in options.envs:
            figures = rate(scene_name, envs, options.device, options.steps, options.repeats)
            results.setdefault(scene_name, {})[str(envs)] = figures
            print(f"{scene_name:6} {envs:8} environments {figures['median']:10.3g} env-steps/s", flush=True)
    if options.out:
        report = {"facts": device_facts(options.device), "steps": options.steps, "env_steps_per_s": results}
        options.out.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
