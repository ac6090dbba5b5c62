"""What is launched to look at a state: what sensors need, of some environments apart from the others."""

from collections.abc import Iterable, Set
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import ExecutionPlan, force_stages
from warpcontact.kernels.joints.measures import coordinates
from warpcontact.kernels.outcomes import body_measures
from warpcontact.model.scene_traits import SHAPE_CONTACT_MEASURES

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts

#: Needs of sensors that tell of surfaces that are far away as well.
NEEDS_ALL_DISTANCES = ("distances", "points", "contact_couplings", *SHAPE_CONTACT_MEASURES)
#: Needs that can be computed of some environments apart from the others, and in every step.
SLICE_NEEDS = frozenset(
    ("contacts", "wrenches", "distances", *body_measures.BODY_MEASURES, "points", "coordinates")
)

#: What tells contacts and wrenches, of what is far away as well.
CONTACT_NEEDS = frozenset(("wrenches", "distances"))

#: All needs.
ALL_NEEDS = SLICE_NEEDS.union(NEEDS_ALL_DISTANCES, ("reactions", "particles"))


def check_needs(needs: Iterable[str]) -> frozenset[str]:
    """Returns ``needs``; raises ``ValueError`` if nothing tells how to compute one."""
    requested = frozenset(needs)
    if unknown := requested - ALL_NEEDS:
        raise ValueError(f"needs {sorted(unknown)} are not known, there are {sorted(ALL_NEEDS)}")
    return requested


def can_evaluate_by_slice(device: wp.Device, nonsmooth: "NonsmoothContacts | None", needs: Set[str]) -> bool:
    """Whether ``evaluation_stages`` computes all that sensors with ``needs`` are of, and nobody waits for a device."""
    return device.is_cpu and needs <= SLICE_NEEDS and not (nonsmooth is not None and needs_contacts(needs))


def needs_contacts(needs: Set[str]) -> bool:
    """Whether sensors with ``needs`` tell of contacts, of which hard ones have to be shown."""
    return not needs.isdisjoint(("contacts", "wrenches", *NEEDS_ALL_DISTANCES))


def provides_contacts(plan: ExecutionPlan, needs: Set[str]) -> bool:
    """Whether looks for sensors with ``needs`` leave contacts as a step of ``plan`` from there finds them."""
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
    """Returns ``count`` environments, or the slice ``own`` of them, to be looked at.

    Forces are told of what may touch alone, unless a sensor is of what is far away: all is looked at then, and
    what is far is searched for, to the last digit. On a GPU steps alone leave out what cannot touch.
    """
    cached = model.device.is_cpu and needs.isdisjoint(NEEDS_ALL_DISTANCES)
    return kind(model, count, cached, ordered_sum=True, nonsmooth=nonsmooth, slice=own)


def evaluation_stages(plan: ExecutionPlan, needs: Set[str], zero_step: Any, active_status: Any) -> list[wp.Launch]:
    """Returns the launches that compute what sensors need, of frozen environments too.

    Args:
        plan: The environments.
        needs: Those of the sensors.
        zero_step: A step of 0 for each environment.
        active_status: The status of an active one for each.
    """
    a = plan.model.arrays
    launches = []
    if needs_contacts(needs):
        # On a GPU what adds up empties queues as well, and to what piles and nonsmooth contacts add has to be there.
        others_add_wrenches = (
            plan.model.device.is_cuda or plan.model.particle_contact_sets or plan.nonsmooth is not None
        )
        by_cluster = not others_add_wrenches and "wrenches" not in needs
        launches += force_stages(plan, a.state, zero_step, active_status, by_cluster=by_cluster)
    return launches + sensor_stages(plan, needs, a.state, active_status)


def sensor_stages(plan: ExecutionPlan, needs: Set[str], state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that measure what sensors need of ``state``, whose contacts are computed.

    Args:
        plan: The environments.
        needs: Those of the sensors.
        state: Their state.
        status: Of the environments [env]; left out are those that are not active.
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
