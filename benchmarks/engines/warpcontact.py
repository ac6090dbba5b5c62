"""warpcontact: Kelvin–Voigt contact with tanh friction, with the triangles of the surface and between spheres.

In the scenes of nonsmooth contact, feet are in contact with meshes; the integrator is the Moreau–Jean scheme.
"""

from typing import Any

import numpy as np
import warp as wp
from benchmark_scenes import BenchmarkScene, sanity
from nonsmooth_benchmark_scenes import DT, EDGE, FRICTION, GRAVITY, HEIGHT, MASS, RADIUS, SAMPLES, NonsmoothScene

import warpcontact as wc
from warpcontact.benchmark.simulation import simulation

PACKAGES = ("warpcontact", "warp-lang", "numpy")
wp.config.log_level = wp.LOG_ERROR


class Simulated:
    """Common part of all runs: a simulation."""

    _sim: wc.Simulation

    def reset(self) -> None:
        self._sim.reset()

    def step(self, count: int) -> None:
        self._sim.step(count)

    def wait(self) -> None:
        wp.synchronize()

    def notes(self) -> dict[str, Any]:
        return {"frozen": len(self._sim.model.health().frozen)}


class Run(Simulated):
    """Run of a benchmark scene; see the package."""

    def __init__(self, scene: BenchmarkScene, envs: int, device: str, threads: int, variant: str) -> None:
        self._scene = scene
        self._sim = simulation(scene, envs, device, threads=threads)

    def sanity(self, steps: int) -> dict[str, float]:
        return sanity(self._scene, self._sim.state.body_position.numpy())


class NonsmoothRun(Simulated):
    """Run of a benchmark scene of nonsmooth contact; see the package. The variant is the solver."""

    def __init__(self, scene: NonsmoothScene, envs: int, device: str, threads: int, variant: str) -> None:
        declared = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
        below = declared.add_surface(wc.meshes.grid((20.0, 20.0), (2, 2)), name="ground")
        material = wc.ContactMaterial(law=wc.laws.Rigid(), friction=wc.friction.Coulomb(mu=FRICTION))
        for number, center in enumerate(scene.start()):
            body = declared.add_body(MASS, scene.inertia, position=center, name=f"box{number}")
            feet = declared.add_points(body, scene.feet_centers, name=f"feet{number}")
            declared.add_contact(feet, below, material, radius=RADIUS, name=f"touch{number}")
            below = declared.add_surface(wc.meshes.box((EDGE, EDGE, HEIGHT)), body, name=f"top{number}")
        model = declared.build(envs=envs, device=device)
        for number in range(scene.boxes):
            model[f"box{number}.linear_velocity"] = scene.velocities(envs)
        self._gaps = [f"touch{number}.gap" for number in range(scene.boxes)]
        self._sim = wc.Simulation(model, DT, wc.integrators.MoreauJean(solver=variant), threads=threads)

    def sanity(self, steps: int) -> dict[str, float]:
        model = self._sim.model
        self.reset()
        residuals, iterations, deepest = [], [], 0.0
        for _ in range(SAMPLES):
            self.step(max(steps // SAMPLES, 1))
            residuals.append(model.sensor("scene.solve_residual"))
            iterations.append(model.sensor("scene.solve_iterations"))
            deepest = min(deepest, *(float(model.sensor(gap).min()) for gap in self._gaps))
        speed = np.sqrt(2.0 * model.sensor("scene.kinetic_energy") / MASS)
        return {
            "residual_median": float(np.median(residuals)),
            "residual_worst": float(np.max(residuals)),
            "iterations_mean": float(np.mean(iterations)),
            "penetration_m": -deepest,
            "not_converged": float(model.sensor("scene.solve_failures").sum() / (steps * model.envs)),
            "speed_at_end_m_s": float(speed.max()),
        }
