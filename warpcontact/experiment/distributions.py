"""Distributions of scalar parameters, by the inverse of their cumulative distribution functions.

Each value is computed from one number of a sampler between 0 and 1, which is random or a coordinate of a design.
"""

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.experiment.errors import abbreviated
from warpcontact.experiment.quantities import plain
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.validation.checks import Array

# Range of numbers from a sampler: multiples of 2⁻⁵³, with 2⁻⁵⁴ instead of 0, so that no distribution is evaluated at
# its infinite ends.
SMALLEST = 2.0**-54
LARGEST = 1.0 - 2.0**-53


def clip_to_open_interval(units: Array) -> Array:
    """Returns ``units`` clipped to values between 0 and 1, exclusive."""
    return np.clip(units, SMALLEST, LARGEST)


class Marginal(ABC):
    """A distribution of numbers, or of vectors with independent components."""

    @abstractmethod
    def from_uniform(self, units: Array) -> Array:
        """Returns values (n, *shape) from uniform numbers (n, *shape)."""

    def from_normal(self, normals: Array) -> Array:
        """Returns values (n, *shape) from standard normal numbers (n, *shape); monotonic in each."""
        from scipy.special import ndtr

        return self.from_uniform(clip_to_open_interval(ndtr(normals)))


@dataclass(frozen=True, eq=False)
class Uniform(Marginal):
    """Uniform distribution from ``low`` to ``high``."""

    low: Array
    high: Array

    def from_uniform(self, units: Array) -> Array:
        """See ``Marginal``."""
        return self.low + (self.high - self.low) * units


@dataclass(frozen=True, eq=False)
class IntegerUniform(Marginal):
    """Integers from ``low`` to ``high``, each with the same probability."""

    low: Array
    high: Array

    def from_uniform(self, units: Array) -> Array:
        """See ``Marginal``."""
        count = self.high - self.low
        return self.low + np.minimum(np.floor((count + 1.0) * units), count)


@dataclass(frozen=True, eq=False)
class LogUniform(Marginal):
    """Log-uniform distribution from ``low`` to ``high``."""

    low: Array
    high: Array

    def from_uniform(self, units: Array) -> Array:
        """See ``Marginal``."""
        return self.low * (self.high / self.low) ** units


@dataclass(frozen=True, eq=False)
class Normal(Marginal):
    """Normal distribution."""

    mean: Array
    deviation: Array

    def from_uniform(self, units: Array) -> Array:
        """See ``Marginal``."""
        from scipy.special import ndtri

        return self.from_normal(ndtri(units))

    def from_normal(self, normals: Array) -> Array:
        """See ``Marginal``."""
        return self.mean + self.deviation * normals


@dataclass(frozen=True, eq=False)
class LogNormal(Normal):
    """Lognormal distribution; ``mean`` and ``deviation`` are those of the logarithm."""

    def from_normal(self, normals: Array) -> Array:
        """See ``Marginal``."""
        with np.errstate(over="ignore"):  # infinite values are reported when the parameter is checked
            return np.asarray(np.exp(super().from_normal(normals)))


@dataclass(frozen=True, eq=False)
class ScipyDistribution(Marginal):
    """A distribution of ``scipy.stats``.

    Args:
        name: Name in ``scipy.stats``.
        parameters: Parameters by name, numbers or vectors.
    """

    name: str
    parameters: Mapping[str, Array]

    def from_uniform(self, units: Array) -> Array:
        """See ``Marginal``."""
        with np.errstate(all="ignore"):
            return np.asarray(_families()[self.name].ppf(units, **self.parameters), dtype=np.float64)


#: Sampled kinds of a variation that are given by two numbers or vectors.
PAIRS: dict[str, type[Any]] = {
    "uniform": Uniform,
    "loguniform": LogUniform,
    "normal": Normal,
    "lognormal": LogNormal,
}
#: All sampled kinds of a variation.
DISTRIBUTIONS = (*PAIRS, "distribution")


def make_marginal(kind: str, given: Any, whole: bool) -> Marginal:
    """Returns the distribution of an entry of ``[variation]``.

    Args:
        kind: Key of the entry, one of ``DISTRIBUTIONS``.
        given: Value of the key.
        whole: Whether the parameter is an integer.
    """
    if kind == "distribution":
        parameters = {key: np.array(value) for key, value in given.items() if key != "name"}
        return ScipyDistribution(given["name"], parameters)
    first, second = np.array(given, dtype=np.float64)
    made: Marginal = (IntegerUniform if whole else PAIRS[kind])(first, second)
    return made


def value_shape(kind: str, given: Any) -> tuple[int, ...]:
    """Returns the shape of one value of an entry; arguments as of ``make_marginal``."""
    if kind == "distribution":
        return np.broadcast_shapes(*(np.shape(value) for key, value in given.items() if key != "name"))
    return np.shape(given[0])


def varying_components(kind: str, given: Any) -> NDArray[np.bool_]:
    """Returns which components of an entry vary between environments, in the shape of one value."""
    if kind == "distribution":
        return np.ones(value_shape(kind, given), dtype=bool)
    first, second = np.array(given, dtype=np.float64)
    return np.asarray(second != (0.0 if kind in ("normal", "lognormal") else first))


def is_discrete(given: Mapping[str, Any]) -> bool:
    """Whether a validated distribution of ``scipy.stats`` is discrete."""
    from scipy import stats

    return isinstance(_families()[given["name"]], stats.rv_discrete)


@functools.cache
def _families() -> dict[str, Any]:
    """Returns all distributions of ``scipy.stats`` by name."""
    from scipy import stats

    named = {name: getattr(stats, name) for name in dir(stats)}
    kinds = stats.rv_continuous, stats.rv_discrete
    return {name: family for name, family in named.items() if isinstance(family, kinds)}


def check_distribution(value: Any) -> dict[str, Any]:
    """Validates the table of a distribution of ``scipy.stats``; returns its name and parameters.

    Raises:
        ValueError: If it is invalid. The message continues the key of the table.
    """
    if not isinstance(value, Mapping):
        raise ValueError(
            f'must be a table, got {abbreviated(value)}; write {{ name = "norm", loc = 1, scale = 0.1 }}'
        )
    if "name" not in value:
        raise ValueError(".name is missing: the name of a distribution of scipy.stats")
    name = value["name"]
    if not isinstance(name, str) or name not in _families():
        hint = suggestion(name, _families()) or ", such as norm, truncnorm, weibull_min, gamma, beta, triang"
        raise ValueError(f".name must be the name of a distribution of scipy.stats, got {abbreviated(name)}{hint}")
    family = _families()[name]
    shapes = family.shapes.split(", ") if family.shapes else []
    known = [*shapes, "loc", *(() if is_discrete({"name": name}) else ("scale",))]
    for key in value:
        if key != "name" and key not in known:
            hint = suggestion(key, known) or f"; {name} has: {', '.join(known)}"
            raise ValueError(f".{key} is not known{hint}")
    for key in shapes:
        if key not in value:
            raise ValueError(f".{key} is missing: {name} has the parameters {', '.join(known)}")
    checked = {key: _numbers(key, value[key]) for key in known if key in value}
    try:
        np.broadcast_shapes(*map(np.shape, checked.values()))
    except ValueError:
        raise ValueError(f": lists of parameters of {name} must have the same length") from None
    for key, (allowed, rule) in _ranges(family).items():
        for number in np.ravel(checked.get(key, 1.0)):
            if not allowed(number):
                raise ValueError(f".{key} must be {rule}, got {number:g}")
    with np.errstate(all="ignore"):
        middle = family.ppf(0.5, **{key: np.array(number) for key, number in checked.items()})
    if not np.all(np.isfinite(middle)):
        given = ", ".join(f"{key} = {number!r}" for key, number in checked.items())
        raise ValueError(f": invalid parameters of {name}: {given}; see the documentation of scipy.stats.{name}")
    return {"name": name} | checked


def _numbers(key: str, value: Any) -> Any:
    what = "a number or a list of numbers"
    try:
        numbers = plain(value, what)
    except ValueError as error:
        raise ValueError(f".{key} {error}") from None
    if isinstance(numbers, tuple) and (not numbers or any(isinstance(number, tuple) for number in numbers)):
        raise ValueError(f".{key} must be {what}, got {abbreviated(value)}")
    return numbers


def _ranges(family: Any) -> dict[str, tuple[Any, str]]:
    """Returns the range of each parameter of a distribution: a predicate, and its description."""
    ranges: dict[str, tuple[Any, str]] = {"scale": (lambda number: number > 0.0, "greater than 0")}
    for info in family._shape_info():  # private, but also the source of the bounds of scipy.stats.fit
        low, high = (float(end) for end in info.domain)
        if 0.0 < low < np.finfo(float).tiny:
            low = 0.0
        with_low, with_high = info.inclusive
        ranges[info.name] = _range(low, high, with_low, with_high, info.integrality)
    return ranges


def _range(low: float, high: float, with_low: bool, with_high: bool, whole: bool) -> tuple[Any, str]:
    def allowed(number: float) -> bool:
        above = number >= low if with_low else number > low
        below = number <= high if with_high else number < high
        return above and below and not (whole and number != round(number))

    words = ["a whole number"] if whole else []
    if low > -math.inf:
        words.append(f"{'at least' if with_low else 'greater than'} {low:g}")
    if high < math.inf:
        words.append(f"{'at most' if with_high else 'less than'} {high:g}")
    return allowed, " and ".join(words)
