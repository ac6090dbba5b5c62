"""Sobol' indices: which part of the variance of an outcome comes from which parameter."""

import numpy as np
import xarray as xr

from warpcontact.analysis.results import ExperimentResults, probability, remaining_dims, usable_outcome, variable
from warpcontact.experiment.sample_columns import sampled_components
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

# So many resamples are averaged at once.
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
    """Returns Sobol' indices of an outcome, of first order and total, for each number that was drawn.

    The estimates are those of ``scipy.stats.sobol_indices`` (Saltelli et al. 2010); the intervals are between
    quantiles of a bootstrap over the rows of the design.

    Args:
        run: A run of an experiment with ``sampling.method = "saltelli"``.
        outcome: The name of an outcome; one with several numbers has indices for each.
        confidence: Of the intervals.
        resamples: Of the bootstrap.
        seed: Of the bootstrap.
        missing: What becomes of environments that are frozen or without a finite value: ``"refuse"`` them, or
            ``"drop"`` each row of the design that has one.

    Returns:
        ``first_order`` and ``total_order`` (parameter, …), with ``_low`` and ``_high`` added to their names the
        ends of the intervals; of an outcome that is the same in all environments NaN. The attribute ``rows`` is
        the number of rows of the design that were used, and ``dropped`` that of the others.

    Raises:
        ValueError: If the run is none of such an experiment, or some environments cannot be used.
    """
    probability("confidence", confidence)
    checks.integer("resamples", resamples, 1)
    checks.integer("seed", seed, 0)
    settings = run.settings
    if settings.sampling.method != "saltelli":
        raise ValueError(
            "sensitivity needs a run with sampling.method = 'saltelli' and envs = n (d + 2), with n a power of "
            f"two and d the number of numbers that are drawn; this one has {settings.sampling.method!r}"
        )
    array = variable(run.outcome, outcome, "outcome", "env")
    names = [
        f"{name}[{', '.join(map(str, index))}]" if index else name
        for name, index in sampled_components(settings.variation)
    ]
    if array.sizes["env"] != settings.envs:
        raise ValueError(
            f"outcome {outcome!r} must be of all {settings.envs} environments, got {array.sizes['env']}"
        )
    values, good = usable_outcome(run, array, missing)
    rows = settings.envs // (len(names) + 2)
    complete_rows = good.reshape(-1, rows).all(axis=0)
    if complete_rows.sum() < 2:
        left = f"got {complete_rows.sum()} of {rows}"
        raise ValueError(f"outcome {outcome!r} must have 2 rows of the design without missing values, {left}")
    # A, B, and A with each column of B.
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
    """The terms of the estimators, row by row, so that a resample is an average with other weights.

    Args:
        a: Outcome on the rows of A, (n, outcomes).
        b: Likewise.
        ab: Outcome on A with a column of B, (parameters, n, outcomes).
    """

    def __init__(self, a: Array, b: Array, ab: Array) -> None:
        # Without the mean both estimators vary less (Sobol' and Levitan 1999).
        mean = 0.5 * (a.mean(axis=0) + b.mean(axis=0))
        a, b, ab = a - mean, b - mean, ab - mean
        self.rows, self.outcomes = a.shape
        # All as columns of one matrix (n, columns): the moments of A and B, then a column for each parameter.
        first, total = b * (ab - a), 0.5 * (a - ab) ** 2
        terms = [0.5 * (a + b)[None], 0.5 * (a**2 + b**2)[None], first, total]
        self.columns = np.concatenate(terms).swapaxes(0, 1).reshape(self.rows, -1)

    def indices(self) -> tuple[Array, Array]:
        """Returns first and total order (parameters, outcomes)."""
        first, total = self._indices(np.full((1, self.rows), 1.0 / self.rows))
        return first[0], total[0]

    def resampled(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Returns first and total order of so many resamples (count, parameters, outcomes)."""
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
