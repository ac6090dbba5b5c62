"""Newton: surface as triangle mesh, its collision pipeline, and one of two solvers.

SemiImplicit has springs and dampers, so k, c and μ are the same; its friction is proportional to the slip speed up
to μ N, with a slope [N·s/m] that equals that of the other engines for a body at rest. XPBD has rigid contacts with
μ only. Steps are replayed from a graph on both devices. Two settings are tuned for speed. The detection distance
is small: SemiImplicit acts in overlap only, and a body moves at most 4 mm per step with XPBD; with the default of
10 cm both take several times as long for the same motion. Buffers have the minimum sufficient size.

In the scenes of body contact the solver is XPBD. Its contacts are those of shapes and convex hulls, or of signed distance fields
of all shapes (hydroelastic).
"""

from typing import Any

import body_contact_benchmark_scenes as bodies
import newton
import numpy as np
import warp as wp
from benchmark_scenes import DAMPING, DT, FRICTION, GRAVITY, SLIP_SPEED, STIFFNESS, BenchmarkScene, sanity
from body_contact_benchmark_scenes import AT_REST, Bin, Rolling

PACKAGES = ("newton", "warp-lang", "numpy")

GAPS = {"semi-implicit": 0.0, "xpbd": 0.004}
#: Candidate triangles and contacts per environment (mean over all environments): about twice the observed numbers.
TRIANGLES = {"W1": 32, "W2p8": 64, "W2p64": 512, "W3": 512}
CONTACTS = {"W1": 8, "W2p8": 32, "W2p64": 128, "W3": 128}
BODY_CONTACTS = 400  # of body contact per environment
BODY_GAP = 0.004  # detection distance of body contact [m]
SDF_RESOLUTION = 64  # voxels along the longest side
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


class BodyContactRun:
    """Run of a benchmark scene of body contact; see the package. The variant is ``"mesh"`` or ``"hydroelastic"``."""

    def __init__(self, scene: Bin | Rolling, envs: int, device: str, threads: int, variant: str) -> None:
        wp.config.log_level = wp.LOG_ERROR
        self._scene = scene
        self._shape = (envs, len(scene.parts))
        with wp.ScopedDevice(device):
            self._model = _body_contact_model(scene, envs, variant == "hydroelastic")
            self._pipeline = newton.CollisionPipeline(self._model, rigid_contact_max=BODY_CONTACTS * envs)
            self._contacts = self._pipeline.contacts()
            self._solver = newton.solvers.SolverXPBD(self._model)
            self._states = [self._model.state(), self._model.state()]
            self._control = self._model.control()
            poses = scene.start(envs).reshape(-1, 7).astype(np.float32)
            self._start = wp.array(poses, dtype=wp.transform)
            self.reset()
            self._take(2)  # compiles all kernels
            self._graph = None
            if wp.get_device(device).is_cuda:
                with wp.ScopedCapture(device=device) as capture:
                    self._take(STEPS_IN_GRAPH)
                self._graph = capture.graph
            self.reset()

    def _take(self, count: int) -> None:
        state, other = self._states
        for _ in range(count):
            state.clear_forces()
            self._pipeline.collide(state, self._contacts)
            self._solver.step(state, other, self._control, self._contacts, bodies.DT)
            state, other = other, state

    def reset(self) -> None:
        wp.copy(self._states[0].body_q, self._start)
        self._states[0].body_qd.zero_()

    def step(self, count: int) -> None:
        if self._graph is None:
            self._take(count)
            return
        for _ in range(count // STEPS_IN_GRAPH):
            wp.capture_launch(self._graph)

    def wait(self) -> None:
        wp.synchronize()

    def sanity(self, steps: int) -> dict[str, float]:
        self.reset()
        self.step(steps)
        before = self._poses()
        self.step(AT_REST)
        velocities = self._states[0].body_qd.numpy().reshape(*self._shape, 6)
        return bodies.sanity(self._scene, before, self._poses(), velocities)

    def notes(self) -> dict[str, Any]:
        count = int(self._contacts.rigid_contact_count.numpy()[0])
        return {
            "contacts": round(count / self._shape[0], 2),
            "overflow": count >= BODY_CONTACTS * self._shape[0],
        }

    def _poses(self) -> np.ndarray:
        return self._states[0].body_q.numpy().reshape(*self._shape, 7).astype(float)


def _body_contact_model(scene: Bin | Rolling, envs: int, hydroelastic: bool) -> newton.Model:
    material = newton.ModelBuilder.ShapeConfig(
        mu=bodies.FRICTION, mu_torsional=0.0, mu_rolling=0.0, density=0.0, gap=BODY_GAP
    )
    if hydroelastic:
        material.is_hydroelastic = True
        material.sdf_max_resolution = SDF_RESOLUTION
    one = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    for part in scene.parts:
        body = one.add_body(mass=part.mass, inertia=wp.mat33(np.diag(part.inertia)))
        if part.kind == "box":
            one.add_shape_box(body, hx=part.size[0], hy=part.size[1], hz=part.size[2], cfg=material)
        elif part.kind == "cylinder":
            one.add_shape_cylinder(body, radius=part.size[0], half_height=part.size[1], cfg=material)
        else:
            mesh = newton.Mesh(part.vertices, part.faces.ravel(), compute_inertia=False)
            if hydroelastic:
                mesh.build_sdf(max_resolution=SDF_RESOLUTION)
                one.add_shape_mesh(body, mesh=mesh, cfg=material)
            elif isinstance(scene, Bin):
                one.add_shape_convex_hull(body, mesh=mesh, cfg=material)
            else:
                one.add_shape_mesh(body, mesh=mesh, cfg=material)
    whole = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    for center, size in scene.walls:
        whole.add_shape_box(
            -1, xform=wp.transform(wp.vec3(*center)), hx=size[0], hy=size[1], hz=size[2], cfg=material
        )
    if isinstance(scene, Rolling):
        mesh = newton.Mesh(scene.surface.vertices, scene.surface.faces.ravel(), compute_inertia=False)
        whole.add_shape_mesh(-1, mesh=mesh, cfg=material)
    whole.replicate(one, envs)
    return whole.finalize()


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
