"""What something takes of memory, by what for and where, and what to do if that is too much."""

import functools
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from warpcontact.system.resources import HOST, AvailableMemory, available_memory
from warpcontact.validation.number_format import format_bytes

# Of what is available, what is planned with: estimates are good to 15 %, and others need some, too.
USABLE_FRACTION = 0.85
# The same where one may choose how much to take: more would be no faster, and others may come.
CAUTIOUS_FRACTION = 0.7


@dataclass(frozen=True)
class MemoryItem:
    """Memory for one purpose.

    Attributes:
        purpose: What for, such as ``"state"``.
        location: Where: ``"host"``, or the name of a device with memory of its own. ``"cpu"`` is taken as the host.
        size: How much [bytes].
        per_env: What one environment more would take [bytes].
    """

    purpose: str
    location: str
    size: int
    per_env: float = 0.0

    def __post_init__(self) -> None:
        if self.location == "cpu":
            object.__setattr__(self, "location", HOST)


@dataclass(frozen=True)
class MemoryEstimate:
    """What a number of environments take of memory.

    Attributes:
        envs: Number of environments.
        device: Name of their device, or names. ``"cpu"`` has no memory of its own: all of it is the host's.
        items: What for, where and how much.
    """

    envs: int
    device: str
    items: tuple[MemoryItem, ...]

    @property
    def device_bytes(self) -> int:
        """Memory on devices, 0 on the CPU, whose memory is that of the host."""
        return sum(item.size for item in self.items if item.location != HOST)

    @property
    def host_bytes(self) -> int:
        """Memory of the host."""
        return self.bytes_at(HOST)

    @property
    def bytes_per_env(self) -> float:
        """What one environment more would take, on device and host together."""
        return sum(item.per_env for item in self.items)

    @property
    def fixed_bytes(self) -> int:
        """What is taken whatever the number of environments, on device and host together."""
        return _fixed(self.items, self.envs)

    @property
    def locations(self) -> tuple[str, ...]:
        """Where it takes memory, devices first."""
        found = dict.fromkeys(item.location for item in self.items)
        return (
            *(location for location in found if location != HOST),
            *(location for location in found if location == HOST),
        )

    def bytes_at(self, location: str) -> int:
        """Returns what it takes of the memory of a device, or of the ``"host"`` [bytes]."""
        return sum(item.size for item in self.items if item.location == location)

    def bytes_for(self, purpose: str) -> int:
        """Returns what it takes for one purpose, everywhere [bytes]."""
        return sum(item.size for item in self.items if item.purpose == purpose)

    def with_items(self, items: Iterable[MemoryItem]) -> "MemoryEstimate":
        """Returns what the same environments take with more ``items``."""
        return replace(self, items=(*self.items, *items))

    def __add__(self, other: "MemoryEstimate") -> "MemoryEstimate":
        """Returns what both take that have different environments, such as parts of a model on several devices."""
        devices = dict.fromkeys((*self.device.split(", "), *other.device.split(", ")))
        envs = self.envs + other.envs
        # One environment more of all is one more of a part for as many as that has of them.
        items = (
            replace(item, per_env=item.per_env * part.envs / envs) for part in (self, other) for item in part.items
        )
        return MemoryEstimate(envs, ", ".join(devices), tuple(items))

    def __str__(self) -> str:
        lines = [f"{env_count_text(self.envs)} on {self.device}"]
        for location in self.locations:
            local_items = [item for item in self.items if item.location == location]
            name = "host" if location == HOST else location
            if location == HOST and self.device == "cpu":
                name = "memory of this machine (the CPU has no other)"
            lines.append(
                f"{name}: {_summary(local_items)}, {format_bytes(_fixed(local_items, self.envs))} in any case"
            )
            for purpose in dict.fromkeys(item.purpose for item in local_items):
                same_purpose = [item for item in local_items if item.purpose == purpose]
                if sum(item.size for item in same_purpose):
                    lines.append(f"  {purpose:<11} {_summary(same_purpose)}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        parts = [f"{format_bytes(self.bytes_at(location))} on {location}" for location in self.locations]
        return f"<MemoryEstimate of {env_count_text(self.envs)} on {self.device}: {', '.join(parts) or 'nothing'}>"


def total(parts: Iterable[MemoryEstimate]) -> MemoryEstimate:
    """Returns what the parts of a model take together."""
    return functools.reduce(operator.add, parts)


class MemoryShortage(MemoryError):
    """There is not enough memory, as found before it was asked for.

    Attributes:
        needed: What it would take [bytes].
        available: What may be taken of it [bytes].
        max_envs: How many environments would do at once, 0 if not even one; ``None``: their number is not the matter.
    """

    def __init__(self, message: str, needed: int, available: int, max_envs: int | None = None) -> None:
        super().__init__(message)
        self.needed = needed
        self.available = available
        self.max_envs = max_envs


def available_memory_for(estimate: MemoryEstimate) -> tuple[AvailableMemory, ...]:
    """Returns what there is of the memory that ``estimate`` needs, where it is known."""
    return tuple(memory for location in estimate.locations if (memory := available_memory(location)) is not None)


def usable_bytes(memory: AvailableMemory) -> int:
    """Returns how much of ``memory`` may be taken [bytes]."""
    return int(USABLE_FRACTION * memory.size)


def shortage(
    estimate: MemoryEstimate, available: Iterable[AvailableMemory], fraction: float = USABLE_FRACTION
) -> AvailableMemory | None:
    """Returns the memory of ``available`` a ``fraction`` of which is too little for ``estimate``; ``None``: it fits."""
    return next(
        (memory for memory in available if estimate.bytes_at(memory.location) > int(fraction * memory.size)), None
    )


def max_envs_that_fit(
    estimate: Callable[[int], MemoryEstimate],
    envs: int,
    available: Iterable[AvailableMemory],
    fraction: float = USABLE_FRACTION,
) -> int:
    """Returns how many of ``envs`` environments fit at once, 0 if none does.

    Args:
        estimate: Returns what a number of environments take; grows with it.
        envs: How many are wanted.
        available: What there is.
        fraction: How much of it may be taken.
    """
    if shortage(estimate(envs), available, fraction) is None:
        return envs
    low, high = 0, envs
    while high - low > 1:
        middle = (low + high) // 2
        fits = shortage(estimate(middle), available, fraction) is None
        low, high = (middle, high) if fits else (low, middle)
    return low


def require(estimate: Callable[[int], MemoryEstimate], envs: int, what: str = "") -> None:
    """Raises ``MemoryShortage`` unless ``envs`` environments fit, with how many would.

    Args:
        estimate: Returns what a number of environments take; grows with it.
        envs: How many are wanted.
        what: What they take it for, if not for everything.
    """
    required = estimate(envs)
    available = available_memory_for(required)
    memory = shortage(required, available)
    if memory is None:
        return
    max_envs = max_envs_that_fit(estimate, envs, available)
    if max_envs:
        batches = -(-envs // max_envs)
        advice = (
            f"at most {env_count_text(max_envs)} at once fit{'s' if max_envs == 1 else ''} on {required.device}: "
            f"run them in {batches} batches of {-(-envs // batches)}"
        )
    else:
        advice = "not even one environment fits"
    raise MemoryShortage(
        f"{what}{shortage_message(required, memory)}; {advice}",
        required.bytes_at(memory.location),
        usable_bytes(memory),
        max_envs,
    )


def shortage_message(estimate: MemoryEstimate, memory: AvailableMemory) -> str:
    """Returns that ``estimate`` is too much for ``memory``, in words."""
    return (
        f"{env_count_text(estimate.envs)} need{'s' if estimate.envs == 1 else ''} "
        f"{format_bytes(estimate.bytes_at(memory.location))} of {memory.name}, of which "
        f"{format_bytes(usable_bytes(memory))} can be used ({USABLE_FRACTION:.0%} of the {format_bytes(memory.size)} available)"
    )


def env_count_text(count: int) -> str:
    """Returns how many environments, in words."""
    return f"{count} environment{'' if count == 1 else 's'}"


def _fixed(items: Iterable[MemoryItem], envs: int) -> int:
    """Returns what of ``items`` does not come with the environments."""
    return max(0, round(sum(item.size - envs * item.per_env for item in items)))


def _summary(items: list[MemoryItem]) -> str:
    """Returns in words what ``items`` are together."""
    per_env = sum(item.per_env for item in items)
    return format_bytes(sum(item.size for item in items)) + (
        f", {format_bytes(per_env)} per environment" if per_env else ""
    )
