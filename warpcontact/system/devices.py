"""Finds devices by name: a single one, all GPUs of this machine, or a list."""

import os
from collections.abc import Sequence

import warp as wp

from warpcontact.system.initialization import initialize, missing_driver


def find_devices(device: str | Sequence[str]) -> list[wp.Device]:
    """Returns the Warp devices named by ``device``, in order.

    Args:
        device: ``"cpu"``, ``"cuda:0"``, …; ``"auto"``: one GPU if available, else the CPU; ``"cuda"``: all visible
            GPUs; or a list of names of single devices, which may contain a name several times.

    Raises:
        ValueError: If this machine has no such device, or the list is empty.
    """
    initialize()
    gpus = wp.get_cuda_devices()
    present = {str(found): found for found in wp.get_devices()}
    listed = f"{', '.join(present)} on this machine"
    if isinstance(device, list | tuple):
        for i, name in enumerate(device):
            if str(name) not in present:
                raise ValueError(f"device[{i}] must be one of {listed}, got {name!r}{_why_missing(name, gpus)}")
        if not device:
            raise ValueError(f"device must list at least one of {listed}, got {device!r}")
        return [present[str(name)] for name in device]
    if device == "auto":
        return [gpus[0] if gpus else present["cpu"]]
    if device == "cuda" and gpus:
        return list(gpus)
    if str(device) not in present:
        every = ", 'cuda' (all GPUs)" if gpus else ", which has no GPU"
        raise ValueError(
            f"device must be 'auto' or one of {listed}{every}, or a list of devices, got {device!r}"
            f"{_why_missing(device, gpus)}"
        )
    return [present[str(device)]]


def _why_missing(device: object, gpus: Sequence[wp.Device]) -> str:
    """Returns the reason why no CUDA device was found, as the end of a message, if ``device`` is one."""
    if gpus or not str(device).startswith("cuda"):
        return ""
    driver, toolkit = wp.get_cuda_driver_version(), wp.get_cuda_toolkit_version()
    if (reason := missing_driver()) is not None:
        reason = f"the NVIDIA driver cannot be loaded ({reason})"
    elif toolkit is None:
        reason = "this build of Warp has no CUDA"
    elif driver is None:
        reason = "the NVIDIA driver cannot be initialized"
    elif driver[0] < toolkit[0]:
        reason = f"the NVIDIA driver supports CUDA {driver[0]}.{driver[1]}, Warp requires {toolkit[0]}.0 or later"
    else:
        shown = os.environ.get("CUDA_VISIBLE_DEVICES")
        reason = "the NVIDIA driver reports no device" + (f" (CUDA_VISIBLE_DEVICES={shown})" if shown else "")
    return f"; no CUDA device was found: {reason}"


def find_device(device: str) -> wp.Device:
    """Returns the single Warp device named by ``device``, see ``find_devices``.

    Raises:
        ValueError: If this machine has no such device, or ``device`` names several.
    """
    found = find_devices(device)
    if len(found) > 1:
        raise ValueError(f"device must be a single one, got {device!r}, which is {', '.join(map(str, found))}")
    return found[0]


def split_evenly(count: int, parts: int) -> list[int]:
    """Returns the numbers of environments of ``parts`` devices, ``count`` in total, as equal as possible.

    With fewer environments than devices, there is one environment per part.
    """
    parts = min(parts, count)
    return [count // parts + (part < count % parts) for part in range(parts)]
