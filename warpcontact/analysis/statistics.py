"""How a statistic of an outcome settles as environments are added."""

import numpy as np
import xarray as xr

from warpcontact.analysis.results import ExperimentResults, probability, remaining_dims, usable_outcome, variable
from warpcontact.experiment.errors import key_path
from warpcontact.experiment.schema import Settings
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

STATISTICS = ("mean", "quantile")
# What gives the environments an order, so that the first ones are no sample of all.
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
    """Returns a statistic of an outcome of the first n environments, for growing n, with confidence intervals.

    Of a mean the interval is that of Student's t. Of a quantile it is between two values in order whose ranks
    follow from the binomial distribution: it holds for any continuous distribution, with at least that confidence.
    Both take the environments to be independent; those of a Latin hypercube or of Sobol' points estimate better
    than the intervals say.

    Args:
        run: A run whose environments are drawn alike.
        outcome: The name of an outcome; one with several numbers has estimates for each.
        statistic: ``"mean"`` or ``"quantile"``.
        q: Which quantile, between 0 and 1.
        points: At how many n, at most; they are evenly spaced in the logarithm, from 2 to all.
        confidence: Of the intervals.
        missing: ``"refuse"`` environments that are frozen or without a finite value, or ``"drop"`` them.

    Returns:
        ``estimate``, ``low`` and ``high`` (n, …), with the attributes of the outcome; the ends of an interval for
        which there are too few environments are NaN.

    Raises:
        ValueError: If there is no such outcome, the first environments are no sample of all, or some cannot be
            used.
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
        raise ValueError(f"outcome {outcome!r} must be of at least 2 environments, got {len(values)}")
    counts = np.unique(np.geomspace(2, len(values), points).round().astype(int))
    counts[-1] = len(values)  # one point is that of all
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
    """Raises ``ValueError`` if the first environments of an experiment are no sample of all."""
    advice = "convergence needs environments that are drawn alike, of which the first ones are a sample"
    if settings.sampling.method == "saltelli":
        raise ValueError(f"{advice}; those of sampling.method = 'saltelli' are not independent")
    for name, entry in settings.variation.items():
        if entry.kind in _ORDERED:
            raise ValueError(f"{advice}; {key_path(('variation', name))}.{entry.kind} gives them an order")


def _means(values: Array, counts: Array, confidence: float) -> tuple[Array, Array, Array]:
    """Returns estimates and ends of intervals (n, numbers) of the mean of ``values`` (envs, numbers)."""
    from scipy.special import stdtrit

    centre = values.mean(axis=0)
    sums = np.cumsum(values - centre, axis=0)[counts - 1]
    squares = np.cumsum((values - centre) ** 2, axis=0)[counts - 1]
    n = counts[:, None].astype(np.float64)
    variance = np.maximum(squares - sums**2 / n, 0.0) / (n - 1.0)
    half = stdtrit(n - 1.0, 0.5 * (1.0 + confidence)) * np.sqrt(variance / n)
    mean = centre + sums / n
    return mean, mean - half, mean + half


def _quantiles(values: Array, counts: Array, q: float, confidence: float) -> tuple[Array, Array, Array]:
    """Returns the same of a quantile."""
    from scipy.stats import binom

    tail = 0.5 * (1.0 - confidence)
    found = np.full((3, len(counts), values.shape[1]), np.nan)
    for i, n in enumerate(counts):
        ordered = np.sort(values[:n], axis=0)
        found[0, i] = np.quantile(ordered, q, axis=0)
        # Ranks from 1: more than ``low`` values lie below the quantile but for the tail, and fewer than ``high``.
        low, high = int(binom.ppf(tail, n, q)), int(binom.ppf(1.0 - tail, n, q)) + 1
        if low >= 1:
            found[1, i] = ordered[low - 1]
        if high <= n:
            found[2, i] = ordered[high - 1]
    return found[0], found[1], found[2]
