"""Statistics of outcomes: convergence with the number of environments, and Sobol' sensitivity indices."""

import numpy as np
import xarray as xr

from warpcontact.analysis.results import ExperimentResults, probability, remaining_dims, usable_outcome, variable
from warpcontact.experiment.design import sampled_components
from warpcontact.experiment.errors import key_path
from warpcontact.experiment.schema import Settings
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

STATISTICS = ("mean", "quantile")
# Variations that order the environments, so that the first ones are not a representative sample.
_ORDERED = ("linspace", "grid")

# Number of resamples averaged in one matrix product.
AT_ONCE = 64


@explain_keywords
def convergence(
    run: ExperimentResults,
    outcome: str,
    statistic: str = "mean",
    q: float = 0.5,
    *,
    points: int = 20,
    confidence: float = 0.95,
    missing: str = "refuse",
) -> xr.Dataset:
    """Returns a statistic of an outcome over the first n environments, for growing n, with confidence intervals.

    The interval of a mean uses Student's t distribution. The interval of a quantile lies between two order statistics
    whose ranks follow from the binomial distribution: it holds for any continuous distribution, with at least the
    given confidence. Both assume independent environments. Latin hypercube and Sobol' sampling converge faster than
    the intervals indicate.

    Args:
        run: Run whose environments are identically distributed.
        outcome: Name of an outcome; if it has several components, each has its own estimates.
        statistic: ``"mean"`` or ``"quantile"``.
        q: Quantile level, between 0 and 1.
        points: Largest number of values of n, logarithmically spaced from 2 to the number of environments.
        confidence: Confidence level of the intervals, between 0 and 1.
        missing: Policy for environments that are frozen or without a finite value: ``"refuse"`` raises an error,
            ``"drop"`` ignores them.

    Returns:
        ``estimate``, ``low`` and ``high`` (n, …), with the attributes of the outcome. Ends of an interval that needs
        more environments are NaN.

    Raises:
        ValueError: If there is no such outcome, the environments are ordered or dependent, or some cannot be used.
    """
    checks.choice("statistic", statistic, STATISTICS)
    for name, value in (("q", q), ("confidence", confidence)):
        probability(name, value)
    checks.integer("points", points, 1)
    _check_sample(run.settings)
    array = variable(run.outcome, outcome, "outcome", "env")
    values, good = usable_outcome(run, array, missing)
    values = values[good]
    if len(values) < 2:
        raise ValueError(f"outcome {outcome!r} must have at least 2 usable environments, got {len(values)}")
    counts = np.unique(np.geomspace(2, len(values), points).round().astype(int))
    counts[-1] = len(values)  # with one point, use all environments
    found = (
        _means(values, counts, confidence) if statistic == "mean" else _quantiles(values, counts, q, confidence)
    )
    dims, shape, coords = remaining_dims(array, "env")
    attrs = array.attrs | {"outcome": outcome, "statistic": statistic, "confidence": confidence}
    return xr.Dataset(
        {
            key: (("n", *dims), numbers.reshape(-1, *shape), array.attrs)
            for key, numbers in zip(("estimate", "low", "high"), found, strict=True)
        },
        coords={"n": counts, **coords},
        attrs=attrs | ({"q": q} if statistic == "quantile" else {}),
    )


def _check_sample(settings: Settings) -> None:
    """Raises ``ValueError`` if the first environments of an experiment are not a sample of all."""
    advice = "convergence needs independent, identically distributed environments"
    if settings.sampling.method == "saltelli":
        raise ValueError(f"{advice}; those of sampling.method = 'saltelli' are not independent")
    for name, entry in settings.variation.items():
        if entry.kind in _ORDERED:
            raise ValueError(f"{advice}; {key_path(('variation', name))}.{entry.kind} gives them an order")


def _means(values: Array, counts: Array, confidence: float) -> tuple[Array, Array, Array]:
    """Returns mean and interval ends, (n, number) each, of ``values`` (env, number)."""
    from scipy.special import stdtrit

    # Subtracting the mean of all environments reduces cancellation.
    center = values.mean(axis=0)
    sums = np.cumsum(values - center, axis=0)[counts - 1]
    squares = np.cumsum((values - center) ** 2, axis=0)[counts - 1]
    n = counts[:, None].astype(np.float64)
    variance = np.maximum(squares - sums**2 / n, 0.0) / (n - 1.0)
    half = stdtrit(n - 1.0, 0.5 * (1.0 + confidence)) * np.sqrt(variance / n)
    mean = center + sums / n
    return mean, mean - half, mean + half


def _quantiles(values: Array, counts: Array, q: float, confidence: float) -> tuple[Array, Array, Array]:
    """Returns quantile and interval ends, (n, number) each, of ``values`` (env, number)."""
    from scipy.stats import binom

    tail = 0.5 * (1.0 - confidence)
    found = np.full((3, len(counts), values.shape[1]), np.nan)
    for i, n in enumerate(counts):
        ordered = np.sort(values[:n], axis=0)
        found[0, i] = np.quantile(ordered, q, axis=0)
        # 1-based ranks of the order statistics that enclose the quantile, each end up to probability ``tail``.
        low, high = int(binom.ppf(tail, n, q)), int(binom.ppf(1.0 - tail, n, q)) + 1
        if low >= 1:
            found[1, i] = ordered[low - 1]
        if high <= n:
            found[2, i] = ordered[high - 1]
    return found[0], found[1], found[2]


@explain_keywords
def sensitivity(
    run: ExperimentResults,
    outcome: str,
    *,
    confidence: float = 0.95,
    resamples: int = 1000,
    seed: int = 0,
    missing: str = "refuse",
) -> xr.Dataset:
    """Returns first-order and total Sobol' indices of an outcome, for each sampled number.

    Estimators as in ``scipy.stats.sobol_indices`` (Saltelli et al. 2010). Confidence intervals are quantiles of a
    bootstrap over the rows of the design.

    Args:
        run: Run of an experiment with ``sampling.method = "saltelli"``.
        outcome: Name of an outcome; if it has several components, each has its own indices.
        confidence: Confidence level of the intervals, between 0 and 1.
        resamples: Number of bootstrap resamples.
        seed: Seed of the bootstrap.
        missing: Policy for environments that are frozen or without a finite value. ``"refuse"``: raise an error.
            ``"drop"``: ignore each row of the design that contains one.

    Returns:
        ``first_order`` and ``total_order`` (parameter, …), and the interval ends with ``_low`` and ``_high`` added to
        their names. NaN if the outcome is constant. Attributes: ``rows``, the number of rows of the design used, and
        ``dropped``, the number of rows ignored.

    Raises:
        ValueError: If the sampling method of the run is another one, or some environments cannot be used.
    """
    probability("confidence", confidence)
    checks.integer("resamples", resamples, 1)
    checks.integer("seed", seed, 0)
    settings = run.settings
    if settings.sampling.method != "saltelli":
        raise ValueError(
            "sensitivity needs a run with sampling.method = 'saltelli' and envs = n (d + 2), with n a power of "
            f"two and d the number of sampled numbers; got {settings.sampling.method!r}"
        )
    array = variable(run.outcome, outcome, "outcome", "env")
    names = [
        f"{name}[{', '.join(map(str, index))}]" if index else name
        for name, index in sampled_components(settings.variation)
    ]
    if array.sizes["env"] != settings.envs:
        raise ValueError(
            f"outcome {outcome!r} must have values of all {settings.envs} environments, got {array.sizes['env']}"
        )
    values, good = usable_outcome(run, array, missing)
    rows = settings.envs // (len(names) + 2)
    complete_rows = good.reshape(-1, rows).all(axis=0)
    if complete_rows.sum() < 2:
        left = f"got {complete_rows.sum()} of {rows}"
        raise ValueError(f"outcome {outcome!r} must have at least 2 complete rows of the design, {left}")
    # Order of the design: A, B, then A with each column taken from B.
    design = values.reshape(len(names) + 2, rows, -1)[:, complete_rows]
    terms = _Terms(design[0], design[1], design[2:])
    rng = np.random.default_rng(seed)
    drawn = [terms.resampled(rng, min(AT_ONCE, resamples - first)) for first in range(0, resamples, AT_ONCE)]
    tail = 0.5 * (1.0 - confidence)
    dims, shape, coords = remaining_dims(array, "env")
    found: dict[str, Array] = {}
    for key, estimate, resampled in zip(
        ("first_order", "total_order"), terms.indices(), map(np.concatenate, zip(*drawn, strict=True)), strict=True
    ):
        low, high = np.quantile(resampled, (tail, 1.0 - tail), axis=0)
        found |= {key: estimate, f"{key}_low": low, f"{key}_high": high}
    return xr.Dataset(
        {key: (("parameter", *dims), numbers.reshape(-1, *shape)) for key, numbers in found.items()},
        coords={"parameter": names, **coords},
        attrs={
            "outcome": outcome,
            "confidence": confidence,
            "resamples": resamples,
            "rows": int(complete_rows.sum()),
            "dropped": int(rows - complete_rows.sum()),
        },
    )


class _Terms:
    """Terms of the estimators, per row of the design, so that a resample is a weighted average.

    Args:
        a: Outcome on the rows of A, (n, outcomes).
        b: Outcome on the rows of B, (n, outcomes).
        ab: Outcome on A with one column taken from B, (parameters, n, outcomes).
    """

    def __init__(self, a: Array, b: Array, ab: Array) -> None:
        # Subtracting the mean reduces the variance of both estimators (Sobol' and Levitan 1999).
        mean = 0.5 * (a.mean(axis=0) + b.mean(axis=0))
        a, b, ab = a - mean, b - mean, ab - mean
        self.rows, self.outcomes = a.shape
        # One matrix (n, columns): first and second moments of A and B, then the terms of each parameter.
        first, total = b * (ab - a), 0.5 * (a - ab) ** 2
        terms = [0.5 * (a + b)[None], 0.5 * (a**2 + b**2)[None], first, total]
        self.columns = np.concatenate(terms).swapaxes(0, 1).reshape(self.rows, -1)

    def indices(self) -> tuple[Array, Array]:
        """Returns first-order and total indices, (parameters, outcomes) each."""
        first, total = self._indices(np.full((1, self.rows), 1.0 / self.rows))
        return first[0], total[0]

    def resampled(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Returns the indices of ``count`` bootstrap resamples, (count, parameters, outcomes) each."""
        chosen = rng.integers(self.rows, size=(count, self.rows))
        weights = np.stack([np.bincount(rows, minlength=self.rows) for rows in chosen]) / self.rows
        return self._indices(weights)

    def _indices(self, weights: Array) -> tuple[Array, Array]:
        means = (weights @ self.columns).reshape(len(weights), -1, self.outcomes)
        variance = (means[:, 1] - means[:, 0] ** 2)[:, None]
        parameters = (means.shape[1] - 2) // 2
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(variance > 0.0, means[:, 2:] / variance, np.nan)
        return ratio[:, :parameters], ratio[:, parameters:]
