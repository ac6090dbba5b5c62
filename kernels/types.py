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
ENV_SUBSTEP = 3  # a point crossed a surface in this step, which is to be taken again in parts
ENV_PAUSED = 4  # has taken this step, while others take it again
ENV_HALTED = 5  # a stop condition holds at the state that this step would begin from
ENV_STOPPED = 6  # held at that state
ENV_SLEEPING = 7  # this step would change nothing, and is left out

# Why an environment was frozen.
NO_CAUSE = 0
NON_FINITE = 1
TOO_FAST = 2
TOO_FAR = 3

# Status of a contact.
OPEN = 0
CONTACT = 1
INACTIVE = 2
FAR = 3
WRONG_SIDE = 4
DISABLED = 5
UNSOLVED = 6  # of smooth shapes: no root was found, and no force acts

# What a nonsmooth contact does.
MODE_OPEN = 0
MODE_STICK = 1
MODE_SLIP = 2

# Option bits of a contact.
LATCHED = 1  # entry="latched"
BOUNDARY_OUTER = 2  # boundary="outer"
HERTZ_TORSION = 4  # the arm of torsion follows from the overlap
SWEPT = 8  # a point that crosses the surface within a step is caught
FORCE_AT_POINT = 16  # the force acts at the point itself, as in a contact coupling

# Status of a spring-damper or bushing.
COUPLING_ACTIVE = 0
COUPLING_SLACK = 1  # tension_only, and not stretched
COUPLING_BROKEN = 2
COUPLING_OUTSIDE = 3  # of its table, the ends of which are held
COUPLING_NO_DIRECTION = 4  # its ends are in one place, and nothing is known of where they came from
COUPLING_DISABLED = 5

# Status of a catenary.
LINE_HANGING = 0  # its length is longer than the distance of its ends
LINE_TAUT = 1  # shorter: it is stretched
LINE_FOLDED = 2  # its ends are above one another, and it hangs from both
LINE_GROUNDED = 3  # a part of it rests on the floor
LINE_SUNK = 4  # an end lies below the floor, and is taken to be on it
LINE_LOOSE = 5  # without weight, and not stretched
LINE_DISABLED = 6
LINE_FAILED = 7  # no solution was found: the forces are those of the last iterate

# Status of the solution of two smooth shapes.
MET = 0
NOT_CONVERGED = 1  # the last iterate is not stationary to the tolerance
OUTSIDE = 2  # beyond the edge of a patch: no contact

# Root of the equations of two surfaces.
ROOT_FACING = 0  # the normals are antiparallel
ROOT_PARALLEL = 1  # of the near side of one and the far side of the other
ROOT_FALSE = 2  # of the equations alone, where a chart is singular
ROOT_NONE = 3  # no root was found

# Column of a face's features: the face, its edges (0-1, 1-2, 2-0), its corners.
FEATURE_COUNT = 7
# Bits of a feature.
FEATURE_ACTIVE = 1
FEATURE_BOUNDARY = 2

# Where a point that does not come through a surface stays on the side that it is on.
SIDE_KNOWN_NOWHERE = 0
SIDE_KNOWN_EVERYWHERE = 1
SIDE_KNOWN_INSIDE_WALLS = 2  # within the walls of the patch

# Faces that are remembered per contact where many threads search side by side, with few registers each: more last
# longer, but sorting them in costs more than that.
CACHED_FACES_GPU = 8

# Queues of a GPU.
QUEUE_COUNT = 4

# How a body may move.
FREE = 0
FIXED = 1
TRANSLATION = 2
PLANAR = 3
HINGE = 4
SLIDER = 5
BALL = 6
PRESCRIBED = 7  # by the velocities in its state
TIME_FUNCTION = 8  # by a function of time

# What the geometry says about the latch of entry="latched".
LATCH_KEEP = 0
LATCH_ARM = 1
LATCH_DISARM = 2


@wp.struct
class LaunchRange:
    """What a launch is to do: tasks, an item of an environment each, shared out among its threads.

    A thread on a GPU has one. On the CPU one thread has all: it looks at the arguments once, not for every task.
    What is launched for one slice of the environments after another, on the CPU, reads which from memory.
    """

    envs: wp.int32  # from the first on
    items: wp.int32  # of an environment
    threads: wp.int32
    slice: wp.array(dtype=wp.int32)  # the first environment and how many, in place of all, and steps; or nothing


@wp.func_native("if (number < 0) __builtin_unreachable(); return number;")
def assume_nonnegative(number: int) -> int:
    """The same number, which is not negative: an index that is costs some instructions at each array."""
    ...


@wp.func
def first_env(launch: LaunchRange):
    """First environment of a launch."""
    if launch.slice.shape[0] > 0:
        return launch.slice[0]
    return 0


@wp.func
def task_count(launch: LaunchRange):
    """How many tasks a launch has."""
    if launch.slice.shape[0] > 0:
        return launch.slice[1] * launch.items
    return launch.envs * launch.items


@wp.func
def step_count(launch: LaunchRange):
    """How many steps a launch takes of each environment, if it takes any number."""
    return launch.slice[2]


@wp.func
def task_env(launch: LaunchRange, task: int):
    """Environment of a task."""
    return assume_nonnegative(first_env(launch) + assume_nonnegative(task) // assume_nonnegative(launch.items))


@wp.func
def task_item(launch: LaunchRange, task: int):
    """Item of its environment that a task is for."""
    return assume_nonnegative(assume_nonnegative(task) % assume_nonnegative(launch.items))


@wp.struct
class BodyMotion:
    """How a body may move, in float64 whatever the precision: what is built from it does not drift."""

    kind: wp.int32  # FREE, FIXED, …
    axis: wp.vec3d  # unit: of a hinge or a slider, the normal of a plane; W
    anchor: wp.vec3d  # what a hinge, a ball or a function of time turns it about, W [m]
    position: wp.vec3d  # initial centre of mass, W [m]
    orientation: wp.quatd  # initial, B → W


@functools.cache
def numbers(real: type) -> SimpleNamespace:
    """Returns vectors and rotations of ``real``, ``wp.float32`` or ``wp.float64``, and its precision."""
    vec3, quat, mat33 = {
        wp.float32: (wp.vec3f, wp.quatf, wp.mat33f),
        wp.float64: (wp.vec3d, wp.quatd, wp.mat33d),
    }[real]
    epsilon = float(np.finfo(wp.dtype_to_numpy(real)).eps)
    return SimpleNamespace(real=real, vec3=vec3, quat=quat, mat33=mat33, epsilon=epsilon)


@functools.cache
def structs(real: type) -> SimpleNamespace:
    """Returns the structs for ``real``, ``wp.float32`` or ``wp.float64``, and what ``numbers`` returns."""
    n = numbers(real)
    vec3, quat, mat33 = n.vec3, n.quat, n.mat33

    @wp.struct
    class ContactGeometry:
        radius: real  # sphere about the point [m]; 0: a point
        kappa: real  # contact point K = S + kappa (D − S) [-]
        max_depth: real  # deepest penetration that still counts as contact [m]
        search_radius: real  # surfaces farther from the point are not seen [m]
        torsion_radius: real  # arm at which torsion acts [m]; unused with HERTZ_TORSION
        force_scale: real  # factor on forces and couples [-]
        closed: real  # gap below which there is contact [m]: 0, or the tolerance of nonsmooth contact
        enabled: wp.int32  # 0 or 1

    @wp.struct
    class Cell:
        clearance: real  # all its points are this far on the outer side [unit of the mesh]; <= 0: unknown
        faces: wp.int32  # where the list of faces that may be nearest begins, and their number; −1: no list

    @wp.struct
    class Model:
        gravity: wp.array2d(dtype=vec3)  # [env, 0], W [m/s²]
        # Bodies [env, body]
        body_mass: wp.array2d(dtype=real)  # [kg]
        body_inertia: wp.array2d(dtype=mat33)  # B, about the centre of mass [kg·m²]
        body_inverse_inertia: wp.array2d(dtype=mat33)  # B [1/(kg·m²)]
        body_isotropic_inertia: wp.array2d(dtype=wp.bool)  # whether the inertia is the same about all axes
        body_external_force: wp.array2d(dtype=vec3)  # [env, body] at the centre of mass, W [N]
        body_external_torque: wp.array2d(dtype=vec3)  # [env, body] W [N·m]
        body_motion: wp.array2d(dtype=BodyMotion)  # empty if all bodies are free
        # Points
        point_body: wp.array(dtype=wp.int32)  # [point] body or WORLD
        point_position: wp.array2d(dtype=vec3)  # [env, point], B (or W, from its anchor) [m]
        point_anchor: wp.array2d(dtype=vec3)  # [env, point], W; of points of the world, one for those of a set [m]
        point_normal: wp.array2d(dtype=vec3)  # [env, point] unit, B (or W); only if areas are weighed by it
        # Surfaces
        surface_body: wp.array(dtype=wp.int32)  # [surface] body or WORLD
        surface_position: wp.array2d(dtype=vec3)  # [env, surface] origin of S in B (or W, from its anchor) [m]
        surface_anchor: wp.array2d(dtype=vec3)  # [env, surface], W; of a surface of the world [m]
        surface_orientation: wp.array2d(dtype=quat)  # [env, surface] S → B (or W)
        surface_scale: wp.array2d(dtype=real)  # [env, surface] m per unit of the mesh
        surface_mesh: wp.array2d(dtype=wp.int32)  # [env, surface] which of its meshes it has
        # Patches: a mesh to search, a whole surface or the active part of one, in units of the mesh from the
        # centre of the surface; those of the meshes of one surface lie side by side
        query_mesh_id: wp.array(dtype=wp.uint64)  # [patch] id of the wp.Mesh
        query_mesh_surface: wp.array(dtype=wp.int32)  # [patch]
        query_mesh_face_start: wp.array(dtype=wp.int32)  # [patch + 1] first row in the tables below
        query_mesh_error: wp.array(dtype=real)  # [patch] how far a float32 query may be off, unit of the mesh
        query_mesh_thin_length: wp.array(
            dtype=real
        )  # [patch] longest edge of faces where that is not rounding; 0: none
        query_mesh_skin: wp.array(dtype=real)  # [patch] how much farther faces are remembered than the nearest
        query_mesh_side_region: wp.array(
            dtype=wp.int32
        )  # [patch] SIDE_KNOWN_*: where a point keeps the side that it is on
        query_mesh_wall_start: wp.array(dtype=wp.int32)  # [patch + 1] first row of its walls
        wall_normal: wp.array(dtype=vec3)  # [wall] unit, into the region of SIDE_KNOWN_INSIDE_WALLS, S
        wall_offset: wp.array(dtype=real)  # [wall] of its plane along the normal
        # Cells about a patch: ``cells.py``
        query_mesh_grid: wp.array(dtype=wp.vec4i)  # [patch] how many along x, y and z, and its first; −1: none
        query_mesh_grid_origin: wp.array(dtype=vec3)  # [patch] their lowest corner, S
        query_mesh_cell_size: wp.array(dtype=real)  # [patch] of a cell, unit of the mesh
        query_mesh_grid_margin: wp.array(dtype=real)  # [patch] from their boundary to the mesh, at least
        cells: wp.array(dtype=Cell)  # [cell]
        cell_face: wp.array(dtype=wp.int32)  # rows of faces, by the cells that list them
        # Tree over the faces of a patch, on a CPU: ``tree.py``
        query_mesh_bvh: wp.array(
            dtype=wp.vec4i
        )  # [patch] its first node, how many, branches of its root, first face
        bvh_bound: wp.array(dtype=wp.float32)  # by node, what bounds its branches: ``warpcontact/geometry/bvh.py``
        bvh_face: wp.array(dtype=wp.int32)  # faces in the order of the branches, from the first of the patch
        face_corner: wp.array2d(dtype=vec3)  # [face, 0 to 2] its corners, [face, 3] its unit normal; S
        face_frame: wp.array2d(
            dtype=vec3
        )  # [face, 0 and 1] unit, along its first edge and across; [face, 2] length of that edge, and the last
        # corner along both; [face, 3] one over the squares of its edges 0-1, 1-2, 2-0; only with cells
        face_normal: wp.array2d(dtype=vec3)  # [face, feature] unit pseudonormal, S
        face_flags: wp.array2d(dtype=wp.uint8)  # [face, feature] FEATURE_* bits
        face_neighbor: wp.array2d(dtype=wp.int32)  # [face, edge] 3 × row + edge of the other side; −1: none
        # Contacts
        contact_point: wp.array(dtype=wp.int32)  # [contact] index of the point
        contact_query_mesh: wp.array(dtype=wp.int32)  # [contact] that of the surface's first mesh
        contact_options: wp.array(dtype=wp.int32)  # [contact] option bits
        contact_set: wp.array(dtype=wp.int32)  # [contact]
        contact_geometry: wp.array2d(dtype=ContactGeometry)  # [env, contact]
        # Sets: the contacts of one set of points with one surface. Blocks: some of them that are near each other
        set_contact: wp.array(dtype=wp.int32)  # [set] its first contact
        set_center: wp.array2d(dtype=vec3)  # [env, set] in the middle of the points, as they are given [m]
        set_extent: wp.array2d(dtype=real)  # [env, set] farthest point from there [m]
        set_cluster_start: wp.array(dtype=wp.int32)  # [set + 1] first block
        cluster_set: wp.array(dtype=wp.int32)  # [block]
        cluster_start: wp.array(dtype=wp.int32)  # [block + 1] first of its contacts in the list
        cluster_contact: wp.array(dtype=wp.int32)  # contacts by block
        cluster_center: wp.array2d(dtype=vec3)  # [env, block] in the middle of its points, as they are given [m]
        body_cluster_start: wp.array(dtype=wp.int32)  # [body + 1] first of its blocks in the list
        body_cluster: wp.array(dtype=wp.int32)  # 2 × block + 0 as the points' body, 1 as the surface's
        # Ends of couplings: 2 × coupling, 2 × coupling + 1
        end_point: wp.array(dtype=wp.int32)  # [end] index of its point
        body_end_start: wp.array(dtype=wp.int32)  # [body + 1] first of its ends in the list
        body_end: wp.array(dtype=wp.int32)  # ends by body

    @wp.struct
    class State:
        body_position: wp.array2d(dtype=vec3)  # [env, body] centre of mass, W [m]
        body_position_remainder: wp.array2d(dtype=vec3)  # [env, body] what rounding left of it; to be added [m]
        body_orientation: wp.array2d(dtype=quat)  # [env, body] B → W
        body_linear_velocity: wp.array2d(dtype=vec3)  # [env, body] of the centre of mass, W [m/s]
        body_angular_velocity: wp.array2d(dtype=vec3)  # [env, body], W [rad/s]

    @wp.struct
    class History:
        """Memory of the contacts; advances once per accepted step, in ``history.py`` or ``alone.py``.

        That of laws and friction models is theirs to declare: ``memory.py``.
        """

        entry_speed: wp.array2d(dtype=real)  # [env, contact] approach speed at entry [m/s]; < 0: not touching
        armed: wp.array2d(dtype=wp.int32)  # [env, contact] latch of entry="latched"
        face: wp.array2d(dtype=wp.int32)  # [env, contact] row of the face followed; −1: none
        crossings: wp.array2d(dtype=wp.int32)  # [env, contact] times the surface was crossed within a step
        crossing_time: wp.array2d(dtype=real)  # [env, contact] of the first of them [s]; NaN: none

    @wp.struct
    class Contacts:
        gap: wp.array2d(dtype=real)  # [env, contact] signed distance, < 0 also at WRONG_SIDE [m]
        penetration: wp.array2d(dtype=real)  # [env, contact] 0 unless status is CONTACT [m]
        normal: wp.array2d(dtype=vec3)  # [env, contact] out of the surface, W
        arm: wp.array2d(
            dtype=vec3
        )  # [env, contact] to K, where the force acts, from where points are given, W [m]
        face: wp.array2d(dtype=wp.int32)  # [env, contact] row of the face; −1: none
        status: wp.array2d(dtype=wp.int32)  # [env, contact] OPEN, CONTACT, …
        armed: wp.array2d(dtype=wp.int32)  # [env, contact] the latch this geometry leads to
        crossed_face: wp.array2d(dtype=wp.int32)  # [env, contact] row of that crossed in this step; −1: none
        crossing_fraction: wp.array2d(dtype=real)  # [env, contact] when in this step, 0 to 1
        approach_speed: wp.array2d(dtype=real)  # [env, contact] dδ/dt at K, 0 unless CONTACT [m/s]
        normal_force: wp.array2d(dtype=real)  # [env, contact] 0 unless CONTACT [N]
        friction_force: wp.array2d(dtype=vec3)  # [env, contact] on the point's body, 0 unless CONTACT, W [N]
        slip_speed: wp.array2d(dtype=real)  # [env, contact] tangential, at K, 0 unless CONTACT [m/s]
        torque: wp.array2d(dtype=vec3)  # [env, contact] of rolling and torsion on the point's body, W [N·m]

    @wp.struct
    class CouplingExtremes:
        """How close contact couplings came; advances once per accepted step, in ``contact_coupling.py``."""

        effective_area: wp.array2d(dtype=real)  # [env, coupling] largest area in range so far [m²]
        minimum_distance: wp.array2d(dtype=real)  # [env, coupling] smallest in range so far [m]; NaN: none

    @wp.struct
    class ActiveContacts:
        """Which contacts a step has to do with, and what each block of them adds to its two bodies."""

        needs_history: wp.array2d(
            dtype=wp.int32
        )  # [env, contact] 1: it touches, or history does not know yet that it ended
        contact: wp.array2d(dtype=wp.int32)  # [env, place] contacts by block, from cluster_start on
        count: wp.array2d(dtype=wp.int32)  # [env, block]
        crossed_count: wp.array2d(dtype=wp.int32)  # [env, block] how many more crossed their surface in this step
        force: wp.array2d(dtype=vec3)  # [env, block] on the points' body, W [N]
        torque_1: wp.array2d(dtype=vec3)  # [env, block] on it, about its centre of mass, W [N·m]
        torque_2: wp.array2d(dtype=vec3)  # [env, block] on the surface's body, about its own, W [N·m]

    @wp.struct
    class Cache:
        """What is known of distances from earlier steps: it saves work and changes no result.

        A distance changes by no more than the point moved. Zeros: nothing is known.
        """

        set_position: wp.array2d(dtype=vec3)  # [env, set] its middle when last seen, from the surface, S [m]
        set_orientation: wp.array2d(dtype=quat)  # [env, set] B → S then, of a set with an extent
        set_travel: wp.array2d(dtype=real)  # [env, set] no point of it moved farther, over the surface [m]
        set_step_travel: wp.array2d(dtype=real)  # [env, set] how much of that in the last step [m]
        set_margin: wp.array2d(dtype=real)  # [env, set] rounding of a position [m]
        set_safe_travel: wp.array2d(dtype=real)  # [env, set] travel up to which none of its points can touch [m]
        set_culled: wp.array2d(dtype=wp.int32)  # [env, set] whether it has not come so far
        cluster_safe_travel: wp.array2d(dtype=real)  # [env, block] likewise [m]
        cluster_probe_travel: wp.array2d(
            dtype=real
        )  # [env, block] travel up to which its middle tells nothing [m]; CPU
        cluster_inactive: wp.array2d(dtype=wp.int32)  # [env, block] 1: the last step had nothing to do with it
        safe_travel: wp.array2d(dtype=real)  # [env, contact] likewise [m]
        # On a GPU: what is still to be done, by kind, so that threads side by side do the same
        queue_count: wp.array(dtype=wp.int32)  # [kind] how many
        queue_clusters: wp.array(dtype=wp.int32)  # numbers of the blocks to probe, or in cells to search for
        queue_contacts: wp.array2d(dtype=wp.int32)  # [kind, …] and of those to look at
        # Nearest face of the list below; in queues, valid within ``valid_radius`` of ``valid_center``
        valid_radius: wp.array2d(dtype=real)  # [env, contact]
        valid_center: wp.array2d(dtype=vec3)  # [env, contact] S
        nearest: wp.array2d(dtype=wp.int32)  # [env, contact] its row
        tied_count: wp.array2d(
            dtype=wp.int32
        )  # [env, contact] how many of the first in the list it may be as well
        # On a CPU, and in cells: within ``room`` of ``clearance_center`` it does not touch; in units of the mesh
        clearance: wp.array2d(dtype=real)  # [env, contact]
        clearance_center: wp.array2d(dtype=vec3)  # [env, contact] S
        # Faces nearest to a point, from where it was when they were looked for; in units of the mesh
        list_center: wp.array2d(dtype=vec3)  # [env, contact] S
        # [env, contact] all other faces are farther from there; or, on a CPU, than one listed wherever in the skin
        uncached_bound: wp.array2d(dtype=real)
        # [env, contact] how many are remembered; in cells, where none are: 1 if the point was near the surface
        face_count: wp.array2d(dtype=wp.int32)
        face: wp.array2d(dtype=wp.int32)  # [env, contact × remembered] their rows, rivals first if any
        distance: wp.array2d(dtype=real)  # [env, contact × remembered] from there
        gradient: wp.array2d(dtype=vec3)  # [env, contact × remembered] its slope there, unit or zero, S

    @wp.struct
    class CouplingWrenches:
        """What couplings do to the bodies at their ends; of an end on the world it is what the world holds."""

        force: wp.array2d(dtype=vec3)  # [env, end] on what the end is fixed to, W [N]
        torque: wp.array2d(dtype=vec3)  # [env, end] about the centre of mass (world: the anchor), W [N·m]

    @wp.struct
    class Wrenches:
        force: wp.array2d(dtype=vec3)  # [env, body], W [N]
        torque: wp.array2d(dtype=vec3)  # [env, body] about the centre of mass, W [N·m]

    @wp.struct
    class NormalState:
        """What a law sees of one contact at one instant."""

        delta: real  # penetration δ > 0 [m]
        delta_dot: real  # dδ/dt, > 0 on approach [m/s]
        entry_speed: real  # δ̇ when the contact began, or the largest since [m/s]
        mass: real  # effective mass along the normal [kg]; only for laws with needs_mass
        inverse_mass: real  # one over it [1/kg], without a division
        # Relative principal curvatures, the smaller first; only for laws with needs_curvature
        curvature_1: real  # [1/m]
        curvature_2: real  # [1/m]
        dt: real  # step that the force acts over [s]; 0: the force of this instant

    @wp.struct
    class TangentialState:
        """What a friction model sees of one contact at one instant."""

        velocity: vec3  # of the point's body relative to the surface: sliding, rolling or spinning, W [m/s]
        speed: real  # its length [m/s]
        normal_force: real  # N ≥ 0 [N]
        patch_radius: real  # √(R δ), the radius of a sphere's patch of contact [m]; 0 for a point
        normal: vec3  # out of the surface, W
        axis: vec3  # tangent unit vector that the surface carries, W; only for directional friction models

    return SimpleNamespace(
        **vars(n),
        ContactGeometry=ContactGeometry,
        Cell=Cell,
        Model=Model,
        State=State,
        History=History,
        Contacts=Contacts,
        CouplingExtremes=CouplingExtremes,
        ActiveContacts=ActiveContacts,
        Cache=Cache,
        CouplingWrenches=CouplingWrenches,
        Wrenches=Wrenches,
        NormalState=NormalState,
        TangentialState=TangentialState,
    )
