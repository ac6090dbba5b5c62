"""Array layout of structs as compile-time information for CPU kernels.

Warp reads the address and strides of an array at run time; computing addresses took a third of the instructions.
On a CPU, arrays of one item kind are interleaved in records of known size. Groups of other arrays have rows of equal
length. So one address serves several arrays and most offsets are constants.
``warpcontact/storage/allocation_plan.py`` allocates this layout; ``tests/kernels/test_static_strides.py`` checks it.
"""

import functools
from collections.abc import Mapping
from typing import Any

import warp as wp
from warpcontact.kernels.lowlevel.switches import is_enabled

# The size of a record is a multiple of this [bytes], the memory transaction size of a GPU.
RECORD = 32

# By struct, the arrays that are interleaved in records on a CPU, one tuple per kind of item; None: all arrays. Not
# the state, because its arrays are shared with other libraries, some of which accept no strided arrays.
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
# By struct, groups of other arrays with the same row length.
_SAME_ROW_LENGTH: dict[str, tuple[tuple[str, ...], ...]] = {
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
# By struct, arrays of a fixed row length.
_FIXED_ROW_LENGTH: dict[str, dict[str, int]] = {
    "Model": {"face_corner": 4, "face_frame": 4, "face_normal": 7, "face_flags": 7, "face_neighbor": 3},
}
# Structs whose rows may be shared by all environments, so that only the strides along a row are known.
_SHARED = ("Model", "Coefficients")


def record_fields(struct: Any) -> tuple[tuple[str, ...], ...]:
    """Returns the names of the arrays of a struct that are interleaved on a CPU, by kind of item, in order."""
    kinds = _IN_RECORDS.get(struct.cls.__name__, ())
    return (tuple(struct.vars),) if kinds is None else kinds


def record_layout(dtypes: Mapping[str, Any]) -> tuple[dict[str, int], int]:
    """Returns the offset of each element in a record and the size of the record [bytes]."""
    offsets, end = {}, 0
    for name, dtype in dtypes.items():
        element = wp.types.type_size_in_bytes(dtype)
        aligned = element // wp.types.type_size(dtype)
        offsets[name] = -(-end // aligned) * aligned
        end = offsets[name] + element
    return offsets, -(-end // RECORD) * RECORD


def _array_types(struct: Any) -> dict[str, Any]:
    return {name: field.type for name, field in struct.vars.items() if isinstance(field.type, wp.array)}


@functools.cache
def assume_strides(struct: Any) -> wp.Function:
    """Returns the device function that sets the strides and addresses of a struct to compile-time expressions.

    The values are equal to those in memory; they are written to the struct copy of the thread. Does nothing on a
    GPU.
    """
    if not is_enabled("strides"):

        @wp.func_native("")
        def assume_nothing(struct_copy: wp.ref[struct]): ...

        return assume_nothing

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
    row_length_of = {name: names[0] for names in _SAME_ROW_LENGTH.get(kind, ()) for name in names}
    fixed = _FIXED_ROW_LENGTH.get(kind, {})
    for name, array_type in types.items():
        if any(name in names for names in record_fields(struct)):
            continue
        size = f"(signed)sizeof(*struct_copy.{name}.data)"
        lines.append(f"struct_copy.{name}.strides[{array_type.ndim - 1}] = {size};")
        if name in fixed:
            lines.append(f"struct_copy.{name}.strides[0] = {fixed[name]} * {size};")
        elif array_type.ndim == 2 and kind not in _SHARED:
            lines.append(
                f"struct_copy.{name}.strides[0] = struct_copy.{row_length_of.get(name, name)}.shape[1] * {size};"
            )
    lines.append("#endif\n")

    @wp.func_native("\n".join(lines))
    def assume(struct_copy: wp.ref[struct]): ...

    return assume
