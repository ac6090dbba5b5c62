"""Available threads and memory, of devices and of this machine within the limits of its control groups."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil

HOST = "host"

# Control groups of Linux, whose limits psutil does not include.
_CGROUP = Path("/proc/self/cgroup")
_CGROUPS = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class AvailableMemory:
    """Memory that is currently available.

    Attributes:
        location: ``"host"``, or the name of a device.
        size: Available memory [bytes].
    """

    location: str
    size: int

    @property
    def name(self) -> str:
        """Name for messages."""
        return "the memory of this machine" if self.location == HOST else f"the memory of {self.location}"


def available_threads() -> int:
    """Returns the number of threads that this process may run concurrently."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def available_memory(location: str) -> AvailableMemory | None:
    """Returns the available memory of ``location``; ``None``: not reported by the device."""
    size = _host() if location == HOST else _device(location)
    return None if size is None else AvailableMemory(location, size)


def _device(name: str) -> int | None:
    """Returns the free memory of a CUDA device."""
    import warp as wp

    device = wp.get_device(name)
    free = int(device.free_memory)
    return free if free > 0 else None


def _host() -> int:
    """Returns the host memory that this process can still allocate [bytes]."""
    return max(0, min([psutil.virtual_memory().available, *_cgroup_limits()]))


def used_memory() -> int:
    """Returns the host memory in use by this process [bytes]."""
    return int(psutil.Process().memory_info().rss)


def _cgroup_limits() -> Iterator[int]:
    """Iterates over the remaining memory of the control groups (version 1 or 2) of this process [bytes]."""
    try:
        lines = _CGROUP.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return
    for line in lines:
        number, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if number == "0" and not controllers:
            top, files = _CGROUPS, ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
            top, files = _CGROUPS / "memory", names
        else:
            continue
        # In a container, the path may be that on the host, while the container's own group is at the top.
        group = top / path.strip("/")
        for folder in (group, *(parent for parent in group.parents if parent.is_relative_to(top))):
            left = _remaining(folder, *files)
            if left is not None:
                yield left


def _remaining(folder: Path, limit: str, usage: str, reclaimable: str) -> int | None:
    """Returns the remaining memory of a control group [bytes]; ``None``: it has no limit."""
    try:
        allowed = int((folder / limit).read_text(encoding="utf-8"))  # "max": no limit
        used = int((folder / usage).read_text(encoding="utf-8"))
        stat = dict(line.split() for line in (folder / "memory.stat").read_text(encoding="utf-8").splitlines())
        return allowed - used + int(stat.get(reclaimable, 0))
    except (OSError, ValueError):
        return None
