"""Arrays of a model that steps write: state, contact history, contacts, wrenches and caches."""

from typing import Any

import warp as wp

from warpcontact.forces.ends import Ends
from warpcontact.geometry.contact_clusters import ContactClusters
from warpcontact.geometry.query_mesh import QueryMeshes
from warpcontact.kernels import types
from warpcontact.model.model_traits import splits_orientation
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.allocation_plan import AllocationPlan, fixed, per_env
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.state_storage import COUNT, SWITCH

#: Status values of environments between steps; all others occur within a step only.
BETWEEN_STEPS = frozenset((types.ENV_ACTIVE, types.ENV_FROZEN, types.ENV_STOPPED))


def declare_arrays(
    scene: SceneData,
    t: types.Structs,
    layout: AllocationPlan,
    clusters: ContactClusters,
    query_meshes: QueryMeshes,
    ends: Ends,
    *,
    uses_face_grid: bool,
) -> ModelArrays:
    """Declares the arrays of a model; structs of parameters are returned empty.

    Args:
        scene: The scene.
        t: Structs of the precision.
        layout: Allocation plan to which the arrays are added.
        clusters: Clusters of contacts.
        query_meshes: Query meshes of the contacts.
        ends: Ends of force elements; the elements are declared later.
        uses_face_grid: Whether queries use face grids; there is no face cache then.
    """
    contacts = len(clusters.contact)
    body_count = sum(body.count for body in scene.bodies)
    bodies, each, parts = per_env(body_count), per_env(contacts), per_env(clusters.count)
    remainders = per_env(body_count if splits_orientation(scene, t.real) else 0)
    # Interleave: only a few of many contacts are accessed. With one contact per environment, all are, in order.
    records = contacts > 1
    arrays = ModelArrays(
        model=t.Model(),
        initial=t.State(),
        state=layout.struct("state", t.State, bodies, body_orientation_remainder=remainders),
        wrenches=layout.struct("state", t.Wrenches, bodies, transient=True),
        # The number of ends is known after all force elements are declared.
        end_wrenches=layout.struct("couplings", t.EndWrenches, lambda envs: (envs, ends.count), transient=True),
        history=layout.struct(
            "contacts",
            t.History,
            each,
            records=records,
            ranges={"armed": SWITCH, "face": (-1, query_meshes.face_count - 1), "crossings": COUNT},
        ),
        contacts=layout.struct("contacts", t.Contacts, each, records=records, transient=True),
        active_contacts=layout.struct(
            "contacts", t.ActiveContacts, parts, transient=True, contact=each, needs_history=each
        ),
        cache=_cache(t, layout, clusters, records, None if uses_face_grid else query_meshes),
        uses_face_grid=uses_face_grid,
        faces_read=query_meshes.faces_read(),
    )
    layout.array("state", arrays, "status", wp.int32, per_env(), ranges={"status": BETWEEN_STEPS})
    layout.array("state", arrays, "time", wp.float64, per_env())
    # Constants: a step of 0 s, and the status of active environments.
    layout.array("state", arrays, "zero_step", t.real, fixed(1, 1), transient=True)
    layout.array("state", arrays, "active_status", wp.int32, fixed(1), transient=True)
    return arrays


def _cache(
    t: types.Structs,
    layout: AllocationPlan,
    made: ContactClusters,
    records: bool,
    query_mesh_set: QueryMeshes | None,
) -> Any:
    clusters, contacts, queued = made.count, len(made.contact), layout.device.is_cuda
    shapes = {name: per_env(made.set_count) for name in t.Cache.vars if name.startswith("set_")}
    cached_faces = 0
    if query_mesh_set is not None:
        cached_faces = types.CACHED_FACES_GPU if queued else query_mesh_set.cached_face_count()
    faces = per_env(contacts * cached_faces)
    room = per_env(0 if query_mesh_set is not None and queued else contacts)
    return layout.struct(
        "cache",
        t.Cache,
        per_env(contacts),
        records=records,
        transient=True,
        ranges=None,
        **shapes,
        # Read for all contacts of a cluster, so not interleaved with the rest.
        safe_travel=per_env(contacts),
        face_count=per_env(contacts),
        **dict.fromkeys(("clearance", "clearance_center"), room),
        **dict.fromkeys(("cluster_safe_travel", "cluster_probe_travel", "cluster_inactive"), per_env(clusters)),
        queue_count=fixed(types.QUEUE_COUNT),
        queue_clusters=(lambda envs: (envs * clusters,)) if queued else fixed(1),
        queue_contacts=(lambda envs: (types.QUEUE_COUNT, envs * contacts))
        if queued
        else fixed(types.QUEUE_COUNT, 1),
        **dict.fromkeys(("face", "distance", "gradient"), faces),
    )
