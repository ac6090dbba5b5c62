"""What an experiment takes of memory and disk, and how many of its environments run at once."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from warpcontact.experiment.design import Design
from warpcontact.experiment.disk import Disk
from warpcontact.experiment.observation import monitor_arguments
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.store import CHUNK, WRITERS
from warpcontact.model.environments import Environments
from warpcontact.model.plan import DeviceModelPlan, ModelPlan
from warpcontact.stepping.recorder import Recorder, RecordingSize
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
from warpcontact.validation.number_format import format_bytes

# Frames are gathered up to this size before they are written, while others are gathered [bytes].
BLOCK = 32 * 2**20
# There are so many blocks of frames at least, so that little is left to write at the end, unless they would be
# smaller than this [bytes]: a file takes time as well.
MIN_BLOCKS = 8
MIN_BLOCK = 4 * 2**20
# Pieces of a recording that are in memory at once while it is compressed, each with a copy, and for its picture,
# and what threads that write leave in the hands of the allocator [bytes]; measured.
WRITTEN_AT_ONCE = 2 * WRITERS
DRAWN_AT_ONCE = 2
ALLOCATOR_OVERHEAD = 24 * 2**20
# What a run loads beside: kernels, what makes and stores data sets, what draws its picture, and with series what
# writes its animation; measured.
LIBRARIES = 100 * 2**20
LIBRARIES_FOR_SERIES = 192 * 2**20
# A shard is rounded to this many significant bits, so that the pieces of a recording are parts of it.
SHARD_BITS = 6


@dataclass(frozen=True)
class Plan:
    """How an experiment runs. ``print(plan)`` tells what it takes.

    Attributes:
        envs: Number of environments.
        shard: How many run at once, and are committed together; 0: not even one fits.
        block: How many frames of them are gathered before they are written.
        footprint: What these take of memory, or what one would that does not fit.
        recording: Size of the whole recording, before it is compressed [bytes].
        available_memory: What there is of memory, where it is known.
        process: What Python and its libraries take of the host beside that, much of it already [bytes]; ``None``:
            the system does not tell.
        disk: Where the results would go; ``None``: nobody asked, or the system does not tell.
    """

    envs: int
    shard: int
    block: int
    footprint: MemoryEstimate
    recording: int
    available_memory: tuple[AvailableMemory, ...]
    process: int | None = None
    disk: Disk | None = None

    @property
    def peak(self) -> int | None:
        """The most that the process has of the host, all kernels being compiled; ``None``: nobody knows."""
        return None if self.process is None else self.process + self.footprint.host_bytes

    @property
    def shards(self) -> int:
        """How many shards there are."""
        return -(-self.envs // self.shard) if self.shard else 0

    def on_disk(self, envs: int) -> int:
        """Returns the size of the recording of so many environments, before it is compressed [bytes]."""
        return self.recording * envs // self.envs

    def resumed(self, summary: Mapping[str, Any]) -> "Plan":
        """Returns the plan of a run that goes on, with the shards and blocks that it has."""
        return replace(self, shard=int(summary["shard"]), block=int(summary["block"]))

    def require(self) -> None:
        """Raises ``MemoryError`` if not even one environment fits."""
        memory = None if self.shard else shortage(self.footprint, self.available_memory)
        if memory is not None:
            message = f"{shortage_message(self.footprint, memory)}; not even one environment fits"
            raise MemoryShortage(message, self.footprint.bytes_at(memory.location), usable_bytes(memory), 0)

    def __str__(self) -> str:
        lines = [str(self.footprint)]
        if self.peak is not None:
            lines.append(f"with Python and its libraries the process has {format_bytes(self.peak)} at most")
        for memory in self.available_memory:
            lines.append(
                f"available: {format_bytes(memory.size)} of {memory.name}; {format_bytes(usable_bytes(memory))} can be used"
            )
        free_text = f"; {self.disk}" if self.disk is not None else ""
        shortage_text = ", which is less" if self.disk is not None and self.disk.free < self.recording else ""
        lines.append(
            f"on disk: up to {format_bytes(self.recording)}, before compression{free_text}{shortage_text}"
        )
        if not self.shard:
            lines.append("does not fit: not even one environment")
        elif self.shards == 1:
            lines.append(f"{env_count_text(self.envs)}: all at once")
        else:
            lines.append(f"{env_count_text(self.envs)}: {self.shards} shards of {self.shard}, one after another")
        return "\n".join(lines)


def make_plan(
    draft: ModelPlan, size: RecordingSize, settings: Settings, design: Design, shard: int | None
) -> Plan:
    """Returns how the experiment runs on the devices of ``draft``.

    Args:
        draft: Its scene, ready to be built.
        size: What its recording takes.
        settings: The experiment, with all defaults.
        design: What varies.
        shard: How many environments are to run at once at most; ``None``: as many as fit.

    Raises:
        MemoryError: If ``shard`` environments do not fit; says how many do.
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
        # Frames are let go of before what was written of them is drawn.
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
        advice = f"at most {max_envs} at once" if max_envs else "not even one environment"
        message = f"shard {shard}: {shortage_message(needed, memory)}; {advice} fits on {needed.device}"
        raise MemoryShortage(message, needed.bytes_at(memory.location), usable_bytes(memory), max_envs)
    chosen = max_envs
    if shard is None and max_envs:
        chosen = shard_size(max_envs, settings.envs)
    block = block_size(size, chosen or 1, frames)
    libraries, own = LIBRARIES_FOR_SERIES if frames else LIBRARIES, used_memory()
    return Plan(
        settings.envs,
        chosen,
        block,
        footprint(chosen or 1),
        size.on_host(settings.envs, frames),
        available_memory,
        None if own is None else own + libraries,
    )


def block_size(size: RecordingSize, envs: int, frames: int) -> int:
    """Returns how many of ``frames`` of ``envs`` environments are gathered before they are written."""
    frame = max(1, size.on_host(envs, 1) - size.on_host(envs, 0))
    enough = max(-(-frames // MIN_BLOCKS), MIN_BLOCK // frame)
    return max(1, min(frames, enough, BLOCK // frame))


def blocks_at_once(frames: int, block: int) -> int:
    """Returns how many blocks are in memory: one is gathered while another is written."""
    return 1 if frames <= block else 2


def shard_size(max_envs: int, envs: int) -> int:
    """Returns the size of shards of about equal size, no more than ``max_envs``, that make up ``envs``."""
    if max_envs >= envs:
        return envs
    grain = 1 << max(0, max_envs.bit_length() - SHARD_BITS)
    largest = max_envs // grain * grain
    equal = -(-envs // -(-envs // largest))
    return -(-equal // grain) * grain


def recording_size(
    model: Environments, sensors: Collection[str], varied: Collection[str], settings: Settings
) -> RecordingSize:
    """Returns what the recording of an experiment takes, from a model of any number of environments."""
    series = settings.record.series
    names = sensors if series else ()
    parameters = recorded_parameters(model, varied, settings.envs)
    return Recorder(model, names, 1, poses=True, parameters=parameters, series=series).size()


def recorded_parameters(model: Environments, varied: Collection[str], envs: int) -> list[str]:
    """Returns the parameters that a recording of ``envs`` environments keeps because some vary.

    These and all that are stored with them, as they have a value per environment then, too.
    """
    if envs == 1:
        return list(varied)
    fields = {id(model.find_parameter(name).field) for name in varied}
    return [*varied, *(name for name in model if id(model.find_parameter(name).field) in fields)]
