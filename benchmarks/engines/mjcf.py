"""The works as MuJoCo models, for MuJoCo and MuJoCo Warp.

The surface is a height field. MuJoCo's contacts are soft constraints: with ``solref = (−k/m, −c/m)`` a contact
accelerates its bodies as a spring and damper would, in so far as other contacts do not do so already; how far is
the impedance d. At d → 0 contacts are springs side by side, which the points of a box are. A sphere has a contact
with each of the triangles that it overlaps and only one in the engine compared; d = 0.9, MuJoCo's own choice,
makes them share. Cones are elliptic: with pyramids, contacts as soft as these gain energy, and are no faster.
Contacts between spheres have half of k and c, because MuJoCo scales with the masses of both bodies. All other
options are MuJoCo's own choice.
"""

import mujoco
import numpy as np
from works import DAMPING, DT, FRICTION, GRAVITY, STIFFNESS, Work


def model(work: Work) -> mujoco.MjModel:
    """Returns the model of a work, its bodies at the origin."""
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
    """Returns ``qpos`` at the start, ``(envs, 7·bodies)``."""
    positions = work.start(envs)
    upright = np.broadcast_to((1.0, 0.0, 0.0, 0.0), (*positions.shape[:2], 4))
    return np.concatenate((positions, upright), axis=-1).reshape(envs, -1)
