"""``warpcontact export DIR --usd FILE``: environments, clips and colors of a run in a folder."""

import subprocess
import sys

import numpy as np
import pytest
from pxr import Usd
from recorded_usd_scene import value
from sharded_runs import STUDY

import warpcontact as wc
from warpcontact.cli import main

pytestmark = pytest.mark.installed


@pytest.fixture(scope="module")
def folder(device, tmp_path_factory):
    path = tmp_path_factory.mktemp("run")
    (path / "study.toml").write_text(STUDY)
    wc.Experiment.from_toml(path / "study.toml").run(path / "out", device=device)
    return path / "out"


@pytest.mark.smoke
def test_export_command_selects_environments_and_colors(folder, tmp_path, capsys):
    path = tmp_path / "a.usdc"
    assert main(["export", str(folder), "--usd", str(path), "--envs", "1", "3", "--color-by", "end_time"]) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert wc.check_usd(path) == []
    stage = Usd.Stage.Open(str(path))
    names = {prim.GetName() for prim in stage.GetPrimAtPath("/World").GetChildren()}
    assert {name for name in names if name.startswith("env_")} == {"env_1", "env_3"}
    run = wc.open_run(folder)
    found = value(stage, "/World/Ensemble/ball", "primvars:warpcontact:endTime")
    np.testing.assert_array_equal(found, run.outcome["end_time"].values)
    notes = stage.GetRootLayer().customLayerData["warpcontact"]
    assert (notes["seed"], notes["fingerprint"]) == (3, run.summary["fingerprint"])
    main(["export", str(folder), "--usd", str(path), "--color-by", "ball.mass", "--envs", "0"])
    stage = Usd.Stage.Open(str(path))
    found = value(stage, "/World/Ensemble/ball", "primvars:warpcontact:ball:mass")
    np.testing.assert_array_equal(found, run.params["ball.mass"].values)


def test_export_command_colors_by_an_outcome_of_any_name(device, tmp_path):
    text = STUDY.replace("[record]", '[outcome]\n_ = { type = "Max", of = "touch.gap" }\n[record]')
    (tmp_path / "study.toml").write_text(text)
    wc.Experiment.from_toml(tmp_path / "study.toml").run(tmp_path / "out", device=device)
    path = tmp_path / "a.usda"
    assert main(["export", str(tmp_path / "out"), "--usd", str(path), "--envs", "1", "--color-by", "_"]) == 0
    found = value(Usd.Stage.Open(str(path)), "/World/Ensemble/ball", "primvars:warpcontact:_")
    np.testing.assert_array_equal(found, wc.open_run(tmp_path / "out").outcome["_"].values)


def test_export_command_clips_equal_a_single_file(folder, tmp_path):
    for path, clips in (("one.usda", []), ("run.usda", ["--clips", "30"])):
        assert main(["export", str(folder), "--usd", str(tmp_path / path), "--envs", "2", *clips]) == 0
    assert len(list((tmp_path / "run.usda.clips").glob("clip_*"))) == 7
    assert wc.check_usd(tmp_path / "run.usda") == []
    one, several = (Usd.Stage.Open(str(tmp_path / name)) for name in ("one.usda", "run.usda"))
    for path, name in (
        ("/World/env_2/ball", "xformOp:translate"),
        ("/World/env_2/contacts/touch", "warpcontact:gap"),
        ("/World/Ensemble/ball", "positions"),
    ):
        for code in range(201):
            np.testing.assert_array_equal(value(one, path, name, code), value(several, path, name, code))


def test_export_command_spacing_offsets_environments(folder, tmp_path):
    options = ["--spacing", "2", "0", "--envs", "0", "1"]
    assert main(["export", str(folder), "--usd", str(tmp_path / "a.usda"), *options]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    np.testing.assert_array_equal(value(stage, "/World/env_1", "xformOp:translate"), [2, 0, 0])


def test_csv_of_a_minus_is_written_to_standard_output(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(folder), "--csv", "table.csv"]) == 0
    capsys.readouterr()
    assert main(["export", str(folder), "--csv", "-"]) == 0
    assert capsys.readouterr().out == (tmp_path / "table.csv").read_text(encoding="utf-8")
    assert [path.name for path in tmp_path.iterdir()] == ["table.csv"]


@pytest.mark.parametrize("kind", ["csv", "usd"])
def test_export_command_prints_only_the_path(folder, tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    words = [sys.executable, "-m", "warpcontact", "export", str(folder), f"--{kind}", str(path)]
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout == f"{path}\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--csv", "a.csv", "--clips", "3"], "--clips requires --usd"),
        (["--csv", "a.csv", "--color-by", "x"], "--color-by requires --usd"),
        (["--usd", "a.usdc", "--clips", "0"], "clip_frames must be a whole number of records, at least 1, got 0"),
        (["--usd", "a.usdc", "--color-by", "stop"], "color_by must be something that was recorded, got 'stop'"),
        (["--usd", "a.usdc", "--color-by", "end_tme"], "got 'end_tme'; did you mean 'end_time'?"),
        (["--usd", "no/a.usdc"], "no/a.usdc: no does not exist"),
        (["--csv", "no/a.csv"], "no/a.csv: no does not exist"),
        (["--csv", "."], ".: is a folder; give the name of a file"),
        (["--usd", "a.obj"], "must end in .usd, .usda, .usdc, .usdz"),
        (["--usd", "a.usdc", "--envs", "77"], "environment 77 is not in the recording"),
    ],
)
def test_invalid_export_arguments_are_reported(folder, tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(folder), *options]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
