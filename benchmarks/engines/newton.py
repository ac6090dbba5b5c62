"""Newton: surface as triangle mesh, its collision pipeline, and one of two solvers.

SemiImplicit has springs and dampers, so k, c and μ are the same; its friction is proportional to the slip speed up
to μ N, with a slope [N·s/m] that equals that of the other engines for a body at rest. XPBD has rigid contacts with
μ only. Steps are replayed from a graph on both devices. Two settings are tuned for speed. The detection distance
is small: SemiImplicit acts in overlap only, and a body moves at most 4 mm per step with XPBD; with the default of
10 cm both take several times as long for the same motion. Buffers have the minimum sufficient size.
"""

from typing import Any

import newton
import numpy as np
import warp as wp
from benchmark_scenes import DAMPING, DT, FRICTION, GRAVITY, SLIP_SPEED, STIFFNESS, BenchmarkScene, sanity

PACKAGES = ("newton", "warp-lang", "numpy")

GAPS = {"semi-implicit": 0.0, "xpbd": 0.004}
#: Candidate triangles and contacts per environment (mean over all environments): about twice the observed numbers.
TRIANGLES = {"W1": 32, "W2p8": 64, "W2p64": 512, "W3": 512}
CONTACTS = {"W1": 8, "W2p8": 32, "W2p64": 128, "W3": 128}
STEPS_IN_GRAPH = 10  # even, so that the state ends in the first of the two buffers


class Run:
    """Run of a benchmark scene; see the package."""

    def __init__(self, scene: BenchmarkScene, envs: int, device: str, threads: int, variant: str) -> None:
        wp.config.log_level = wp.LOG_ERROR
        self._scene = scene
        self._shape = (envs, scene.bodies)
        with wp.ScopedDevice(device):
            self._model = _model(scene, envs, GAPS[variant])
            self._pipeline = newton.CollisionPipeline(
                self._model,
                rigid_contact_max=CONTACTS[scene.name] * envs,
                max_triangle_pairs=max(TRIANGLES[scene.name] * envs, 1000),
            )
            self._contacts = self._pipeline.contacts()
            if variant == "xpbd":
                self._solver = newton.solvers.SolverXPBD(self._model)
            else:
                self._solver = newton.solvers.SolverSemiImplicit(self._model, angular_damping=0.0)
            self._states = [self._model.state(), self._model.state()]
            self._control = self._model.control()
            poses = np.zeros((envs * scene.bodies, 7), dtype=np.float32)
            poses[:, :3], poses[:, 6] = scene.start(envs).reshape(-1, 3), 1.0
            self._start = wp.array(poses, dtype=wp.transform)
            self.reset()
            self._take(2)  # compiles all kernels
            with wp.ScopedCapture(device=device) as capture:
                self._take(STEPS_IN_GRAPH)
            self._graph = capture.graph
            self.reset()

    def _take(self, count: int) -> None:
        state, other = self._states
        for _ in range(count):
            state.clear_forces()
            self._pipeline.collide(state, self._contacts)
            self._solver.step(state, other, self._control, self._contacts, DT)
            state, other = other, state

    def reset(self) -> None:
        wp.copy(self._states[0].body_q, self._start)
        self._states[0].body_qd.zero_()

    def step(self, count: int) -> None:
        for _ in range(count // STEPS_IN_GRAPH):
            wp.capture_launch(self._graph)

    def wait(self) -> None:
        wp.synchronize()

    def sanity(self, steps: int) -> dict[str, float]:
        return sanity(self._scene, self._states[0].body_q.numpy().reshape(*self._shape, 7)[..., :3])

    def notes(self) -> dict[str, Any]:
        return {"contacts": round(int(self._contacts.rigid_contact_count.numpy()[0]) / self._shape[0], 2)}


def _model(scene: BenchmarkScene, envs: int, gap: float) -> newton.Model:
    slope = FRICTION * scene.mass * GRAVITY / (SLIP_SPEED * scene.resting_contacts)
    material = newton.ModelBuilder.ShapeConfig(
        ke=STIFFNESS, kd=DAMPING, kf=slope, mu=FRICTION, mu_torsional=0.0, mu_rolling=0.0, density=0.0, gap=gap
    )
    one = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    for _ in range(scene.bodies):
        body = one.add_body(mass=scene.mass, inertia=wp.mat33(np.eye(3) * scene.inertia))
        for centre, radius in scene.spheres():
            one.add_shape_sphere(body, xform=wp.transform(wp.vec3(*centre)), radius=radius, cfg=material)
    scene = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    mesh = newton.Mesh(scene.surface.vertices, scene.surface.faces.ravel(), compute_inertia=False)
    scene.add_shape_mesh(-1, mesh=mesh, cfg=material)
    scene.replicate(one, envs)
    return scene.finalize()
