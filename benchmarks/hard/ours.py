"""Benchmark scenes of nonsmooth contact with this engine: feet on meshes, Moreau–Jean scheme."""

import warnings

import numpy as np
import warp as wp

import warpcontact as wc
from hard.works import DT, EDGE, FRICTION, GRAVITY, HEIGHT, MASS, RADIUS, Work


class Run:
    """Run of a benchmark scene."""

    def __init__(
        self, work: Work, envs: int, device: str, threads: int, solver: str, precision: str = "float32"
    ) -> None:
        scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
        below = scene.add_surface(wc.meshes.grid((20.0, 20.0), (2, 2)), name="ground")
        material = wc.ContactMaterial(law=wc.laws.Rigid(), friction=wc.friction.Coulomb(mu=FRICTION))
        for number, place in enumerate(work.start()):
            body = scene.add_body(MASS, work.inertia, position=place, name=f"box{number}")
            feet = scene.add_points(body, work.places, name=f"feet{number}")
            scene.add_contact(feet, below, material, radius=RADIUS, name=f"touch{number}")
            below = scene.add_surface(wc.meshes.box((EDGE, EDGE, HEIGHT)), body, name=f"top{number}")
        self.model = scene.build(envs=envs, device=device, precision=precision)
        for number in range(work.boxes):
            self.model[f"box{number}.linear_velocity"] = work.velocities(envs)
        self.sim = wc.Simulation(self.model, DT, wc.integrators.MoreauJean(solver=solver), threads=threads)

    def reset(self) -> None:
        """Returns to the initial state."""
        self.sim.reset()

    def step(self, count: int) -> None:
        """Takes steps and waits for the device."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.sim.step(count)
        wp.synchronize()

    def quality(self, steps: int, samples: int = 20) -> dict[str, float]:
        """Returns quality figures of a run from the initial state, sampled at regular intervals."""
        self.reset()
        residual, iterations, deepest = [], [], 0.0
        names = [name for name in self.model.sensor_names if name.endswith(".gap")]
        for _ in range(samples):
            self.step(steps // samples)
            residual.append(self.model.sensor("scene.solve_residual"))
            iterations.append(self.model.sensor("scene.solve_iterations"))
            deepest = min(deepest, *(float(self.model.sensor(name).min()) for name in names))
        failures = self.model.sensor("scene.solve_failures").sum() / (steps * self.model.envs)
        speed = np.sqrt(2.0 * self.model.sensor("scene.kinetic_energy") / MASS)
        return {
            "residual_median": float(np.median(residual)),
            "residual_worst": float(np.max(residual)),
            "iterations_mean": float(np.mean(iterations)),
            "penetration_m": -deepest,
            "not_converged": float(failures),
            "speed_at_end_m_s": float(speed.max()),
        }
