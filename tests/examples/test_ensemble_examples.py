"""Small runs of the examples with large ensembles have correct results."""

import numpy as np
import pytest
from closed_forms import contact_time
from example_files import FOLDER, load

import warpcontact as wc


@pytest.mark.parametrize(
    ("name", "options", "written"),
    [
        pytest.param("restitution_map", ["--side", "2"], "restitution_map.png", marks=pytest.mark.slow),
        ("lander", ["--envs", "8"], "peak_load.png"),
        ("stopping_distance", ["--envs", "32"], "picture.png"),
    ],
)
def test_ensemble_example_writes_its_results(name, options, written, device, tmp_path):
    assert load(name).main([*options, "--device", device, "--out", str(tmp_path / "out")])
    assert (tmp_path / "out" / written).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_restitution_map_example_matches_restitution_at_all_masses_and_speeds(device, tmp_path, capsys):
    errors = load("restitution_map").main(["--side", "12", "--device", device, "--out", str(tmp_path / "out")])
    assert "largest deviation of all" in capsys.readouterr().out
    assert (tmp_path / "out" / "restitution_map.png").read_bytes().startswith(b"\x89PNG")
    assert len(errors) == 5
    # Second order in the step at 28 steps per contact, (π/28)²/8; the approximant of Kuwabara–Kono has an error of
    # 7e-4.
    assert max(errors.values()) < 1.6e-3


def test_restitution_map_duration_exceeds_the_longest_impact():
    example = load("restitution_map")
    mass, speed = example.MASSES[1], example.SPEEDS[0]
    hertz, linear = (
        contact_time(example.HERTZ, 1.5, mass, speed),
        contact_time(example.LINEAR, 1.0, mass, speed),
    )
    # Dissipation makes contacts longer: by a tenth for a restitution of 0.5.
    assert max(hertz, linear) < 0.8 * example.experiment(np.array([mass]), np.array([speed])).settings.duration


@pytest.mark.slow
def test_lander_example_loads_match_impact_energy(device, tmp_path, capsys):
    result = load("lander").main(["--envs", "96", "--device", device, "--out", str(tmp_path / "out")])
    printed = capsys.readouterr().out
    assert "of 96 tipped over" in printed
    for name in ("picture.png", "peak_load.png", "load_over_time.png"):
        assert (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG")
    assert result["load 0.5"] < result["load 0.95"] < result["load 0.99"]
    run = wc.open_run(tmp_path / "out")
    leg = run.outcome["peak_leg_load"].values
    # Together the four legs carry more than one, and at most four times the load of one.
    total = run.outcome["peak_load"].values
    assert (leg <= total).all()
    assert (total <= 4 * leg).all()
    # The load of a leg is at least the spring force at maximum penetration, where the speed is zero.
    spring = 2e5 * run.outcome["stroke"].values ** 1.5
    np.testing.assert_array_less(spring, leg * (1 + 1e-5))
    rested = run.outcome["end_time"].values < 10.0
    # The ground is within 0.25 m of its mean, and the legs end 1.25 m below the center.
    height = run.outcome["place"].sel(axis="z").values[rested]
    assert height.min() > 0.0
    assert height.max() < 2.0


def test_lander_example_starts_without_contact():
    model = wc.Experiment.from_toml(FOLDER / "lander.toml").model(envs=512, device="cpu")
    for contact in ("legs", "roof"):
        assert model.sensor(f"{contact}.gap").min() > 0.1
