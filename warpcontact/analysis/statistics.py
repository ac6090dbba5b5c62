"""Convergence of a statistic of an outcome with the number of environments."""

import numpy as np
import xarray as xr

from warpcontact.analysis.results import ExperimentResults, probability, remaining_dims, usable_outcome, variable
from warpcontact.experiment.errors import key_path
from warpcontact.experiment.schema import Settings
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

STATISTICS = ("mean", "quantile")
# Variations that order the environments, so that the first ones are not a representative sample.
_ORDERED = ("linspace", "grid")


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
