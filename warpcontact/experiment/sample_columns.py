"""Which numbers an experiment draws in each environment, where they come from, and which are drawn together."""

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

# What differs between environments and is not drawn.
_ORDERED = ("linspace", "grid", "values")


def sampled_components(variation: Mapping[str, VariationSettings]) -> list[tuple[str, tuple[int, ...]]]:
    """Returns the numbers that are drawn and differ, in order: name of a parameter, and which of its numbers."""
    entries = ((name, entry.kind, getattr(entry, entry.kind)) for name, entry in variation.items() if entry.drawn)
    return [
        (name, tuple(map(int, index)))
        for name, kind, given in entries
        for index in np.argwhere(varying_components(kind, given))
    ]


class SampleColumns:
    """The numbers that each environment draws, each a column of a sampler.

    Args:
        variation: What varies.
        method: How numbers are drawn, one of ``sampling.METHODS``.
        envs: Number of environments.
        seed: Seed of the experiment.
        problems: Receives what is wrong.

    Attributes:
        numbers: Which numbers of a value of each parameter have a column, by name. One by which environments do
            not differ has none, unless it is drawn at random: what follows it is drawn as if it did.
        first: The first column of each.
        incomplete: Names of those that have problems, so that nobody knows how many numbers they should have.
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
        """Returns where the numbers come from, or some way to go on if the method does not fit.

        Args:
            any_envs: Whether any number of environments fits, as it is not known.
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
            sound = self._fits_saltelli(any_envs) and not any_envs
            return Saltelli(self.seed, self.number, self.envs) if sound else independent
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
            rule = "must have an entry that is drawn and differs for sampling.method = 'saltelli'"
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
                f"numbers that are drawn, got {self.envs}; next to it: {' and '.join(map(str, nearest))}",
            )
        return len(self.problems.lines) == before

    def correlation(
        self, number: int, entry: CorrelationSettings, is_invalid: Callable[[str], bool]
    ) -> Correlation | None:
        """Returns what draws some of the numbers together, or ``None`` if that is wrong.

        Args:
            number: Which ``[[correlation]]`` it is.
            entry: What it says.
            is_invalid: Tells of the name of a parameter whether its element has problems of its own.
        """
        before = len(self.problems.lines)
        if self.method == "saltelli":
            rule = "must be left out: sampling.method = 'saltelli' takes what is drawn to be independent"
            self.problems.add(f"correlation[{number}]", rule)
            return None
        for i, name in enumerate(entry.names):
            path = f"correlation[{number}].names[{i}]"
            if name in self.incomplete:
                continue
            if name in self.variation:
                self._check_correlated(path, name)
            elif not is_invalid(name):
                self.problems.add_unknown_name(path, name, "drawn entry of [variation]", self.first)
        if len(self.problems.lines) > before or not self.first.keys() - self.incomplete >= set(entry.names):
            return None
        columns = tuple(self.first[name] for name in entry.names)
        return Correlation(columns, np.linalg.cholesky(np.array(entry.matrix)))

    def _check_correlated(self, path: str, name: str) -> None:
        """Checks an entry that is to be drawn with others."""
        entry = self.variation[name]
        if name in self._correlated:
            self.problems.add(path, f"must be in no other [[correlation]], got {name!r} again")
        elif not entry.drawn:
            message = f"must be drawn, by one of {', '.join(DISTRIBUTIONS)}, got {name!r}, which has {entry.kind}"
            self.problems.add(path, message)
        elif shape := value_shape(entry.kind, getattr(entry, entry.kind)):
            message = f"must be one number in each environment, got {name!r}, which has {int(np.prod(shape))}"
            self.problems.add(path, message)
        elif not varying_components(entry.kind, getattr(entry, entry.kind)):
            self.problems.add(path, f"must differ between environments, got {name!r}, which is always the same")
        self._correlated.add(name)
