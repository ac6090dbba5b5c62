"""Prepares the steps of a simulation: loads kernels, and builds the steppers of the slices of each device."""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from pathlib import Path

import warp as wp

from warpcontact.forces.execution_plan import ExecutionPlan, KernelLister
from warpcontact.kernels.lowlevel import unique_kernel
from warpcontact.model.environments import Environments
from warpcontact.model.model import DeviceModel
from warpcontact.stepping.explanation import PartExplanation, StepExplanation
from warpcontact.stepping.integrators import Integrator
from warpcontact.stepping.requirements import cut_slices, slice_sizes, step_kernels
from warpcontact.stepping.slice_stepper import StepBuffers, Stepper
from warpcontact.stepping.staged_start import StagedStart
from warpcontact.stepping.worker_pool import DeviceShare
from warpcontact.system.capture_lock import shared_capture_lock

_KERNELS = Path(unique_kernel.__file__).parents[1]


@dataclass(frozen=True)
class StepOptions:
    """Options of ``Simulation`` that determine its launches."""

    crossing_substeps: int
    threads: int
    deterministic: bool
    distance_cache: bool
    capture_graphs: bool
    launch_shape: str


class StepPreparation:
    """Kernels and steppers of a simulation.

    Args:
        model: The model.
        integrator: The time integrator.
        buffers: Step buffers of each part of the model.
        options: Options of the simulation.
    """

    def __init__(
        self, model: Environments, integrator: Integrator, buffers: Sequence[StepBuffers], options: StepOptions
    ) -> None:
        self._model, self._integrator, self._buffers, self._options = model, integrator, buffers, options
        self._start = StagedStart(options.launch_shape, options.threads)
        # Needs of frames whose kernels were loaded.
        self._loaded_needs: set[frozenset[str]] = set()

    @shared_capture_lock()
    def explain(self) -> StepExplanation:
        """Returns how steps are launched; see ``Simulation.explain``."""
        parts = []
        for (part, slices, threads), buffers in zip(self._cut_shares(), self._buffers, strict=True):
            steppers = [
                self._stepper(part, buffers, shape, KernelLister)
                for shape in (self._options.launch_shape, self._start.fastest_shape)
            ]
            final, now = (
                (one.shape, tuple(map(_name, one.step_launches)), tuple(map(_file, one.step_launches)))
                for one in steppers
            )
            on_cpu = threads if part.device.is_cpu else 0
            explanation = PartExplanation(str(part.device), part.envs, len(slices), on_cpu, *final, *now)
            parts.append(explanation)
        start = self._start
        return StepExplanation(
            tuple(parts), start.uses_quick_builds, start.compiled, start.requested, start.errors
        )

    def load_kernels(self, recorded_needs: Sequence[Set[str]]) -> None:
        """Loads the kernels of steps and frames on the CPU: quick builds of those without a release build.

        Args:
            recorded_needs: The needs of each kind of frame, see ``Sensor.needs``.
        """
        missing = {frozenset(needs) for needs in recorded_needs} - self._loaded_needs
        if not missing or not any(device.is_cpu for device in self._model.devices):
            return

        @shared_capture_lock()
        def kernels(shape: str) -> tuple[list[wp.Kernel], list[wp.Kernel]]:
            steppers = self._kernel_listers(shape)
            steps = [kernel for _, stepper in steppers for kernel in stepper.step_launches]
            return steps, [kernel for pair in steppers for kernel in step_kernels(*pair, list(missing))]

        # Compiling allocates no memory of Warp, so other threads can capture graphs in the meantime.
        self._start.load(kernels)
        self._loaded_needs |= missing

    def load_release_builds(self) -> bool:
        """Compiles the kernels of steps now; returns whether any was compiled in the background until now."""
        if self._start.is_over:
            return False
        self._start.load_release_builds(self.step_kernels([]))
        return True

    @shared_capture_lock()
    def step_kernels(self, recorded_needs: Sequence[Set[str]]) -> list[wp.Kernel]:
        """Returns the CPU kernels of steps and frames, each once; ``recorded_needs``: needs of each kind of frame."""
        pairs = self._kernel_listers(self._options.launch_shape)
        return list(dict.fromkeys(kernel for pair in pairs for kernel in step_kernels(*pair, recorded_needs)))

    @shared_capture_lock()
    def device_shares(self) -> list[DeviceShare]:
        """Returns the slices of each part of the model, with a stepper for each thread."""
        shape = self._start.fastest_shape
        return [
            DeviceShare(slices, [self._stepper(part, buffers, shape) for _ in range(threads)])
            for (part, slices, threads), buffers in zip(self._cut_shares(), self._buffers, strict=True)
        ]

    def renewed_shares(self) -> list[DeviceShare] | None:
        """Returns new ``device_shares`` once after release builds were loaded in the background; else ``None``."""
        return self.device_shares() if self._start.take_compiled() else None

    def _cut_shares(self) -> list[tuple[DeviceModel, list[slice], int]]:
        """Returns each part of the model with its slices and the number of threads that step them."""
        parts, threads = [(part, part.envs) for part in self._model.parts], self._options.threads
        sizes = slice_sizes(parts, threads)
        slices = [cut_slices(envs, size) for (_, envs), size in zip(parts, sizes, strict=True)]
        on_cpu = sum(len(own) for (part, _), own in zip(parts, slices, strict=True) if part.device.is_cpu)
        return [
            (part, own, min(threads, on_cpu) if part.device.is_cpu else 1)
            for (part, _), own in zip(parts, slices, strict=True)
        ]

    def _kernel_listers(self, shape: str) -> list[tuple[DeviceModel, Stepper]]:
        """Returns the parts of the model on a CPU, each with a stepper whose launches are kernels."""
        own = zip(self._model.parts, self._buffers, strict=True)
        return [
            (part, self._stepper(part, buffers, shape, KernelLister))
            for part, buffers in own
            if part.device.is_cpu
        ]

    def _stepper(
        self, model: DeviceModel, buffers: StepBuffers, shape: str, kind: type[ExecutionPlan] | None = None
    ) -> Stepper:
        options = self._options
        # On a CPU one thread steps a slice, so the order of summation is always the same.
        uses_gpu = model.device.is_cuda
        ordered = options.deterministic or not uses_gpu
        own = None if uses_gpu else wp.array([0, model.envs, 0], dtype=wp.int32, device=model.device)
        plan = (kind or ExecutionPlan)(
            model,
            model.envs,
            options.distance_cache,
            ordered,
            uses_gpu,
            buffers.nonsmooth,
            fastest_shape=shape,
            slice=own,
        )
        return Stepper(
            plan,
            self._integrator,
            buffers,
            substeps=options.crossing_substeps,
            captured=options.capture_graphs,
            short_graphs=shape != options.launch_shape,
        )


def _name(kernel: wp.Kernel) -> str:
    """Returns the name of the function of a kernel."""
    return str(kernel.key.split("__")[-1])


def _file(kernel: wp.Kernel) -> str:
    """Returns the file of a kernel: its path from the folder of all kernels on, or its name if it is elsewhere."""
    path = Path(kernel.func.__code__.co_filename)
    return f"kernels/{path.relative_to(_KERNELS).as_posix()}" if path.is_relative_to(_KERNELS) else path.name
