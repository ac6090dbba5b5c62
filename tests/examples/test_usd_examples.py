"""Every experiment file of the examples gives a valid animation in every format, and as clips."""

import pytest
from example_files import FOLDER

import warpcontact as wc

# These record no time series; the records of the others are far apart.
WITHOUT = ("lander", "stopping_distance")
DURATION = {"buoy": 2.0}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.toml") if path.stem not in WITHOUT))
def test_example_animation_is_valid_in_every_usd_format(name, device, tmp_path):
    experiment = wc.Experiment.from_toml(FOLDER / f"{name}.toml")
    run = experiment.changed(duration=DURATION.get(name, 0.3)).run(tmp_path / "out", device=device)
    assert wc.check_usd(run.files["animation"]) == []
    for suffix in (".usda", ".usdc", ".usdz"):
        path = wc.export_usd(run.recording, tmp_path / f"a{suffix}", envs=[0])
        assert wc.check_usd(path) == []
    path = wc.export_usd(run.recording, tmp_path / "clips.usda", envs=[0], clip_frames=4)
    assert wc.check_usd(path) == []
