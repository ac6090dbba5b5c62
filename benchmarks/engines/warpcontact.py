"""warpcontact: Kelvin–Voigt contact with tanh friction on the triangles of the surface."""

import inspect
from typing import Any

import numpy as np
import warp as wp
from works import DAMPING, DT, FRICTION, SLIP_SPEED, STIFFNESS, Work

import warpcontact as wc

WORKS = ("W1", "W2p8", "W2p64")
PACKAGES = ("warpcontact", "warp-lang", "numpy")


def simulation(work: Work, envs: int, device: str, precision: str = "float32", **options: Any) -> wc.Simulation:
    """Returns a simulation of a work; options are those of ``wc.Simulation``, others those of its contact."""
    wp.config.log_level = wp.LOG_ERROR
    names = inspect.signature(wc.Simulation).parameters
    stepping = {name: options.pop(name) for name in tuple(options) if name in names}
    template = wc.Template(
        law=wc.laws.KelvinVoigt(stiffness=STIFFNESS, damping=DAMPING),
        friction=wc.frictions.Tanh(mu=FRICTION, velocity_scale=SLIP_SPEED),
    )
    scene = wc.Scene()
    ground = scene.add_surface(wc.Mesh(work.surface.vertices, work.surface.faces), name="ground")
    body = scene.add_body(work.mass, [work.inertia] * 3, name="body")
    points = scene.add_point(body, (0, 0, 0)) if work.points is None else scene.add_points(body, work.points)
    scene.add_contact(points, ground, template, radius=work.radius, name="touch", **options)
    model = scene.build(envs=envs, device=device, precision=precision)
    model["body.position"] = work.start(envs)[:, 0]
    return wc.Simulation(model, dt=DT, **stepping)


class Run:
    """See the package."""

    def __init__(self, work: Work, envs: int, device: str, threads: int, variant: str) -> None:
        self._sim = simulation(work, envs, device, threads=threads)

    def reset(self) -> None:
        self._sim.reset()

    def step(self, count: int) -> None:
        self._sim.step(count)

    def wait(self) -> None:
        wp.synchronize()

    def positions(self) -> np.ndarray:
        return self._sim.state.body_position.numpy()

    def notes(self) -> dict[str, Any]:
        return {"frozen": len(self._sim.model.health().frozen)}
