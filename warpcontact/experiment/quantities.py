"""Validators of values in an experiment file, based on the checks of the Python API, and files with values of sets.

Files are ``.npy``, or ``.csv`` with one row per item.
"""

import io
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator, ValidationInfo

from warpcontact.experiment.errors import abbreviated
from warpcontact.files.regular_files import check_numbers
from warpcontact.files.run_folder import open_file
from warpcontact.kernels.catalogue.device_model import check_values, describe_shape, has_shape
from warpcontact.meshes.repair import REPAIRS, steps_of
from warpcontact.scene.contact_coupling import check_quadrature
from warpcontact.scene.elements import AREA, MASS, RADIUS
from warpcontact.scene.surface_contact import check_amount
from warpcontact.system.resources import HOST, available_memory
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

SUFFIXES = (".npy", ".csv")


def check_rows_file(label: str, name: str) -> str:
    """Returns ``name`` if ``read_rows`` can read this type of file, or raises ``ValueError``."""
    if Path(name).suffix.lower() not in SUFFIXES:
        raise ValueError(
            f"{label} must be a list, or a file that ends in {' or '.join(SUFFIXES)}, got {name!r}".lstrip()
        )
    return name


def read_rows(path: Path) -> Array:
    """Returns the numbers in a file: for ``.csv`` (n,) if it has one column, otherwise (n, columns).

    Lines of a ``.csv`` that begin with ``#`` are skipped. Nine columns are converted to 3×3 tensors.

    Raises:
        ValueError: If the file cannot be read or contains other data than numbers.
    """
    is_npy = path.suffix.lower() == ".npy"
    memory = available_memory(HOST)
    try:
        with open_file(path, None if memory is None else memory.size) as file:
            values = _npy_array(file) if is_npy else _csv_table(file)
    except FileNotFoundError:
        raise ValueError(f"there is no file {str(path)!r}") from None
    except OSError as error:
        raise ValueError(f"{str(path)!r} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ValueError(f"{str(path)!r} holds no table of numbers: {error}") from None
    if not is_npy:
        values = values[:, 0] if values.shape[1] == 1 else values
        values = values.reshape(-1, 3, 3) if values.shape[1:] == (9,) else values
    return np.asarray(values, dtype=np.float64)


def _npy_array(file: BinaryIO) -> NDArray[Any]:
    try:
        found = np.load(file, allow_pickle=False)
    except OSError:
        raise
    except MemoryError:
        raise ValueError("it requires more memory than available, or is damaged") from None
    except Exception:  # NumPy raises various exceptions for damaged files
        raise ValueError("it must be a complete array of numbers as written by numpy.save") from None
    if not isinstance(found, np.ndarray):
        found.close()
        raise ValueError("it must be one array as written by numpy.save, got an archive of arrays (.npz)")
    check_numbers("its values", found)
    return found


def _csv_table(file: BinaryIO) -> NDArray[Any]:
    with io.TextIOWrapper(file, encoding="utf-8-sig") as text:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the warning about empty files
                values = np.loadtxt(text, delimiter=",", ndmin=2)
        except UnicodeDecodeError:
            raise ValueError("it must be text in UTF-8") from None
        except ValueError as error:
            text.seek(0)
            raise ValueError(_csv_fault(text.read()) or str(error)) from None
    if not values.size:
        raise ValueError("it is empty")
    return values


def _csv_fault(content: str) -> str | None:
    """Returns the problem with the first invalid line of a ``.csv``; ``None``: all lines are valid."""
    columns = None
    for number, line in enumerate(content.splitlines(), 1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        cells = text.split(",")
        for k, cell in enumerate(cells, 1):
            if not _is_number(cell):
                return f"line {number}, column {k} must be a number, got {abbreviated(cell.strip())}"
        columns = columns or len(cells)
        if len(cells) != columns:
            return f"line {number} must have as many columns as those before, {columns}, got {len(cells)}"
    return None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def plain(value: Any, what: str, advice: str = "") -> Any:
    """Returns a number as ``float``, and lists of numbers as tuples.

    Args:
        value: A number, or lists, tuples or arrays of numbers.
        what: Description of the required value, for the message.
        advice: Advice against infinite values, added to the message.

    Raises:
        ValueError: If an entry is not a number, or not finite.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(plain(entry, what, advice) for entry in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"must be {what}, got {abbreviated(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"must be finite, got {abbreviated(value)}{advice}")
    return number


def numbers(
    *shapes: tuple[int, ...],
    allowed: Mapping[str, Any] = checks.FINITE,
    what: str | None = None,
    check: Callable[[str, Any], Any] | None = None,
) -> PlainValidator:
    """Returns the validator of a number (shape ``()``) or of nested lists of numbers.

    Args:
        shapes: Allowed shapes.
        allowed: Range and unit, as from ``checks.limits``.
        what: Description of the required value, for messages; default: the first shape with the unit.
        check: Additional check of values in range; raises ``ValueError``, as the functions of ``checks``.
    """
    unit = "" if allowed["unit"] == "-" else f" [{allowed['unit']}]"
    advice = "; leave the key out for no limit" if allowed.get("may_be_infinite") else ""
    what = what or f"{checks.describe_shape(shapes[0])}{unit}"

    def validate(value: Any) -> Any:
        entries = plain(value, what, advice)
        try:
            shape = np.shape(entries)
        except ValueError:  # rows of different length
            shape = (-1,)
        if shape not in shapes:
            raise ValueError(f"must be {what}, got {abbreviated(value)}")
        values = checks.numbers("", entries, shape, allowed)
        if check is not None:
            check("", values)
        return entries

    return PlainValidator(validate)


def each(
    *shapes: tuple[int, ...],
    allowed: Mapping[str, Any] = checks.FINITE,
    what: str,
    one: bool = True,
    check: Callable[[str, Any], Any] | None = None,
) -> PlainValidator:
    """Returns the validator of one value per item of a set: one value, rows, or the name of a file with rows.

    Args:
        shapes: Allowed shapes of one value.
        allowed: Range and unit, as from ``checks.limits``.
        what: Description of one value, for messages.
        one: Whether one value for all items is allowed.
        check: Additional check of values in range; raises ``ValueError``, as the functions of ``checks``.
    """
    form = (
        f"{what}, a list of that for each, or the name of a file" if one else f"a list of {what} each, or a file"
    )

    def validate(value: Any) -> Any:
        if isinstance(value, str):
            return check_rows_file("", value)
        entries = plain(value, form)
        try:
            shape = np.shape(entries)
        except ValueError:  # rows of different length
            shape = (-1,)
        if 0 in shape or not ((one and shape in shapes) or (entries and shape[1:] in shapes and shape != (-1,))):
            raise ValueError(f"must be {form}, got {abbreviated(value)}")
        values = checks.numbers("", entries, shape, allowed)
        if check is not None:
            check("", values)
        return entries

    return PlainValidator(validate)


def table(shape: tuple[int, ...], allowed: Mapping[str, Any]) -> PlainValidator:
    """Returns the validator of a table parameter of ``shape`` with ``allowed`` as its range and unit."""
    unit = "" if allowed["unit"] == "-" else f" [{allowed['unit']}]"
    what = f"{describe_shape(shape)}{unit}"

    def validate(value: Any) -> Any:
        entries = plain(value, what)
        try:
            values = np.array(entries, dtype=np.float64)
        except ValueError:  # rows of different length
            values = np.zeros(())
        if not has_shape(values, shape):
            raise ValueError(f"must be {what}, got {abbreviated(value)}")
        check_values("", values, allowed)
        return entries

    return PlainValidator(validate)


def one_of(options: Sequence[str]) -> PlainValidator:
    """Returns the validator of one of the strings ``options``."""
    return PlainValidator(lambda value: checks.choice("", value, options))


def whole_numbers(count: int) -> PlainValidator:
    """Returns the validator of a list of ``count`` whole numbers."""

    def validate(value: Any) -> tuple[int, ...]:
        entries = tuple(value) if isinstance(value, list | tuple) else ()
        if len(entries) != count or not all(_is_whole(entry) for entry in entries):
            raise ValueError(f"must be {count} whole numbers, got {abbreviated(value)}")
        return entries

    return PlainValidator(validate)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _element_name(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"must be a text, got {abbreviated(value)}")
    try:
        return checks.new_name("table", value, {})
    except ValueError as error:
        rule = str(error).partition(" must ")[2]  # the part before is a name that is not in the file
        raise ValueError(f"must {rule}") from None


def _inertia(name: str, values: Any) -> None:
    checks.inertia_tensors(name, np.diag(values) if values.ndim == 1 else values)


def _inertias(name: str, values: Any) -> None:
    # 3 rows of 3 numbers can be one tensor or the moments of three bodies; the scene checks them.
    if values.shape != (3, 3):
        moments = values.shape[-2:] != (3, 3)
        checks.inertia_tensors(name, values[..., None] * np.eye(3) if moments else values)


def _faces(value: Any, info: ValidationInfo) -> Any:
    """Validates the active faces of a surface; requires the field ``mesh``, which is validated before."""
    if "mesh" not in info.data:  # the mesh is invalid, so that the number of meshes is unknown
        return value
    mesh = info.data["mesh"]
    if not isinstance(mesh, tuple):
        return _faces_of_one(value)
    if not isinstance(value, list | tuple) or len(value) != len(mesh):
        got = len(value) if isinstance(value, list | tuple) else abbreviated(value)
        raise ValueError(f"must be a list with one entry for each of the {len(mesh)} meshes, got {got}")
    return tuple(entry if entry is True else _faces_of_one(entry, f"[{i}]") for i, entry in enumerate(value))


def _faces_of_one(value: Any, number: str = "") -> tuple[Any, ...] | str:
    """Validates the active faces of one mesh; ``number`` is its index in a list, in which ``true`` means all faces."""
    if isinstance(value, str):
        return value
    entries = tuple(value) if isinstance(value, list | tuple) else (None,)
    masks, names = (all(isinstance(entry, kind) for entry in entries) for kind in (bool, str))
    if not masks and not names and not all(_is_whole(entry) for entry in entries):
        everything = ", or true for all of them" if number else ""
        raise ValueError(
            f"{number} must be a list of face numbers, of names of groups, or of true and false for each face, or "
            f"one name{everything}, got {abbreviated(value)}".lstrip()
        )
    return entries


def _repair(value: Any) -> bool | str | tuple[str, ...]:
    given = tuple(value) if isinstance(value, list) else value
    try:
        steps_of(given)
    except ValueError:
        allowed = f"true, false, or names out of {', '.join(REPAIRS)}"
        raise ValueError(f"must be {allowed}, got {abbreviated(value)}") from None
    return cast("bool | str | tuple[str, ...]", given)


def _title(value: Any) -> str:
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise ValueError(f"must be a text on one line, got {abbreviated(value)}")
    checks.check_length("", value)
    return value


def _positions(value: Any) -> Any:
    if isinstance(value, str):
        return check_rows_file("", value)
    rows = plain(value, "a list of 3 numbers each [m]")
    for i, row in enumerate(rows if isinstance(rows, tuple) else ()):
        if not isinstance(row, tuple) or np.shape(row) != (3,):
            raise ValueError(f"[{i}] must be 3 numbers [m], got {abbreviated(row)}")
    if not isinstance(rows, tuple) or not rows:
        raise ValueError(f"must be a list of 3 numbers each [m], got {abbreviated(value)}")
    return rows


def _choices(value: Any, what: str = "a list of values") -> tuple[Any, ...]:
    rows = plain(value, what)
    if not isinstance(rows, tuple) or not rows:
        raise ValueError(f"must be {what}, got {abbreviated(value)}")
    for i, row in enumerate(rows):
        if np.shape(row) != np.shape(rows[0]):
            raise ValueError(f"[{i}] must be of the same kind as the values before, got {abbreviated(row)}")
    return rows


def _rows(value: Any) -> tuple[Any, ...] | str:
    if isinstance(value, str):
        return check_rows_file("", value)
    return _choices(value, "a list of one value per environment")


def _value(value: Any) -> Any:
    what = "a number or a list of numbers"
    entries = plain(value, what)
    try:
        np.shape(entries)
    except ValueError:  # rows of different length
        raise ValueError(f"must be {what}, got {abbreviated(value)}") from None
    return entries


def _amount(value: Any) -> int | str:
    return check_amount("", value)


def _amounts(value: Any) -> Any:
    if not isinstance(value, list | tuple):
        return _amount(value)
    if len(value) != 2:
        raise ValueError(f"must be one entry or two, one for each surface, got {abbreviated(value)}")
    return tuple(check_amount(f"[{i}]", entry) for i, entry in enumerate(value))


def _areas(value: Any) -> tuple[float, ...]:
    what = f"a list of numbers [{AREA['unit']}]"
    entries = plain(value, what)
    if not isinstance(entries, tuple) or not entries or np.ndim(entries) != 1:
        raise ValueError(f"must be {what}, got {abbreviated(value)}")
    checks.numbers("", entries, (len(entries),), AREA)
    return entries


def _pair(rule: str, holds: Callable[[Any, Any], Any]) -> PlainValidator:
    """Returns the validator of two numbers or vectors that satisfy ``rule`` in each component."""
    what = "two numbers, or two lists of numbers of the same length"

    def validate(value: Any) -> tuple[Any, ...]:
        pair = plain(value, what)
        try:
            first, second = np.array(pair)
        except (ValueError, TypeError):  # wrong number of entries, or lists of different length
            raise ValueError(f"must be {what}, got {abbreviated(value)}") from None
        if not np.all(holds(first, second)):
            raise ValueError(f"must be {rule}, got {abbreviated(value)}")
        return pair

    return PlainValidator(validate)


def _number_or_name(value: Any) -> float | str:
    return value if isinstance(value, str) else plain(value, "a number or the name of a parameter")


element_name = PlainValidator(_element_name)
position = numbers((3,), allowed=limits("m"))
quaternion = numbers((4,), what="a unit quaternion (x, y, z, w)", check=checks.unit_quaternions)
velocity = numbers((3,), allowed=limits("m/s"))
angular_velocity = numbers((3,), allowed=limits("rad/s"))
force = numbers((3,), allowed=limits("N"))
torque = numbers((3,), allowed=limits("N·m"))
acceleration = numbers((3,), allowed=limits("m/s²"))
time = numbers((), allowed=limits("s", above=0.0))
inertia = numbers((3,), (3, 3), allowed=limits("kg·m²"), what="3 numbers or a 3×3 tensor [kg·m²]", check=_inertia)
masses = each((), allowed=MASS, what="a number [kg]")
inertias = each((3,), (3, 3), allowed=limits("kg·m²"), what="3 numbers or a 3×3 tensor [kg·m²]", check=_inertias)
quaternions = each((4,), what="a unit quaternion (x, y, z, w)", check=checks.unit_quaternions)
velocities = each((3,), allowed=limits("m/s"), what="3 numbers [m/s]")
angular_velocities = each((3,), allowed=limits("rad/s"), what="3 numbers [rad/s]")
forces = each((3,), allowed=limits("N"), what="3 numbers [N]")
torques = each((3,), allowed=limits("N·m"), what="3 numbers [N·m]")
radii = each((), allowed=RADIUS, what="a number [m]")
color = numbers((3,), what="red, green and blue from 0 to 1", check=checks.color)
faces = PlainValidator(_faces)
repair = PlainValidator(_repair)
title = PlainValidator(_title)
positions = PlainValidator(_positions)
areas = PlainValidator(_areas)
amount = PlainValidator(_amount)
quadrature = PlainValidator(lambda value: check_quadrature("", value))
amounts = PlainValidator(_amounts)
value = PlainValidator(_value)
rows = PlainValidator(_rows)
choices = PlainValidator(_choices)
pair = _pair("", lambda first, second: True)
interval = _pair("[low, high] with low ≤ high", lambda low, high: low <= high)
positive_interval = _pair("[low, high] with 0 < low ≤ high", lambda low, high: (low > 0.0) & (low <= high))
mean_and_deviation = _pair("[mean, deviation] with deviation ≥ 0", lambda mean, deviation: deviation >= 0.0)
number_or_name = PlainValidator(_number_or_name)
