"""Devices by name: one, all GPUs of this machine, or a list."""

from collections.abc import Sequence

import warp as wp


def find_devices(device: str | Sequence[str]) -> list[wp.Device]:
    """Returns the Warp devices that ``device`` asks for, in order.

    Args:
        device: ``"cpu"``, ``"cuda:0"``, …; ``"auto"``: one GPU if there is any, else the CPU; ``"cuda"``: all GPUs
            that CUDA shows; or a list of names of single devices, in which one may come more than once.

    Raises:
        ValueError: If this machine has no such device, or the list is empty.
    """
    wp.init()
    gpus = wp.get_cuda_devices()
    present = {str(found): found for found in wp.get_devices()}
    listed = f"{', '.join(present)} on this machine"
    if isinstance(device, list | tuple):
        for i, name in enumerate(device):
            if str(name) not in present:
                raise ValueError(f"device[{i}] must be one of {listed}, got {name!r}")
        if not device:
            raise ValueError(f"device must list at least one of {listed}, got {device!r}")
        return [present[str(name)] for name in device]
    if device == "auto":
        return [gpus[0] if gpus else present["cpu"]]
    if device == "cuda" and gpus:
        return list(gpus)
    if str(device) not in present:
        every = ", 'cuda' (all GPUs)" if gpus else ", which has no GPU"
        raise ValueError(f"device must be 'auto' or one of {listed}{every}, or a list of devices, got {device!r}")
    return [present[str(device)]]


def find_device(device: str) -> wp.Device:
    """Returns the one Warp device that ``device`` asks for, in the words of ``find_devices``.

    Raises:
        ValueError: If this machine has no such device, or it asks for several.
    """
    found = find_devices(device)
    if len(found) > 1:
        raise ValueError(f"device must be a single one, got {device!r}, which is {', '.join(map(str, found))}")
    return found[0]


def spread(count: int, parts: int) -> list[int]:
    """Returns how many of ``count`` environments each of ``parts`` devices has, as equal as possible.

    There are no more parts than environments.
    """
    parts = min(parts, count)
    return [count // parts + (part < count % parts) for part in range(parts)]
