"""Chooses how the stages of a step are composed into kernels: the launch shape.

``SHAPES`` lists the launch shapes, the fastest first, each with the obstacles that exclude it. ``choose_shape``
returns the first one without an obstacle, with the obstacle that excluded each faster one. The stages are the same
device functions in all launch shapes, so results are bitwise identical on one device. ``ExecutionPlan.shape`` is the
launch shape of a plan, and the functions ``*_stages`` of ``execution_plan`` build its launches.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from warpcontact.kernels.lowlevel.unique_kernel import QUICK

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan

#: Names of the launch shapes.
WARP_PER_ENVIRONMENT, LOOP_PER_ENVIRONMENT = "warp per environment", "loop per environment"
FUSED_CONTACT, STAGED = "fused contact", "staged"
#: Choice of the fastest possible launch shape.
AUTO = "auto"

#: Whether stages are fused into one kernel if results stay bitwise identical. Separate kernels compile faster.
FUSE_STAGES = not QUICK
#: Maximum number of contacts, or threads, of a launch that counts as small.
SMALL_LAUNCH = 131072
#: Maximum number of clusters per body whose wrenches the integrator sums on a GPU.
MAX_SUMMED_CLUSTERS = 16


@dataclass(frozen=True)
class LaunchShape:
    """How the stages of a step are composed into kernels.

    Attributes:
        name: Name in ``SHAPES``.
        small: Whether there are so few contacts that launch overhead outweighs thread divergence. A GPU then uses
            fewer launches.
        detection: Kernels of broad and narrow phase, if these are launches of their own: one thread per cluster of
            contacts (``"clusters"``), a face grid (``"grid"``) or work queues of a GPU (``"queues"``).
        integrator_sums: Whether the integration kernel sums the cluster and particle wrenches of a body.
        integrator_accepts: Whether the integration kernel also accepts the step.
        rejected: Faster launch shapes, each with the reason for which it was rejected.
    """

    name: str
    small: bool
    detection: str
    integrator_sums: bool
    integrator_accepts: bool
    rejected: dict[str, str]

    @property
    def summary(self) -> str:
        """The kernels of a step."""
        return SHAPES[self.name].summary

    @property
    def fuses_contact(self) -> bool:
        """Whether detection and contact force are one kernel, which does not write the sensors of contacts."""
        return self.name in (LOOP_PER_ENVIRONMENT, FUSED_CONTACT)


def choose_shape(plan: "ExecutionPlan") -> LaunchShape:
    """Returns the fastest launch shape that is possible for ``plan`` and not faster than ``plan.fastest_shape``."""
    rejected: dict[str, str] = {}
    allowed = plan.fastest_shape == AUTO
    for name, row in SHAPES.items():
        allowed = allowed or name == plan.fastest_shape
        obstacles = row.obstacles if allowed else (_not_selected,)
        reason = next((text for obstacle in obstacles if (text := obstacle(plan))), "")
        if not reason:
            break
        rejected[name] = reason
    return LaunchShape(
        name, _is_small(plan), _detection(plan), _integrator_sums(plan), _integrator_accepts(plan), rejected
    )


def _is_small(plan: "ExecutionPlan") -> bool:
    return plan.count * plan.model.contact_count <= SMALL_LAUNCH


def _detection(plan: "ExecutionPlan") -> str:
    """Returns which kernels detect contacts, see ``LaunchShape.detection``."""
    if not plan.uses_cache:
        return "clusters"
    # In work queues, threads of a warp share contacts of many clusters, if there are enough of them.
    queues_are_faster = plan.one_thread_per_contact and not _is_small(plan) and plan.model.clusters.width > 1
    if plan.model.arrays.uses_face_grid and not queues_are_faster:
        return "grid"
    return "queues" if plan.one_thread_per_contact else "clusters"


def _integrator_sums(plan: "ExecutionPlan") -> bool:
    model = plan.model
    few_clusters = model.device.is_cpu or model.clusters.max_per_body <= MAX_SUMMED_CLUSTERS
    adding = model.elements_added_to_bodies
    return few_clusters and (not adding or (len(adding) == 1 and adding[0].sums_by_body))


def _integrator_accepts(plan: "ExecutionPlan") -> bool:
    """Returns whether environments have one free body and few contacts, and no stage must precede acceptance."""
    model = plan.model
    # With many environments on a GPU, two launches with fewer registers each are faster.
    few_clusters = model.device.is_cpu or (model.clusters.count == 1 and _is_small(plan))
    obstacles = (_fusion_is_off, _other_integrator, _outputs_are_read, _several_bodies, _joints, _tracks_faces)
    return (
        few_clusters
        and model.clusters.count > 0
        and _integrator_sums(plan)
        and not any(obstacle(plan) for obstacle in obstacles)
    )


# An obstacle of a launch shape returns the reason for which it excludes the launch shape for a plan. Empty text: it
# does not.
Obstacle = Callable[["ExecutionPlan"], str]


class ShapeRow(NamedTuple):
    """A row of ``SHAPES``.

    Attributes:
        summary: The kernels of a step.
        obstacles: What excludes the launch shape. The first obstacle that applies is reported.
    """

    summary: str
    obstacles: tuple[Obstacle, ...]


def _not_selected(plan: "ExecutionPlan") -> str:
    return f'launch_shape is "{plan.fastest_shape}"'


def _fusion_is_off(plan: "ExecutionPlan") -> str:
    return "" if FUSE_STAGES else "WARPCONTACT_COMPILE=quick selects staged kernels"


def _for_gpus(plan: "ExecutionPlan") -> str:
    return "" if plan.one_thread_per_contact else "it is for GPUs"


def _for_cpus(plan: "ExecutionPlan") -> str:
    return "it is for CPUs" if plan.one_thread_per_contact else ""


def _no_cache(plan: "ExecutionPlan") -> str:
    return "" if plan.uses_cache else "distance_cache is off, or a monitor reads all distances"


def _outputs_are_read(plan: "ExecutionPlan") -> str:
    return "outcomes, events, stop conditions or frames read the contacts" if plan.write_outputs else ""


def _nonsmooth(plan: "ExecutionPlan") -> str:
    return "" if plan.nonsmooth is None else "contacts are nonsmooth"


def _other_integrator(plan: "ExecutionPlan") -> str:
    return "" if plan.semi_implicit_euler else "the integrator is not SemiImplicitEuler itself"


def _detected_before(plan: "ExecutionPlan") -> str:
    return "" if plan.evaluated_state is None else "the contacts of a frame are reused"


def _tracks_faces(plan: "ExecutionPlan") -> str:
    return "a contact is latched or swept" if plan.model.tracks_faces else ""


def _all_minima(plan: "ExecutionPlan") -> str:
    return "" if all(group.minima is None for group in plan.model.groups) else 'a contact has minima="all"'


def _contacts_are_read(plan: "ExecutionPlan") -> str:
    reading = next((element.family for element in plan.model.force_elements if element.reads_contacts), "")
    return f"the model has force elements of the family {reading!r}, which read the contacts" if reading else ""


def _several_bodies(plan: "ExecutionPlan") -> str:
    bodies = plan.model.body_count
    return "" if bodies == 1 else f"environments have {bodies} bodies"


def _joints(plan: "ExecutionPlan") -> str:
    return "a body has a joint or prescribed motion" if plan.model.has_joints else ""


def _other_forces(plan: "ExecutionPlan") -> str:
    other = next((element.family for element in plan.model.force_elements if not element.fused), "")
    return f"the model has force elements of the family {other!r}" if other else ""


def _no_contacts(plan: "ExecutionPlan") -> str:
    return "" if plan.model.clusters.count else "there are no contacts of points with surfaces"


def _several_contact_models(plan: "ExecutionPlan") -> str:
    count = len(plan.model.groups)
    return "" if count == 1 else f"there are {count} contact models"


def _several_sets(plan: "ExecutionPlan") -> str:
    count = plan.model.clusters.set_count
    return "" if count == 1 else f"there are {count} contact sets"


def _many_clusters(plan: "ExecutionPlan") -> str:
    count = plan.model.clusters.count
    return "" if count <= MAX_SUMMED_CLUSTERS else f"a body has {count} clusters of contacts"


def _face_grid(plan: "ExecutionPlan") -> str:
    return "surfaces have face grids" if plan.model.arrays.uses_face_grid else ""


def _no_face_grid(plan: "ExecutionPlan") -> str:
    return "" if plan.model.arrays.uses_face_grid else "surfaces have no face grid"


def _fused_contact_kernel(plan: "ExecutionPlan") -> str:
    """Returns the reason for which no fused contact kernel exists for the device and its detection."""
    if not plan.one_thread_per_contact:
        return _face_grid(plan)
    width = plan.model.clusters.width
    if width != 1:
        return f"on a GPU a cluster must have one contact, here up to {width}"
    return _no_face_grid(plan) or _several_contact_models(plan)


_FUSION_OBSTACLES = (
    _fusion_is_off,
    _no_cache,
    _outputs_are_read,
    _nonsmooth,
    _detected_before,
    _tracks_faces,
    _all_minima,
)
_STEP_FUSION_OBSTACLES = (_other_integrator, _several_bodies, _joints, _other_forces)

#: The launch shapes, the fastest first. Device functions that compose stages are in ``kernels/launch_shapes``.
SHAPES: dict[str, ShapeRow] = {
    WARP_PER_ENVIRONMENT: ShapeRow(
        "one kernel per step; the threads of a warp share the contacts of its environments",
        (_for_gpus, *_FUSION_OBSTACLES, *_STEP_FUSION_OBSTACLES, _several_sets, _no_face_grid, _many_clusters),
    ),
    LOOP_PER_ENVIRONMENT: ShapeRow(
        "one kernel for any number of steps; a thread takes them in one environment after the other",
        (
            _for_cpus,
            *_FUSION_OBSTACLES,
            *_STEP_FUSION_OBSTACLES,
            _no_contacts,
            _several_contact_models,
            _face_grid,
        ),
    ),
    FUSED_CONTACT: ShapeRow(
        "contact detection and force in one kernel per contact model, then the other stages",
        (*_FUSION_OBSTACLES, _contacts_are_read, _no_contacts, _fused_contact_kernel),
    ),
    STAGED: ShapeRow("separate kernels for detection, contact force and integration", ()),
}
