"""warpcontact: Kelvin–Voigt contact with tanh friction, with the triangles of the surface and between spheres.

In the scenes of nonsmooth contact, feet are in contact with meshes; the integrator is the Moreau–Jean scheme. In those of body
contact, parts are in body contact with each other and with the walls, with impulses (nonsmooth) or pressure (compliant).
"""

from typing import Any

import body_contact_benchmark_scenes as bodies
import numpy as np
import warp as wp
from benchmark_scenes import BenchmarkScene, sanity
from body_contact_benchmark_scenes import AT_REST, Bin, Part, Rolling
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
        self._sim.compile()

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


class BodyContactRun(Simulated):
    """Run of a benchmark scene of body contact; see the package. The variant is ``"nonsmooth"`` or ``"compliant"``."""

    def __init__(self, scene: Bin | Rolling, envs: int, device: str, threads: int, variant: str) -> None:
        self._scene = scene
        declared = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
        fixed: list[Any] = [
            declared.add_shape(None, wc.shapes.RoundedBox(size), position=center) for center, size in scene.walls
        ]
        if isinstance(scene, Rolling):
            fixed.append(declared.add_surface(wc.Mesh(scene.surface.vertices, scene.surface.faces)))
        self._bodies = []
        for number, part in enumerate(scene.parts):
            body = declared.add_body(part.mass, part.inertia, name=f"part{number}")
            _add_solid(declared, body, part)
            self._bodies.append(body)
        nonsmooth = variant == "nonsmooth"
        material = (
            wc.ContactMaterial(law=wc.laws.Rigid(), friction=wc.friction.Coulomb(mu=bodies.FRICTION))
            if nonsmooth
            else wc.ContactMaterial(
                law=wc.laws.ElasticFoundation(stiffness=bodies.STIFFNESS, damping=50.0),
                friction=wc.friction.CundallStrack(
                    mu_static=bodies.FRICTION, mu_dynamic=bodies.FRICTION, stiffness=1e4, damping=10.0
                ),
            )
        )
        declared.add_body_contact([*self._bodies, *fixed], material, name="contact")
        model = declared.build(envs=envs, device=device)
        poses, velocities = scene.start(envs), scene.velocities(envs)
        for number, body in enumerate(self._bodies):
            model[f"{body.name}.position"] = poses[:, number, :3]
            model[f"{body.name}.orientation"] = poses[:, number, 3:]
            model[f"{body.name}.linear_velocity"] = velocities[:, number, :3]
            model[f"{body.name}.angular_velocity"] = velocities[:, number, 3:]
        integrator = wc.integrators.MoreauJean() if nonsmooth else wc.integrators.SemiImplicitEuler()
        self._substeps = 1 if nonsmooth else bodies.COMPLIANT_SUBSTEPS
        self._sim = wc.Simulation(model, bodies.DT / self._substeps, integrator, threads=threads)
        self._sim.compile()

    def step(self, count: int) -> None:
        self._sim.step(count * self._substeps)

    def sanity(self, steps: int) -> dict[str, float]:
        self.reset()
        self.step(steps)
        before, _ = self._poses()
        self.step(AT_REST)
        touching = self._sim.model.sensor("contact.status") == wc.ContactStatus.CONTACT
        return bodies.sanity(self._scene, before, *self._poses()) | {"pairs": float(touching.sum(axis=-1).mean())}

    def _poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the poses (envs, bodies, 7) and velocities (envs, bodies, 6) in world axes."""

        def values(*sensors: str) -> np.ndarray:
            each = [[self._sim.model.sensor(f"{body.name}.{name}") for name in sensors] for body in self._bodies]
            return np.stack([np.concatenate(parts, axis=-1) for parts in each], axis=1)

        return values("position", "orientation"), values("linear_velocity", "angular_velocity")


def _add_solid(scene: wc.Scene, body: wc.Body, part: Part) -> None:
    """Adds the geometry of a part to a body."""
    if part.kind == "mesh":
        scene.add_surface(wc.Mesh(part.vertices, part.faces), body)
    elif part.kind == "box":
        scene.add_shape(body, wc.shapes.RoundedBox(part.size))
    else:
        radius, half_length = part.size
        scene.add_shape(body, wc.shapes.Cylinder(radius=radius, half_length=half_length))
