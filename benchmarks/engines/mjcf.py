"""Benchmark scenes as MuJoCo models, for MuJoCo and MuJoCo Warp.

The surface is a height field. MuJoCo contacts are soft constraints. With ``solref = (−k/m, −c/m)`` a contact adds
the acceleration of a spring and damper, reduced by what other contacts provide; the impedance d sets the degree.
For d → 0 contacts are independent springs, as the points of a box are. A sphere has one contact per overlapped
triangle in MuJoCo but one in total in this engine, so the MuJoCo default d = 0.9 is used, which shares the load.
Cones are elliptic: pyramidal ones gain energy with such soft contacts and are not faster. Contacts between spheres
have half of k and c, because MuJoCo scales with the masses of both bodies. All other options are defaults.
"""

import mujoco
import numpy as np
from works import DAMPING, DT, FRICTION, GRAVITY, STIFFNESS, Work


def model(work: Work) -> mujoco.MjModel:
    """Returns the model of a benchmark scene, with its bodies at the origin."""
    spec = mujoco.MjSpec()
    spec.option.timestep = DT
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.gravity = (0.0, 0.0, -GRAVITY)
    surface = work.surface
    low, high = surface.heights.min(), surface.heights.max()
    spec.add_hfield(
        name="surface",
        size=(surface.x[-1], surface.y[-1], high - low, 0.5),
        nrow=len(surface.y),
        ncol=len(surface.x),
        userdata=((surface.heights.T - low) / (high - low)).ravel(),
    )
    impedance = 0.9 if work.points is None else 0.01
    contact = {
        "friction": (FRICTION, 0.0, 0.0),
        "condim": 3,
        "solref": (-STIFFNESS / work.mass, -DAMPING / work.mass),
        "solimp": (impedance, impedance, 0.001, 0.5, 2.0),
    }
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="surface", pos=(0.0, 0.0, low), **contact
    )
    for _ in range(work.bodies):
        body = spec.worldbody.add_body(mass=work.mass, inertia=[work.inertia] * 3, explicitinertial=True)
        body.add_freejoint()
        for centre, radius in work.spheres():
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0, 0), pos=centre, mass=0.0, **contact)
    return spec.compile()


def start(work: Work, envs: int) -> np.ndarray:
    """Returns the initial ``qpos``, ``(envs, 7·bodies)``."""
    positions = work.start(envs)
    upright = np.broadcast_to((1.0, 0.0, 0.0, 0.0), (*positions.shape[:2], 4))
    return np.concatenate((positions, upright), axis=-1).reshape(envs, -1)
