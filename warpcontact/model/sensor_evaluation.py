"""Launches that evaluate a state: the quantities that sensors need, for all environments or a slice.

``evaluation_stages`` is used by ``Model`` and by ``Stepper`` for recorded frames.
"""

from collections.abc import Iterable, Set
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import ExecutionPlan, force_stages
from warpcontact.kernels.joints.measures import coordinates
from warpcontact.kernels.outcomes import body_measures
from warpcontact.model.scene_traits import SHAPE_CONTACT_MEASURES

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts

#: Needs that require the evaluation of all contacts, also of those that are far.
NEEDS_ALL_DISTANCES = ("distances", "points", "contact_couplings", *SHAPE_CONTACT_MEASURES)
#: Needs that can be computed slice by slice and in every step.
SLICE_NEEDS = frozenset(
    ("contacts", "wrenches", "distances", *body_measures.BODY_MEASURES, "points", "coordinates")
)

#: Needs of contacts and wrenches, including contacts that are far.
CONTACT_NEEDS = frozenset(("wrenches", "distances"))

#: All needs.
ALL_NEEDS = SLICE_NEEDS.union(NEEDS_ALL_DISTANCES, ("reactions", "particles"))


def check_needs(needs: Iterable[str]) -> frozenset[str]:
    """Returns ``needs`` as a set; raises ``ValueError`` if one does not exist."""
    requested = frozenset(needs)
    if unknown := requested - ALL_NEEDS:
        raise ValueError(f"unknown needs {sorted(unknown)}; possible needs: {sorted(ALL_NEEDS)}")
    return requested


def can_evaluate_by_slice(device: wp.Device, nonsmooth: "NonsmoothContacts | None", needs: Set[str]) -> bool:
    """Returns whether ``evaluation_stages`` computes all ``needs`` on a CPU, so that slices can be evaluated."""
    return device.is_cpu and needs <= SLICE_NEEDS and not (nonsmooth is not None and needs_contacts(needs))


def needs_contacts(needs: Set[str]) -> bool:
    """Returns whether ``needs`` include contacts; outputs of nonsmooth contacts must then be copied, see ``show``."""
    return not needs.isdisjoint(("contacts", "wrenches", *NEEDS_ALL_DISTANCES))


def provides_contacts(plan: ExecutionPlan, needs: Set[str]) -> bool:
    """Returns whether a step of ``plan`` can reuse the contacts of an evaluation for ``needs``."""
    return (
        plan.uses_cache
        and plan.model.device.is_cpu
        and needs_contacts(needs)
        and needs.isdisjoint(NEEDS_ALL_DISTANCES)
    )


def evaluation_plan(
    kind: type[ExecutionPlan],
    model: Any,
    count: int,
    nonsmooth: "NonsmoothContacts | None",
    needs: Set[str],
    own: wp.array | None = None,
) -> ExecutionPlan:
    """Returns the execution plan for the evaluation of ``count`` environments, or the slice ``own`` of them.

    On a CPU it uses the distance cache, unless a need requires contacts that are far. All contacts are then evaluated
    exactly. On a GPU evaluations never use the cache.
    """
    cached = model.device.is_cpu and needs.isdisjoint(NEEDS_ALL_DISTANCES)
    return kind(model, count, cached, ordered_sum=True, nonsmooth=nonsmooth, slice=own)


def evaluation_stages(plan: ExecutionPlan, needs: Set[str], zero_step: Any, active_status: Any) -> list[wp.Launch]:
    """Returns the launches that compute ``needs`` for the current state, also of frozen environments.

    Args:
        plan: Execution plan of the environments.
        needs: Needs of the sensors.
        zero_step: Step length 0 for all environments [env, 0] [s].
        active_status: Active status for all environments [env].
    """
    a = plan.model.arrays
    launches = []
    if needs_contacts(needs):
        # On a GPU the sum of wrenches also empties the work queues. Particle and nonsmooth contacts add to the sum.
        others_add_wrenches = (
            plan.model.device.is_cuda or plan.model.particle_contact_sets or plan.nonsmooth is not None
        )
        by_cluster = not others_add_wrenches and "wrenches" not in needs
        launches += force_stages(plan, a.state, zero_step, active_status, by_cluster=by_cluster)
    return launches + sensor_stages(plan, needs, a.state, active_status)


def sensor_stages(plan: ExecutionPlan, needs: Set[str], state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that compute ``needs`` for ``state``, after its contacts were computed.

    Args:
        plan: Execution plan of the environments.
        needs: Needs of the sensors.
        state: State of the environments.
        status: Status of the environments [env]. Environments that are not active are skipped.
    """
    model = plan.model
    a, real = model.arrays, model.types.real
    launches = []
    for name, (_, kernel) in body_measures.BODY_MEASURES.items():
        if name in needs:
            launches += plan.prepare(kernel(real), model.body_count, [status, a.model, state, getattr(a, name)])
    if "points" in needs:
        inputs = [status, a.model, state, a.contacts, a.points]
        launches += plan.prepare(body_measures.points(real), model.contact_count, inputs)
    if "coordinates" in needs:
        inputs = [status, a.model, state, a.coordinates]
        launches += plan.prepare(coordinates(real), model.body_count, inputs)
    return launches
