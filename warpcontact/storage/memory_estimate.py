"""Memory estimates by purpose and location, and errors before an allocation that does not fit."""

import functools
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from warpcontact.system.resources import HOST, AvailableMemory, available_memory
from warpcontact.validation.number_format import format_bytes

# Usable fraction of the available memory: estimates are accurate to 15 %, and other processes need memory, too.
USABLE_FRACTION = 0.85
# The same if the amount can be chosen: more would not be faster, and other processes may need memory later.
CAUTIOUS_FRACTION = 0.7


@dataclass(frozen=True)
class MemoryItem:
    """Memory for one purpose.

    Attributes:
        purpose: Purpose, such as ``"state"``.
        location: ``"host"``, or the name of a device with separate memory. ``"cpu"`` is converted to ``"host"``.
        size: Size [bytes].
        per_env: Additional size of one more environment [bytes].
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
    """Memory estimate for a number of environments.

    Attributes:
        envs: Number of environments.
        device: Name of their device, or names. ``"cpu"`` uses the memory of the host.
        items: Memory by purpose and location.
    """

    envs: int
    device: str
    items: tuple[MemoryItem, ...]

    @property
    def device_bytes(self) -> int:
        """Memory on devices with separate memory; 0 on a CPU [bytes]."""
        return sum(item.size for item in self.items if item.location != HOST)

    @property
    def host_bytes(self) -> int:
        """Memory of the host [bytes]."""
        return self.bytes_at(HOST)

    @property
    def bytes_per_env(self) -> float:
        """Additional size of one more environment, on device and host together [bytes]."""
        return sum(item.per_env for item in self.items)

    @property
    def fixed_bytes(self) -> int:
        """Size independent of the number of environments, on device and host together [bytes]."""
        return _fixed(self.items, self.envs)

    @property
    def locations(self) -> tuple[str, ...]:
        """All locations of the items, devices first."""
        found = dict.fromkeys(item.location for item in self.items)
        return (
            *(location for location in found if location != HOST),
            *(location for location in found if location == HOST),
        )

    def bytes_at(self, location: str) -> int:
        """Returns the size at a location: a device or ``"host"`` [bytes]."""
        return sum(item.size for item in self.items if item.location == location)

    def bytes_for(self, purpose: str) -> int:
        """Returns the size for one purpose at all locations [bytes]."""
        return sum(item.size for item in self.items if item.purpose == purpose)

    def with_items(self, items: Iterable[MemoryItem]) -> "MemoryEstimate":
        """Returns the estimate with additional ``items`` for the same environments."""
        return replace(self, items=(*self.items, *items))

    def __add__(self, other: "MemoryEstimate") -> "MemoryEstimate":
        """Returns the sum for different environments, such as parts of a model on several devices."""
        devices = dict.fromkeys((*self.device.split(", "), *other.device.split(", ")))
        envs = self.envs + other.envs
        # One more environment in total is a fraction part.envs / envs of one more in each part.
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
                name = "host memory"
            lines.append(f"{name}: {_summary(local_items)}, {format_bytes(_fixed(local_items, self.envs))} fixed")
            for purpose in dict.fromkeys(item.purpose for item in local_items):
                same_purpose = [item for item in local_items if item.purpose == purpose]
                if sum(item.size for item in same_purpose):
                    lines.append(f"  {purpose:<11} {_summary(same_purpose)}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        parts = [f"{format_bytes(self.bytes_at(location))} on {location}" for location in self.locations]
        return f"<MemoryEstimate of {env_count_text(self.envs)} on {self.device}: {', '.join(parts) or 'nothing'}>"


def total(parts: Iterable[MemoryEstimate]) -> MemoryEstimate:
    """Returns the sum of the estimates of the parts of a model."""
    return functools.reduce(operator.add, parts)


class MemoryShortage(MemoryError):
    """Raised before an allocation that would not fit into memory.

    Attributes:
        needed: Estimated size [bytes].
        available: Usable memory [bytes].
        max_envs: Maximum number of environments that fit; 0 if none fits. ``None``: does not depend on their number.
    """

    def __init__(self, message: str, needed: int, available: int, max_envs: int | None = None) -> None:
        super().__init__(message)
        self.needed = needed
        self.available = available
        self.max_envs = max_envs


def available_memory_for(estimate: MemoryEstimate) -> tuple[AvailableMemory, ...]:
    """Returns the available memory at the locations of ``estimate``, if it can be determined."""
    return tuple(memory for location in estimate.locations if (memory := available_memory(location)) is not None)


def usable_bytes(memory: AvailableMemory) -> int:
    """Returns the usable part of ``memory`` [bytes]."""
    return int(USABLE_FRACTION * memory.size)


def shortage(
    estimate: MemoryEstimate, available: Iterable[AvailableMemory], fraction: float = USABLE_FRACTION
) -> AvailableMemory | None:
    """Returns the first memory of which ``fraction`` is too small for ``estimate``; ``None``: it fits."""
    return next(
        (memory for memory in available if estimate.bytes_at(memory.location) > int(fraction * memory.size)), None
    )


def max_envs_that_fit(
    estimate: Callable[[int], MemoryEstimate],
    envs: int,
    available: Iterable[AvailableMemory],
    fraction: float = USABLE_FRACTION,
) -> int:
    """Returns the maximum number of environments that fit, at most ``envs``; 0 if none fits.

    Args:
        estimate: Returns the memory estimate for a number of environments; must increase with it.
        envs: Requested number of environments.
        available: Available memory.
        fraction: Usable fraction of it.
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
    """Raises ``MemoryShortage`` unless ``envs`` environments fit; the message states the number that fits.

    Args:
        estimate: Returns the memory estimate for a number of environments; must increase with it.
        envs: Requested number of environments.
        what: Beginning of the message, if the memory is for one purpose only.
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
            f"at most {env_count_text(max_envs)} fit{'s' if max_envs == 1 else ''} on {required.device}: "
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
    """Returns the text of an error: ``estimate`` does not fit into ``memory``."""
    return (
        f"{env_count_text(estimate.envs)} need{'s' if estimate.envs == 1 else ''} "
        f"{format_bytes(estimate.bytes_at(memory.location))} of {memory.name}, of which "
        f"{format_bytes(usable_bytes(memory))} can be used ({USABLE_FRACTION:.0%} of the {format_bytes(memory.size)} available)"
    )


def env_count_text(count: int) -> str:
    """Returns a number of environments as text."""
    return f"{count} environment{'' if count == 1 else 's'}"


def _fixed(items: Iterable[MemoryItem], envs: int) -> int:
    """Returns the size of ``items`` that does not depend on the number of environments [bytes]."""
    return max(0, round(sum(item.size - envs * item.per_env for item in items)))


def _summary(items: list[MemoryItem]) -> str:
    """Returns the total size of ``items``, and their size per environment, as text."""
    per_env = sum(item.per_env for item in items)
    return format_bytes(sum(item.size for item in items)) + (
        f", {format_bytes(per_env)} per environment" if per_env else ""
    )
