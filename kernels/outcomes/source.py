"""Value of a sensor for outcomes, stop conditions and events, from an array (env, item, component)."""

import functools
from typing import NamedTuple

import warp as wp

#: Reductions over the items of a set.
EACH, SUM, LARGEST, SMALLEST = "each", "sum", "max", "min"
ITEM_REDUCTIONS = (EACH, SUM, LARGEST, SMALLEST)
#: Largest number of sources of an outcome.
MAX_SOURCES = 4


class SourceForm(NamedTuple):
    """How a value is computed from the array of a sensor.

    Attributes:
        dtype: Scalar type of the array.
        norm: Whether the value is the length of the vector.
        items: One of ``ITEM_REDUCTIONS``.
    """

    dtype: type
    norm: bool
    items: str


@functools.cache
def value(form: SourceForm) -> wp.Function:
    """Returns the device function ``(array, env, item, component)`` of a source."""
    dtype, norm = form.dtype, form.norm
    reduces_items, sums, highest = form.items != EACH, form.items == SUM, form.items == LARGEST

    @wp.func
    def component_value(array: wp.array3d(dtype=dtype), env: int, item: int, component: int):
        if wp.static(norm):
            total = wp.float64(0.0)
            for other in range(array.shape[2]):
                x = wp.float64(array[env, item, other])
                total += x * x
            return wp.sqrt(total)
        return wp.float64(array[env, item, component])

    @wp.func
    def value(array: wp.array3d(dtype=dtype), env: int, item: int, component: int):
        if wp.static(reduces_items):
            result = component_value(array, env, 0, component)
            for other in range(1, array.shape[1]):
                x = component_value(array, env, other, component)
                if wp.static(sums):
                    result += x
                elif wp.static(highest):
                    result = wp.where(x > result, x, result)
                else:
                    result = wp.where(x < result, x, result)
            return result
        return component_value(array, env, item, component)

    return value


@functools.cache
def values(forms: tuple[SourceForm, ...]) -> wp.Function:
    """Returns the device function that evaluates up to four sources, as a number or a vector.

    With fewer sources the remaining arrays are not read.
    """
    of = [value(form) for form in forms]
    count = len(forms)
    of += of[:1] * (MAX_SOURCES - count)
    value_0, value_1, value_2, value_3 = of
    types = [form.dtype for form in forms] + [forms[0].dtype] * (MAX_SOURCES - count)
    type_0, type_1, type_2, type_3 = types
    Vector = wp.types.vector(length=max(2, count), dtype=wp.float64)

    @wp.func
    def number(
        a: wp.array3d(dtype=type_0),
        b: wp.array3d(dtype=type_1),
        c: wp.array3d(dtype=type_2),
        d: wp.array3d(dtype=type_3),
        env: int,
        item: int,
        component: int,
    ):
        return value_0(a, env, item, component)

    @wp.func
    def vector(
        a: wp.array3d(dtype=type_0),
        b: wp.array3d(dtype=type_1),
        c: wp.array3d(dtype=type_2),
        d: wp.array3d(dtype=type_3),
        env: int,
        item: int,
        component: int,
    ):
        x = Vector()
        x[0] = value_0(a, env, item, component)
        x[1] = value_1(b, env, item, component)
        if wp.static(count > 2):
            x[2] = value_2(c, env, item, component)
        if wp.static(count > 3):
            x[3] = value_3(d, env, item, component)
        return x

    return number if count == 1 else vector


def array_types(forms: tuple[SourceForm, ...]) -> list[type]:
    """Returns the scalar types of the four arrays."""
    return [form.dtype for form in forms] + [forms[0].dtype] * (MAX_SOURCES - len(forms))
