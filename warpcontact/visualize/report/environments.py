"""Report section with the table of environments, sorted and filtered by the script of the page."""

from collections.abc import Iterable
from itertools import islice
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.validation.number_format import count, several
from warpcontact.visualize.report.columns import Column, columns_of, too_many_in
from warpcontact.visualize.report.markup import Markup, element, joined, short

ROWS = 2000
COLUMNS = 40
# Largest number of names in a note.
NAMED = 6
# These columns are omitted if all values are equal.
_OMITTED_COLUMNS = ("resets", "events_missed", "stopped_by", "cause", "end_time")


def table_rows(envs: NDArray[np.int64], first: Iterable[int]) -> NDArray[np.intp]:
    """Returns the rows of the table: environments that must be included, and others evenly spaced."""
    if len(envs) <= ROWS:
        return np.arange(len(envs))
    must = np.flatnonzero(np.isin(envs, np.fromiter(first, np.int64)))[: ROWS // 2]
    rest = np.setdiff1d(np.arange(len(envs)), must, assume_unique=True)
    spread = rest[np.unique(np.linspace(0, len(rest) - 1, ROWS - len(must)).astype(np.intp))]
    return np.sort(np.concatenate([must, spread]))


def section(params: xr.Dataset, outcome: xr.Dataset, first: Iterable[int]) -> tuple[Markup, dict[str, Any]]:
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
