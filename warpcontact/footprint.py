"""What something takes of memory, by what for and where, and what to do if that is too much."""

import functools
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from warpcontact.available import HOST, Room, find_room

# Of what is available, what is planned with: estimates are good to 15 %, and others need some, too.
USABLE = 0.85
# The same where one may choose how much to take: more would be no faster, and others may come.
COMFORTABLE = 0.7

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB", "PiB")


@dataclass(frozen=True)
class Need:
    """Memory for one purpose.

    Attributes:
        purpose: What for, such as ``"state"``.
        place: Where: ``"host"``, or the name of a device with memory of its own. ``"cpu"`` is taken as the host.
        size: How much [bytes].
        per_env: What one environment more would take [bytes].
    """

    purpose: str
    place: str
    size: int
    per_env: float = 0.0

    def __post_init__(self) -> None:
        if self.place == "cpu":
            object.__setattr__(self, "place", HOST)


@dataclass(frozen=True)
class Footprint:
    """What a number of environments take of memory.

    Attributes:
        envs: Number of environments.
        device: Name of their device, or names. ``"cpu"`` has no memory of its own: all of it is the host's.
        needs: What for, where and how much.
    """

    envs: int
    device: str
    needs: tuple[Need, ...]

    @property
    def device_bytes(self) -> int:
        """Memory on devices, 0 on the CPU, whose memory is that of the host."""
        return sum(need.size for need in self.needs if need.place != HOST)

    @property
    def host_bytes(self) -> int:
        """Memory of the host."""
        return self.on(HOST)

    @property
    def bytes_per_env(self) -> float:
        """What one environment more would take, on device and host together."""
        return sum(need.per_env for need in self.needs)

    @property
    def fixed_bytes(self) -> int:
        """What is taken whatever the number of environments, on device and host together."""
        return _fixed(self.needs, self.envs)

    @property
    def places(self) -> tuple[str, ...]:
        """Where it takes memory, devices first."""
        found = dict.fromkeys(need.place for need in self.needs)
        return (*(place for place in found if place != HOST), *(place for place in found if place == HOST))

    def on(self, place: str) -> int:
        """Returns what it takes of the memory of a device, or of the ``"host"`` [bytes]."""
        return sum(need.size for need in self.needs if need.place == place)

    def of(self, purpose: str) -> int:
        """Returns what it takes for one purpose, everywhere [bytes]."""
        return sum(need.size for need in self.needs if need.purpose == purpose)

    def with_needs(self, needs: Iterable[Need]) -> "Footprint":
        """Returns what the same environments take with more ``needs``."""
        return replace(self, needs=(*self.needs, *needs))

    def __add__(self, other: "Footprint") -> "Footprint":
        """Returns what both take that have different environments, such as parts of a model on several devices."""
        devices = dict.fromkeys((*self.device.split(", "), *other.device.split(", ")))
        envs = self.envs + other.envs
        # One environment more of all is one more of a part for as many as that has of them.
        needs = (
            replace(need, per_env=need.per_env * part.envs / envs) for part in (self, other) for need in part.needs
        )
        return Footprint(envs, ", ".join(devices), tuple(needs))

    def __str__(self) -> str:
        lines = [f"{environments(self.envs)} on {self.device}"]
        for place in self.places:
            own = [need for need in self.needs if need.place == place]
            name = "host" if place == HOST else place
            if place == HOST and self.device == "cpu":
                name = "memory of this machine (the CPU has no other)"
            lines.append(f"{name}: {_line(own)}, {readable(_fixed(own, self.envs))} in any case")
            for purpose in dict.fromkeys(need.purpose for need in own):
                of_it = [need for need in own if need.purpose == purpose]
                if sum(need.size for need in of_it):
                    lines.append(f"  {purpose:<11} {_line(of_it)}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        parts = [f"{readable(self.on(place))} on {place}" for place in self.places]
        return f"<Footprint of {environments(self.envs)} on {self.device}: {', '.join(parts) or 'nothing'}>"


def total(parts: Iterable[Footprint]) -> Footprint:
    """Returns what the parts of a model take together."""
    return functools.reduce(operator.add, parts)


class MemoryShortage(MemoryError):
    """There is not enough memory, as found before it was asked for.

    Attributes:
        needed: What it would take [bytes].
        available: What may be taken of it [bytes].
        most: How many environments would do at once, 0 if not even one; ``None``: their number is not the matter.
    """

    def __init__(self, message: str, needed: int, available: int, most: int | None = None) -> None:
        super().__init__(message)
        self.needed = needed
        self.available = available
        self.most = most


def rooms_of(footprint: Footprint) -> tuple[Room, ...]:
    """Returns what there is of the memory that ``footprint`` needs, where it is known."""
    return tuple(room for place in footprint.places if (room := find_room(place)) is not None)


def usable(room: Room) -> int:
    """Returns how much of ``room`` may be taken [bytes]."""
    return int(USABLE * room.size)


def shortage(footprint: Footprint, rooms: Iterable[Room], part: float = USABLE) -> Room | None:
    """Returns the memory of ``rooms`` a ``part`` of which is too little for ``footprint``; ``None``: it fits."""
    return next((room for room in rooms if footprint.on(room.place) > int(part * room.size)), None)


def most_that_fit(
    footprint: Callable[[int], Footprint], envs: int, rooms: Iterable[Room], part: float = USABLE
) -> int:
    """Returns how many of ``envs`` environments fit at once, 0 if none does.

    Args:
        footprint: Returns what a number of environments take; grows with it.
        envs: How many are wanted.
        rooms: What there is.
        part: How much of it may be taken.
    """
    if shortage(footprint(envs), rooms, part) is None:
        return envs
    low, high = 0, envs
    while high - low > 1:
        middle = (low + high) // 2
        fits = shortage(footprint(middle), rooms, part) is None
        low, high = (middle, high) if fits else (low, middle)
    return low


def require(footprint: Callable[[int], Footprint], envs: int, what: str = "") -> None:
    """Raises ``MemoryShortage`` unless ``envs`` environments fit, with how many would.

    Args:
        footprint: Returns what a number of environments take; grows with it.
        envs: How many are wanted.
        what: What they take it for, if not for everything.
    """
    takes = footprint(envs)
    rooms = rooms_of(takes)
    room = shortage(takes, rooms)
    if room is None:
        return
    most = most_that_fit(footprint, envs, rooms)
    if most:
        batches = -(-envs // most)
        advice = (
            f"at most {environments(most)} at once fit{'s' if most == 1 else ''} on {takes.device}: "
            f"run them in {batches} batches of {-(-envs // batches)}"
        )
    else:
        advice = "not even one environment fits"
    raise MemoryShortage(f"{what}{said(takes, room)}; {advice}", takes.on(room.place), usable(room), most)


def said(footprint: Footprint, room: Room) -> str:
    """Returns that ``footprint`` is too much for ``room``, in words."""
    return (
        f"{environments(footprint.envs)} need{'s' if footprint.envs == 1 else ''} "
        f"{readable(footprint.on(room.place))} of {room.name}, of which "
        f"{readable(usable(room))} can be used ({USABLE:.0%} of the {readable(room.size)} available)"
    )


def environments(count: int) -> str:
    """Returns how many environments, in words."""
    return f"{count} environment{'' if count == 1 else 's'}"


def readable(size: float) -> str:
    """Returns a number of bytes as one reads it, such as ``1.50 GiB``."""
    unit = 0
    while abs(size) >= 1024.0 and unit < len(_UNITS) - 1:
        size, unit = size / 1024.0, unit + 1
    return f"{size:.0f} {_UNITS[unit]}" if unit == 0 or size >= 999.5 else f"{size:.3g} {_UNITS[unit]}"


def _fixed(needs: Iterable[Need], envs: int) -> int:
    """Returns what of ``needs`` does not come with the environments."""
    return max(0, round(sum(need.size - envs * need.per_env for need in needs)))


def _line(needs: list[Need]) -> str:
    """Returns in words what ``needs`` are together."""
    each = sum(need.per_env for need in needs)
    return readable(sum(need.size for need in needs)) + (f", {readable(each)} per environment" if each else "")
