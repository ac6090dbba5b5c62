"""Arrays of every model that steps write: state, history of contacts, contacts, wrenches and caches."""

from types import SimpleNamespace
from typing import Any

import warp as wp

from warpcontact.allocation import COUNT, SWITCH
from warpcontact.arrays import Layout, fixed, per_env
from warpcontact.blocks import Blocks
from warpcontact.kernels import types
from warpcontact.of_scene import MEASURES
from warpcontact.patches import Patches
from warpcontact.scene import Scene

#: Status of environments between steps; all others are those of a part of a step.
BETWEEN_STEPS = frozenset((types.ENV_ACTIVE, types.ENV_FROZEN, types.ENV_STOPPED))


def declare_arrays(
    scene: Scene, t: SimpleNamespace, layout: Layout, blocks: Blocks, patches: Patches, *, celled: bool
) -> SimpleNamespace:
    """Declares the arrays of a model; those that follow from the scene are empty structs.

    Args:
        scene: The scene.
        t: Structs of the precision.
        layout: Where to declare them.
        blocks: Clusters of contacts.
        patches: Meshes that contacts search.
        celled: Whether they are searched in grids, with no cached faces.
    """
    contacts = len(blocks.contact)
    body_count = sum(body.count for body in scene.bodies)
    ends = 2 * (len(scene.couplings) + sum(contact.count for contact in scene.shape_contacts))
    bodies, each, parts = per_env(body_count), per_env(contacts), per_env(blocks.count)
    records = contacts > 1  # a few of many contacts are near; of one contact neighbours are those of other envs
    arrays = SimpleNamespace(
        model=t.Model(),
        initial=t.State(),
        state=layout.struct("state", t.State, bodies),
        wrenches=layout.struct("state", t.Wrenches, bodies, transient=True),
        ends=layout.struct("couplings", t.Ends, per_env(ends), transient=True),
        history=layout.struct(
            "contacts",
            t.History,
            each,
            records=records,
            ranges={"armed": SWITCH, "face": (-1, patches.face_count - 1), "crossings": COUNT},
        ),
        contacts=layout.struct("contacts", t.Contacts, each, records=records, transient=True),
        near=layout.struct("contacts", t.Near, parts, transient=True, contact=each, news=each),
        cache=_cache(t, layout, blocks, records, None if celled else patches),
        celled=celled,
        faces_read=patches.faces_read(),
        **dict.fromkeys(("status", "time", "instant", "constrained", "active")),  # allocated with the model
        **dict.fromkeys(MEASURES),  # allocated by the first sensor that needs them
    )
    layout.array("state", arrays, "status", wp.int32, per_env(), ranges={"status": BETWEEN_STEPS})
    layout.array("state", arrays, "time", wp.float64, per_env())
    # Constants: a step of 0 s, and the status of active environments.
    layout.array("state", arrays, "instant", t.real, fixed(1, 1), transient=True)
    layout.array("state", arrays, "active", wp.int32, fixed(1), transient=True)
    return arrays


def _cache(t: SimpleNamespace, layout: Layout, made: Blocks, records: bool, searched: Patches | None) -> Any:
    blocks, contacts, queued = made.count, len(made.contact), layout.device.is_cuda
    shapes = {name: per_env(made.set_count) for name in t.Cache.vars if name.startswith("set_")}
    remembered = 0
    if searched is not None:
        remembered = types.REMEMBERED_IN_QUEUES if queued else searched.remembered()
    faces = per_env(contacts * remembered)
    room = per_env(0 if searched is not None and queued else contacts)
    return layout.struct(
        "cache",
        t.Cache,
        per_env(contacts),
        records=records,
        transient=True,
        ranges=None,
        **shapes,
        # What blocks look through lies by contact.
        wake=per_env(contacts),
        faces=per_env(contacts),
        **dict.fromkeys(("room", "room_place"), room),
        **dict.fromkeys(("block_wake", "block_probe", "block_quiet"), per_env(blocks)),
        waiting=fixed(types.QUEUES),
        waiting_block=(lambda envs: (envs * blocks,)) if queued else fixed(1),
        waiting_contact=(lambda envs: (types.QUEUES, envs * contacts)) if queued else fixed(types.QUEUES, 1),
        **dict.fromkeys(("face", "distance", "direction"), faces),
    )
