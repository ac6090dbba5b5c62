"""Available threads and memory, of devices and of this machine within the limits of its control groups."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

HOST = "host"

# Sources of information on Linux.
_MEMINFO = Path("/proc/meminfo")
_STATUS = Path("/proc/self/status")
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
    """Returns the available memory of ``location``; ``None``: not reported by the system."""
    size = _host() if location == HOST else _device(location)
    return None if size is None else AvailableMemory(location, size)


def _device(name: str) -> int | None:
    """Returns the free memory of a CUDA device."""
    import warp as wp

    device = wp.get_device(name)
    free = int(device.free_memory)
    return free if free > 0 else None


def _host() -> int | None:
    """Returns the host memory that this process can still allocate [bytes]."""
    limits = [size for size in (_free(), *_cgroup_limits()) if size is not None]
    return max(0, min(limits)) if limits else None


def _free() -> int | None:
    """Returns the free or reclaimable memory [bytes]; on systems that do not report it, the total memory."""
    free = _read_kilobytes(_MEMINFO, "MemAvailable")
    if free is not None:
        return free
    for name in ("SC_AVPHYS_PAGES", "SC_PHYS_PAGES"):
        try:
            pages, size = os.sysconf(name), os.sysconf("SC_PAGE_SIZE")
        except (AttributeError, ValueError, OSError):
            continue
        if pages > 0 and size > 0:
            return pages * size
    return None


def used_memory() -> int | None:
    """Returns the host memory in use by this process [bytes]; ``None``: not reported by the system."""
    return _read_kilobytes(_STATUS, "VmRSS")


def _read_kilobytes(path: Path, name: str) -> int | None:
    """Returns a value in kB from a file of Linux, converted to bytes."""
    try:
        for line in path.read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            if key == name:
                return 1024 * int(value.split()[0])
    except (OSError, ValueError, IndexError):
        pass
    return None


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
        used_memory = int((folder / usage).read_text(encoding="utf-8"))
        stat = dict(line.split() for line in (folder / "memory.stat").read_text(encoding="utf-8").splitlines())
        return allowed - used_memory + int(stat.get(reclaimable, 0))
    except (OSError, ValueError):
        return None
