"""Columns of the sampler: which numbers are sampled in each environment, and which of them are correlated."""

from collections.abc import Callable, Mapping

import numpy as np

from warpcontact.experiment.distributions import DISTRIBUTIONS, value_shape, varying_components
from warpcontact.experiment.errors import Problems, key_path
from warpcontact.experiment.sampling import (
    MOST_COLUMNS,
    Correlation,
    LatinHypercube,
    Random,
    Saltelli,
    Sampler,
    Sobol,
)
from warpcontact.experiment.variation_settings import CorrelationSettings, VariationSettings

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
        most = MOST_COLUMNS // 2 if self.method == "saltelli" else MOST_COLUMNS
        if self.method in ("sobol", "saltelli") and self.number > most:
            rule = f"{self.method!r} draws at most {most} numbers in each environment, got {self.number}"
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
