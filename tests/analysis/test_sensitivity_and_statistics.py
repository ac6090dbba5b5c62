"""Sensitivity indices, quantile fans and convergence against closed forms."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import xarray as xr
from scipy import stats
from test_experiment import content

import warpcontact as wc
from warpcontact.analysis import fan as fan_module
from warpcontact.experiment.sampling import Saltelli
from warpcontact.experiment.schema import Settings

STATUS = {"flag_values": [0, 1, 2], "flag_meanings": "ACTIVE FROZEN STOPPED"}


@dataclass
class Run:
    """Stand-in for the results of a run with ``settings``."""

    settings: Settings
    outcome: xr.Dataset = field(default_factory=xr.Dataset)
    series: xr.Dataset = field(default_factory=xr.Dataset)


def study(envs, method="saltelli", **variation):
    """Returns an experiment and its samples (envs, d); parameter names have no dots."""
    names = {name: name.replace("_", ".", 1) for name in variation}
    varied = {names[name]: entry for name, entry in variation.items()}
    experiment = wc.Experiment.from_dict(content(envs=envs, variation=varied, sampling={"method": method}))
    rows = experiment.design.rows(0, envs)
    columns = [rows[names[name]].reshape(envs, -1) for name in variation]
    return experiment.settings, np.concatenate(columns, axis=1)


def with_outcome(settings, values, dims=("env",), **others):
    data = {"peak": (dims, values, {"units": "N"}), **others}
    return Run(settings, outcome=xr.Dataset(data, coords={"env": np.arange(len(values))}))


# --- sensitivity


def ishigami(n):
    """Ishigami's function, a = 7 and b = 0.1, on n (d + 2) environments."""
    velocity = {"uniform": [[-np.pi] * 3, [np.pi] * 3]}
    settings, x = study(5 * n, ball_linear_velocity=velocity)
    return settings, np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_sobol_indices_of_ishigami_function_are_within_confidence_interval():
    indices = wc.sensitivity(with_outcome(*ishigami(2**13)), "peak", confidence=0.99)
    # Closed form of the variance and its parts.
    a, b = 7.0, 0.1
    parts = np.array([0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8, 0.0])
    mixed = b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    exact = xr.Dataset(
        {
            "first_order": ("parameter", parts / (parts.sum() + mixed)),
            "total_order": ("parameter", (parts + np.array([mixed, 0, mixed])) / (parts.sum() + mixed)),
        }
    )
    assert indices["parameter"].values.tolist() == [f"ball.linear_velocity[{i}]" for i in range(3)]
    for key, values in exact.items():
        np.testing.assert_allclose(indices[key], values, atol=0.02)  # 1/√8192 = 0.011
        assert (indices[f"{key}_low"].values <= values.values + 1e-12).all()
        assert (indices[f"{key}_high"].values >= values.values - 1e-12).all()
        assert (indices[f"{key}_high"] - indices[f"{key}_low"]).max() < 0.1
    assert (indices.attrs["rows"], indices.attrs["dropped"]) == (8192, 0)


def test_sobol_indices_match_scipy():
    n = 256
    settings, values = ishigami(n)
    a, b, *ab = values.reshape(5, n)
    expected = stats.sobol_indices(func={"f_A": a[None], "f_B": b[None], "f_AB": np.array(ab)[:, None]}, n=n)
    indices = wc.sensitivity(with_outcome(settings, values), "peak", resamples=10)
    np.testing.assert_allclose(indices["first_order"], expected.first_order, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(indices["total_order"], expected.total_order, rtol=1e-10, atol=1e-12)


def test_sobol_indices_of_a_sum_equal_its_variance_shares():
    """For an outcome with several components, the indices of a sum are weighted by their variances."""
    settings, x = study(4 * 4096, ball_mass={"normal": [20, 1]}, touch_radius={"uniform": [1, 2]})
    weights = np.array([[1, 1], [0, 3], [2, 0.5]])
    run = with_outcome(settings, x @ weights.T + 1e4, ("env", "axis"))
    indices = wc.sensitivity(run, "peak")
    shares = weights**2 * [1, 1 / 12]
    shares = (shares / shares.sum(axis=1, keepdims=True)).T
    assert indices["first_order"].dims == ("parameter", "axis")
    # Without products of parameters both orders are equal; 1/√4096 = 0.016.
    np.testing.assert_allclose(indices["first_order"], shares, atol=0.02)
    np.testing.assert_allclose(indices["total_order"], shares, atol=0.02)


def test_confidence_intervals_of_indices_have_stated_coverage():
    settings, _ = study(4 * 128, ball_mass={"normal": [20, 1]}, touch_radius={"uniform": [1, 2]})
    share = 1 / (1 + 9 / 12)
    held = 0
    for seed in range(100):
        units = next(Saltelli(seed, 2, 4 * 128).blocks(0))[: 4 * 128]
        run = with_outcome(settings, stats.norm.ppf(units[:, 0]) + 3 * units[:, 1])
        indices = wc.sensitivity(run, "peak", confidence=0.9, resamples=200, seed=seed)
        held += float(indices["total_order_low"][0]) <= share <= float(indices["total_order_high"][0])
    # 90 ± 3 for random rows. For Sobol' points the estimates are better than resampling can show.
    assert held >= 80


def test_sobol_indices_are_nan_for_constant_outcome():
    settings, x = study(4 * 8, ball_mass={"uniform": [1, 2]}, touch_radius={"uniform": [1, 2]})
    indices = wc.sensitivity(with_outcome(settings, np.full(len(x), 3.0)), "peak")
    assert all(np.isnan(indices[key]).all() for key in indices)


def test_confidence_intervals_are_repeatable_with_equal_seed():
    run = with_outcome(*ishigami(64))
    first, again, other = (wc.sensitivity(run, "peak", seed=seed, resamples=100) for seed in (0, 0, 1))
    assert first.identical(again)
    assert not first["first_order_low"].equals(other["first_order_low"])
    assert first["first_order"].equals(other["first_order"])


@pytest.mark.parametrize("how", ["nan", "frozen"])
def test_sensitivity_raises_for_missing_environments_or_drops_their_rows(how):
    n = 64
    settings, values = ishigami(n)
    bad = [3, n + 3, 2 * n + 7]
    status = np.zeros(len(values), dtype=np.int32)
    if how == "nan":
        values[bad] = np.nan
    else:
        status[bad] = 1
        status[5] = 2  # stopped: it has its outcomes
    run = with_outcome(settings, values, status=("env", status, STATUS))
    reason = "not finite" if how == "nan" else "frozen"
    with pytest.raises(
        ValueError, match=rf"'peak' cannot be used in 3 of 320 environments: 3 \({reason}\), 67 .*drop"
    ):
        wc.sensitivity(run, "peak")
    indices = wc.sensitivity(run, "peak", missing="drop", resamples=10)
    assert (indices.attrs["rows"], indices.attrs["dropped"]) == (n - 2, 2)
    kept = np.delete(np.arange(n), [3, 7])
    a, b, *ab = values.reshape(5, n)[:, kept]
    both = np.concatenate([a, b])
    expected = [0.5 * np.mean((a - one) ** 2) / both.var() for one in ab]
    np.testing.assert_allclose(indices["total_order"], expected, rtol=1e-10)


# --- quantile fans


def waves(envs, times=50, extra=()):
    rng = np.random.default_rng(0)
    values = rng.normal(size=(times, envs, *extra)).astype(np.float32)
    dims = ("time", "env", *("axis", "item")[: len(extra)])
    coords = {"time": 0.1 * np.arange(times), "env": np.arange(envs)}
    settings, _ = study(4, "random", ball_mass={"uniform": [1, 2]})
    series = xr.Dataset({"ball.height": (dims, values, {"units": "m"})}, coords=coords)
    return Run(settings, series=series), values


@pytest.mark.parametrize("extra", [(), (3,), (3, 2)])
@pytest.mark.parametrize("block", [1, 10_000, 2**26])
def test_quantile_fan_matches_quantiles_at_each_time(extra, block, monkeypatch):
    monkeypatch.setattr(fan_module, "BLOCK", block)
    run, values = waves(101, extra=extra)
    fan = wc.quantile_fan(run, "ball.height", (0.0, 0.1, 0.5, 1.0))
    assert fan.dims == ("quantile", "time", *("axis", "item")[: len(extra)])
    assert fan.attrs["units"] == "m"
    assert fan["time"].equals(run.series["time"])
    ordered = np.sort(values.astype(float), axis=1)
    # With 101 values, every hundredth quantile is one of them.
    for level, rank in ((0.0, 0), (0.1, 10), (0.5, 50), (1.0, 100)):
        np.testing.assert_allclose(fan.sel(quantile=level), ordered[:, rank], rtol=1e-12)


def test_quantile_fan_reads_store_in_blocks(tmp_path, monkeypatch):
    run, _ = waves(20)
    run.series.to_zarr(tmp_path / "series", encoding={"ball.height": {"chunks": (8, 5)}}, consolidated=False)
    stored = xr.open_zarr(tmp_path / "series", consolidated=False, chunks=None)
    monkeypatch.setattr(fan_module, "BLOCK", 20 * 20 * 8)  # 20 blocks
    read = []
    monkeypatch.setattr(
        np, "quantile", lambda values, *a, _f=np.quantile, **k: read.append(len(values)) or _f(values, *a, **k)
    )
    fan = wc.quantile_fan(Run(run.settings, series=stored), "ball.height")
    assert read == [16, 16, 16, 2]
    assert fan.equals(wc.quantile_fan(run, "ball.height"))


def test_quantile_fan_drops_missing_values_on_request():
    run, values = waves(10, times=4)
    run.series["ball.height"][2, 4] = np.nan
    run.outcome = xr.Dataset({"status": ("env", np.eye(10, dtype=int)[7], STATUS)}, coords={"env": np.arange(10)})
    with pytest.raises(
        ValueError, match=r"in 2 of 10 environments: 4 \(not finite\), 7 \(frozen\); pass missing='drop'"
    ):
        wc.quantile_fan(run, "ball.height")
    fan = wc.quantile_fan(run, "ball.height", missing="drop")
    for time in range(4):
        rest = np.delete(values[time].astype(float), [4, 7] if time == 2 else [7])
        np.testing.assert_allclose(fan[:, time], np.quantile(rest, fan["quantile"]), rtol=1e-12)
    run.series["ball.height"][1] = np.nan
    assert np.isnan(wc.quantile_fan(run, "ball.height", missing="drop")[:, 1]).all()


def test_quantile_fan_of_selected_environments_identifies_frozen_ones():
    run, values = waves(10, times=4)
    run.outcome = xr.Dataset({"status": ("env", np.eye(10, dtype=int)[7], STATUS)}, coords={"env": np.arange(10)})
    run.series = run.series.isel(env=[1, 7, 9])
    fan = wc.quantile_fan(run, "ball.height", (0.0, 1.0), missing="drop")
    np.testing.assert_allclose(fan.sel(quantile=1.0), values[:, [1, 9]].max(axis=1))


def test_quantile_fan_is_written_as_png_and_svg(tmp_path):
    run, _ = waves(20, extra=(3,))
    fan = wc.quantile_fan(run, "ball.height")
    wc.write_fan(tmp_path / "fan.png", fan.isel(axis=2))
    assert (tmp_path / "fan.png").read_bytes().startswith(b"\x89PNG")
    wc.write_fan(tmp_path / "fan.svg", fan.isel(axis=2)[:2], title="height")
    with pytest.raises(
        ValueError, match="fan must have the dimensions quantile and time, got quantile, time, axis"
    ):
        wc.write_fan(tmp_path / "fan.png", fan)
    with pytest.raises(ValueError, match=r"must end in \.svg or \.png, got \.txt"):
        wc.write_fan(tmp_path / "fan.txt", fan.isel(axis=2))


# --- convergence


def sampled(values, method="random", dims=("env",), **changes):
    settings, _ = study(4, method, ball_mass={"uniform": [1, 2]}, **changes)
    return with_outcome(settings, values, dims)


def test_mean_interval_matches_student_t():
    values = np.random.default_rng(0).normal(3.0, 2.0, (500, 2))
    found = wc.convergence(sampled(values, dims=("env", "axis")), "peak", points=9, confidence=0.9)
    assert found["estimate"].dims == ("n", "axis")
    assert found["estimate"].attrs["units"] == "N"
    counts = found["n"].values
    assert counts[0] == 2
    assert counts[-1] == 500
    assert (np.diff(counts) > 0).all()
    for i, n in enumerate(counts):
        expected = stats.t.interval(0.9, n - 1, values[:n].mean(axis=0), stats.sem(values[:n]))
        np.testing.assert_allclose(found["estimate"][i], values[:n].mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose([found["low"][i], found["high"][i]], expected, rtol=1e-10)


def test_mean_interval_keeps_precision_far_from_zero():
    values = 1e9 + np.random.default_rng(0).normal(size=4096)
    found = wc.convergence(sampled(values), "peak", points=1)
    half = float(found["high"][0] - found["estimate"][0])
    assert half == pytest.approx(stats.t.ppf(0.975, 4095) * values.std(ddof=1) / 64, abs=2.4e-7)  # digits of 1e9


@pytest.mark.parametrize("q", [0.5, 0.9])
def test_quantile_intervals_have_at_least_stated_coverage(q):
    rng = np.random.default_rng(1)
    # 400 outcomes, each with a sample of 200 from the exponential distribution.
    found = wc.convergence(
        sampled(rng.exponential(size=(200, 400)), dims=("env", "trial")), "peak", "quantile", q, points=6
    )
    exact = -np.log(1.0 - q)
    last = found.isel(n=-1)
    held = ((last["low"] <= exact) & (exact <= last["high"])).mean()
    # Ranks are integers: slightly above 0.95, here up to 0.963, ± four standard deviations.
    assert 0.95 - 4 * np.sqrt(0.05 * 0.95 / 400) <= held <= 0.965 + 4 * np.sqrt(0.05 * 0.95 / 400)
    assert np.isnan(found["high"][0]).all()  # two values are both below with too high a probability
    assert float(last["estimate"].mean()) == pytest.approx(exact, rel=0.05)


def test_quantile_interval_ranks_match_binomial_tables():
    # For the median of 10 values, the second and the ninth: a confidence of 1 − 2·11/1024 = 0.979.
    found = wc.convergence(sampled(np.arange(1.0, 11.0)), "peak", "quantile", points=1)
    assert (float(found["low"][0]), float(found["estimate"][0]), float(found["high"][0])) == (2.0, 5.5, 9.0)


# --- invalid arguments


def test_analysis_raises_for_invalid_arguments():
    run = sampled(np.arange(4.0))
    saltelli = with_outcome(*ishigami(2))
    fan, _ = waves(4)
    ordered = sampled(np.arange(4.0), touch_force_scale={"linspace": [0, 1]})
    for call, message in (
        (
            lambda: wc.sensitivity(run, "peak"),
            "needs a run with sampling.method = 'saltelli' .* got 'random'",
        ),
        (
            lambda: wc.sensitivity(saltelli, "peek"),
            "outcome must be one of the run, got 'peek'; did you mean 'peak'",
        ),
        (
            lambda: wc.sensitivity(saltelli, "peak", confidence=1),
            "confidence must be greater than 0 and less than 1, got 1",
        ),
        (
            lambda: wc.sensitivity(saltelli, "peak", resamples=0),
            "resamples must be a whole number of at least 1, got 0",
        ),
        (lambda: wc.sensitivity(saltelli, "peak", seed=-1), "seed must be a whole number of at least 0, got -1"),
        (
            lambda: wc.sensitivity(saltelli, "peak", missing="ignore"),
            "missing must be one of 'refuse', 'drop', got 'ignore'",
        ),
        (
            lambda: wc.sensitivity(Run(saltelli.settings, run.outcome), "peak"),
            "'peak' must have values of all 10 environments, got 4",
        ),
        (
            lambda: wc.quantile_fan(fan, "ball.hight"),
            "sensor must be one of the run, got 'ball.hight'; did you mean",
        ),
        (
            lambda: wc.quantile_fan(fan, "ball.height", (0.5, 1.1)),
            r"quantiles must be numbers from 0 to 1, got \(0.5, 1.1\)",
        ),
        (lambda: wc.quantile_fan(fan, "ball.height", ()), r"quantiles must be numbers from 0 to 1, got \(\)"),
        (
            lambda: wc.quantile_fan(fan, "ball.height", (0.5, 0.1)),
            r"quantiles must be strictly ascending, got \(0.5, 0.1\)",
        ),
        (
            lambda: wc.convergence(sampled(np.zeros(0)), "peak"),
            "outcome 'peak' has no values yet, because no environment is finished; resume the run",
        ),
        (
            lambda: wc.sensitivity(with_outcome(saltelli.settings, np.zeros((0, 3)), ("env", "axis")), "peak"),
            "outcome 'peak' has no values yet, because no environment is finished",
        ),
        (
            lambda: wc.quantile_fan(Run(fan.settings, series=fan.series.isel(env=[])), "ball.height"),
            "sensor 'ball.height' has no values yet, because no environment is started",
        ),
        (lambda: wc.quantile_fan(run, "x"), "sensor must be one of the run, got 'x'; there are: none"),
        (
            lambda: wc.convergence(run, "peak", "median"),
            "statistic must be one of 'mean', 'quantile', got 'median'",
        ),
        (lambda: wc.convergence(run, "peak", "quantile", 0), "q must be greater than 0 and less than 1, got 0"),
        (lambda: wc.convergence(run, "peak", points=0), "points must be a whole number of at least 1, got 0"),
        (lambda: wc.convergence(saltelli, "peak"), "those of sampling.method = 'saltelli' are not independent"),
        (lambda: wc.convergence(ordered, "peak"), 'variation."touch.force_scale".linspace gives them an order'),
        (
            lambda: wc.convergence(sampled(np.array([1.0, np.nan])), "peak", missing="drop"),
            "at least 2 usable env.* got 1",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            call()
