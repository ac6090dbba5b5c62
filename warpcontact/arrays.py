"""Arrays on a device: those of a struct, made together, and those that all environments share."""

from typing import Any

import warp as wp


def allocate(struct: Any, shape: tuple[int, int], device: wp.Device, **others: tuple[int, ...]) -> Any:
    """Returns an instance of a Warp struct of arrays [env, item], each of ``shape``, or its own one, and zero."""
    instance = struct()
    for name, variable in struct.vars.items():
        array = wp.zeros(others.get(name, shape), dtype=variable.type.dtype, device=device)
        setattr(instance, name, array)
    return instance


def broadcast(memory: wp.array, envs: int) -> wp.array:
    """Returns ``memory`` (1 or envs, items) as an array (envs, items), with stride 0 if it is shared.

    The caller keeps ``memory`` alive.
    """
    if memory.shape[0] == envs:
        return memory
    return wp.array(
        ptr=memory.ptr,
        shape=(envs, *memory.shape[1:]),
        strides=(0, *memory.strides[1:]),
        dtype=memory.dtype,
        device=memory.device,
        copy=False,
    )
