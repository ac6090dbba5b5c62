"""Design of an experiment: the sampled components, and the values of all varied parameters for any environments."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from warpcontact.experiment.distributions import (
    DISTRIBUTIONS,
    LARGEST,
    SMALLEST,
    Marginal,
    Normal,
    value_shape,
    varying_components,
)
from warpcontact.experiment.errors import Problems, key_path
from warpcontact.experiment.sampling import (
    BLOCK,
    MOST_COLUMNS,
    Correlation,
    LatinHypercube,
    Midpoint,
    Random,
    Saltelli,
    Sampler,
    Sobol,
)
from warpcontact.experiment.variation_settings import CorrelationSettings, VariationSettings
from warpcontact.validation.checks import Array

# Kinds of a variation that are not sampled.
_ORDERED = ("linspace", "grid", "values")


def sampled_components(variation: Mapping[str, VariationSettings]) -> list[tuple[str, tuple[int, ...]]]:
    """Returns the sampled components that vary, in order: name of the parameter, and index of the component."""
    entries = ((name, entry.kind, getattr(entry, entry.kind)) for name, entry in variation.items() if entry.drawn)
    return [
        (name, tuple(map(int, index)))
        for name, kind, given in entries
        for index in np.argwhere(varying_components(kind, given))
    ]


class SampleColumns:
    """Assigns the sampled numbers of each environment to columns of a sampler.

    Args:
        variation: Variation settings by parameter name.
        method: Sampling method, one of ``sampling.METHODS``.
        envs: Number of environments.
        seed: Seed of the experiment.
        problems: Receives the problems.

    Attributes:
        numbers: Indices of the components that have a column, by parameter name. A component that does not vary has
            none, except with random sampling, so that the samples of later components do not depend on it.
        first: First column of each parameter.
        incomplete: Names of parameters with problems, whose number of columns is unknown.
    """

    def __init__(
        self,
        variation: Mapping[str, VariationSettings],
        method: str,
        envs: int,
        seed: int,
        problems: Problems,
    ) -> None:
        self.variation = variation
        self.method = method
        self.envs = envs
        self.seed = seed
        self.problems = problems
        self.numbers: dict[str, tuple[int, ...]] = {}
        self.first: dict[str, int] = {}
        self.number = 0
        for name, entry in variation.items():
            if entry.drawn:
                differ = varying_components(entry.kind, getattr(entry, entry.kind))
                self.numbers[name] = tuple(map(int, np.flatnonzero(differ | (method == "random"))))
                self.first[name] = self.number
                self.number += len(self.numbers[name])
        self.incomplete: set[str] = set()
        self._correlated: set[str] = set()

    def sampler(self, any_envs: bool) -> Sampler:
        """Returns the sampler, or independent random numbers if the method cannot be used.

        Args:
            any_envs: Whether to accept any number of environments, because it is unknown.
        """
        counts = {name: len(numbers) for name, numbers in self.numbers.items()}
        independent = Random(self.seed, counts)
        max_count = MOST_COLUMNS // 2 if self.method == "saltelli" else MOST_COLUMNS
        if self.method in ("sobol", "saltelli") and self.number > max_count:
            rule = f"{self.method!r} draws at most {max_count} numbers in each environment, got {self.number}"
            self.problems.add("sampling.method", f": {rule}")
            return independent
        if self.method == "saltelli":
            any_envs = any_envs or bool(self.incomplete)
            valid = self._fits_saltelli(any_envs) and not any_envs
            return Saltelli(self.seed, self.number, self.envs) if valid else independent
        if self.method == "latin_hypercube":
            return LatinHypercube(self.seed, counts, self.envs)
        return Sobol(self.seed, self.number) if self.method == "sobol" and self.number else independent

    def _fits_saltelli(self, any_envs: bool) -> bool:
        before = len(self.problems.lines)
        for name, entry in self.variation.items():
            if entry.kind in _ORDERED:
                allowed = ", ".join((*DISTRIBUTIONS, "value", "solid_sphere"))
                rule = f"must be left out with sampling.method = 'saltelli'; allowed: {allowed}"
                self.problems.add(f"{key_path(('variation', name))}.{entry.kind}", rule)
        if not self.number:
            rule = "must have a sampled entry that varies, for sampling.method = 'saltelli'"
            self.problems.add("variation", rule)
        if len(self.problems.lines) > before:
            return False
        group = self.number + 2
        rows, rest = divmod(self.envs, group)
        if not any_envs and (rest or rows < 2 or rows & (rows - 1)):
            below = 1 << max(1, rows.bit_length() - 1)
            nearest = [n * group for n in (below, 2 * below) if n == below or self.envs > below * group]
            self.problems.add(
                "envs",
                f"must be {group} n, with n = 2, 4, 8, …, for sampling.method = 'saltelli' and {self.number} "
                f"sampled numbers, got {self.envs}; nearest: {' and '.join(map(str, nearest))}",
            )
        return len(self.problems.lines) == before

    def correlation(
        self, number: int, entry: CorrelationSettings, is_invalid: Callable[[str], bool]
    ) -> Correlation | None:
        """Returns a correlation between columns, or ``None`` if it is invalid.

        Args:
            number: Index of the ``[[correlation]]``.
            entry: Its settings.
            is_invalid: Returns whether the element of a parameter name has reported problems.
        """
        before = len(self.problems.lines)
        if self.method == "saltelli":
            rule = "must be left out: sampling.method = 'saltelli' requires independent samples"
            self.problems.add(f"correlation[{number}]", rule)
            return None
        for i, name in enumerate(entry.names):
            path = f"correlation[{number}].names[{i}]"
            if name in self.incomplete:
                continue
            if name in self.variation:
                self._check_correlated(path, name)
            elif not is_invalid(name):
                self.problems.add_unknown_name(path, name, "sampled entry of [variation]", self.first)
        if len(self.problems.lines) > before or not self.first.keys() - self.incomplete >= set(entry.names):
            return None
        columns = tuple(self.first[name] for name in entry.names)
        return Correlation(columns, np.linalg.cholesky(np.array(entry.matrix)))

    def _check_correlated(self, path: str, name: str) -> None:
        """Checks an entry of a correlation."""
        entry = self.variation[name]
        if name in self._correlated:
            self.problems.add(path, f"must be in no other [[correlation]], got {name!r} again")
        elif not entry.drawn:
            message = (
                f"must be sampled, by one of {', '.join(DISTRIBUTIONS)}, got {name!r}, which has {entry.kind}"
            )
            self.problems.add(path, message)
        elif shape := value_shape(entry.kind, getattr(entry, entry.kind)):
            message = f"must be one number in each environment, got {name!r}, which has {int(np.prod(shape))}"
            self.problems.add(path, message)
        elif not varying_components(entry.kind, getattr(entry, entry.kind)):
            self.problems.add(path, f"must differ between environments, got {name!r}, which is always the same")
        self._correlated.add(name)


class Entry(Protocol):
    """Values of one parameter that are a function of the environment number."""

    def rows(self, envs: NDArray[np.intp]) -> Array:
        """Returns the values (n, …) of the environments with numbers ``envs`` (n,)."""


@dataclass(frozen=True, eq=False)
class ConstantEntry:
    """One value for all environments."""

    value: Array

    def rows(self, envs: NDArray[np.intp]) -> Array:
        """See ``Entry``."""
        return np.repeat(self.value[None], len(envs), axis=0)


@dataclass(frozen=True, eq=False)
class ListedEntry:
    """Listed values, each for ``repeat`` consecutive environments, repeated cyclically."""

    values: Array
    repeat: int = 1

    def rows(self, envs: NDArray[np.intp]) -> Array:
        """See ``Entry``."""
        return np.asarray(self.values[envs // self.repeat % len(self.values)])


@dataclass(frozen=True, eq=False)
class LinearEntry:
    """Evenly spaced values from ``first`` to ``last`` over ``count`` environments, as from ``np.linspace``."""

    first: Array
    last: Array
    count: int

    def rows(self, envs: NDArray[np.intp]) -> Array:
        """See ``Entry``."""
        number = envs.astype(np.float64).reshape(-1, *(1,) * self.first.ndim)
        span, intervals = self.last - self.first, max(self.count - 1, 1)
        step = span / intervals
        values = self.first + (number / intervals * span if np.any(step == 0.0) else number * step)
        values[(envs == self.count - 1) & (self.count > 1)] = self.last
        return values


@dataclass(frozen=True, eq=False)
class IntegerEntry:
    """Integers from ``first`` to ``last``, each for about the same number of consecutive environments of ``count``."""

    first: Array
    last: Array
    count: int

    def rows(self, envs: NDArray[np.intp]) -> Array:
        """See ``Entry``."""
        span = np.abs(self.last - self.first)
        passed = np.floor(envs * (span + 1.0) / max(self.count - 1, 1))
        return np.asarray(self.first + np.sign(self.last - self.first) * np.minimum(passed, span))


@dataclass(frozen=True, eq=False)
class SampledEntry:
    """Values sampled from a distribution.

    Args:
        marginal: The distribution.
        shape: Shape of one value.
        column: First column in the sampler.
        numbers: Indices of the components that have a column; the others are the same in all environments.
    """

    marginal: Marginal
    shape: tuple[int, ...]
    column: int
    numbers: tuple[int, ...]

    def values(self, units: Array, normals: Mapping[int, Array]) -> Array:
        """Returns values (n, …) from the rows (n, columns) of a sampler, or from correlated ``normals`` by column."""
        if len(self.numbers) and self.column in normals:
            return self.marginal.from_normal(normals[self.column])
        components = np.full((len(units), int(np.prod(self.shape))), 0.5)
        components[:, self.numbers] = units[:, self.column : self.column + len(self.numbers)]
        return self.marginal.from_uniform(components.reshape(-1, *self.shape))


@dataclass(frozen=True, eq=False)
class SphereInertia:
    """Inertia tensors of uniform solid spheres.

    Args:
        mass: Name of a varied parameter, or values (1,) or (1, items) [kg].
        radius: Name of a varied parameter, or values (1,) or (1, items) [m].
        single: Whether the inertia is that of a single body, not of a set.
    """

    mass: str | Array
    radius: str | Array
    single: bool

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the parameters that it depends on."""
        return tuple(source for source in (self.mass, self.radius) if isinstance(source, str))

    def values(self, parameters: Mapping[str, Array], count: int) -> Array:
        """Returns values (count, 3, 3) or (count, items, 3, 3) from those of other parameters [kg·m²]."""
        mass, radius = (self._values(source, parameters) for source in (self.mass, self.radius))
        moment = 0.4 * mass * radius**2
        moment = np.broadcast_to(moment, (count, *moment.shape[1:]))
        return np.asarray(moment[..., None, None] * np.eye(3))

    def _values(self, source: str | Array, parameters: Mapping[str, Array]) -> Array:
        values = parameters[source] if isinstance(source, str) else source
        return values[:, None] if values.ndim == 1 and not self.single else values


@dataclass(frozen=True)
class ValueConversion:
    """Conversion of the values of an entry to those of its parameter.

    Attributes:
        tensor: Whether to convert principal moments to tensors.
        shared: Whether one value applies to all items of a set.
    """

    tensor: bool = False
    shared: bool = False

    def apply(self, values: Array) -> Array:
        """Returns the converted ``values`` (n, …)."""
        if self.tensor:
            values = values[..., None] * np.eye(3)
        return values[:, None] if self.shared else values


@dataclass(frozen=True, eq=False)
class Design:
    """The values of all varied parameters in all environments.

    The values of an environment are bitwise identical for any range of environments they are computed with.

    Attributes:
        envs: Number of environments.
        entries: Entries by parameter name, in the order of the experiment.
        conversions: Conversion of each entry to values of its parameter.
        sampler: Source of the sampled numbers.
        correlations: Correlations between columns of the sampler.
    """

    envs: int
    entries: Mapping[str, Entry | SampledEntry | SphereInertia]
    conversions: Mapping[str, ValueConversion]
    sampler: Sampler
    correlations: tuple[Correlation, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the experiment."""
        return tuple(self.entries)

    @property
    def row_bytes(self) -> int:
        """Size of the values of one environment [bytes]."""
        drawn = (entry for entry in self.entries.values() if isinstance(entry, SampledEntry))
        columns = max((entry.column + len(entry.numbers) for entry in drawn), default=0)
        # With Midpoint, because a Latin hypercube would be generated completely for its first row.
        row = replace(self, sampler=Midpoint(columns)).rows(0, 1)
        return sum(values.nbytes for values in row.values())

    def subset(self, names: Collection[str]) -> "Design":
        """Returns the design of these parameters, including those that they depend on."""
        entries = {name: self.entries[name] for name in names}
        sources = {
            source for entry in entries.values() if isinstance(entry, SphereInertia) for source in entry.sources
        }
        return replace(
            self, entries={name: e for name, e in self.entries.items() if name in entries or name in sources}
        )

    def value_range(self, name: str) -> Array | None:
        """Returns lower and upper bounds of the sampled values, component by component, as values (2, …).

        ``None``: the values are not sampled, or have no bounds.
        """
        entry = self.entries[name]
        if not isinstance(entry, SampledEntry):
            return None
        if isinstance(entry.marginal, Normal) and any(entry.column in one.columns for one in self.correlations):
            return None  # a sum of normal numbers can exceed the range of a single one
        units = np.repeat([[SMALLEST], [LARGEST]], entry.column + len(entry.numbers), axis=1)
        return self.conversions[name].apply(entry.values(units, {}))

    def rows(self, first: int, stop: int) -> dict[str, Array]:
        """Returns the values in environments ``first`` to ``stop``, exclusive.

        Memory use is proportional to the result, except for a Latin hypercube, which is generated completely and
        cached.

        Args:
            first: First environment.
            stop: End of the range.

        Returns:
            Values by parameter name: (stop − first, …) with the shape of one value; for a set
            (stop − first, items, …), or (stop − first, 1, …) if all items have the same value. They can be assigned
            to a model with stop − first environments.

        Raises:
            IndexError: If the range exceeds the environments of the design.
        """
        if not 0 <= first <= stop <= self.envs:
            raise IndexError(f"environments must be from 0 to {self.envs}, got {first} to {stop}")
        numbers = np.arange(first, stop)
        found = self._sampled(first, stop)
        for name, entry in self.entries.items():
            if not isinstance(entry, SampledEntry | SphereInertia):
                found[name] = entry.rows(numbers)
        found = {name: self.conversions[name].apply(values) for name, values in found.items()}
        # Entries that are computed from other parameters come last.
        for name, entry in self.entries.items():
            if isinstance(entry, SphereInertia):
                found[name] = entry.values(found, stop - first)
        return {name: found[name] for name in self.entries}

    def _sampled(self, first: int, stop: int) -> dict[str, Array]:
        """Returns the values of all sampled entries, computed block by block."""
        entries = {name: entry for name, entry in self.entries.items() if isinstance(entry, SampledEntry)}
        if not entries:
            return {}
        begin = first // BLOCK * BLOCK
        pieces: dict[str, list[Array]] = {name: [] for name in entries}
        bounds = pairwise(range(begin, max(stop, first + 1) + BLOCK, BLOCK))
        for (start, end), units in zip(bounds, self.sampler.blocks(begin), strict=False):
            normals: dict[int, Array] = {}
            for correlation in self.correlations:
                normals |= correlation.normals(units)
            cut = slice(max(first, start) - start, min(stop, end) - start)
            for name, entry in entries.items():
                pieces[name].append(entry.values(units, normals)[cut])
        return {name: np.concatenate(values) for name, values in pieces.items()}
