"""Measures the time of rendering a picture.

    python benchmarks/rendering.py --device cpu

Each picture is rendered several times, from the recording to the final pixels; the median is reported. The first
run, which compiles kernels, is reported separately.
"""

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
from result_file import default_path, write

import warpcontact as wc
from warpcontact.benchmark.facts import facts, versions
from warpcontact.system.resources import available_threads

SIZES = ((1280, 720), (3840, 2160))
REPEATS = 3


def ball_on_terrain() -> wc.Recording:
    """Returns a recording of a ball over 20 000 triangles."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.sinusoidal_terrain(), name="ground")
    ball = scene.add_body(mass=0.5, inertia=(5e-4,) * 3, position=(0, 0, 1.0), name="ball")
    material = wc.ContactMaterial(law=wc.laws.HuntCrossley(stiffness=1e5, exponent=1.5, restitution=0.7))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, radius=0.05, name="touch")
    return recorded(scene)


def grains(count: int) -> wc.Recording:
    """Returns a recording of ``count`` spheres above a plane."""
    scene = wc.Scene(gravity=(0, 0, 0))
    side = 0.025 * count ** (1 / 3)
    places = np.random.default_rng(1).uniform((-side, -side, 0.02), (side, side, 2 * side), (count, 3))
    bodies = scene.add_bodies(places, mass=1e-3, inertia=(4e-8,) * 3, name="grains")
    scene.add_shape(bodies, wc.shapes.Sphere(0.01), name="hulls")
    scene.add_shape(None, wc.shapes.Plane(), name="plate")
    return recorded(scene)


def recorded(scene: wc.Scene) -> wc.Recording:
    """Returns a recording of one step of a scene."""
    return wc.Simulation(scene.build(device="cpu"), dt=1e-4).run(1e-4, record=[], poses=True)


WORKS = {
    "ball on terrain": ball_on_terrain,
    "1000 spheres": lambda: grains(1000),
    "100 000 spheres": lambda: grains(100_000),
}


def main() -> None:
    """Prints the figures and writes them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--large", action="store_true", help="render in 3840 x 2160 as well")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rows = []
    for name, work in WORKS.items():
        recording = work()
        for size in SIZES if arguments.large else SIZES[:1]:
            taken = []
            for _ in range(REPEATS + 1):
                start = time.perf_counter()
                wc.render(recording, size=size, device=arguments.device)
                taken.append(time.perf_counter() - start)
            row = {"work": name, "size": list(size), "seconds": statistics.median(taken[1:]), "first": taken[0]}
            print(
                f"{name}, {size[0]} x {size[1]}: {row['seconds']:.3f} s (first {row['first']:.1f} s)", flush=True
            )
            rows.append(row)
    about = {**facts(arguments.device, available_threads()), **versions()}
    path = arguments.out or default_path("rendering", arguments.device, about)
    write(path, {"about": about, "results": rows})


if __name__ == "__main__":
    main()
