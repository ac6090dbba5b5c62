"""Report sections on environments: the table, sorted and filtered by the script of the page, and failures."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.drawing.reduction import merged_items
from warpcontact.model.flags import words_of
from warpcontact.model.health import Health
from warpcontact.scene.status import FailureCause
from warpcontact.validation.number_format import count, quantity, several
from warpcontact.visualize.report.markup import Markup, element, joined, name, short, table

# Largest number of values per environment of a variable with columns; variables of sets often have more.
VALUES = 12
# Variables up to this size are read once instead of once per column [bytes].
AT_ONCE = 256 * 2**20

ROWS = 2000
COLUMNS = 40
# Largest number of names in a note.
NAMED = 6
# These columns are omitted if all values are equal.
_OMITTED_COLUMNS = ("resets", "events_missed", "stopped_by", "cause", "end_time")

# Largest number of failed environments in their table.
FAILED_ROWS = 200
_CAUSES = {
    FailureCause.NON_FINITE: "non-finite state",
    FailureCause.TOO_FAST: "a body exceeded scene.max_speed",
    FailureCause.TOO_FAR: "a body exceeded scene.max_distance",
}


@dataclass(frozen=True, eq=False)
class Column:
    """One number or code per environment, read on access.

    Attributes:
        name: Name, for vectors with that of the component.
        unit: Unit, ``"-"``: none.
        about: Description.
        words: Meaning of codes; empty for numbers.
        variable: Name of the variable.
        array: Values (env,).
    """

    name: str
    unit: str
    about: str
    words: dict[int, str]
    variable: str
    array: xr.DataArray

    @property
    def values(self) -> NDArray[Any]:
        """Values (env,): numbers as float64, codes unchanged."""
        found = self.array.values
        return found if self.words else found.astype(np.float64)


def columns_of(data: xr.Dataset, without: Collection[str] = ()) -> Iterator[Column]:
    """Iterates over the columns of the variables (env, …) of ``data``, except ``without`` and variables of sets."""
    for key, variable in data.data_vars.items():
        if key in without or not _is_shown(variable):
            continue
        array = merged_items(variable.compute() if variable.nbytes <= AT_ONCE else variable)
        axes = [str(dim) for dim in array.dims if dim != "env"]
        for position in np.ndindex(*(array.sizes[dim] for dim in axes)):
            labels = [
                str(array[dim].values[i]) if dim in array.coords else str(i)
                for dim, i in zip(axes, position, strict=True)
            ]
            yield Column(
                name=".".join([str(key), *labels]),
                unit=str(array.attrs.get("units", "-")),
                about=str(array.attrs.get("long_name", key)),
                words=words_of(array),
                variable=str(key),
                array=array.isel(dict(zip(axes, position, strict=True))),
            )


def too_many_in(data: xr.Dataset) -> list[str]:
    """Returns the names of variables with too many values per environment for columns."""
    return [str(key) for key, array in data.data_vars.items() if "env" in array.dims and not _is_shown(array)]


def _is_shown(array: xr.DataArray) -> bool:
    if "env" not in array.dims or array.dtype.kind not in "biuf":
        return False
    return _values_per_env(array) <= VALUES or _values_per_env(merged_items(array)) <= VALUES


def _values_per_env(array: xr.DataArray) -> int:
    """Returns the number of values per environment."""
    return int(np.prod([array.sizes[dim] for dim in array.dims if dim != "env"], initial=1))


def table_rows(envs: NDArray[np.int64], first: Iterable[int]) -> NDArray[np.intp]:
    """Returns the rows of the table: environments that must be included, and others evenly spaced."""
    if len(envs) <= ROWS:
        return np.arange(len(envs))
    must = np.flatnonzero(np.isin(envs, np.fromiter(first, np.int64)))[: ROWS // 2]
    rest = np.setdiff1d(np.arange(len(envs)), must, assume_unique=True)
    spread = rest[np.unique(np.linspace(0, len(rest) - 1, ROWS - len(must)).astype(np.intp))]
    return np.sort(np.concatenate([must, spread]))


def table_section(params: xr.Dataset, outcome: xr.Dataset, first: Iterable[int]) -> tuple[Markup, dict[str, Any]]:
    """Returns the section of the page, and the data of its table.

    Args:
        params: Parameters of the environments.
        outcome: Outcomes of finished environments.
        first: Environments that must be included if there is no space for all.
    """
    envs = np.asarray(outcome["env"].values)
    rows = table_rows(envs, first)
    shown = outcome.isel(env=rows)
    both = [name for name in params if name in outcome]
    own = params.drop_vars(both).sel(env=shown["env"])
    given = _informative_columns(columns_of(own), parameters=True)
    measured = _informative_columns(columns_of(shown), parameters=False)
    columns = list(islice((*measured, *given), COLUMNS))
    more = len(measured) + len(given) - len(columns)
    sentences = [f"{several(len(envs), 'environment')}."]
    if len(rows) < len(envs):
        sentences = [
            f"{count(len(rows))} of {several(len(envs), 'environment')}: those that failed or are replayed, and "
            "others evenly spaced. For all: warpcontact export DIR --csv FILE."
        ]
    if more:
        sentences.append(f"{several(more, 'further column')} omitted.")
    if sets := [*too_many_in(shown), *too_many_in(own)]:
        named = ", ".join(short(one, 40) for one in sets[:NAMED])
        others = f" and {count(len(sets) - NAMED)} more" if len(sets) > NAMED else ""
        sentences.append(f"Variables with many values per environment are omitted: {named}{others}.")
    sentences.append("Parameters with equal values in all environments are omitted.")
    content = joined(
        [
            element("p", " ".join(sentences), class_="note"),
            _filter(),
            element(
                "div",
                id="environments-table",
                class_="scroll",
                tabindex="0",
                role="region",
                aria_label="table of environments",
            ),
            element("div", id="environments-pages", class_="pages"),
            element("noscript", element("p", "The table needs JavaScript.", class_="note")),
        ]
    )
    data = {
        "env": envs[rows].tolist(),
        "columns": [_content(column, values) for column, values in columns],
    }
    return content, data


def _informative_columns(columns: Iterable[Column], *, parameters: bool) -> list[tuple[Column, NDArray[Any]]]:
    """Returns the columns that differ between environments or matter otherwise, with their values."""
    found: list[tuple[Column, NDArray[Any]]] = []
    for column in columns:
        values = column.values
        constant = len(values) > 1 and bool((values == values[:1]).all())
        if constant and (parameters or column.variable in _OMITTED_COLUMNS):
            continue
        if parameters and any(
            other.variable == column.variable and np.array_equal(other_values, values)
            for other, other_values in found
        ):
            continue  # such as equal moments of inertia about the axes
        found.append((column, values))
        if len(found) > 4 * COLUMNS:
            break
    return found


def _content(column: Column, values: NDArray[Any]) -> dict[str, Any]:
    listed: list[Any]
    if column.words:
        # Codes without a meaning denote "none", such as no stop condition.
        listed = [int(value) if int(value) in column.words else None for value in values]
    else:
        listed = [float(f"{value:.6g}") if np.isfinite(value) else None for value in values]
    return {
        "name": short(column.name, 200),
        "unit": "" if column.unit == "-" else column.unit,
        "about": short(column.about, 200),
        "words": {str(code): word for code, word in column.words.items()},
        "values": listed,
    }


def _filter() -> Markup:
    advice = "For example: mass > 1 restitution <= 0.5 status = frozen; or an environment number"
    return element(
        "form",
        element("label", "Filter", for_="environments-filter"),
        element(
            "input",
            id="environments-filter",
            type="search",
            placeholder="mass > 1 status = frozen",
            title=advice,
            autocomplete="off",
            spellcheck="false",
            aria_describedby="environments-count",
        ),
        element("output", id="environments-count", for_="environments-filter", aria_live="polite"),
        id="environments-form",
        class_="filter",
        role="search",
    )


def quarantine_section(health: Health, outcome: xr.Dataset) -> Markup:
    """Returns the section of the page."""
    parts = []
    if health.good:
        parts.append(element("p", "No environment failed.", class_="note"))
    else:
        were = "was" if len(health.frozen) == 1 else "were"
        sentences = (
            f"{several(len(health.frozen), 'environment')} failed and {were} frozen in the last valid state."
        )
        if len(health.frozen) > FAILED_ROWS:
            sentences += f" The first {FAILED_ROWS}:"
        rows = [
            (replay_button(int(env)), quantity(time, "s", 6), _CAUSES.get(cause, cause.name))
            for env, cause, time in zip(health.frozen[:FAILED_ROWS], health.causes, health.times, strict=False)
        ]
        parts += [
            element("p", sentences, class_="note"),
            table(("environment", "frozen at", "cause"), rows, numbers=(1,)),
        ]
    if len(health.stopped):
        parts.append(
            element("p", f"{several(len(health.stopped), 'environment')} stopped by a condition.", class_="note")
        )
        if "stopped_by" in outcome:
            codes = outcome["stopped_by"].values
            words = words_of(outcome["stopped_by"])
            conditions = [(name(words.get(int(c), str(c))), count(int(n))) for c, n in _counts(codes)]
            parts.append(table(("condition", "environments"), conditions, numbers=(1,)))
    resets = outcome["resets"].values if "resets" in outcome else np.zeros(0)
    if resets.any():
        again = int(np.count_nonzero(resets))
        parts.append(
            element(
                "p",
                f"{several(again, 'environment')} failed and restarted, {count(int(resets.sum()))} times in total.",
                class_="note",
            )
        )
    return joined(parts)


def replay_button(env: int) -> Markup:
    """Returns the number of an environment as a button that shows it in the replay."""
    return element("button", str(env), type="button", class_="link", data_replay=env)


def _counts(codes: np.ndarray) -> list[tuple[int, int]]:
    values, numbers = np.unique(codes[codes >= 0], return_counts=True)
    return list(zip(values.tolist(), numbers.tolist(), strict=True))
