"""Estimates memory, disk space and time of an experiment and chooses the shard size.

``make_plan`` finds the largest shard that fits into the available memory of the devices and the host, and the number
of frames per block of the recording. The estimate covers model, simulation, recording buffers and writing.
``estimate_time`` steps some environments for two seconds.
"""

import shutil
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from warpcontact.building.plan import ModelPlan
from warpcontact.experiment.design import Design
from warpcontact.experiment.observation import make_simulation, monitor_arguments
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.store import CHUNK, WRITERS
from warpcontact.model.environments import Environments
from warpcontact.model.plan import DeviceModelPlan
from warpcontact.stepping.recorder import Recorder, RecordingSize
from warpcontact.stepping.simulation import MIN_CHUNK
from warpcontact.stepping.step_counts import frame_count, recorded_steps
from warpcontact.storage.memory_estimate import (
    CAUTIOUS_FRACTION,
    MemoryEstimate,
    MemoryItem,
    MemoryShortage,
    available_memory_for,
    env_count_text,
    max_envs_that_fit,
    shortage,
    shortage_message,
    total,
    usable_bytes,
)
from warpcontact.system.resources import HOST, AvailableMemory, used_memory
from warpcontact.validation.number_format import duration_text, format_bytes

# Duration of the measurement [s], and numbers of environments: enough for all threads of a machine, or for a GPU.
DURATION = 2.0
CPU_ENVS = 1024
GPU_ENVS = 32768

# Largest block of frames [bytes]. One block is written while the next one is recorded.
BLOCK = 32 * 2**20
# Minimum number of blocks per recording, so that little remains to be written at the end, unless blocks would be
# smaller than MIN_BLOCK [bytes]: each file has a fixed cost.
MIN_BLOCKS = 8
MIN_BLOCK = 4 * 2**20
# Number of chunks in memory while a recording is compressed (each with a copy) and while its picture is drawn, and
# memory that the allocator keeps for the writing threads [bytes]; measured.
WRITTEN_AT_ONCE = 2 * WRITERS
DRAWN_AT_ONCE = 2
ALLOCATOR_OVERHEAD = 24 * 2**20
# Memory of libraries loaded during a run: kernels, data sets, pictures, and with series also USD [bytes]; measured.
LIBRARIES = 100 * 2**20
LIBRARIES_FOR_SERIES = 192 * 2**20
# Shard sizes are rounded to this many significant bits, so that they are divisible by a suitable chunk size.
SHARD_BITS = 6


@dataclass(frozen=True)
class Disk:
    """The disk of an existing or future folder.

    Attributes:
        folder: The folder.
        free: Free space for this user [bytes].
    """

    folder: Path
    free: int

    def __str__(self) -> str:
        return f"{format_bytes(self.free)} is free on the disk of {self.folder}"


def find_disk(folder: Path) -> Disk | None:
    """Returns the disk of ``folder``, or of its nearest existing parent; ``None``: not reported by the system."""
    existing = folder.absolute()
    existing = next((one for one in (existing, *existing.parents) if one.exists()), existing)
    try:
        return Disk(folder, shutil.disk_usage(existing).free)
    except OSError:
        return None


@dataclass(frozen=True)
class TimeEstimate:
    """Estimated wall time of a run, and the measurement it is based on.

    Attributes:
        envs: Number of environments that were stepped.
        steps: Number of steps that were taken.
        total_steps: Number of steps of the run.
        rate: Environment steps per second.
        total_env_steps: Number of environment steps of the run.
    """

    envs: int
    steps: int
    total_steps: int
    rate: float
    total_env_steps: int

    @property
    def seconds(self) -> float:
        """Estimated wall time of stepping, without writing [s]."""
        return self.total_env_steps / self.rate

    def __str__(self) -> str:
        return (
            f"time: about {duration_text(self.seconds)} of stepping, at "
            f"{self.rate:.3g} environment steps per second "
            f"(measured with {self.envs} environments over the first {self.steps} of {self.total_steps} steps)"
        )


def estimate_time(draft: ModelPlan, settings: Settings, design: Design, max_envs: int) -> TimeEstimate:
    """Measures the stepping rate of some environments of an experiment.

    Args:
        draft: Plan of the model; cannot be used again.
        settings: The experiment, with all defaults.
        design: The varied parameters.
        max_envs: Maximum number of environments.
    """
    on_gpu = any(part.device.is_cuda for part in draft.parts)
    envs = min(settings.envs, max_envs, GPU_ENVS if on_gpu else CPU_ENVS)
    model = draft.build(envs)
    for name, rows in design.rows(0, envs).items():
        model[name] = rows
    simulation = make_simulation(model, settings)
    simulation.warned_at_start = True
    steps, _ = recorded_steps(settings.duration, settings.record.every, settings.dt)
    simulation.compile()
    simulation.step()
    simulation.reset()
    done = 0
    start = time.perf_counter()
    while done < steps and time.perf_counter() - start < DURATION:
        count = min(max(MIN_CHUNK, done), steps - done)
        simulation.step(count)
        model.health()  # synchronizes with a GPU
        done += count
    elapsed = time.perf_counter() - start
    return TimeEstimate(envs, done, steps, envs * done / elapsed, settings.envs * steps)


@dataclass(frozen=True)
class Plan:
    """Memory, disk and shards of an experiment; ``print(plan)`` shows them.

    Attributes:
        envs: Number of environments.
        shard: Environments per shard, which are run and committed together; 0: not even one environment fits.
        block: Frames per block, which are written together.
        footprint: Memory estimate of one shard; if ``shard`` is 0, of one environment.
        recording: Size of the whole recording before compression [bytes].
        available_memory: Available memory of the devices and the host, if the system reports it.
        process: Host memory of Python and its libraries, in addition to ``footprint`` [bytes].
        disk: Disk of the results; ``None``: not requested, or not reported by the system.
    """

    envs: int
    shard: int
    block: int
    footprint: MemoryEstimate
    recording: int
    available_memory: tuple[AvailableMemory, ...]
    process: int
    disk: Disk | None = None

    @property
    def peak(self) -> int:
        """Peak host memory of the process with all kernels compiled [bytes]."""
        return self.process + self.footprint.host_bytes

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.envs // self.shard) if self.shard else 0

    def on_disk(self, envs: int) -> int:
        """Returns the size of the recording of ``envs`` environments before compression [bytes]."""
        return self.recording * envs // self.envs

    def resumed(self, summary: Mapping[str, Any]) -> "Plan":
        """Returns the plan with the shard and block sizes of the run that is resumed."""
        return replace(self, shard=int(summary["shard"]), block=int(summary["block"]))

    def require(self) -> None:
        """Raises ``MemoryError`` if not even one environment fits."""
        memory = None if self.shard else shortage(self.footprint, self.available_memory)
        if memory is not None:
            message = f"{shortage_message(self.footprint, memory)}; not even one environment fits"
            raise MemoryShortage(message, self.footprint.bytes_at(memory.location), usable_bytes(memory), 0)

    def __str__(self) -> str:
        lines = [
            str(self.footprint),
            f"process including Python and its libraries: at most {format_bytes(self.peak)}",
        ]
        for memory in self.available_memory:
            lines.append(
                f"available: {format_bytes(memory.size)} of {memory.name}; {format_bytes(usable_bytes(memory))} can be used"
            )
        free_text = f"; {self.disk}" if self.disk is not None else ""
        shortage_text = ", not enough" if self.disk is not None and self.disk.free < self.recording else ""
        lines.append(
            f"on disk: up to {format_bytes(self.recording)}, before compression{free_text}{shortage_text}"
        )
        if not self.shard:
            lines.append("does not fit: not even one environment")
        elif self.shards == 1:
            lines.append(f"{env_count_text(self.envs)}: one shard")
        else:
            lines.append(f"{env_count_text(self.envs)}: {self.shards} shards of {self.shard}, one after another")
        return "\n".join(lines)


def make_plan(
    draft: ModelPlan, size: RecordingSize, settings: Settings, design: Design, shard: int | None
) -> Plan:
    """Returns the plan of an experiment on the devices of ``draft``.

    Args:
        draft: Plan of the model.
        size: Size of its recording.
        settings: The experiment, with all defaults.
        design: The varied parameters.
        shard: Maximum number of environments per shard; ``None``: as many as fit.

    Raises:
        MemoryError: If ``shard`` environments do not fit; the message states how many do.
    """
    frames = frame_count(*recorded_steps(settings.duration, settings.record.every, settings.dt))
    if not settings.record.series:
        frames = 0

    def recording(part: DeviceModelPlan, envs: int, block: int) -> MemoryEstimate:
        device = str(part.device)
        buffers = size.memory_items(device, envs, block, blocks_at_once(frames, block))
        needs = [*part.sensor_memory(part.device, size.measured, envs), *buffers]
        return MemoryEstimate(envs, device, tuple(needs))

    def footprint(envs: int) -> MemoryEstimate:
        block = block_size(size, envs, frames)
        buffers = total(recording(part, own, block) for part, own in draft.shares(envs))
        writing = min(WRITTEN_AT_ONCE * CHUNK, 3 * size.on_host(envs, block) // 4)
        drawing = min(DRAWN_AT_ONCE * CHUNK, size.on_host(settings.envs, frames) // 4) if frames else 0
        # The frames are freed before the picture is drawn.
        recorded = sum(
            need.size for need in buffers.items if need.purpose == "recording" and need.location == HOST
        )
        drawing = max(0, drawing - recorded)
        stepping = {
            "integrator": settings.integrator.make(),
            "crossing_substeps": settings.crossing_substeps,
            "recorded_needs": size.measured if frames else None,
        }
        return draft.memory(envs, design.names, **stepping, **monitor_arguments(settings)).with_items(
            [
                *buffers.items,
                MemoryItem("values", HOST, envs * design.row_bytes, design.row_bytes),
                MemoryItem("writing", HOST, max(writing, drawing) + ALLOCATOR_OVERHEAD),
            ]
        )

    requested = settings.envs if shard is None else min(shard, settings.envs)
    available_memory = available_memory_for(footprint(requested))
    max_envs = max_envs_that_fit(footprint, requested, available_memory)
    if shard is None and 0 < max_envs < requested:
        max_envs = max(1, max_envs_that_fit(footprint, requested, available_memory, CAUTIOUS_FRACTION))
    elif (
        shard is not None
        and max_envs < requested
        and (memory := shortage(footprint(requested), available_memory)) is not None
    ):
        needed = footprint(requested)
        advice = f"at most {max_envs} fit" if max_envs else "not even one environment fits"
        message = f"shard {shard}: {shortage_message(needed, memory)}; {advice} on {needed.device}"
        raise MemoryShortage(message, needed.bytes_at(memory.location), usable_bytes(memory), max_envs)
    chosen = max_envs
    if shard is None and max_envs:
        chosen = shard_size(max_envs, settings.envs)
    block = block_size(size, chosen or 1, frames)
    return Plan(
        settings.envs,
        chosen,
        block,
        footprint(chosen or 1),
        size.on_host(settings.envs, frames),
        available_memory,
        used_memory() + (LIBRARIES_FOR_SERIES if frames else LIBRARIES),
    )


def block_size(size: RecordingSize, envs: int, frames: int) -> int:
    """Returns the number of frames per block, of ``frames`` frames of ``envs`` environments."""
    frame = max(1, size.on_host(envs, 1) - size.on_host(envs, 0))
    enough = max(-(-frames // MIN_BLOCKS), MIN_BLOCK // frame)
    return max(1, min(frames, enough, BLOCK // frame))


def blocks_at_once(frames: int, block: int) -> int:
    """Returns the number of blocks in memory: 2 if one is written while the next one is recorded."""
    return 1 if frames <= block else 2


def shard_size(max_envs: int, envs: int) -> int:
    """Returns the size of nearly equal shards of at most ``max_envs`` that make up ``envs`` environments."""
    if max_envs >= envs:
        return envs
    grain = 1 << max(0, max_envs.bit_length() - SHARD_BITS)
    largest = max_envs // grain * grain
    equal = -(-envs // -(-envs // largest))
    return -(-equal // grain) * grain


def recording_size(
    model: Environments, sensors: Collection[str], varied: Collection[str], settings: Settings
) -> RecordingSize:
    """Returns the size of the recording of an experiment, from a model with any number of environments."""
    series = settings.record.series
    names = sensors if series else ()
    parameters = recorded_parameters(model, varied, settings.envs)
    return Recorder(model, names, 1, poses=True, parameters=parameters, series=series).size()


def recorded_parameters(model: Environments, varied: Collection[str], envs: int) -> list[str]:
    """Returns the parameters that are stored in a recording of ``envs`` environments because some vary.

    With several environments, all parameters of the same device field are included: they have a value per
    environment as well.
    """
    if envs == 1:
        return list(varied)
    fields = {id(model.find_parameter(name).field) for name in varied}
    return [*varied, *(name for name in model if id(model.find_parameter(name).field) in fields)]
