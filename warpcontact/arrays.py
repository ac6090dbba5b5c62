"""Arrays on a device: those of a struct, made together, and those that all environments share."""

from typing import Any

import warp as wp

# A record takes a multiple of this [bytes], as much as a GPU fetches at once.
RECORD = 32


def allocate(
    struct: Any, shape: tuple[int, int], device: wp.Device, records: bool = False, **others: tuple[int, ...]
) -> Any:
    """Returns an instance of a Warp struct of arrays [env, item], zero.

    Args:
        struct: The struct.
        shape: Shape of its arrays.
        device: Where they are.
        records: Whether what belongs to an item lies side by side: few items here and there are fetched whole.
        others: Arrays that have a shape of their own, and lie apart.
    """
    instance = struct()
    shapes = {name: others.get(name, shape) for name in struct.vars}
    arrays = {name: struct.vars[name].type.dtype for name in struct.vars}
    side_by_side = {name: dtype for name, dtype in arrays.items() if records and name not in others}
    for name, array in _records(side_by_side, shape, device).items():
        setattr(instance, name, array)
    for name in arrays.keys() - side_by_side.keys():
        setattr(instance, name, wp.zeros(shapes[name], dtype=arrays[name], device=device))
    return instance


def _records(arrays: dict[str, Any], shape: tuple[int, int], device: wp.Device) -> dict[str, wp.array]:
    """Returns arrays of some types, interleaved in one piece of memory."""
    if not arrays:
        return {}
    offsets, size = {}, 0
    for name, dtype in arrays.items():
        element = wp.types.type_size_in_bytes(dtype)
        number = element // wp.types.type_size(dtype)
        offsets[name] = -(-size // number) * number
        size = offsets[name] + element
    size = -(-size // RECORD) * RECORD
    memory = wp.zeros(max(1, shape[0] * shape[1]) * size, dtype=wp.uint8, device=device)
    result = {}
    for name, dtype in arrays.items():
        result[name] = wp.array(
            ptr=memory.ptr + offsets[name],
            dtype=dtype,
            shape=shape,
            strides=(size * shape[1], size),
            device=device,
            copy=False,
        )
        result[name].memory = memory  # which lives as long as the last of them
    return result


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
