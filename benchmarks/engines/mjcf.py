"""Benchmark scenes as MuJoCo models, for MuJoCo and MuJoCo Warp.

The surface is a height field. MuJoCo contacts are soft constraints. With ``solref = (−k/m, −c/m)`` a contact adds
the acceleration of a spring and damper, reduced by what other contacts provide; the impedance d sets the degree.
For d → 0 contacts are independent springs, as the points of a box are. A sphere has one contact per overlapped
triangle in MuJoCo but one in total in this engine, so the MuJoCo default d = 0.9 is used, which shares the load.
Cones are elliptic: pyramidal ones gain energy with such soft contacts and are not faster. Contacts between spheres
have half of k and c, because MuJoCo scales with the masses of both bodies. All other options are defaults.

In the scenes of nonsmooth contact, feet are small spheres, and stiffness, damping and impedance are the defaults. In those
of body contact, bodies are boxes, cylinders and meshes with the default options, which find several contacts per pair.
"""

import body_contact_benchmark_scenes
import mujoco
import nonsmooth_benchmark_scenes
import numpy as np
from benchmark_scenes import DAMPING, DT, FRICTION, GRAVITY, STIFFNESS, BenchmarkScene, Surface
from body_contact_benchmark_scenes import Bin, Rolling, matrix
from nonsmooth_benchmark_scenes import EDGE, HEIGHT, MASS, RADIUS, NonsmoothScene


def model(scene: BenchmarkScene) -> mujoco.MjModel:
    """Returns the model of a benchmark scene, with its bodies at the origin."""
    spec = mujoco.MjSpec()
    spec.option.timestep = DT
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.gravity = (0.0, 0.0, -GRAVITY)
    low = add_height_field(spec, scene.surface)
    impedance = 0.9 if scene.points is None else 0.01
    contact = {
        "friction": (FRICTION, 0.0, 0.0),
        "condim": 3,
        "solref": (-STIFFNESS / scene.mass, -DAMPING / scene.mass),
        "solimp": (impedance, impedance, 0.001, 0.5, 2.0),
    }
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="surface", pos=(0.0, 0.0, low), **contact
    )
    for _ in range(scene.bodies):
        body = spec.worldbody.add_body(mass=scene.mass, inertia=[scene.inertia] * 3, explicitinertial=True)
        body.add_freejoint()
        for centre, radius in scene.spheres():
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0, 0), pos=centre, mass=0.0, **contact)
    return spec.compile()


def add_height_field(spec: mujoco.MjSpec, surface: Surface) -> float:
    """Adds the height field ``"surface"``; returns its lowest height [m], at which its geom must be."""
    low, high = surface.heights.min(), surface.heights.max()
    spec.add_hfield(
        name="surface",
        size=(surface.x[-1], surface.y[-1], high - low, 0.5),
        nrow=len(surface.y),
        ncol=len(surface.x),
        userdata=((surface.heights.T - low) / (high - low)).ravel(),
    )
    return float(low)


def start(scene: BenchmarkScene, envs: int) -> np.ndarray:
    """Returns the initial ``qpos``, ``(envs, 7·bodies)``."""
    positions = scene.start(envs)
    upright = np.broadcast_to((1.0, 0.0, 0.0, 0.0), (*positions.shape[:2], 4))
    return np.concatenate((positions, upright), axis=-1).reshape(envs, -1)


def body_contact_model(scene: Bin | Rolling) -> mujoco.MjModel:
    """Returns the model of a benchmark scene of body contact, with its bodies at the origin."""
    spec = mujoco.MjSpec()
    spec.option.timestep = body_contact_benchmark_scenes.DT
    spec.option.gravity = (0.0, 0.0, -GRAVITY)
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    contact = {"friction": (body_contact_benchmark_scenes.FRICTION, 0.0, 0.0), "condim": 3}
    for center, size in scene.walls:
        # Walls touch bodies only.
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=center, contype=1, conaffinity=0, **contact
        )
    if isinstance(scene, Rolling):
        low = add_height_field(spec, scene.surface)
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="surface", pos=(0.0, 0.0, low), **contact
        )
    for number, part in enumerate(scene.parts):
        body = spec.worldbody.add_body(mass=part.mass, inertia=part.inertia, explicitinertial=True)
        body.add_freejoint()
        if part.kind == "mesh":
            name = f"mesh{number}"
            spec.add_mesh(name=name, uservert=part.vertices.ravel(), userface=part.faces.ravel())
            shape = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": name}
        elif part.kind == "box":
            shape = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": part.size}
        else:
            shape = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": (*part.size, 0.0)}
        body.add_geom(mass=0.0, **shape, **contact)
    return spec.compile()


def scalar_first(poses: np.ndarray) -> np.ndarray:
    """Returns poses (…, 7) with quaternions (w, x, y, z) of poses with quaternions (x, y, z, w)."""
    return poses[..., [0, 1, 2, 6, 3, 4, 5]]


def scalar_last(poses: np.ndarray) -> np.ndarray:
    """Returns poses (…, 7) with quaternions (x, y, z, w) of poses with quaternions (w, x, y, z)."""
    return poses[..., [0, 1, 2, 4, 5, 6, 3]]


def world_velocities(velocities: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Returns linear and angular velocities (envs, bodies, 6) in world axes; MuJoCo has angular ones in those of the body."""
    turned = velocities.copy()
    for env, body in np.ndindex(poses.shape[:2]):
        turned[env, body, 3:] = matrix(poses[env, body, 3:]) @ velocities[env, body, 3:]
    return turned


def nonsmooth_model(scene: NonsmoothScene, cone: str) -> mujoco.MjModel:
    """Returns the model of a benchmark scene of nonsmooth contact, with ``"elliptic"`` or ``"pyramidal"`` cones."""
    spec = mujoco.MjSpec()
    spec.option.timestep = nonsmooth_benchmark_scenes.DT
    spec.option.gravity = (0.0, 0.0, -GRAVITY)
    cones = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
    spec.option.cone = cones[cone]
    contact = {"friction": (nonsmooth_benchmark_scenes.FRICTION, 0.0, 0.0), "condim": 3}
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(20.0, 20.0, 1.0), contype=1, conaffinity=0, **contact
    )
    for number, center in enumerate(scene.start()):
        body = spec.worldbody.add_body(pos=center, mass=MASS, inertia=scene.inertia, explicitinertial=True)
        body.add_freejoint()
        # The feet of a box collide only with the next lower object: bit ``number`` marks the object under box
        # ``number``.
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=(EDGE / 2, EDGE / 2, HEIGHT / 2), mass=0.0,
            contype=2 << number, conaffinity=0, **contact,
        )  # fmt: skip
        for foot in scene.feet_centers:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(RADIUS, 0, 0), pos=foot, mass=0.0,
                contype=0, conaffinity=1 << number, **contact,
            )  # fmt: skip
    return spec.compile()
