"""Resources for stepping, in addition to the model: slice sizes, kernels, and memory for launches and graphs."""

import ctypes
import functools
import itertools
from collections.abc import Collection, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any, cast

import warp as wp

from warpcontact.forces.execution_plan import KernelLister
from warpcontact.forces.launch_shape import AUTO
from warpcontact.kernels.outcomes import recording
from warpcontact.model.sensor_evaluation import can_evaluate_by_slice, evaluation_plan, evaluation_stages
from warpcontact.stepping.integrators import Integrator, SemiImplicitEuler
from warpcontact.stepping.outcomes.watch import ContactEvents, MonitorSettings, StopCondition
from warpcontact.stepping.slice_stepper import MAX_FRAME_GRAPHS, StepBuffers, StepChunk, Stepper
from warpcontact.storage.memory_estimate import MemoryEstimate, MemoryItem, total
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.resources import HOST, available_threads

if TYPE_CHECKING:
    from warpcontact.kernels.outcomes.base import Outcome
    from warpcontact.model.model import DeviceModel
    from warpcontact.model.plan import DeviceModelPlan

# Cache of a core that a slice may fill, and bytes of a body and a face in it; measured.
CACHE_BYTES = 512 * 1024
BODY_BYTES = 400
FACE_BYTES = 100
MAX_SLICE = 256
# Minimum slice size because of faces: with smaller slices, launch overhead exceeds the gain from the cache.
MIN_SLICE_FOR_FACES = 32

# Bytes of a prepared launch, of a graph, and of a graph per byte of the arguments of its launches, which are stored
# with the locations of all pointers in them; measured with Warp 1.19 (tests/test_memory_plan.py).
LAUNCH_BYTES = 1800
GRAPH_BYTES = 50_000
CAPTURED_PER_ARGUMENT_BYTE = 2.05
# Size of an array argument of a kernel: pointers, shape and strides.
ARRAY_BYTES = 56


def slice_sizes(shares: "Sequence[tuple[DeviceModel | DeviceModelPlan, int]]", threads: int) -> list[int]:
    """Returns the number of environments per slice, by part.

    On a CPU a slice fits into the cache of a core, and there is at least one slice per thread if possible. On a GPU a
    slice has all environments of the part.

    Args:
        shares: The parts, each with its number of environments.
        threads: Number of CPU threads.
    """
    on_cpu = sum(envs for part, envs in shares if part.device.is_cpu)
    largest = min(MAX_SLICE, -(-on_cpu // threads))
    return [max(1, min(_max_slice(part), largest)) if part.device.is_cpu else envs for part, envs in shares]


def cut_slices(envs: int, size: int) -> list[slice]:
    """Returns slices of ``size`` environments that cover ``envs`` environments; the last may be smaller."""
    return [slice(first, min(first + size, envs)) for first in range(0, envs, size)]


def _max_slice(part: "DeviceModel | DeviceModelPlan") -> int:
    """Returns the number of environments that fit into the cache of a core, with the faces that they read."""
    per_env = _cache_bytes_per_env(part)
    with_faces = CACHE_BYTES // (per_env + FACE_BYTES * part.arrays.faces_read)
    return min(CACHE_BYTES // per_env, max(MIN_SLICE_FOR_FACES, with_faces))


def _cache_bytes_per_env(part: "DeviceModel | DeviceModelPlan") -> int:
    """Returns the cache bytes of one environment, without faces."""
    return BODY_BYTES * part.body_count + sum(element.cache_bytes for element in part.force_elements)


@shared_capture_lock()
def stepping_memory(
    shares: Sequence[tuple["DeviceModel | DeviceModelPlan", int]],
    integrator: Integrator | None = None,
    *,
    crossing_substeps: int = 1,
    threads: int | None = None,
    distance_cache: bool = True,
    capture_graphs: bool = True,
    launch_shape: str = AUTO,
    outcomes: "Mapping[str, Outcome] | None" = None,
    stop: Mapping[str, StopCondition] | None = None,
    events: ContactEvents | None = None,
    quarantine: str = "freeze",
    recorded_needs: Set[str] | None = None,
    varied: Collection[str] = (),
) -> MemoryEstimate:
    """Returns the memory estimate of a ``Simulation``, without the model. Options are those of ``Simulation``.

    ``shares`` are the parts of the model, each with its number of environments. ``recorded_needs`` are the needs of
    the recorded sensors, see ``Sensor.needs``; ``None``: no recording. ``varied`` names the parameters that will
    differ between environments.
    """
    threads = available_threads() if threads is None else threads
    integrator = SemiImplicitEuler() if integrator is None else integrator
    settings = MonitorSettings.of(outcomes, stop, events, quarantine)
    # At most one thread per environment can have a slice.
    threads_used = min(threads, sum(envs for part, envs in shares if part.device.is_cpu))
    estimates = []
    for part, envs in shares:
        buffers = StepBuffers(part, integrator, settings=settings)
        monitor = buffers.monitor
        # No kernel is launched, so a ``DeviceModelPlan`` can stand for the model.
        queued = part.device.is_cuda
        plan = KernelLister(
            cast("DeviceModel", part),
            1,
            distance_cache and not (monitor and monitor.needs_all_distances),
            ordered_sum=not queued,
            one_thread_per_contact=queued,
            nonsmooth=buffers.nonsmooth,
            fastest_shape=launch_shape,
        )
        stepper = Stepper(plan, integrator, buffers, substeps=crossing_substeps, captured=capture_graphs)
        size = LAUNCH_BYTES * sum(len(launches) for launches in stepper.launches())
        for steps in (1,) if stepper.multi_step else stepper.graph_steps:
            size += _captured_bytes(stepper.graph(StepChunk(steps)))
        if (
            recorded_needs is not None
            and settings.quarantine == "freeze"
            and can_evaluate_by_slice(part, part.device, buffers.nonsmooth is not None, recorded_needs)
        ):
            lister = evaluation_plan(KernelLister, part, 1, buffers.nonsmooth, recorded_needs)
            evaluation = [
                *evaluation_stages(lister, recorded_needs, part.zero_step, None),
                recording.record_frame(),
            ]
            size += LAUNCH_BYTES * len(evaluation)
            if stepper.captured:
                # Graphs of the evaluation alone, and with the steps before it.
                evaluations = [evaluation]
                if stepper.prepare_step_after_evaluation(recorded_needs):
                    first = stepper.graph(StepChunk(1 + stepper.multi_step, after_evaluation=True))
                    size += LAUNCH_BYTES * len(first)
                    evaluations += [first, [*evaluation, *first]] if stepper.multi_step else [first]
                # Without multi-step launches, assume the largest graph that ends with an evaluation.
                steps = 1 if stepper.multi_step else MAX_FRAME_GRAPHS * stepper.graph_steps[0]
                evaluations.append([*evaluation, *stepper.graph(StepChunk(steps))])
                size += sum(_captured_bytes(graph) for graph in evaluations)
        launches = MemoryItem("launches", HOST, size * (threads_used if part.device.is_cpu else 1))
        needs = [*buffers.layout.memory_items(envs), launches]
        if monitor is not None:
            # Allocated arrays are counted in the estimate of the model.
            needs += part.sensor_memory(part.device, part.unallocated(monitor.needs), envs)
        if buffers.nonsmooth is not None:
            needs.append(buffers.nonsmooth.material_need(part.parameters_by_name, envs, varied))
        estimates.append(MemoryEstimate(envs, str(part.device), tuple(needs)))
    return total(estimates)


def step_kernels(part: "DeviceModel", stepper: Stepper, recorded_needs: Sequence[Set[str]]) -> list[wp.Kernel]:
    """Returns the kernels that steps and frames launch, each once, the largest first.

    Args:
        part: The model.
        stepper: Its stepper, with a ``KernelLister`` as execution plan.
        recorded_needs: The needs of each kind of frame, see ``Sensor.needs``.
    """
    evaluations = [
        evaluation_stages(
            evaluation_plan(KernelLister, part, part.envs, part.nonsmooth, needs), needs, part.zero_step, None
        )
        for needs in recorded_needs
    ]
    for needs in recorded_needs:
        stepper.prepare_step_after_evaluation(needs)
    # Evaluations first: their kernels are the largest.
    return list(dict.fromkeys(itertools.chain(*evaluations, *stepper.launches())))


def _captured_bytes(launched: list[Any]) -> int:
    """Returns the bytes of a graph of kernels; 0 if there are none."""
    return GRAPH_BYTES + int(CAPTURED_PER_ARGUMENT_BYTE * sum(map(_argument_bytes, launched))) if launched else 0


@functools.cache
def _argument_bytes(kernel: wp.Kernel) -> int:
    """Returns the size of the arguments of a kernel."""
    return sum(_size(argument.type) for argument in kernel.adj.args)


def _size(kind: Any) -> int:
    if isinstance(kind, wp.array):
        return ARRAY_BYTES
    return ctypes.sizeof(kind.ctype) if hasattr(kind, "ctype") else wp.types.type_size_in_bytes(kind)
