"""Sobol' sensitivity indices: share of the variance of an outcome due to each parameter."""

import numpy as np
import xarray as xr

from warpcontact.analysis.results import ExperimentResults, probability, remaining_dims, usable_outcome, variable
from warpcontact.experiment.design import sampled_components
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

# Number of resamples averaged in one matrix product.
AT_ONCE = 64


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
