"""Overrides of an experiment file act like entries of the file."""

import pytest

import warpcontact as wc
from warpcontact.cli import main

FILE = """\
envs = 3
duration = 0.004
dt = 1e-3
[[body]]
name = "ball"
mass = 1.0
inertia = [0.1, 0.1, 0.1]
position = [0, 0, 1]
[[body]]
name = "box"
mass = 3.0
inertia = [0.1, 0.1, 0.1]
[variation]
"ball.mass" = { uniform = [1, 2] }
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "drop.toml"
    path.write_text(FILE)
    return path


@pytest.mark.parametrize(
    ("change", "old", "new"),
    [
        ("dt=2e-3", "dt = 1e-3", "dt = 2e-3"),
        (" dt = 2e-3 ", "dt = 1e-3", "dt = 2e-3"),
        ("body[1].mass=4", "mass = 3.0", "mass = 4"),
        ("body.box.mass=4", "mass = 3.0", "mass = 4"),
        ("body.ball.position[2]=5", "[0, 0, 1]", "[0, 0, 5]"),
        ('body[0].name="sphere"', '"ball"\n', '"sphere"\n'),
        ('precision="float64"', "envs", 'precision = "float64"\nenvs'),
        ("record.every=2e-3", "[variation]", "[record]\nevery = 2e-3\n[variation]"),
        ('variation."ball.mass".uniform=[2,3]', "[1, 2]", "[2, 3]"),
        (
            "variation.'box.mass'={ values = [1, 2, 3] }",
            "[variation]",
            '[variation]\n"box.mass".values = [1, 2, 3]',
        ),
    ],
)
def test_set_option_equals_edited_file(change, old, new, file, tmp_path):
    def outcome(path, *changes):
        try:
            return wc.Experiment.from_toml(path, changes=changes).settings
        except wc.ExperimentError as error:
            return error.problems

    edited = tmp_path / "folder" / "drop.toml"
    edited.parent.mkdir()
    assert FILE.count(old) == 1
    edited.write_text(FILE.replace(old, new))
    assert outcome(file, change) == outcome(edited)
    assert outcome(file, change) != outcome(file)


def test_last_set_option_wins_and_is_stored_with_the_run(file, tmp_path):
    words = ["--set", "body.ball.mass=5.0", "--set", "gravity=[0, 0, -1.6]", "--set", "body[0].mass=7.0"]
    words += ["--set", "seed=3", "--envs", "2", "--device", "cpu"]
    assert main(["run", str(file), "--out", str(tmp_path / "run"), *words]) == 0
    settings = wc.open_run(tmp_path / "run").settings
    assert settings.body[0].mass == 7.0
    assert settings.gravity == (0.0, 0.0, -1.6)
    assert (settings.seed, settings.envs) == (3, 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("body.ball.mass=-1", "body[0] ('ball').mass must be greater than 0, got -1 kg"),
        ("body[0].mas=1", "body[0] ('ball').mas is not known; did you mean 'mass'?"),
        ('dt="fast"', "dt must be a number [s], got 'fast'"),
        (
            "body.bal.mass=1",
            "--set 'body.bal.mass=1': body.bal does not exist: no entry has this name; did you mean",
        ),
        ("body.crate.mass=1", "body.crate does not exist: no entry has this name; there are: ball, box"),
        ("body[2].mass=1", "body[2] does not exist: the list has 2 entries"),
        ("dt.big=1", "dt.big does not exist: dt is 0.001"),
        ("variation[0]=1", "variation[0] does not exist: variation is no list"),
        ("precision=float64", "precision must be a TOML value, got 'float64'; write a string in quotes: "),
        ("envs=", "envs must be a TOML value, got ''"),
        ("envs=1\ndt = 3", "envs must be a TOML value, got '1\\ndt = 3'"),
        ("envs", "--set 'envs': must be PATH=VALUE"),
        ("=3", "--set '=3': must be PATH=VALUE"),
        ("body..mass=3", "must be PATH=VALUE"),
        (".dt=3", "must be PATH=VALUE"),
        ("body.[0]=3", "must be PATH=VALUE"),
        ("dt dt=3", "must be PATH=VALUE"),
    ],
)
@pytest.mark.parametrize("command", ["run", "plan"])
def test_invalid_set_option_is_reported(command, change, message, file, tmp_path, capsys):
    words = ["--out", str(tmp_path / "run")] if command == "run" else []
    assert main([command, str(file), "--set", change, *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_changes_argument_raises_for_a_string(file):
    with pytest.raises(TypeError, match="changes must be a list of texts PATH=VALUE, got the string 'dt=2e-3'"):
        wc.Experiment.from_toml(file, changes="dt=2e-3")


def test_set_option_is_refused_for_a_resumed_run(file, tmp_path, capsys):
    folder = str(tmp_path / "run")
    assert main(["run", str(file), "--out", folder, "--device", "cpu"]) == 0
    assert (
        main(["run", str(file), "--out", folder, "--device", "cpu", "--resume", "--set", "body.box.mass=4"]) == 2
    )
    assert "body[1].mass is 3.0 there, 4.0 here" in capsys.readouterr().err
