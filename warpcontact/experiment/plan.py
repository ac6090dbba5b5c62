"""What an experiment takes of memory and disk, and how many of its environments run at once."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from warpcontact.available import HOST, Room
from warpcontact.checks import Array
from warpcontact.draft import Draft, PartDraft
from warpcontact.environments import Environments
from warpcontact.experiment.observation import watching
from warpcontact.experiment.result import CHUNK
from warpcontact.experiment.schema import Settings
from warpcontact.footprint import (
    COMFORTABLE,
    Footprint,
    MemoryShortage,
    Need,
    environments,
    most_that_fit,
    readable,
    rooms_of,
    said,
    shortage,
    total,
    usable,
)
from warpcontact.recorder import Recorder, RecordingSize
from warpcontact.simulation import frame_count, recorded_steps

# Pieces of a recording that are in memory at once while it is compressed, and for its picture; measured.
WRITTEN_AT_ONCE = 8
DRAWN_AT_ONCE = 2
# A batch is rounded to this many significant bits, so that the pieces of a recording are parts of it.
BITS = 6


@dataclass(frozen=True)
class Plan:
    """How an experiment runs. ``print(plan)`` tells what it takes.

    Attributes:
        envs: Number of environments.
        batch: How many run at once; 0: not even one fits.
        footprint: What these take of memory, or what one would that does not fit.
        recording: Size of the whole recording, before it is compressed [bytes].
        rooms: What there is of memory, where it is known.
    """

    envs: int
    batch: int
    footprint: Footprint
    recording: int
    rooms: tuple[Room, ...]

    @property
    def batches(self) -> int:
        """How many batches follow each other."""
        return -(-self.envs // self.batch) if self.batch else 0

    def require(self) -> None:
        """Raises ``MemoryError`` if not even one environment fits."""
        room = None if self.batch else shortage(self.footprint, self.rooms)
        if room is not None:
            message = f"{said(self.footprint, room)}; not even one environment fits"
            raise MemoryShortage(message, self.footprint.on(room.place), usable(room), 0)

    def __str__(self) -> str:
        lines = [str(self.footprint)]
        for room in self.rooms:
            lines.append(f"available: {readable(room.size)} of {room.name}; {readable(usable(room))} can be used")
        lines.append(f"on disk: up to {readable(self.recording)}, before compression")
        if not self.batch:
            lines.append("does not fit: not even one environment")
        elif self.batches == 1:
            lines.append(f"{environments(self.envs)}: all at once")
        else:
            lines.append(f"{environments(self.envs)}: {self.batches} batches of {self.batch}, one after another")
        return "\n".join(lines)


def make_plan(
    draft: Draft, size: RecordingSize, settings: Settings, varied: Mapping[str, Array], batch: int | None
) -> Plan:
    """Returns how the experiment runs on the devices of ``draft``.

    Args:
        draft: Its scene, ready to be built.
        size: What its recording takes.
        settings: The experiment, with all defaults.
        varied: Values of the parameters that vary, of all environments.
        batch: How many environments are to run at once at most; ``None``: as many as fit.

    Raises:
        MemoryError: If ``batch`` environments do not fit; says how many do.
    """
    frames = frame_count(*recorded_steps(settings.duration, settings.record.every, settings.dt))

    def recording(part: PartDraft, envs: int) -> Footprint:
        device = str(part.device)
        needs = [*part.measures_needs(part.device, size.measured, envs), *size.needs(device, envs, frames)]
        return Footprint(envs, device, tuple(needs))

    def footprint(envs: int) -> Footprint:
        writing = min(WRITTEN_AT_ONCE * CHUNK, size.on_host(envs, frames) // 2)
        drawing = min(DRAWN_AT_ONCE * CHUNK, size.on_host(settings.envs, frames))
        stepping = {"integrator": settings.integrator.make(), "crossing_steps": settings.crossing_steps}
        return draft.memory(envs, varied, **stepping, **watching(settings)).with_needs(
            [
                *total(recording(part, own) for part, own in draft.shares(envs)).needs,
                Need("values", HOST, sum(values.nbytes for values in varied.values())),
                Need("writing", HOST, max(writing, drawing)),
            ]
        )

    wanted = settings.envs if batch is None else min(batch, settings.envs)
    rooms = rooms_of(footprint(wanted))
    most = most_that_fit(footprint, wanted, rooms)
    if batch is None and 0 < most < wanted:
        most = max(1, most_that_fit(footprint, wanted, rooms, COMFORTABLE))
    elif batch is not None and most < wanted and (room := shortage(footprint(wanted), rooms)) is not None:
        takes = footprint(wanted)
        advice = f"at most {most} at once" if most else "not even one environment"
        message = f"batch {batch}: {said(takes, room)}; {advice} fits on {takes.device}"
        raise MemoryShortage(message, takes.on(room.place), usable(room), most)
    chosen = batch_size(most, settings.envs) if most else 0
    return Plan(settings.envs, chosen, footprint(chosen or 1), size.on_host(settings.envs, frames), rooms)


def batch_size(most: int, envs: int) -> int:
    """Returns the size of batches of about equal size, no more than ``most``, that make up ``envs``."""
    if most >= envs:
        return envs
    grain = 1 << max(0, most.bit_length() - BITS)
    largest = most // grain * grain
    equal = -(-envs // -(-envs // largest))
    return -(-equal // grain) * grain


def recording_size(
    model: Environments, readings: Collection[str], varied: Collection[str], envs: int
) -> RecordingSize:
    """Returns what the recording of ``envs`` environments takes, from a model of any number of them."""
    return Recorder(model, readings, 1, poses=True, parameters=kept(model, varied, envs)).size()


def kept(model: Environments, varied: Collection[str], envs: int) -> list[str]:
    """Returns the parameters that a recording of ``envs`` environments keeps because some vary.

    These and all that are stored with them, as they have a value per environment then, too.
    """
    if envs == 1:
        return list(varied)
    fields = {id(model.find_parameter(name).field) for name in varied}
    return [*varied, *(name for name in model if id(model.find_parameter(name).field) in fields)]
