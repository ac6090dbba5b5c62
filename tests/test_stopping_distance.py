"""Sensitivity of a simulated outcome: the way that a sliding block takes to stop, against its closed form."""

from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr

import warpcontact as wc
from warpcontact.experiment.schema import Settings

GRAVITY = 9.81
ROWS = 512
SLIDE = {
    "envs": 4 * ROWS,
    "duration": 2.6,
    "dt": 1e-2,
    "gravity": [0, 0, -GRAVITY],
    "surface": [{"name": "floor", "mesh": {"shape": "grid", "size": [40, 4]}}],
    "body": [{"name": "block", "mass": 2, "inertia": [0.1] * 3}],
    "point": [{"name": "foot", "body": "block", "position": [0, 0, 0]}],
    "template": [
        {"name": "dry", "law": {"type": "Rigid"}, "friction": {"type": "Coulomb", "mu": 0.3}},
    ],
    "contact": [{"name": "slide", "points": "foot", "surface": "floor", "template": "dry"}],
    "integrator": {"type": "MoreauJean"},
    "variation": {
        "block.linear_velocity": {"uniform": [[1, 0, 0], [4, 0, 0]]},
        "slide.friction.mu": {"uniform": [0.2, 0.6]},
    },
    "sampling": {"method": "saltelli"},
    "record": {"every": 2.6, "readings": ["block.position", "block.linear_velocity"]},
    "output": {"usd_envs": 0},
}


@dataclass
class Run:
    settings: Settings
    outcome: xr.Dataset


def moments(low, high, power):
    """Mean and mean square of x^power, x uniform, for powers other than −1 and −1/2."""

    def mean(p):
        return (
            np.log(high / low) / (high - low)
            if p == -1
            else (high ** (p + 1) - low ** (p + 1)) / (p + 1) / (high - low)
        )

    return mean(power), mean(2 * power)


@pytest.mark.slow
def test_speed_and_friction_share_the_variance_of_the_stopping_distance_as_the_closed_form_has_it(
    device, tmp_path
):
    experiment = wc.Experiment.from_dict(SLIDE)
    recording = experiment.run(tmp_path / "out", device=device).recording
    last = recording.isel(time=-1)
    # All have stopped, as exactly as the solver goes: 1e-5 of 4 m/s.
    assert np.abs(last["block.linear_velocity"]).max() < 4e-5
    distance = last["block.position"].sel(axis="x").values.astype(float)
    rows = experiment.design.rows(0, 4 * ROWS)
    speed, mu = rows["block.linear_velocity"][:, 0], rows["slide.friction.mu"]
    # Two steps are those of touching and of coming to rest, in which a block goes up to 2 v dt.
    np.testing.assert_allclose(distance, speed**2 / (2 * mu * GRAVITY), atol=2 * 4 * SLIDE["dt"])

    run = Run(experiment.settings, xr.Dataset({"distance": ("env", distance)}))
    indices = wc.sensitivity(run, "distance")
    assert indices["parameter"].values.tolist() == ["block.linear_velocity[0]", "slide.friction.mu"]
    # Of a product f(v) h(μ), with f = v² and h = 1/μ.
    f, ff = moments(1, 4, 2)
    h, hh = moments(0.2, 0.6, -1)
    variance = ff * hh - (f * h) ** 2
    first = np.array([(ff - f**2) * h**2, (hh - h**2) * f**2]) / variance
    total = 1 - first[::-1]
    # 512 rows of Sobol' points: less than 1/√512 = 0.044.
    np.testing.assert_allclose(indices["first_order"], first, atol=0.044)
    np.testing.assert_allclose(indices["total_order"], total, atol=0.044)
    for key, exact in (("first_order", first), ("total_order", total)):
        assert (indices[f"{key}_low"] <= exact).all()
        assert (exact <= indices[f"{key}_high"]).all()
