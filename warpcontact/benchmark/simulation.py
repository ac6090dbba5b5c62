"""Builds the scenes of the benchmark: Kelvin–Voigt contact with tanh friction on a triangle mesh."""

import inspect
import time
from typing import Any

import warp as wp

from warpcontact.benchmark.scenes import DAMPING, DT, FRICTION, SLIP_SPEED, STIFFNESS, BenchmarkScene
from warpcontact.building.scene import Scene
from warpcontact.kernels import friction, laws
from warpcontact.kernels.shapes.spheres import Sphere
from warpcontact.meshes import Mesh
from warpcontact.scene.elements import ContactMaterial
from warpcontact.stepping.simulation import Simulation


def simulation(
    scene: BenchmarkScene, envs: int, device: str, precision: str = "float32", **options: Any
) -> Simulation:
    """Returns a simulation of a scene in its initial state.

    Args:
        scene: The scene.
        envs: Number of environments, each with its own initial position.
        device: As for ``Scene.build``.
        precision: As for ``Scene.build``.
        options: Arguments of ``Simulation``, and of its contact.
    """
    names = inspect.signature(Simulation).parameters
    stepping = {name: options.pop(name) for name in tuple(options) if name in names}
    material = ContactMaterial(
        law=laws.KelvinVoigt(stiffness=STIFFNESS, damping=DAMPING),
        friction=friction.Tanh(mu=FRICTION, velocity_scale=SLIP_SPEED),
    )
    declared = Scene()
    ground = declared.add_surface(Mesh(scene.surface.vertices, scene.surface.faces), name="ground")
    start = scene.start(envs)
    if start.shape[1] > 1:
        body = declared.add_bodies(start[0], scene.mass, [scene.inertia] * 3, name="body")
        declared.add_particle_contact(declared.add_shape(body, Sphere(scene.radius)), material, name="pile")
    else:
        body = declared.add_body(scene.mass, [scene.inertia] * 3, name="body")
        start = start[:, 0]
    points = (
        declared.add_point(body, (0, 0, 0)) if scene.points is None else declared.add_points(body, scene.points)
    )
    declared.add_contact(points, ground, material, radius=scene.radius, name="touch", **options)
    model = declared.build(envs=envs, device=device, precision=precision)
    model["body.position"] = start
    return Simulation(model, dt=DT, **stepping)


def run_seconds(sim: Simulation, steps: int) -> float:
    """Returns the time of ``steps`` steps from the initial state [s], without the reset and without compilation."""
    sim.compile()
    sim.reset()
    _wait(sim)
    start = time.perf_counter()
    sim.step(steps)
    _wait(sim)
    return time.perf_counter() - start


def _wait(sim: Simulation) -> None:
    for device in sim.model.devices:
        wp.synchronize_device(device)


def seconds_of_runs(sim: Simulation, steps: int, at_least: float) -> float:
    """Returns the mean time of a run [s], over as many runs as take at least ``at_least`` seconds together."""
    times: list[float] = []
    while sum(times) < at_least:
        times.append(run_seconds(sim, steps))
    return sum(times) / len(times)
