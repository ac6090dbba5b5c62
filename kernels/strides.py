"""How the arrays of a struct lie in memory, told to the compiler: a third of what a core executed was addresses.

Warp looks up where an array begins, and its strides, at run time. On a CPU what belongs to an item lies side by
side, in a record of known size, and other arrays are as wide as their neighbors: so one address serves for many,
and most of it is constant. ``warpcontact/arrays.py`` makes them so; ``tests/test_strides.py`` compares.
"""

import functools
from collections.abc import Mapping
from typing import Any

import warp as wp

# A record takes a multiple of this [bytes], as much as a GPU fetches at once.
RECORD = 32

# By struct, what lies in records on a CPU, of each kind of item; None: all. Not the state, whose arrays are shared
# with other libraries, of which some take none with gaps.
_IN_RECORDS: dict[str, tuple[tuple[str, ...], ...] | None] = {
    "History": None,
    "Contacts": None,
    "Near": (("count", "crossed", "force", "torque_1", "torque_2"),),
    "Cache": (
        ("nearest", "place", "beyond", "room", "room_place", "sure", "sure_place", "rivals"),
        ("set_position", "set_orientation", "set_travel", "set_step", "set_margin", "set_wake", "set_asleep"),
    ),
}
# By struct, which of its other arrays are equally wide.
_EQUALLY_WIDE: dict[str, tuple[tuple[str, ...], ...]] = {
    "State": (
        (
            "body_position",
            "body_position_remainder",
            "body_orientation",
            "body_linear_velocity",
            "body_angular_velocity",
        ),
    ),
    "Near": (("news", "contact"),),
    "Cache": (("block_wake", "block_probe", "block_quiet"), ("wake", "faces"), ("face", "distance", "direction")),
}
# By struct, arrays of a fixed width.
_FIXED: dict[str, dict[str, int]] = {
    "Model": {"face_corner": 4, "face_frame": 4, "face_normal": 7, "face_flags": 7, "face_neighbor": 3},
}
# Structs of which all environments may share one row, so that only the strides along it are known.
_SHARED = ("Model", "Coefficients")


def in_records(struct: Any) -> tuple[tuple[str, ...], ...]:
    """Returns the names of the arrays of a struct that lie in records on a CPU, by kinds, in their order there."""
    kinds = _IN_RECORDS.get(struct.cls.__name__, ())
    return (tuple(struct.vars),) if kinds is None else kinds


def record_of(dtypes: Mapping[str, Any]) -> tuple[dict[str, int], int]:
    """Returns where in a record of elements each begins, and how long the record is [bytes]."""
    offsets, end = {}, 0
    for name, dtype in dtypes.items():
        element = wp.types.type_size_in_bytes(dtype)
        aligned = element // wp.types.type_size(dtype)
        offsets[name] = -(-end // aligned) * aligned
        end = offsets[name] + element
    return offsets, -(-end // RECORD) * RECORD


def _array_types(struct: Any) -> dict[str, Any]:
    return {name: one.type for name, one in struct.vars.items() if isinstance(one.type, wp.array)}


@functools.cache
def telling(struct: Any) -> wp.Function:
    """Returns the device function that tells the compiler how the arrays of a struct lie.

    It writes what is there anyway, into the copy of the struct that a thread has. On a GPU it does nothing.
    """
    kind, types = struct.cls.__name__, _array_types(struct)
    lines = ["#if !defined(__CUDA_ARCH__)"]
    for names in in_records(struct):
        first = names[0]
        offsets, size = record_of({name: types[name].dtype for name in names})
        for name in names:
            lines.append(
                f"one.{name}.data = reinterpret_cast<decltype(one.{name}.data)>("
                f"reinterpret_cast<char*>(one.{first}.data) + {offsets[name]});"
            )
            lines.append(f"one.{name}.strides[0] = one.{first}.shape[1] * {size};")
            lines.append(f"one.{name}.strides[1] = {size};")
    widest = {name: names[0] for names in _EQUALLY_WIDE.get(kind, ()) for name in names}
    fixed = _FIXED.get(kind, {})
    for name, own in types.items():
        if any(name in names for names in in_records(struct)):
            continue
        size = f"(signed)sizeof(*one.{name}.data)"
        lines.append(f"one.{name}.strides[{own.ndim - 1}] = {size};")
        if name in fixed:
            lines.append(f"one.{name}.strides[0] = {fixed[name]} * {size};")
        elif own.ndim == 2 and kind not in _SHARED:
            lines.append(f"one.{name}.strides[0] = one.{widest.get(name, name)}.shape[1] * {size};")
    lines.append("#endif\n")

    @wp.func_native("\n".join(lines))
    def tell(one: wp.ref[struct]): ...

    return tell


@wp.func_native(
    """
    #if !defined(__CUDA_ARCH__)
    asm volatile("" : "+r"(number));
    #endif
    if (number < 0) __builtin_unreachable();
    return number;
    """
)
def anew(number: int) -> int:
    """The same number, not negative, of which the compiler does not know that: for loops of few turns.

    Else it computes what follows from the number before a loop, the addresses of all arrays in there, whatever is
    asked for.
    """
    ...
