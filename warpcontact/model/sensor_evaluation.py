"""Launches that evaluate a state: the quantities that sensors need, for all environments or a slice.

``evaluation_stages`` is used by ``Model`` and by ``Stepper`` for recorded frames.
"""

from collections.abc import Set
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import ExecutionPlan, force_stages
from warpcontact.kernels.outcomes import body_measures
from warpcontact.model.model_traits import ModelTraits

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts


def can_evaluate_by_slice(model: ModelTraits, device: wp.Device, nonsmooth: bool, needs: Set[str]) -> bool:
    """Returns whether ``evaluation_stages`` computes all ``needs`` on a CPU, so that slices can be evaluated.

    ``nonsmooth``: whether there are nonsmooth contacts. Their sensors are copied after an evaluation.
    """
    return device.is_cpu and model.are_by_slice(needs) and not (nonsmooth and model.needs_contacts(needs))


def provides_contacts(plan: ExecutionPlan, needs: Set[str]) -> bool:
    """Returns whether a step of ``plan`` can reuse the contacts of an evaluation for ``needs``."""
    model = plan.model
    return (
        plan.uses_cache
        and model.device.is_cpu
        and model.needs_contacts(needs)
        and not model.needs_all_distances(needs)
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
    cached = model.device.is_cpu and not model.needs_all_distances(needs)
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
    if plan.model.needs_contacts(needs):
        # On a GPU the sum of wrenches also empties the work queues. Some force elements add to the sum.
        others_add_wrenches = (
            plan.model.device.is_cuda or plan.model.elements_added_to_bodies or plan.nonsmooth is not None
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
            launches += plan.prepare(
                kernel(real),
                model.body_count,
                status=status,
                model=a.model,
                state=state,
                measured=getattr(a, name),
            )
    for element in model.force_elements:
        launches += element.sensor_launches(plan, needs, state, status)
    return launches
