"""The structs that kernels read and write: every device array once, with unit, frame and shape.

``structs(real)`` returns them for one precision. Arrays are indexed ``[env, item]``; an array that all
environments share has stride 0 along ``env``, so kernels never ask. Frames: W world, B body (at its centre of
mass), S surface (axes of the mesh, origin at the centre of the surface). Velocities and wrenches are in world
axes, at the centre of mass. Quaternions are (x, y, z, w).
"""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

#: Body index that stands for the world.
WORLD = -1

# Status of an environment. A kernel looks at it first; anything but ACTIVE is left untouched.
ENV_ACTIVE = 0
ENV_FAILED = 1  # turned non-finite in this step; its other bodies may be half way
ENV_FROZEN = 2  # held at its last finite state
ENV_CROSSED = 3  # a point crossed a surface in this step, which is to be taken again in parts
ENV_WAITING = 4  # has taken this step, while others take it again

# Status of a contact.
OPEN = 0
CONTACT = 1
HIDDEN = 2
FAR = 3
WRONG_SIDE = 4
DISABLED = 5

# Option bits of a contact.
LATCHED = 1  # entry="latched"
RIM_OUTER = 2  # rim="outer"
HERTZ_PATCH = 4  # the arm of torsion follows from the overlap
SWEPT = 8  # a point that crosses the surface within a step is caught

# Column of a face's features: the face, its edges (0-1, 1-2, 2-0), its corners.
FEATURE_COUNT = 7
# Bits of a feature.
FEATURE_ACTIVE = 1
FEATURE_BORDER = 2

# What the geometry says about the latch of entry="latched".
LATCH_KEEP = 0
LATCH_ARM = 1
LATCH_DISARM = 2


@functools.cache
def structs(real: type) -> SimpleNamespace:
    """Returns the structs for ``real``, ``wp.float32`` or ``wp.float64``."""
    vec3, quat, mat33 = {
        wp.float32: (wp.vec3f, wp.quatf, wp.mat33f),
        wp.float64: (wp.vec3d, wp.quatd, wp.mat33d),
    }[real]

    @wp.struct
    class ContactGeometry:
        radius: real  # sphere about the point [m]; 0: a point
        kappa: real  # contact point K = S + kappa (D − S) [-]
        max_depth: real  # deepest penetration that still counts as contact [m]
        search_radius: real  # surfaces farther from the point are not seen [m]
        torsion_radius: real  # arm at which torsion acts [m]; unused with HERTZ_PATCH
        share: real  # factor on forces and couples [-]
        enabled: wp.int32  # 0 or 1

    @wp.struct
    class Model:
        gravity: wp.array2d(dtype=vec3)  # [env, 0], W [m/s²]
        # Bodies [env, body]
        body_mass: wp.array2d(dtype=real)  # [kg]
        body_inertia: wp.array2d(dtype=mat33)  # B, about the centre of mass [kg·m²]
        body_inverse_inertia: wp.array2d(dtype=mat33)  # B [1/(kg·m²)]
        # Points
        point_body: wp.array(dtype=wp.int32)  # [point] body or WORLD
        point_position: wp.array2d(dtype=vec3)  # [env, point], B (or W) [m]
        # Surfaces
        surface_body: wp.array(dtype=wp.int32)  # [surface] body or WORLD
        surface_position: wp.array2d(dtype=vec3)  # [env, surface] origin of S in B (or W) [m]
        surface_orientation: wp.array2d(dtype=quat)  # [env, surface] S → B (or W)
        surface_scale: wp.array2d(dtype=real)  # [env, surface] m per unit of the mesh
        surface_mesh: wp.array2d(dtype=wp.int32)  # [env, surface] which of its meshes it has
        # Patches: a mesh to search, a whole surface or the active part of one, in units of the mesh from the
        # centre of the surface; those of the meshes of one surface lie side by side
        patch_mesh: wp.array(dtype=wp.uint64)  # [patch] id of the wp.Mesh
        patch_surface: wp.array(dtype=wp.int32)  # [patch]
        patch_face_start: wp.array(dtype=wp.int32)  # [patch + 1] first row in the tables below
        patch_slack: wp.array(dtype=real)  # [patch] how far a float32 query may be off, unit of the mesh
        patch_doubtful: wp.array(dtype=wp.bool)  # [patch] whether that is more than rounding
        patch_thin: wp.array(dtype=wp.bool)  # [patch] whether a float32 distance to a face may mean nothing
        face_corner: wp.array2d(dtype=vec3)  # [face, corner], S, unit of the mesh
        face_normal: wp.array2d(dtype=vec3)  # [face, feature] unit pseudonormal, S
        face_flags: wp.array2d(dtype=wp.uint8)  # [face, feature] FEATURE_* bits
        face_neighbor: wp.array2d(dtype=wp.int32)  # [face, edge] 3 × row + edge of the other side; −1: none
        # Contacts
        contact_point: wp.array(dtype=wp.int32)  # [contact] index of the point
        contact_patch: wp.array(dtype=wp.int32)  # [contact] that of the surface's first mesh
        contact_options: wp.array(dtype=wp.int32)  # [contact] option bits
        contact_geometry: wp.array2d(dtype=ContactGeometry)  # [env, contact]

    @wp.struct
    class State:
        body_position: wp.array2d(dtype=vec3)  # [env, body] centre of mass, W [m]
        body_orientation: wp.array2d(dtype=quat)  # [env, body] B → W
        body_linear_velocity: wp.array2d(dtype=vec3)  # [env, body] of the centre of mass, W [m/s]
        body_angular_velocity: wp.array2d(dtype=vec3)  # [env, body], W [rad/s]

    @wp.struct
    class History:
        """Memory of the contacts; advances once per accepted step, in ``history.py`` and nowhere else.

        That of laws and frictions is theirs to declare: ``memory.py``.
        """

        entry_speed: wp.array2d(dtype=real)  # [env, contact] approach speed at entry [m/s]; < 0: not touching
        armed: wp.array2d(dtype=wp.int32)  # [env, contact] latch of entry="latched"
        face: wp.array2d(dtype=wp.int32)  # [env, contact] row of the face followed; −1: none
        crossings: wp.array2d(dtype=wp.int32)  # [env, contact] times the surface was crossed within a step
        crossing_time: wp.array2d(dtype=real)  # [env, contact] of the first of them [s]; NaN: none

    @wp.struct
    class Contacts:
        gap: wp.array2d(dtype=real)  # [env, contact] < 0 in overlap [m]
        penetration: wp.array2d(dtype=real)  # [env, contact] 0 unless status is CONTACT [m]
        normal: wp.array2d(dtype=vec3)  # [env, contact] out of the surface, W
        point: wp.array2d(dtype=vec3)  # [env, contact] K, where the force acts, W [m]
        face: wp.array2d(dtype=wp.int32)  # [env, contact] row of the face; −1: none
        status: wp.array2d(dtype=wp.int32)  # [env, contact] OPEN, CONTACT, …
        armed: wp.array2d(dtype=wp.int32)  # [env, contact] the latch this geometry leads to
        crossed_face: wp.array2d(dtype=wp.int32)  # [env, contact] row of that crossed in this step; −1: none
        crossed_at: wp.array2d(dtype=real)  # [env, contact] when in this step, 0 to 1
        approach_speed: wp.array2d(dtype=real)  # [env, contact] dδ/dt at K, 0 unless CONTACT [m/s]
        normal_force: wp.array2d(dtype=real)  # [env, contact] [N]
        friction_force: wp.array2d(dtype=vec3)  # [env, contact] on the point's body, W [N]
        slip_speed: wp.array2d(dtype=real)  # [env, contact] tangential, at K, 0 unless CONTACT [m/s]
        torque: wp.array2d(dtype=vec3)  # [env, contact] of rolling and torsion on the point's body, W [N·m]

    @wp.struct
    class Wrenches:
        force: wp.array2d(dtype=vec3)  # [env, body], W [N]
        torque: wp.array2d(dtype=vec3)  # [env, body] about the centre of mass, W [N·m]

    @wp.struct
    class Touch:
        """What a law sees of one contact at one instant."""

        delta: real  # penetration δ > 0 [m]
        delta_dot: real  # dδ/dt, > 0 on approach [m/s]
        entry_speed: real  # δ̇ when the contact began, or the largest since [m/s]
        mass: real  # effective mass along the normal [kg]; only for laws with needs_mass
        dt: real  # step that the force acts over [s]; 0: the force of this instant

    @wp.struct
    class Slip:
        """What a friction model sees of one contact at one instant."""

        velocity: vec3  # of the point's body relative to the surface: sliding, rolling or spinning, W [m/s]
        speed: real  # its length [m/s]
        normal_force: real  # N ≥ 0 [N]
        patch_radius: real  # √(R δ), the radius of a sphere's patch of contact [m]; 0 for a point
        normal: vec3  # out of the surface, W
        axis: vec3  # tangent unit vector that the surface carries, W; only for directional frictions

    return SimpleNamespace(
        real=real,
        vec3=vec3,
        quat=quat,
        mat33=mat33,
        epsilon=float(np.finfo(wp.dtype_to_numpy(real)).eps),
        ContactGeometry=ContactGeometry,
        Model=Model,
        State=State,
        History=History,
        Contacts=Contacts,
        Wrenches=Wrenches,
        Touch=Touch,
        Slip=Slip,
    )
