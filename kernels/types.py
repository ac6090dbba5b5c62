"""Structs of the kernels: every device array with its unit, frame and shape.

``structs(real)`` returns them for one precision. Arrays are indexed ``[env, item]``. An array that all
environments share has stride 0 along ``env``, so kernels need no distinction. Frames: W world, B body (origin at
its center of mass), S surface (axes of the mesh, origin at the center of the surface). Velocities and wrenches are
in world axes, at the center of mass. Quaternions are (x, y, z, w).
"""

import functools
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import warp as wp
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.warps import lane_count

#: Type of a Warp struct, the result of ``wp.struct``, for which Warp has no public name.
Struct: TypeAlias = Any

#: Body index of the world.
WORLD = -1

# Status of an environment. Kernels read it first and skip environments that are not ENV_ACTIVE.
ENV_ACTIVE = 0
ENV_FAILED = 1  # became non-finite in this step; its other bodies may be partly updated
ENV_FROZEN = 2  # keeps its last finite state
ENV_SUBSTEP = 3  # a point crossed a surface in this step; the step is repeated in substeps
ENV_PAUSED = 4  # finished this step; paused while other environments repeat it
ENV_HALTED = 5  # a stop condition holds in the state before this step
ENV_STOPPED = 6  # stopped at that state
ENV_SLEEPING = 7  # this step would not change the state and is skipped

# Cause of freezing of an environment.
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
UNSOLVED = 6  # shape contact only: no root was found, and no force acts

# Mode of a nonsmooth contact.
MODE_OPEN = 0
MODE_STICK = 1
MODE_SLIP = 2

# Option bits of a contact.
LATCHED = 1  # entry="latched"
BOUNDARY_OUTER = 2  # boundary="outer"
HERTZ_TORSION = 4  # the torsion arm follows from the overlap
SWEPT = 8  # crossings of the surface within a step are detected
FORCE_AT_POINT = 16  # the force acts at the point itself, as in a contact coupling
IGNORES_BOUNDARY = 32  # minima="all": places outside a boundary have no force, but other minima next to them do

# Status of a spring-damper or bushing.
COUPLING_ACTIVE = 0
COUPLING_SLACK = 1  # tension_only and not stretched
COUPLING_BROKEN = 2
COUPLING_OUTSIDE = 3  # outside the range of its table; the end value of the table is used
COUPLING_NO_DIRECTION = 4  # the ends coincide and have no previous direction
COUPLING_DISABLED = 5

# Status of a catenary.
LINE_HANGING = 0  # longer than the distance of its ends
LINE_TAUT = 1  # shorter than the distance of its ends: stretched
LINE_FOLDED = 2  # one end above the other; hangs from both
LINE_GROUNDED = 3  # partly on the floor
LINE_SUNK = 4  # an end is below the floor and is treated as on it
LINE_LOOSE = 5  # without weight and not stretched
LINE_DISABLED = 6
LINE_FAILED = 7  # not converged; the forces are those of the last iterate

# Status of the solution of two shapes.
MET = 0
NOT_CONVERGED = 1  # the last iterate is not stationary to the tolerance
OUTSIDE = 2  # beyond the boundary of a parametric surface: no contact


# Column of a face's features: the face, its edges (0-1, 1-2, 2-0), its vertices.
FEATURE_COUNT = 7
# Bits of a feature.
FEATURE_ACTIVE = 1
FEATURE_BOUNDARY = 2

# Region in which the side of a point is known as long as the point does not pass through the surface.
SIDE_KNOWN_NOWHERE = 0
SIDE_KNOWN_EVERYWHERE = 1
SIDE_KNOWN_INSIDE_WALLS = 2  # within the walls of the query mesh

# Number of cached faces per contact on a GPU, where each thread has few registers. Longer lists are valid longer,
# but sorting faces into them costs more than that saves.
CACHED_FACES_GPU = 8

# Number of work queues on a GPU.
QUEUE_COUNT = 4

# Joint of a body.
FREE = 0
FIXED = 1
TRANSLATION = 2
PLANAR = 3
HINGE = 4
SLIDER = 5
BALL = 6
PRESCRIBED = 7  # by the velocities in the state
TIME_FUNCTION = 8  # by a function of time

# Effect of the geometry on the latch of entry="latched".
LATCH_KEEP = 0
LATCH_ARM = 1
LATCH_DISARM = 2


@wp.struct
class LaunchRange:
    """Range of environments and items of a launch; a task is one item of one environment.

    On a GPU each thread has one task. On a CPU one thread has all tasks, so that the arguments are read only once.
    CPU launches that are repeated for several slices read the range of environments from ``slice``.
    """

    envs: wp.int32  # number of environments
    items: wp.int32  # items per environment
    threads: wp.int32
    slice: wp.array(dtype=wp.int32)  # first env, number of envs, steps; empty: unused


@wp.func
def first_env(launch: LaunchRange):
    """Returns the first environment of a launch."""
    if launch.slice.shape[0] > 0:
        return launch.slice[0]
    return 0


@wp.func
def task_count(launch: LaunchRange):
    """Returns the number of tasks of a launch."""
    if launch.slice.shape[0] > 0:
        return launch.slice[1] * launch.items
    return launch.envs * launch.items


@wp.func
def step_count(launch: LaunchRange):
    """Returns the number of steps per environment of a multi-step launch."""
    return launch.slice[2]


@wp.func
def task_env(launch: LaunchRange, task: int):
    """Returns the environment of a task."""
    return assume_nonnegative(first_env(launch) + assume_nonnegative(task) // assume_nonnegative(launch.items))


@wp.func
def task_item(launch: LaunchRange, task: int):
    """Returns the item of a task within its environment."""
    return assume_nonnegative(assume_nonnegative(task) % assume_nonnegative(launch.items))


@wp.func
def task_of_item(launch: LaunchRange, task: int):
    """Returns the environment and the item of a task, for items that differ more from each other than environments do.

    On a GPU the lanes of a warp have the same item of consecutive environments, so that they diverge less. On a CPU it is
    the order of ``task_env``.
    """
    if lane_count() > 1:
        envs = task_count(launch) // launch.items
        return first_env(launch) + task % envs, task // envs
    return task_env(launch, task), task_item(launch, task)


@wp.struct
class BodyMotion:
    """Joint of a body, in float64 for any precision, so that the poses computed from it do not drift."""

    kind: wp.int32  # FREE, FIXED, …
    axis: wp.vec3d  # unit, W: axis of a hinge or slider, normal of a plane
    anchor: wp.vec3d  # fixed point of a hinge, a ball or a rotation given as a function of time, W [m]
    position: wp.vec3d  # initial center of mass, W [m]
    orientation: wp.quatd  # initial, B → W


class Numbers(NamedTuple):
    """Number types of one precision."""

    real: type  # ``wp.float32`` or ``wp.float64``
    vec3: type  # vector
    quat: type  # quaternion (x, y, z, w)
    mat33: type  # matrix
    epsilon: float  # distance from 1 to the next larger number


@functools.cache
def numbers(real: type) -> Numbers:
    """Returns the vector, quaternion and matrix types of ``real`` (float32 or float64), and epsilon."""
    vec3, quat, mat33 = {
        wp.float32: (wp.vec3f, wp.quatf, wp.mat33f),
        wp.float64: (wp.vec3d, wp.quatd, wp.mat33d),
    }[real]
    epsilon = float(np.finfo(wp.dtype_to_numpy(real)).eps)
    return Numbers(real=real, vec3=vec3, quat=quat, mat33=mat33, epsilon=epsilon)


class Structs(NamedTuple):
    """Number types and structs of one precision."""

    real: type  # ``wp.float32`` or ``wp.float64``
    vec3: type  # vector
    quat: type  # quaternion (x, y, z, w)
    mat33: type  # matrix
    epsilon: float  # distance from 1 to the next larger number
    ContactGeometry: Struct  # geometric parameters of a contact
    Cell: Struct  # cell of a face grid
    Model: Struct  # bodies, points, surfaces, contacts and coupling ends
    State: Struct  # state of bodies
    History: Struct  # history of contacts
    Contacts: Struct  # gap, normal, contact point and forces of contacts
    CouplingExtremes: Struct  # closest approach of contact couplings
    ActiveContacts: Struct  # contacts that later stages process, and wrenches of clusters
    Cache: Struct  # distances cached from earlier steps
    EndWrenches: Struct  # wrenches at the ends of couplings and shape contacts
    Wrenches: Struct  # wrenches on bodies
    NormalState: Struct  # arguments of a normal law
    TangentialState: Struct  # arguments of a friction model


@functools.cache
def structs(real: type) -> Structs:
    """Returns the structs for ``real`` (``wp.float32`` or ``wp.float64``) and the types of ``numbers``."""
    n = numbers(real)
    vec3, quat, mat33 = n.vec3, n.quat, n.mat33

    @wp.struct
    class ContactGeometry:
        radius: real  # radius of the sphere about the point [m]; 0: a point
        kappa: real  # contact point K = S + kappa (D − S) [-]
        max_depth: real  # largest penetration that counts as contact [m]
        search_radius: real  # largest distance at which the surface is searched for [m]
        torsion_radius: real  # arm of torsional friction [m]; unused with HERTZ_TORSION
        force_scale: real  # factor on forces and torques [-]
        contact_tolerance: (
            real  # gap below which the contact is closed [m]: 0, or the tolerance of nonsmooth contact
        )
        enabled: wp.int32  # 0 or 1

    @wp.struct
    class Cell:
        clearance: real  # lower bound on the distance of its points, if on the outer side [mesh unit]; <= 0: none
        faces: wp.int32  # packed list of the faces that may be nearest (``face_grid.py``); −1: none

    @wp.struct
    class Model:
        gravity: wp.array2d(dtype=vec3)  # [env, 0], W [m/s²]
        # Bodies [env, body]
        body_mass: wp.array2d(dtype=real)  # [kg]
        body_inertia: wp.array2d(dtype=mat33)  # B, about the center of mass [kg·m²]
        body_inverse_inertia: wp.array2d(dtype=mat33)  # B [1/(kg·m²)]
        body_isotropic_inertia: wp.array2d(dtype=wp.bool)  # whether the inertia is the same about all axes
        body_external_force: wp.array2d(dtype=vec3)  # [env, body] at the center of mass, W [N]
        body_external_torque: wp.array2d(dtype=vec3)  # [env, body] W [N·m]
        body_motion: wp.array2d(dtype=BodyMotion)  # empty if all bodies are free
        # Points
        point_body: wp.array(dtype=wp.int32)  # [point] body or WORLD
        point_position: wp.array2d(dtype=vec3)  # [env, point], B (or W, from its anchor) [m]
        point_anchor: wp.array2d(dtype=vec3)  # [env, point], W; world points only, one per set [m]
        point_normal: wp.array2d(dtype=vec3)  # [env, point] unit, B (or W); only for area weights
        # Surfaces
        surface_body: wp.array(dtype=wp.int32)  # [surface] body or WORLD
        surface_position: wp.array2d(dtype=vec3)  # [env, surface] origin of S in B (or W, from its anchor) [m]
        surface_anchor: wp.array2d(dtype=vec3)  # [env, surface], W; surfaces of the world only [m]
        surface_orientation: wp.array2d(dtype=quat)  # [env, surface] S → B (or W)
        surface_scale: wp.array2d(dtype=real)  # [env, surface] m per unit of the mesh
        surface_mesh: wp.array2d(dtype=wp.int32)  # [env, surface] index of the selected mesh of the surface
        # Query meshes: a whole surface or its active part, in mesh units, relative to the center of the surface.
        # Those of one surface are consecutive.
        query_mesh_id: wp.array(dtype=wp.uint64)  # [query mesh] id of the wp.Mesh
        query_mesh_surface: wp.array(dtype=wp.int32)  # [query mesh]
        query_mesh_face_start: wp.array(dtype=wp.int32)  # [query mesh + 1] first row in the face tables below
        query_mesh_error: wp.array(dtype=real)  # [query mesh] bound on the error of a float32 query [mesh unit]
        query_mesh_thin_length: wp.array(
            dtype=real
        )  # [query mesh] longest edge of faces thinner than rounding; 0: none
        query_mesh_skin: wp.array(dtype=real)  # [query mesh] faces are cached if not farther beyond the nearest
        query_mesh_side_region: wp.array(dtype=wp.int32)  # [query mesh] SIDE_KNOWN_*: where a point keeps its side
        query_mesh_wall_start: wp.array(dtype=wp.int32)  # [query mesh + 1] first row of its walls
        wall_normal: wp.array(dtype=vec3)  # [wall] unit, S, into the region of SIDE_KNOWN_INSIDE_WALLS
        wall_offset: wp.array(dtype=real)  # [wall] offset of its plane along the normal
        # Face grid of a query mesh: ``face_grid.py``
        query_mesh_grid: wp.array(dtype=wp.vec4i)  # [query mesh] cells along x, y and z, first cell; −1: no grid
        query_mesh_grid_origin: wp.array(dtype=vec3)  # [query mesh] origin (lowest x, y and z) of the grid, S
        query_mesh_cell_size: wp.array(dtype=real)  # [query mesh] edge length of a cell [mesh unit]
        query_mesh_grid_margin: wp.array(dtype=real)  # [query mesh] least distance of grid boundary and mesh
        cells: wp.array(dtype=Cell)  # [cell]
        cell_face: wp.array(dtype=wp.int32)  # face rows of the lists of cells
        # BVH over the faces of a query mesh, CPU only: ``bvh_search.py``
        query_mesh_bvh: wp.array(
            dtype=wp.vec4i
        )  # [query mesh] first node, number of nodes, children of the root, first face
        bvh_bound: wp.array(dtype=wp.float32)  # bounds of each node's children: ``geometry/bvh.py``
        bvh_face: wp.array(dtype=wp.int32)  # faces in leaf order, relative to the first of the query mesh
        face_corner: wp.array2d(dtype=vec3)  # [face, 0 to 2] vertices, [face, 3] unit normal; S
        face_frame: wp.array2d(
            dtype=vec3
        )  # [face, 0 and 1] unit vectors along the first edge and across it; [face, 2] length of that edge and
        # the third vertex in these axes; [face, 3] inverse squared lengths of edges 0-1, 1-2, 2-0; only with a
        # face grid
        face_normal: wp.array2d(dtype=vec3)  # [face, feature] unit pseudonormal, S
        face_flags: wp.array2d(dtype=wp.uint8)  # [face, feature] FEATURE_* bits
        face_neighbor: wp.array2d(dtype=wp.int32)  # [face, edge] 3 × row + edge of the neighbor; −1: none
        # Contacts
        contact_point: wp.array(dtype=wp.int32)  # [contact] index of the point
        contact_query_mesh: wp.array(dtype=wp.int32)  # [contact] first query mesh of the surface
        contact_options: wp.array(dtype=wp.int32)  # [contact] option bits
        contact_set: wp.array(dtype=wp.int32)  # [contact]
        contact_geometry: wp.array2d(dtype=ContactGeometry)  # [env, contact]
        # Sets: contacts of one point set with one surface. Clusters: groups of neighboring contacts of a set
        set_contact: wp.array(dtype=wp.int32)  # [set] first contact
        set_center: wp.array2d(dtype=vec3)  # [env, set] center of its points, in their frame [m]
        set_extent: wp.array2d(dtype=real)  # [env, set] largest distance of a point from the center [m]
        set_cluster_start: wp.array(dtype=wp.int32)  # [set + 1] first cluster
        cluster_set: wp.array(dtype=wp.int32)  # [cluster]
        cluster_start: wp.array(dtype=wp.int32)  # [cluster + 1] first contact in ``cluster_contact``
        cluster_contact: wp.array(dtype=wp.int32)  # contacts by cluster
        cluster_center: wp.array2d(dtype=vec3)  # [env, cluster] center of its points, in their frame [m]
        body_cluster_start: wp.array(dtype=wp.int32)  # [body + 1] first cluster in ``body_cluster``
        body_cluster: wp.array(dtype=wp.int32)  # 2 × cluster + 0 as the points' body, 1 as the surface's
        # Ends of couplings: 2 × coupling, 2 × coupling + 1
        end_point: wp.array(dtype=wp.int32)  # [end] index of its point
        body_end_start: wp.array(dtype=wp.int32)  # [body + 1] first end in ``body_end``
        body_end: wp.array(dtype=wp.int32)  # ends by body

    @wp.struct
    class State:
        body_position: wp.array2d(dtype=vec3)  # [env, body] center of mass, W [m]
        body_position_remainder: wp.array2d(dtype=vec3)  # [env, body] rounding remainder, to be added [m]
        body_orientation: wp.array2d(dtype=quat)  # [env, body] B → W
        body_orientation_remainder: wp.array2d(dtype=quat)  # [env, body] rounding remainder, to be added; or empty
        body_linear_velocity: wp.array2d(dtype=vec3)  # [env, body] of the center of mass, W [m/s]
        body_angular_velocity: wp.array2d(dtype=vec3)  # [env, body], W [rad/s]

    @wp.struct
    class History:
        """History of the contacts; advances once per accepted step, in ``history.py`` or ``fused_step.py``.

        History variables of laws and friction models are declared by their classes: ``history_variables.py``.
        """

        entry_speed: wp.array2d(dtype=real)  # [env, contact] approach speed at entry [m/s]; < 0: no contact
        armed: wp.array2d(dtype=wp.int32)  # [env, contact] latch of entry="latched"
        face: wp.array2d(dtype=wp.int32)  # [env, contact] row of the tracked face; −1: none
        crossings: wp.array2d(dtype=wp.int32)  # [env, contact] number of crossings of the surface within a step
        crossing_time: wp.array2d(dtype=real)  # [env, contact] time of the first crossing [s]; NaN: none

    @wp.struct
    class Contacts:
        gap: wp.array2d(dtype=real)  # [env, contact] signed distance, < 0 also at WRONG_SIDE [m]
        penetration: wp.array2d(dtype=real)  # [env, contact] 0 unless status is CONTACT [m]
        normal: wp.array2d(dtype=vec3)  # [env, contact] out of the surface, W
        arm: wp.array2d(
            dtype=vec3
        )  # [env, contact] from the origin of the points to K, where the force acts, W [m]
        face: wp.array2d(dtype=wp.int32)  # [env, contact] row of the face; −1: none
        status: wp.array2d(dtype=wp.int32)  # [env, contact] OPEN, CONTACT, …
        armed: wp.array2d(dtype=wp.int32)  # [env, contact] latch that follows from this geometry
        crossed_face: wp.array2d(dtype=wp.int32)  # [env, contact] row of the face crossed in this step; −1: none
        crossing_fraction: wp.array2d(dtype=real)  # [env, contact] time of the crossing / dt, 0 to 1
        approach_speed: wp.array2d(dtype=real)  # [env, contact] dδ/dt at K, 0 unless CONTACT [m/s]
        normal_force: wp.array2d(dtype=real)  # [env, contact] 0 unless CONTACT [N]
        friction_force: wp.array2d(dtype=vec3)  # [env, contact] on the point's body, 0 unless CONTACT, W [N]
        slip_speed: wp.array2d(dtype=real)  # [env, contact] tangential, at K, 0 unless CONTACT [m/s]
        torque: wp.array2d(dtype=vec3)  # [env, contact] rolling and torsion, on the point's body, W [N·m]

    @wp.struct
    class CouplingExtremes:
        """Closest approach of contact couplings; advances once per accepted step, in ``contact_coupling.py``."""

        effective_area: wp.array2d(dtype=real)  # [env, coupling] largest area in range up to now [m²]
        minimum_distance: wp.array2d(dtype=real)  # [env, coupling] smallest in range up to now [m]; NaN: none

    @wp.struct
    class ActiveContacts:
        """Contacts that later stages of a step process, and the wrench of each cluster on its two bodies."""

        needs_history: wp.array2d(
            dtype=wp.int32
        )  # [env, contact] 1: in contact, or the end of contact is not yet in the history
        contact: wp.array2d(dtype=wp.int32)  # [env, index] contacts by cluster, from cluster_start on
        count: wp.array2d(dtype=wp.int32)  # [env, cluster] number of listed contacts
        crossed_count: wp.array2d(dtype=wp.int32)  # [env, cluster] others that crossed their surface in this step
        force: wp.array2d(dtype=vec3)  # [env, cluster] on the points' body, W [N]
        torque_1: wp.array2d(dtype=vec3)  # [env, cluster] on the points' body, about its center of mass, W [N·m]
        torque_2: wp.array2d(dtype=vec3)  # [env, cluster] on the surface's body, about its center of mass, W [N·m]

    @wp.struct
    class Cache:
        """Distances cached from earlier steps. The cache saves work and does not change results.

        A distance changes by at most the displacement of the point. Zeros: nothing is cached.
        """

        set_position: wp.array2d(dtype=vec3)  # [env, set] last position of its center, S [m]
        set_orientation: wp.array2d(dtype=quat)  # [env, set] last orientation B → S, if the set has an extent
        set_travel: wp.array2d(dtype=real)  # [env, set] accumulated motion bound of its points [m]
        set_step_travel: wp.array2d(dtype=real)  # [env, set] part of it due to the last step [m]
        set_margin: wp.array2d(dtype=real)  # [env, set] rounding of a position [m]
        set_safe_travel: wp.array2d(dtype=real)  # [env, set] no contact of its points below this travel [m]
        set_culled: wp.array2d(dtype=wp.int32)  # [env, set] 1: travel is below ``set_safe_travel``
        cluster_safe_travel: wp.array2d(dtype=real)  # [env, cluster] likewise [m]
        cluster_probe_travel: wp.array2d(
            dtype=real
        )  # [env, cluster] travel below which its center is not probed [m]; CPU
        cluster_inactive: wp.array2d(dtype=wp.int32)  # [env, cluster] 1: no active contact in the last step
        safe_travel: wp.array2d(dtype=real)  # [env, contact] likewise [m]
        # Work queues on a GPU, one per kind of work, so that neighboring threads do the same
        queue_count: wp.array(dtype=wp.int32)  # [queue] number of entries
        queue_clusters: wp.array(dtype=wp.int32)  # clusters to probe, or with a face grid to search for
        queue_contacts: wp.array2d(dtype=wp.int32)  # [queue, …] contacts to evaluate
        # Nearest face of the list below; with queues, valid within ``valid_radius`` of ``valid_center``
        valid_radius: wp.array2d(dtype=real)  # [env, contact]
        valid_center: wp.array2d(dtype=vec3)  # [env, contact] S
        nearest: wp.array2d(dtype=wp.int32)  # [env, contact] row of the nearest face
        tied_count: wp.array2d(
            dtype=wp.int32
        )  # [env, contact] number of first list entries that may also be nearest
        # CPU and face grid: no contact within ``clearance`` of ``clearance_center``; in mesh units
        clearance: wp.array2d(dtype=real)  # [env, contact]
        clearance_center: wp.array2d(dtype=vec3)  # [env, contact] S
        # Cached faces near ``list_center``, the position of the point when they were searched; in mesh units
        list_center: wp.array2d(dtype=vec3)  # [env, contact] S
        # [env, contact] lower bound on the distance of other faces from there; on a CPU without dominated faces
        uncached_bound: wp.array2d(dtype=real)
        # [env, contact] number of cached faces; with a face grid, which caches none, 1: point near the surface
        face_count: wp.array2d(dtype=wp.int32)
        face: wp.array2d(
            dtype=wp.int32
        )  # [env, contact × capacity] rows; on a GPU the ``tied_count`` candidates first
        distance: wp.array2d(
            dtype=real
        )  # [env, contact × capacity] lower bound on the distance from ``list_center``
        gradient: wp.array2d(dtype=vec3)  # [env, contact × capacity] gradient of that distance, unit or zero, S

    @wp.struct
    class EndWrenches:
        """Wrenches of couplings and shape contacts on the bodies at their ends; for an end on the world, on the world."""

        force: wp.array2d(dtype=vec3)  # [env, end] on the body of the end, W [N]
        torque: wp.array2d(dtype=vec3)  # [env, end] about the center of mass (world: the anchor), W [N·m]

    @wp.struct
    class Wrenches:
        force: wp.array2d(dtype=vec3)  # [env, body], W [N]
        torque: wp.array2d(dtype=vec3)  # [env, body] about the center of mass, W [N·m]

    @wp.struct
    class NormalState:
        """Arguments of a normal law: one contact at one instant."""

        delta: real  # penetration δ > 0 [m]
        delta_dot: real  # dδ/dt, > 0 on approach [m/s]
        entry_speed: real  # approach speed at first touch, or the largest since [m/s]
        mass: real  # effective mass along the normal [kg]; only for laws with needs_mass
        inverse_mass: real  # inverse of ``mass`` [1/kg]
        # Relative principal curvatures, the smaller first; only for laws with needs_curvature
        curvature_1: real  # [1/m]
        curvature_2: real  # [1/m]
        dt: real  # step over which the force acts [s]; 0: force at this instant

    @wp.struct
    class TangentialState:
        """Arguments of a friction model: one contact at one instant."""

        velocity: vec3  # of the point's body relative to the surface: sliding, rolling or torsional, W [m/s]
        speed: real  # magnitude of ``velocity``
        normal_force: real  # N ≥ 0 [N]
        patch_radius: real  # √(R δ), contact radius of a sphere [m]; 0 for a point
        normal: vec3  # out of the surface, W
        axis: vec3  # unit tangent fixed to the surface, W; only for directional friction models

    return Structs(
        *n,
        ContactGeometry=ContactGeometry,
        Cell=Cell,
        Model=Model,
        State=State,
        History=History,
        Contacts=Contacts,
        CouplingExtremes=CouplingExtremes,
        ActiveContacts=ActiveContacts,
        Cache=Cache,
        EndWrenches=EndWrenches,
        Wrenches=Wrenches,
        NormalState=NormalState,
        TangentialState=TangentialState,
    )
