"""Settings of ``[variation]``, ``[sampling]`` and ``[[correlation]]`` in the experiment file."""

from typing import Annotated, Any

import numpy as np
from pydantic import Field, PlainValidator, model_validator

from warpcontact.experiment import quantities as q
from warpcontact.experiment.catalogue import Section
from warpcontact.experiment.distributions import DISTRIBUTIONS, check_distribution
from warpcontact.experiment.errors import abbreviated
from warpcontact.experiment.sampling import METHODS
from warpcontact.validation import checks

#: Tolerance for asymmetry and for the smallest eigenvalue of a correlation matrix.
SYMMETRY = 1.0e-9


#: Largest number of environments; their numbers have 32 bits.
MOST_ENVS = 2**31 - 1


class SolidSphere(Section):
    """Inertia of a uniform solid sphere, (2/5) m r²."""

    mass: Annotated[str | float, q.number_or_name] = Field(description="a parameter or a number [kg]")
    radius: Annotated[str | float, q.number_or_name] = Field(description="a parameter or a number [m]")


class VariationSettings(Section):
    """An entry of ``[variation]``: the values of one parameter. Exactly one of the keys is required.

    ``group`` is only allowed together with ``grid``.
    """

    uniform: Annotated[tuple[Any, ...] | None, q.interval] = None
    loguniform: Annotated[tuple[Any, ...] | None, q.positive_interval] = None
    normal: Annotated[tuple[Any, ...] | None, q.mean_and_deviation] = None
    lognormal: Annotated[tuple[Any, ...] | None, q.mean_and_deviation] = None
    linspace: Annotated[tuple[Any, ...] | None, q.pair] = None
    distribution: Annotated[dict[str, Any] | None, PlainValidator(check_distribution)] = None
    grid: Annotated[tuple[Any, ...] | None, q.choices] = None
    value: Annotated[Any, q.value] = None
    values: Annotated[tuple[Any, ...] | str | None, q.rows] = None
    solid_sphere: SolidSphere | None = None
    group: Annotated[str | None, q.element_name] = None

    @property
    def kind(self) -> str:
        """The key that is set."""
        return self._kinds()[0]

    @property
    def drawn(self) -> bool:
        """Whether the values are sampled from a distribution."""
        return self.kind in DISTRIBUTIONS

    def _kinds(self) -> list[str]:
        return [key for key in type(self).model_fields if key != "group" and getattr(self, key) is not None]

    @model_validator(mode="after")
    def _one_kind(self) -> "VariationSettings":
        given = self._kinds()
        if len(given) != 1:
            kinds = ", ".join(key for key in type(self).model_fields if key != "group")
            raise ValueError(f"must have exactly one of {kinds}; got {' and '.join(given) or 'none'}")
        if self.group is not None and self.grid is None:
            raise ValueError(f".group must be left out: it requires grid, got {given[0]}")
        return self


class SamplingSettings(Section):
    """``[sampling]``: the sampling method."""

    method: Annotated[str, q.one_of(METHODS)] = "random"


def _names(value: Any) -> tuple[str, ...]:
    what = "a list of the names of two or more entries of [variation]"
    entries = tuple(value) if isinstance(value, list | tuple) else ()
    if len(entries) < 2 or not all(isinstance(entry, str) for entry in entries):
        raise ValueError(f"must be {what}, got {abbreviated(value)}")
    for i, name in enumerate(entries):
        if name in entries[:i]:
            raise ValueError(f"[{i}] must be another name, got {name!r} again")
    return entries


def _correlations(value: Any) -> tuple[Any, ...]:
    what = "a square list of lists of numbers"
    rows = q.plain(value, what)
    try:
        shape = np.shape(rows)
    except ValueError:  # rows of different length
        shape = ()
    if len(shape) != 2 or shape[0] != shape[1]:
        raise ValueError(f"must be {what}, got {abbreviated(value)}")
    matrix = checks.numbers("", rows, shape, checks.limits("-", at_least=-1.0, at_most=1.0))
    for i, row in enumerate(matrix):
        if row[i] != 1.0:
            raise ValueError(f"[{i}][{i}] must be 1, got {row[i]:g}")
        for j in range(i):
            if abs(row[j] - matrix[j, i]) > SYMMETRY:
                raise ValueError(f"[{i}][{j}] must be that of [{j}][{i}], {matrix[j, i]:g}, got {row[j]:g}")
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    # A singular matrix has no Cholesky factor.
    if smallest <= SYMMETRY:
        raise ValueError(
            f"must be positive definite, got {abbreviated(value)} with an eigenvalue of {smallest:.3g}"
        )
    return tuple(rows)


class CorrelationSettings(Section):
    """``[[correlation]]``: sampled entries of ``[variation]`` that are correlated."""

    names: Annotated[tuple[str, ...], PlainValidator(_names)] = Field(
        description="a list of names of entries of [variation]"
    )
    matrix: Annotated[tuple[Any, ...], PlainValidator(_correlations)] = Field(
        description="their correlations, a list of lists of numbers"
    )

    @model_validator(mode="after")
    def _fits(self) -> "CorrelationSettings":
        if len(self.matrix) != len(self.names):
            raise ValueError(
                f".matrix must have a row for each of the {len(self.names)} names, got {len(self.matrix)}"
            )
        return self


def grid_axes(variation: "dict[str, VariationSettings]") -> dict[str, int]:
    """Returns the lengths of the axes of the grid, in order: one axis per group and per entry without a group."""
    axes: dict[str, int] = {}
    for name, entry in variation.items():
        if entry.grid is not None:
            axes.setdefault(axis_of(name, entry), len(entry.grid))
    return axes


def axis_of(name: str, entry: VariationSettings) -> str:
    """Returns the name of the grid axis of an entry."""
    # Parameter names do not start with a bracket.
    return name if entry.group is None else f"[{entry.group}]"


def grid_size(variation: "dict[str, VariationSettings]") -> int:
    """Returns the number of combinations of the grid; 1 if there is none."""
    size = 1
    for length in grid_axes(variation).values():
        size *= length
    return size
