"""How the arrays of a struct lie in memory, told to the compiler: a third of what a core executed was addresses.

Warp looks up where an array begins, and its strides, at run time. On a CPU what belongs to an item lies side by
side, in a record of known size, and other arrays are as wide as their neighbors: so one address serves for many,
and most of it is constant. ``warpcontact/storage/allocation_plan.py`` makes them so; ``tests/test_strides.py`` compares.
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
    "ActiveContacts": (("count", "crossed_count", "force", "torque_1", "torque_2"),),
    "Cache": (
        (
            "nearest",
            "list_center",
            "uncached_bound",
            "clearance",
            "clearance_center",
            "valid_radius",
            "valid_center",
            "tied_count",
        ),
        (
            "set_position",
            "set_orientation",
            "set_travel",
            "set_step_travel",
            "set_margin",
            "set_safe_travel",
            "set_culled",
        ),
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
    "ActiveContacts": (("needs_history", "contact"),),
    "Cache": (
        ("cluster_safe_travel", "cluster_probe_travel", "cluster_inactive"),
        ("safe_travel", "face_count"),
        ("face", "distance", "gradient"),
    ),
}
# By struct, arrays of a fixed width.
_FIXED: dict[str, dict[str, int]] = {
    "Model": {"face_corner": 4, "face_frame": 4, "face_normal": 7, "face_flags": 7, "face_neighbor": 3},
}
# Structs of which all environments may share one row, so that only the strides along it are known.
_SHARED = ("Model", "Coefficients")


def record_fields(struct: Any) -> tuple[tuple[str, ...], ...]:
    """Returns the names of the arrays of a struct that lie in records on a CPU, by kinds, in their order there."""
    kinds = _IN_RECORDS.get(struct.cls.__name__, ())
    return (tuple(struct.vars),) if kinds is None else kinds


def record_layout(dtypes: Mapping[str, Any]) -> tuple[dict[str, int], int]:
    """Returns where in a record of elements each begins, and how long the record is [bytes]."""
    offsets, end = {}, 0
    for name, dtype in dtypes.items():
        element = wp.types.type_size_in_bytes(dtype)
        aligned = element // wp.types.type_size(dtype)
        offsets[name] = -(-end // aligned) * aligned
        end = offsets[name] + element
    return offsets, -(-end // RECORD) * RECORD


def _array_types(struct: Any) -> dict[str, Any]:
    return {
        name: struct_copy.type
        for name, struct_copy in struct.vars.items()
        if isinstance(struct_copy.type, wp.array)
    }


@functools.cache
def assume_strides(struct: Any) -> wp.Function:
    """Returns the device function that tells the compiler how the arrays of a struct lie.

    It writes what is there anyway, into the copy of the struct that a thread has. On a GPU it does nothing.
    """
    kind, types = struct.cls.__name__, _array_types(struct)
    lines = ["#if !defined(__CUDA_ARCH__)"]
    for names in record_fields(struct):
        first = names[0]
        offsets, size = record_layout({name: types[name].dtype for name in names})
        for name in names:
            lines.append(
                f"struct_copy.{name}.data = reinterpret_cast<decltype(struct_copy.{name}.data)>("
                f"reinterpret_cast<char*>(struct_copy.{first}.data) + {offsets[name]});"
            )
            lines.append(f"struct_copy.{name}.strides[0] = struct_copy.{first}.shape[1] * {size};")
            lines.append(f"struct_copy.{name}.strides[1] = {size};")
    widest = {name: names[0] for names in _EQUALLY_WIDE.get(kind, ()) for name in names}
    fixed = _FIXED.get(kind, {})
    for name, array_type in types.items():
        if any(name in names for names in record_fields(struct)):
            continue
        size = f"(signed)sizeof(*struct_copy.{name}.data)"
        lines.append(f"struct_copy.{name}.strides[{array_type.ndim - 1}] = {size};")
        if name in fixed:
            lines.append(f"struct_copy.{name}.strides[0] = {fixed[name]} * {size};")
        elif array_type.ndim == 2 and kind not in _SHARED:
            lines.append(
                f"struct_copy.{name}.strides[0] = struct_copy.{widest.get(name, name)}.shape[1] * {size};"
            )
    lines.append("#endif\n")

    @wp.func_native("\n".join(lines))
    def assume(struct_copy: wp.ref[struct]): ...

    return assume


@wp.func_native(
    """
    #if !defined(__CUDA_ARCH__)
    asm volatile("" : "+r"(number));
    #endif
    if (number < 0) __builtin_unreachable();
    return number;
    """
)
def hide_from_optimizer(number: int) -> int:
    """The same number, not negative, of which the compiler does not know that: for loops of few turns.

    Else it computes what follows from the number before a loop, the addresses of all arrays in there, whatever is
    asked for.
    """
    ...
