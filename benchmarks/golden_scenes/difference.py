"""Hashes of named arrays, and their differences in absolute and relative terms and in units in the last place."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

Arrays = Mapping[str, np.ndarray]

#: Group of the sensors at the end of a run.
SENSORS = "sensors"


def digest(arrays: Arrays) -> str:
    """Returns the SHA-256 of arrays in the order of their names: name, type, shape and all bytes of each."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        found.update(f"{name}\n{values.dtype.str}\n{values.shape}\n".encode())
        found.update(values.tobytes())
    return found.hexdigest()


def digests(arrays: Arrays) -> dict[str, str]:
    """Returns the hash of each group of arrays, the part of their names before the first ``/``."""
    groups: dict[str, dict[str, np.ndarray]] = {}
    for name, values in arrays.items():
        groups.setdefault(name.partition("/")[0], {})[name] = values
    return {group: digest(groups[group]) for group in sorted(groups)}


@dataclass(frozen=True)
class Difference:
    """Two arrays of one name that are not bitwise identical.

    Attributes:
        name: Name of the array.
        absolute: Largest absolute difference, in the unit of the array; infinite if a value is NaN in one only.
        relative: Largest relative difference of a value.
        scaled: Largest absolute difference over the largest finite magnitude in the arrays.
        ulps: Largest difference in units in the last place; of integers their difference.
        count: Number of values that differ.
        size: Number of values.
        first: First index along the first axis at which values differ: the frame of a recording.
        note: Difference of another kind, such as of shape; empty if there is none.
    """

    name: str
    absolute: float = 0.0
    relative: float = 0.0
    scaled: float = 0.0
    ulps: int = 0
    count: int = 0
    size: int = 0
    first: int = 0
    note: str = ""

    def __str__(self) -> str:
        if self.note:
            return f"{self.name}: {self.note}"
        return (
            f"{self.name}: {self.absolute:.3g} absolute, {self.relative:.3g} relative, {self.ulps} ulp, "
            f"{self.count} of {self.size} values, from index {self.first}"
        )


def compare_values(name: str, one: np.ndarray, other: np.ndarray) -> Difference | None:
    """Returns the difference of two arrays, ``None`` if they are bitwise identical."""
    if one.shape != other.shape:
        return Difference(name, note=f"shape {one.shape} and {other.shape}")
    if one.dtype != other.dtype:
        return Difference(name, note=f"type {one.dtype} and {other.dtype}")
    if one.tobytes() == other.tobytes():
        return None
    first, second = np.atleast_1d(one), np.atleast_1d(other)
    if one.dtype.kind not in "fiub":
        differs = first != second
        return Difference(name, note=f"{np.count_nonzero(differs)} of {differs.size} values")
    ulps = ulp_distance(first, second)
    differs = ulps != 0
    with np.errstate(all="ignore"):
        a, b = first.astype(np.float64), second.astype(np.float64)
        absolute = np.abs(a - b)
        # One NaN, or infinities of opposite sign, are infinitely apart; two NaN of different bits are not.
        absolute[np.isnan(absolute)] = np.inf
        absolute[(np.isnan(a) & np.isnan(b)) | (a == b)] = 0.0
        scale = np.maximum(np.abs(a), np.abs(b))
        relative = np.where(absolute == 0.0, 0.0, absolute / scale)
        relative[np.isnan(relative)] = np.inf
        largest = max(np.max(np.abs(values), where=np.isfinite(values), initial=0.0) for values in (a, b))
    return Difference(
        name,
        absolute=float(absolute.max()),
        relative=float(relative.max()),
        scaled=float(absolute.max() / largest) if largest > 0.0 else float(absolute.max()),
        ulps=int(ulps.max()),
        count=int(np.count_nonzero(differs)),
        size=differs.size,
        first=int(np.argwhere(differs)[0, 0]),
    )


def ulp_distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns the number of representable values from ``one`` to ``other``, element by element.

    Zeros of either sign are one value; a difference of their sign alone counts as 1. For integers it is the
    difference.

    Args:
        one: Floats, integers or booleans.
        other: Array of the same type and shape.
    """
    if one.dtype.kind != "f":
        distance: np.ndarray = np.abs(one.astype(object) - other.astype(object))
        return distance
    integer = {2: np.int16, 4: np.int32, 8: np.int64}[one.dtype.itemsize]
    ranks = []
    for values in (one, other):
        bits = np.ascontiguousarray(values).view(integer).astype(object)
        # Of negative numbers the magnitude grows with the bits, so that ranks fall.
        ranks.append(np.where(bits < 0, -(bits & int(np.iinfo(integer).max)), bits))
    distance = np.abs(ranks[0] - ranks[1])
    signed_zeros = (distance == 0) & (np.signbit(one) != np.signbit(other))
    return np.where(signed_zeros, 1, distance)


def missing(one: Arrays, other: Arrays) -> list[str]:
    """Returns the names of arrays that are in ``one`` only, without sensors, which a checkout may add."""
    return sorted(name for name in set(one) - set(other) if not name.startswith(f"{SENSORS}/"))


def differences(
    one: Arrays, other: Arrays, labels: Iterable[str] = ("the first", "the second")
) -> list[Difference]:
    """Returns the differences of two sets of arrays, those of shape or type first, then by their scaled size."""
    first, second = labels
    found = [Difference(name, note=f"only in {first}") for name in missing(one, other)]
    found += [Difference(name, note=f"only in {second}") for name in missing(other, one)]
    for name in sorted(set(one) & set(other)):
        difference = compare_values(name, one[name], other[name])
        if difference is not None:
            found.append(difference)
    return sorted(found, key=_rank)


def _rank(difference: Difference) -> tuple[bool, bool, float, int, str]:
    # The remainder of a rounded position has no scale: any change of the position changes all of it.
    remainder = difference.name.endswith("_remainder")
    return not difference.note, remainder, -difference.scaled, -difference.ulps, difference.name
