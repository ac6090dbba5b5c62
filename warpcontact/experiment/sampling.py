"""Samplers: points in the unit cube from which parameter values are computed.

Methods: independent random numbers, Latin hypercube, scrambled Sobol' points, and the design of Saltelli et al. (2010)
for sensitivity indices. Points are computed in blocks of ``BLOCK`` environments that start at multiples of ``BLOCK``:
vector instructions may round a number differently at another position of an array, and the values of a shard must be
bitwise identical to those of a run of all environments.
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
# Largest number of bits of SciPy's engine for which ``fast_forward`` works.
SOBOL_BITS = 32
#: Largest dimension of Sobol' points in SciPy's table of direction numbers.
MOST_COLUMNS = 21201
METHODS = ("random", "latin_hypercube", "sobol", "saltelli")
# Seeds the generator of Sobol' points; not a valid parameter name.
_DESIGN = "[sampling]"


def generator(seed: int, name: str, start: int = 0) -> np.random.Generator:
    """Returns the random generator of the parameter ``name``, advanced by ``start`` numbers."""
    digest = hashlib.sha256(name.encode()).digest()
    bits = np.random.PCG64(np.random.SeedSequence([seed, int.from_bytes(digest[:16])]))
    # Each random number takes one 64-bit state of the generator.
    return np.random.Generator(bits.advance(start))


class Sampler(Protocol):
    """A source of numbers between 0 and 1, one row per environment and one column per sampled number."""

    def blocks(self, start: int) -> Iterator[Array]:
        """Iterates over blocks (BLOCK, columns) without end, from row ``start``, a multiple of BLOCK.

        Rows after the last environment are arbitrary.
        """


@dataclass(frozen=True)
class Midpoint:
    """The center of the unit cube for each environment, for computing the shapes of values.

    Args:
        columns: Number of columns.
    """

    columns: int

    def blocks(self, start: int) -> Iterator[Array]:
        """See ``Sampler``."""
        while True:
            yield np.full((BLOCK, self.columns), 0.5)


@dataclass(frozen=True)
class Random:
    """Independent random numbers, with one generator per parameter.

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
    """Latin hypercube: each column has one random number in each of ``envs`` equal intervals, in random order.

    Args:
        seed: Seed of the experiment.
        counts: Numbers per environment by the name of the parameter; each parameter has its own generator.
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
        """The complete design (envs, columns), because a permutation cannot be generated in parts."""
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
        columns: Dimension, up to ``MOST_COLUMNS``.
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
    """Design for sensitivity indices: matrices A and B, and for each column j the matrix A with column j of B.

    The rows of A and B together are scrambled Sobol' points of dimension 2 d (Saltelli et al. 2010).

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
        # n is a power of two: a block lies within one matrix, or contains all of A and B.
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
    """Returns the next points of ``engine``, shifted by half of their resolution to the center of their cell."""
    return np.asarray(engine.random(count) + 0.5 ** (SOBOL_BITS + 1))


@dataclass(frozen=True, eq=False)
class Correlation:
    """A Gaussian copula: makes columns of a sampler correlated.

    Args:
        columns: Columns of the sampler.
        factor: Lower triangular Cholesky factor of their correlation matrix.
    """

    columns: tuple[int, ...]
    factor: Array

    def normals(self, units: Array) -> dict[int, Array]:
        """Returns correlated standard normal numbers (n,) by column, from the numbers (n, columns) of a sampler."""
        from scipy.special import ndtri

        normals = [ndtri(units[:, column]) for column in self.columns]
        # Column by column: the rounding of a matrix product can depend on the number of threads.
        mixed = {}
        for i, column in enumerate(self.columns):
            mixed[column] = self.factor[i, 0] * normals[0]
            for j in range(1, i + 1):
                mixed[column] = mixed[column] + self.factor[i, j] * normals[j]
        return mixed
