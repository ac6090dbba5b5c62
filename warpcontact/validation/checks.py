"""Checks of user input. Each error names the entry, the value and the condition."""

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels.catalogue.device_model import as_numbers, check_values
from warpcontact.kernels.catalogue.names import suggestion

Array = NDArray[np.float64]

# Largest number of names listed in a message.
MAX_LISTED = 20

#: Largest length of a name that is used in file names [bytes of UTF-8].
MAX_NAME_LENGTH = 200

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def limits(
    unit: str,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    may_be_infinite: bool = False,
) -> Mapping[str, Any]:
    """Returns an allowed range in the form that ``check_values`` requires."""
    return {
        "unit": unit,
        "above": above,
        "at_least": at_least,
        "at_most": at_most,
        "may_be_infinite": may_be_infinite,
    }


FINITE = limits("-")
# A normalized quaternion has a computed length of 1 within at most 7 roundings of 1.1e-16.
UNIT_ROUNDING = 1.0e-15


def numbers(name: str, value: ArrayLike, shape: tuple[int, ...], allowed: Mapping[str, Any] = FINITE) -> Array:
    """Returns ``value`` as float64 of exactly ``shape``, or raises ``ValueError``."""
    given = as_numbers(value)
    if given is None:
        raise ValueError(f"{name} must be {describe_shape(shape)}, got {value!r}")
    values = np.array(given, dtype=np.float64)
    if values.shape != shape:
        raise ValueError(f"{name} must be {describe_shape(shape)}, got {_brief(value, values)}")
    check_values(name, values, allowed)
    return values


def shape_of(name: str, value: ArrayLike, kind: str = "numbers") -> tuple[int, ...]:
    """Returns the shape of numbers, or raises ``ValueError``, whose message calls them ``kind``."""
    given = as_numbers(value)
    if given is None:
        raise ValueError(f"{name} must be {kind}, got {value!r}")
    return given.shape


def row(name: str, value: ArrayLike, allowed: Mapping[str, Any] = FINITE) -> Array:
    """Returns one number or a list of numbers as float64 (n,), or raises ``ValueError``."""
    given = as_numbers(value)
    if given is None or given.ndim > 1 or not given.size:
        raise ValueError(f"{name} must be a number or a list of numbers, got {value!r}")
    return np.atleast_1d(numbers(name, given, given.shape, allowed))


def entries(value: Any) -> list[Any]:
    """Returns the entries of ``value``, or a list with ``value`` itself if it has none, such as a number."""
    if isinstance(value, np.ndarray) and not value.ndim:
        return [value[()]]
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str) else [value]


def describe_shape(shape: tuple[int, ...]) -> str:
    """Returns ``shape`` as text."""
    if shape == ():
        return "a number"
    if len(shape) == 1:
        return f"{shape[0]} numbers"
    return f"numbers of shape {shape}"


def _brief(value: ArrayLike, values: Array) -> str:
    return repr(value) if values.size <= 9 else f"an array of shape {values.shape}"


def unit_quaternions(name: str, value: Array) -> Array:
    """Returns quaternions (…, 4), in the order x, y, z, w, normalized to length 1.

    Quaternions of length 1 up to rounding are returned unchanged, so that normalizing twice has no effect.

    Raises:
        ValueError: If a length differs from 1 by more than 1e-3, which is more than rounding errors.
    """
    length = np.linalg.norm(value, axis=-1)
    invalid = np.argwhere(np.abs(length - 1.0) > 1.0e-3)
    if len(invalid):
        where = tuple(invalid[0])
        raise ValueError(
            f"{name}{list(map(int, where)) if where else ''} must be a unit quaternion (x, y, z, w), "
            f"got {value[where].tolist()} of length {length[where]:g}"
        )
    return value / np.where(np.abs(length - 1.0) <= UNIT_ROUNDING, 1.0, length)[..., None]


def switches(name: str, value: Array) -> Array:
    """Returns ``value`` if all entries are 0 or 1, or raises ``ValueError``."""
    invalid = np.argwhere((value != 0.0) & (value != 1.0))
    if len(invalid):
        raise ValueError(f"{name}{list(map(int, invalid[0]))} must be 0 or 1, got {value[tuple(invalid[0])]:g}")
    return value


def switch(name: str, value: Any) -> bool:
    """Returns ``value`` as a ``bool`` if it is true, false, 0 or 1, or raises ``ValueError``."""
    if not isinstance(value, bool | int | float | np.bool_ | np.number) or value not in (0, 1):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def integer(name: str, value: object, least: int = 1) -> int:
    """Returns ``value`` if it is an integer of at least ``least``, or raises ``ValueError``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return int(value)


def integers(name: str, value: Array) -> Array:
    """Returns ``value`` if all entries are integers, or raises ``ValueError``."""
    _raise_for_first(name, value, value != np.round(value), "a whole number")
    return value


def inertia_tensors(name: str, value: Array) -> Array:
    """Returns inertia tensors (…, 3, 3), symmetrized, checked to be physical [kg·m²].

    Raises:
        ValueError: If one is not symmetric, not positive definite, or violates the triangle inequality of the
            principal moments (no mass distribution has I₁ > I₂ + I₃).
    """
    scale = np.abs(value).max(axis=(-2, -1))
    skew = np.abs(value - np.swapaxes(value, -2, -1)).max(axis=(-2, -1))
    _raise_for_first(name, value, skew > 1.0e-6 * scale, "symmetric")
    symmetric = 0.5 * (value + np.swapaxes(value, -2, -1))
    moments = np.linalg.eigvalsh(symmetric)
    _raise_for_first(name, value, moments[..., 0] <= 1.0e-9 * moments[..., 2], "positive definite [kg·m²]")
    # The tolerance accepts a thin plate, for which equality holds, with rounding errors.
    too_large = moments[..., 2] > (moments[..., 0] + moments[..., 1]) * (1.0 + 1.0e-6)
    _raise_for_first(name, value, too_large, "physical: no principal moment may exceed the sum of the other two")
    return symmetric


def _raise_for_first(name: str, value: Array, invalid: NDArray[np.bool_], allowed: str) -> None:
    where = np.argwhere(invalid)
    if len(where):
        index = tuple(where[0])
        # The last axes have length 1 if the user gave none; omit their indices.
        axes = max((axis + 1 for axis, length in enumerate(invalid.shape) if length > 1), default=0)
        entry = f"{name}{list(map(int, index[:axes])) or ''}"
        raise ValueError(f"{entry} must be {allowed}, got {value[index].tolist()}")


def choice(name: str, value: Any, allowed: Sequence[str]) -> str:
    """Returns ``value`` if it is one of ``allowed``, or raises ``ValueError``."""
    if not isinstance(value, str) or value not in allowed:
        options = ", ".join(repr(option) for option in allowed)
        raise ValueError(f"{name} must be one of {options}, got {value!r}{suggestion(value, allowed)}")
    return str(value)


def new_name(kind: str, value: str | None, taken: Mapping[str, Any]) -> str:
    """Returns ``value`` as the name of a new element, or a name derived from ``kind`` if it is ``None``."""
    if value is None:
        value, number = kind, 1
        while value in taken:
            number += 1
            value = f"{kind}_{number}"
        return value
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise ValueError(
            f"name of a {kind} must be letters, digits, _ and -, not starting with a digit, got {value!r}"
        )
    check_length(f"name of a {kind}", value)
    if value in taken or value == "scene":
        raise ValueError(f"name {value!r} of a {kind} is taken; every name in a scene is used once")
    return value


def key(what: str, value: object) -> str:
    """Returns ``value`` if it is a valid key in a dictionary of names, or raises ``ValueError``."""
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise ValueError(
            f"{what}: a name must be letters, digits, _ and -, not starting with a digit, got {value!r}"
        )
    check_length(f"{what}: a name", value)
    return value


def check_length(what: str, name: str, most: int = MAX_NAME_LENGTH) -> None:
    """Raises ``ValueError`` if a name is too long for a file name."""
    size = len(name.encode(errors="surrogatepass"))
    if size > most:
        raise ValueError(
            f"{what} must have at most {most} bytes, as files are named after it, got {size}: {name[:20]!r}…"
        )


def find_entry(
    kind: str,
    name: str,
    table: Mapping[str, Any],
    stored: Callable[[str], str] = str,
    hint: Callable[[str, Mapping[str, Any]], str] | None = None,
) -> Any:
    """Returns the entry ``name``.

    Args:
        kind: Kind of the entries, for messages.
        name: Name or alias of an entry.
        table: The entries by name.
        stored: Returns the name for an alias, other names unchanged.
        hint: Returns the end of the message from an unknown name and the entries. Default: similar names.

    Raises:
        TypeError: If ``name`` is not a string.
        KeyError: If there is none; the message suggests names.
    """
    if not isinstance(name, str):
        raise TypeError(f"name of a {kind} must be a string, got {name!r}")
    try:
        return table[stored(name)]
    except KeyError:
        end = similar(name, table) if hint is None else hint(name, table)
        raise KeyError(f"no {kind} {name!r}{end}") from None


def similar(name: str, known: Collection[str]) -> str:
    """Returns the end of a message about an unknown name: the closest known name, or some of all names."""
    return suggestion(name, known) or f"; {available_names(name, known)}"


def available_names(name: str, known: Iterable[str]) -> str:
    """Returns the available names as text: of the same element, or the elements with names if it has none."""
    first = name.partition(".")[0]
    names = list(known)
    listed = [one for one in names if one.startswith(f"{first}.")]
    # Names without dots are those of elements.
    listed = listed or list(dict.fromkeys(one.partition(".")[0] + ".*" * ("." in one) for one in names))
    return f"there are: {', '.join(listed[:MAX_LISTED]) or 'none'}{', …' * (len(listed) > MAX_LISTED)}"


def element(value: Any) -> str:
    """Returns a short description of a value that was given instead of an element of a scene."""
    name = getattr(value, "name", None)
    return f"{type(value).__name__} {name!r}" if isinstance(name, str) else repr(value)


def color(name: str, value: ArrayLike | None) -> Array | None:
    """Returns an RGB color with components from 0 to 1."""
    if value is None:
        return None
    return numbers(name, value, (3,), limits("-", at_least=0.0, at_most=1.0))
