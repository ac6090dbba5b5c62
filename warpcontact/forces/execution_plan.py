"""Builds the step as a list of prepared Warp launches.

``ExecutionPlan`` describes the environments and the options of a step. ``launch_shape`` chooses from it how stages are
composed into kernels. The functions ``*_stages`` return the launches of one stage:

    motion bounds → broad and narrow phase → forces at ends → contact forces → sums of wrenches → forces added to them
    → integration → swept test → monitors → accept → history

Force elements (``force_element.py``) provide the launches of detection, forces and history.

Integrators (``integrators/``) build the stages from forces to the swept test. On one device all launch shapes give
bitwise identical results.
"""

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces import launch_shape
from warpcontact.forces.force_element import ForceTarget
from warpcontact.forces.launch_shape import AUTO, WARP_PER_ENVIRONMENT, LaunchShape
from warpcontact.kernels.acceptance import accept_step
from warpcontact.kernels.broadphase import (
    contact_detection,
    contact_detection_grid,
    contact_detection_queues,
    motion_bound,
    swept,
)
from warpcontact.kernels.contact import history, wrenches
from warpcontact.kernels.integrators import semi_implicit
from warpcontact.kernels.launch_shapes import fused_contact, fused_contact_grid, fused_step, fused_steps_cpu
from warpcontact.kernels.lowlevel import warps
from warpcontact.kernels.narrowphase.closest_point import (
    DETECT_BVH,
    DETECT_CACHED,
    DETECT_CANDIDATES,
    DETECT_FACE_CACHE,
    DETECT_GRID,
    DETECT_QUERY,
)
from warpcontact.kernels.types import LaunchRange
from warpcontact.system.kernel_builds import current_build
from warpcontact.system.launches import in_order

if TYPE_CHECKING:
    from warpcontact.forces.contact_groups import ContactGroup
    from warpcontact.forces.force_element import ForceElement
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.model import DeviceModel


# Maximum number of GPU threads that process a work queue of any length; multiples of a warp.
DETECTION_THREADS = 262144
SEARCH_THREADS = 65536
# Threads per block. Small blocks give kernels with many registers a higher occupancy.
SMALL_BLOCK, GRID_BLOCK, LARGE_BLOCK = 64, 128, 256
# Number of warps that fill all multiprocessors of a GPU; measured on an H200.
FULL_WARPS = 2048


@dataclass(frozen=True)
class ExecutionPlan:
    """Environments of one model and the kernels that compute them.

    Attributes:
        model: The model.
        count: Number of environments, from the first one.
        uses_cache: Whether contacts that cannot touch are skipped, using cached clearances. Gap, normal and point of
            skipped contacts are then not written; steps do not need them.
        ordered_sum: Whether wrenches are summed in a fixed order instead of with atomics.
        one_thread_per_contact: Whether a thread processes one contact at a time, as on GPUs, instead of all contacts of
            a cluster. Without a face grid, work queues then distribute the contacts.
        nonsmooth: The nonsmooth contacts, which have impulses instead of forces. ``None``: all contacts are compliant.
        evaluated_state: State whose contacts were detected before and have not changed since. ``None``: no such state.
        write_outputs: Whether kernels write contact outputs (forces, slip) that sensors read.
        semi_implicit_euler: Whether the integrator is ``SemiImplicitEuler`` itself, whose steps kernels can fuse.
        fastest_shape: Fastest launch shape to choose, a name in ``launch_shape.SHAPES``. ``AUTO``: any.
        slice: Device array [3] that launches read when they run: first environment, number of environments, and
            number of steps of a multi-step launch. ``None``: all environments.
    """

    model: "DeviceModel"
    count: int
    uses_cache: bool
    ordered_sum: bool
    one_thread_per_contact: bool = False
    nonsmooth: "NonsmoothContacts | None" = None
    evaluated_state: Any = None
    write_outputs: bool = True
    semi_implicit_euler: bool = False
    fastest_shape: str = AUTO
    slice: wp.array | None = None

    @property
    def force_elements(self) -> "tuple[ForceElement, ...]":
        """All force elements in launch order; the nonsmooth contacts are the last one."""
        return (*self.model.force_elements, *([] if self.nonsmooth is None else [self.nonsmooth]))

    @property
    def other_forces(self) -> tuple[bool, bool]:
        """Whether force elements have forces at their ends, and whether there are external forces."""
        return self.model.has_ends, self.model.has_external_forces

    @cached_property
    def shape(self) -> LaunchShape:
        """How the stages of a step are composed into kernels."""
        return launch_shape.choose_shape(self)

    def prepare(
        self,
        kernel: wp.Kernel,
        items: int,
        /,
        *,
        threads: int | None = None,
        block_dim: int | None = None,
        **inputs: Any,
    ) -> list[wp.Launch]:
        """Returns the recorded launch of a kernel as a list; an empty list if there are no items.

        Args:
            kernel: The kernel. Its argument ``launch`` is a ``LaunchRange``.
            items: Number of items per environment.
            threads: Number of GPU threads. Default: one per item.
            block_dim: Threads per GPU block. Default: ``SMALL_BLOCK`` for small launches, so that they use all
                multiprocessors, else ``LARGE_BLOCK``.
            inputs: The other arguments of the kernel, by name.

        Raises:
            TypeError: If the names are not those of the arguments of the kernel.
        """
        if items == 0:
            return []
        device = self.model.device
        work = LaunchRange()
        work.envs, work.items = self.count, items
        work.threads = (threads or self.count * items) if device.is_cuda else 1
        if self.slice is not None:
            work.slice = self.slice
        block_dim = block_dim or (SMALL_BLOCK if work.threads <= launch_shape.SMALL_LAUNCH else LARGE_BLOCK)
        values = in_order(kernel, {"launch": work, **inputs})
        kernel = current_build(kernel, device)
        return [wp.launch(kernel, work.threads, values, device=device, record_cmd=True, block_dim=block_dim)]


class KernelLister(ExecutionPlan):
    """Execution plan that returns kernels instead of launches."""

    def prepare(
        self,
        kernel: wp.Kernel,
        items: int,
        /,
        *,
        threads: int | None = None,
        block_dim: int | None = None,
        **inputs: Any,
    ) -> list[Any]:
        """Returns the kernel of the launch as a list; an empty list if there are no items."""
        if items == 0:
            return []
        in_order(kernel, {"launch": None, **inputs})
        return [kernel]


@dataclass(frozen=True)
class StepLength:
    """Length of a step [env, 0] [s].

    Attributes:
        real: In the precision of the model, for the integration of forces.
        clock: In float64, for clocks and prescribed motions.
        half_clock: Half of ``clock``.
    """

    real: wp.array
    clock: wp.array
    half_clock: wp.array


def force_stages(
    plan: ExecutionPlan, state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
) -> list[wp.Launch]:
    """Returns the launches that compute contacts and wrenches of ``state``, without changing the state.

    Args:
        plan: The environments.
        state: State of the environments.
        step: Time over which the forces act [env, 0] [s]; zeros for instantaneous forces.
        status: Status of the environments [env]. Environments that are not active are skipped.
        by_cluster: Whether to leave the wrenches of clusters, and those added to bodies, unsummed. The integrator
            sums them, or they are not needed.
    """
    model = plan.model
    a, real = model.arrays, model.types.real
    ordered_sum = plan.ordered_sum or by_cluster
    elements = plan.force_elements

    def forces(target: ForceTarget) -> list[wp.Launch]:
        acting = [one for one in elements if one.target is target]
        each = (one.force_launches(plan, state, step, status, by_cluster=by_cluster) for one in acting)
        return list(itertools.chain(*each))

    launches = list(itertools.chain(*(one.detection_launches(plan, state, status) for one in elements)))
    launches += forces(ForceTarget.ENDS)
    sums = {"queue_count": a.cache.queue_count, "ends": a.end_wrenches, "wrenches": a.wrenches}
    if not ordered_sum:
        kernel = wrenches.initialize_wrenches(real, *plan.other_forces)
        launches += plan.prepare(kernel, model.body_count, status=status, model=a.model, **sums)
    launches += forces(ForceTarget.CLUSTERS)
    if ordered_sum and not by_cluster:
        kernel = wrenches.sum_by_body(real, *plan.other_forces)
        contacts = {"active_contacts": a.active_contacts}
        launches += plan.prepare(kernel, model.body_count, status=status, model=a.model, **contacts, **sums)
    return launches + forces(ForceTarget.BODIES)


def fused_contact_stages(
    plan: ExecutionPlan, group: "ContactGroup", state: Any, step: wp.array, status: wp.array, *, ordered_sum: bool
) -> list[wp.Launch]:
    """Returns the launches that detect the contacts of a group and compute their forces in one kernel."""
    model = plan.model
    a = model.arrays
    factory_arguments = group.contact_model, model.types.real, group.has_joints, group.projected
    inputs = {**_contact_inputs(plan, state), **group.material_inputs, "step": step}
    if not plan.one_thread_per_contact:
        ranges = {"first_set": group.first_set, "first_contact": group.first}
        return plan.prepare(
            fused_contact.kernel(*factory_arguments), group.set_count, status=status, **ranges, **inputs
        )
    inputs |= {"ordered": ordered_sum, "wrenches": a.wrenches}
    kernel, count = fused_contact_grid.kernel(*factory_arguments, plan.shape.small), group.cluster_count
    launches = plan.prepare(kernel, count, block_dim=GRID_BLOCK, status=status, **inputs)
    if plan.shape.small:
        return launches
    threads = min(SEARCH_THREADS, _whole_warps(plan.count * count))
    kernel = fused_contact_grid.remaining(*factory_arguments)
    return launches + plan.prepare(kernel, count, threads=threads, block_dim=SMALL_BLOCK, **inputs)


def _contact_inputs(plan: ExecutionPlan, state: Any) -> dict[str, Any]:
    """Returns the arguments of kernels that detect contacts of points and meshes."""
    a = plan.model.arrays
    return {
        "model": a.model,
        "state": state,
        "history": a.history,
        "cache": a.cache,
        "contacts": a.contacts,
        "active_contacts": a.active_contacts,
    }


def detection_stages(plan: ExecutionPlan, state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches of broad and narrow phase of points and meshes; arguments as in ``force_stages``.

    A kernel that sums or clears wrenches must follow, because it empties the work queues.
    """
    model = plan.model
    a, real = model.arrays, model.types.real
    if plan.shape.detection == "grid":
        return _grid_detection_stages(plan, state, status)
    launches = []
    if plan.uses_cache:
        launches += plan.prepare(
            motion_bound.kernel(real),
            model.clusters.set_count,
            status=status,
            model=a.model,
            state=state,
            cache=a.cache,
        )
    if plan.shape.detection == "queues":
        return launches + _queued_detection_stages(plan, state, status)
    kernel, inputs = contact_detection.kernel(real, model.tracks_faces), _contact_inputs(plan, state)
    return launches + plan.prepare(kernel, model.clusters.count, status=status, cached=plan.uses_cache, **inputs)


def _grid_detection_stages(plan: ExecutionPlan, state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that detect contacts in face grids, and search with a BVH for the remaining ones."""
    model = plan.model
    real, latched, clusters = model.types.real, model.tracks_faces, model.clusters.count
    inputs = _contact_inputs(plan, state)
    # On a CPU one thread processes a whole cluster.
    width = model.clusters.width if model.device.is_cuda else 0
    single_launch = plan.shape.small or not plan.one_thread_per_contact
    kernel = contact_detection_grid.kernel(real, latched, width, single_launch)
    threads, block_dim = _whole_warps(plan.count * clusters * width), warps.LANES if single_launch else GRID_BLOCK
    launches = plan.prepare(kernel, clusters, threads=threads, block_dim=block_dim, status=status, **inputs)
    if single_launch:
        return launches
    threads = min(SEARCH_THREADS, _whole_warps(plan.count * clusters))
    kernel = contact_detection_grid.remaining(real, latched)
    return launches + plan.prepare(kernel, clusters, threads=threads, block_dim=SMALL_BLOCK, **inputs)


def _queued_detection_stages(plan: ExecutionPlan, state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches of contact detection on a GPU with one work queue per detection part."""
    model = plan.model
    a, real, latched = model.arrays, model.types.real, model.tracks_faces
    clusters, contacts = model.clusters.count, model.contact_count
    inputs, queues = _contact_inputs(plan, state), {"status": status, "model": a.model, "cache": a.cache}
    launches = plan.prepare(contact_detection_queues.enqueue(real, latched), clusters, contacts=contacts, **queues)
    if contacts > clusters:
        kernel, threads = (
            contact_detection_queues.probe_clusters(real, latched, a.uses_face_grid),
            min(SEARCH_THREADS, _whole_warps(plan.count * clusters)),
        )
        launches += plan.prepare(
            kernel, clusters, threads=threads, block_dim=SMALL_BLOCK, items=contacts, **inputs
        )
    parts = (
        [DETECT_GRID, DETECT_QUERY]
        if a.uses_face_grid
        else [DETECT_FACE_CACHE, DETECT_BVH]
        if plan.shape.small
        else [DETECT_CACHED, DETECT_CANDIDATES, DETECT_BVH]
    )
    for part, next_part in zip(parts, [*parts[1:], parts[-1]], strict=True):
        kernel = contact_detection_queues.process(real, latched, part, next_part)
        max_threads = SEARCH_THREADS if part in (DETECT_BVH, DETECT_QUERY) else DETECTION_THREADS
        threads = min(max_threads, _whole_warps(plan.count * contacts))
        launches += plan.prepare(kernel, contacts, threads=threads, block_dim=SMALL_BLOCK, **inputs)
    return launches + plan.prepare(
        contact_detection_queues.compact(real), clusters, active_contacts=a.active_contacts, **queues
    )


def _whole_warps(threads: int) -> int:
    return -(-threads // warps.LANES) * warps.LANES


def accept_stages(plan: ExecutionPlan, dt: StepLength, state_in: Any, state_out: Any) -> list[wp.Launch]:
    """Returns the launches that accept a proposed step in all active environments, after the integration stages."""
    if plan.shape.name == WARP_PER_ENVIRONMENT:
        # The fused step also advances history variables.
        return []
    model = plan.model
    a, real = model.arrays, model.types.real
    launches = []
    if not plan.shape.integrator_accepts:
        single_launch = model.clusters.count > 0 and not model.tracks_faces
        inputs = {"status": a.status, "time": a.time, "bodies": model.body_count}
        inputs |= {"state_in": state_in, "state_out": state_out}
        if not single_launch:
            launches += plan.prepare(accept_step.kernel(real), 1, step=dt.clock, **inputs)
        launches += plan.prepare(
            history.kernel(real, model.tracks_faces, single_launch),
            model.clusters.count,
            step=dt.real,
            clock_step=dt.clock,
            model=a.model,
            contacts=a.contacts,
            active_contacts=a.active_contacts,
            history=a.history,
            cache=a.cache,
            **inputs,
        )
    for element in plan.force_elements:
        launches += element.accept_launches(plan, dt, state_in)
    return launches


def fused_step_stages(plan: ExecutionPlan, dt: StepLength, state_in: Any, state_out: Any) -> list[wp.Launch]:
    """Returns the launch that takes an accepted semi-implicit Euler step of a warp per environment."""
    model, clusters = plan.model, plan.model.clusters
    real, (group,) = model.types.real, model.groups
    lanes = warps.LANES if model.device.is_cuda else 1
    factory_arguments = group.contact_model, real, group.projected, model.has_external_forces
    kernel = fused_step.kernel(*factory_arguments, clusters.width, clusters.count, lanes)
    # With many environments, each thread has one. With few, a warp has fewer environments, so that there are
    # ``FULL_WARPS`` warps; the lanes share the contacts. A single contact cannot be shared.
    envs_per_warp = lanes if model.contact_count == 1 else min(lanes, max(1, plan.count // FULL_WARPS))
    return plan.prepare(
        kernel,
        1,
        threads=-(-plan.count // envs_per_warp) * lanes,
        block_dim=SMALL_BLOCK if plan.shape.small else LARGE_BLOCK,
        envs_per_warp=envs_per_warp,
        state_in=state_in,
        state_out=state_out,
        **_step_inputs(plan, dt, group),
    )


def multi_step_stages(plan: ExecutionPlan, dt: StepLength, state: Any) -> list[wp.Launch]:
    """Returns the multi-step launch of semi-implicit Euler steps of a loop per environment."""
    model, clusters = plan.model, plan.model.clusters
    (group,) = model.groups
    kernel = fused_steps_cpu.kernel(
        group.contact_model, model.types.real, group.projected, model.has_external_forces
    )
    counts, inputs = {"sets": clusters.set_count, "clusters": clusters.count}, _step_inputs(plan, dt, group)
    return plan.prepare(kernel, 1, state=state, **counts, **inputs)


def _step_inputs(plan: ExecutionPlan, dt: StepLength, group: "ContactGroup") -> dict[str, Any]:
    """Returns the arguments, apart from states, of kernels that take whole steps."""
    a = plan.model.arrays
    return {
        "status": a.status,
        "step": dt.real,
        "clock_step": dt.clock,
        "time": a.time,
        "model": a.model,
        "guard": a.guard,
        "history": a.history,
        "contacts": a.contacts,
        "active_contacts": a.active_contacts,
        "cache": a.cache,
        "ends": a.end_wrenches,
        **group.material_inputs,
    }


def copy_state_stage(plan: ExecutionPlan, source: Any, target: Any) -> list[wp.Launch]:
    """Returns the launch that copies the state of the active environments; frozen ones are skipped."""
    model = plan.model
    kernel = semi_implicit.copy_state(model.types.real)
    return plan.prepare(kernel, model.body_count, status=model.arrays.status, source=source, target=target)


def mask_substeps_stage(plan: ExecutionPlan, *, unmask: bool) -> list[wp.Launch]:
    """Returns the launch that pauses all environments without a crossing; with ``unmask``, resumes them."""
    return plan.prepare(swept.mask_substeps(), 1, status=plan.model.arrays.status, restore=int(unmask))
