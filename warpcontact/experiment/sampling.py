"""The numbers between 0 and 1 of which values are drawn: random ones, and designs that fill the unit cube evenly.

They come in blocks of ``BLOCK`` environments, which begin at multiples of it, whatever rows are asked for: vector
instructions may round the same number differently at another place of an array, and a shard is to draw the very
bits that a run of all environments draws.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from warpcontact.experiment.distributions import clip_to_open_interval
from warpcontact.validation.checks import Array

BLOCK = 1024
# The most with which SciPy's engine can be put forward.
SOBOL_BITS = 32
#: The most columns of Sobol' points for which direction numbers are known.
MOST_COLUMNS = 21201
METHODS = ("random", "latin_hypercube", "sobol", "saltelli")
# What the generator of a whole design is seeded by in place of a name; no parameter has this one.
_DESIGN = "[sampling]"


def generator(seed: int, name: str, start: int = 0) -> np.random.Generator:
    """Returns the random generator of the parameter called ``name``, ``start`` numbers after its first."""
    digest = hashlib.sha256(name.encode()).digest()
    bits = np.random.PCG64(np.random.SeedSequence([seed, int.from_bytes(digest[:16])]))
    # One draw of 64 bits makes one number.
    return np.random.Generator(bits.advance(start))


class Sampler(Protocol):
    """Where numbers between 0 and 1 come from, with a column for each number that an environment draws."""

    def blocks(self, start: int) -> Iterator[Array]:
        """Iterates over blocks (BLOCK, columns), without end; ``start``, a multiple of BLOCK, is the first row.

        Rows beyond the last environment may be anything.
        """


@dataclass(frozen=True)
class Midpoint:
    """One half in place of each number: where it is the form of values that matters.

    Args:
        columns: How many columns there are.
    """

    columns: int

    def blocks(self, start: int) -> Iterator[Array]:
        """See ``Sampler``."""
        while True:
            yield np.full((BLOCK, self.columns), 0.5)


@dataclass(frozen=True)
class Random:
    """Independent random numbers, of each parameter from a generator of its own.

    Args:
        seed: Seed of the experiment.
        counts: Numbers per environment by the name of the parameter.
    """

    seed: int
    counts: dict[str, int]

    def blocks(self, start: int) -> Iterator[Array]:
        """See ``Sampler``."""
        counts = self.counts.items()
        generators = [(generator(self.seed, name, start * count), count) for name, count in counts]
        while True:
            drawn = [rng.random((BLOCK, count)) for rng, count in generators]
            yield clip_to_open_interval(np.concatenate([np.empty((BLOCK, 0)), *drawn], axis=1))


@dataclass(frozen=True)
class LatinHypercube:
    """Each column has one random number in each of ``envs`` intervals of the same length, in random order.

    Args:
        seed: Seed of the experiment.
        counts: Numbers per environment by the name of the parameter; each has a generator of its own.
        envs: Number of environments.
    """

    seed: int
    counts: dict[str, int]
    envs: int

    def blocks(self, start: int) -> Iterator[Array]:
        """See ``Sampler``."""
        while True:
            yield self._table[np.minimum(np.arange(start, start + BLOCK), self.envs - 1)]
            start += BLOCK

    @cached_property
    def _table(self) -> Array:
        """The whole design (envs, columns): the order of all intervals is drawn at once."""
        table = np.empty((self.envs, sum(self.counts.values())))
        column = 0
        for name, count in self.counts.items():
            rng = generator(self.seed, name)
            for _ in range(count):
                table[:, column] = (rng.permutation(self.envs) + rng.random(self.envs)) / self.envs
                column += 1
        return clip_to_open_interval(table)


@dataclass(frozen=True)
class Sobol:
    """Scrambled Sobol' points.

    Args:
        seed: Seed of the experiment.
        columns: Their dimension, up to ``MOST_COLUMNS``.
    """

    seed: int
    columns: int

    def blocks(self, start: int) -> Iterator[Array]:
        """See ``Sampler``."""
        engine = _sobol_engine(self.seed, self.columns)
        if start:
            engine.fast_forward(start)
        while True:
            yield _points(engine, BLOCK)


@dataclass(frozen=True)
class Saltelli:
    """The design for indices of sensitivity: matrices A, B, and for each column j A with column j of B.

    A and B, side by side, are scrambled Sobol' points of twice the dimension (Saltelli et al. 2010).

    Args:
        seed: Seed of the experiment.
        columns: Dimension d.
        envs: Number of environments, n (d + 2) with n a power of two.
    """

    seed: int
    columns: int
    envs: int

    def blocks(self, start: int) -> Iterator[Array]:
        """See ``Sampler``."""
        n, d = self.envs // (self.columns + 2), self.columns
        engine = _sobol_engine(self.seed, 2 * d)
        # Either a block is within one matrix, or the whole of A and B is within one block.
        size = min(n, BLOCK)
        while True:
            matrix, row = np.divmod(np.minimum(np.arange(start, start + BLOCK), self.envs - 1), n)
            first = 0 if n < BLOCK else int(row[0])
            if engine.num_generated != first:
                engine.reset()
                if first:
                    engine.fast_forward(first)
            points = _points(engine, size)[row - first]
            of_b = (matrix[:, None] == 1) | (matrix[:, None] - 2 == np.arange(d))
            yield np.where(of_b, points[:, d:], points[:, :d])
            start += BLOCK


def _sobol_engine(seed: int, columns: int) -> Any:
    from scipy.stats import qmc

    return qmc.Sobol(columns, bits=SOBOL_BITS, rng=generator(seed, _DESIGN))


def _points(engine: Any, count: int) -> Array:
    """Returns the next points of ``engine``, each in the middle of what its bits leave open."""
    return np.asarray(engine.random(count) + 0.5 ** (SOBOL_BITS + 1))


@dataclass(frozen=True, eq=False)
class Correlation:
    """A Gaussian copula: columns that are the ranks of correlated normal numbers.

    Args:
        columns: The columns of a sampler.
        factor: Lower triangular factor of their matrix of correlations.
    """

    columns: tuple[int, ...]
    factor: Array

    def normals(self, units: Array) -> dict[int, Array]:
        """Returns correlated standard normal numbers (n,) by column, of the numbers (n, columns) of a sampler."""
        from scipy.special import ndtri

        normals = [ndtri(units[:, column]) for column in self.columns]
        # Column by column: a product of matrices may be rounded as the number of threads has it.
        mixed = {}
        for i, column in enumerate(self.columns):
            mixed[column] = self.factor[i, 0] * normals[0]
            for j in range(1, i + 1):
                mixed[column] = mixed[column] + self.factor[i, j] * normals[j]
        return mixed
