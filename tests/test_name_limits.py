"""Names that become file names: length and characters."""

import pytest
from test_experiment import content
from test_experiment_custom_law import LAWS

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.validation.checks import MAX_NAME_LENGTH

LONGEST = "b" * MAX_NAME_LENGTH
TOO_LONG = "b" * (MAX_NAME_LENGTH + 1)


def renamed(section, name):
    entry = content()[section][0] | {"name": name}
    changes = {section: [entry]}
    if section == "body":
        changes["point"] = [content()["point"][0] | {"body": name}]
    if section == "contact":
        changes["record"] = {"sensors": [f"{name}.gap"]}
    if section in ("surface", "point", "material"):
        key = "points" if section == "point" else section
        changes["contact"] = [content()["contact"][0] | {key: name}]
    return content(**changes)


@pytest.mark.parametrize("section", ["body", "surface", "point", "material", "contact"])
def test_name_of_an_element_has_at_most_200_bytes(section, tmp_path):
    assert wc.Experiment.from_dict(renamed(section, LONGEST)).settings
    with pytest.raises(wc.ExperimentError) as error:
        wc.Experiment.from_dict(renamed(section, TOO_LONG)).run(tmp_path / "run", device="cpu")
    assert f"{section}[0].name must have at most 200 bytes, as files are named after it, got 201: 'bbbb" in str(
        error
    )
    assert not (tmp_path / "run").exists()


def test_run_with_the_longest_names_is_written_and_read(tmp_path):
    raw = renamed("body", LONGEST) | {"name": LONGEST, "duration": 2e-3, "output": {"usd_envs": 0}}
    raw["record"] = {"sensors": [f"{LONGEST}.position"]}
    run = wc.Experiment.from_dict(raw).run(tmp_path / "run", device="cpu", progress=False)
    assert wc.open_run(run.folder, verify=True).series[f"{LONGEST}.position"].notnull().all()


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"name": TOO_LONG}, "name"),
        ({"name": "ü" * 101}, "name"),
        ({"outcome": {TOO_LONG: {"type": "Max", "of": "touch.gap"}}}, f"outcome.{TOO_LONG}: a name"),
        ({"stop": {TOO_LONG: {"of": "touch.gap", "below": -1.0}}}, f"stop.{TOO_LONG}: a name"),
    ],
    ids=["title", "bytes", "outcome", "stop"],
)
def test_other_names_have_at_most_200_bytes(changes, place):
    with pytest.raises(
        wc.ExperimentError, match=f"{place} must have at most 200 bytes, as files are named after it"
    ):
        wc.Experiment.from_dict(content(**changes))


def test_name_of_a_file_of_laws_has_at_most_200_bytes(tmp_path):
    (tmp_path / f"{TOO_LONG}.py").write_text(LAWS)
    material = {"name": "rubber", "law": {"type": f"{TOO_LONG}.py:Cubic", "stiffness": 1e9}}
    with pytest.raises(wc.ExperimentError, match=r"type: the name of a file must have at most 200 bytes"):
        wc.Experiment.from_dict(content(material=[material]), tmp_path)


def test_variable_with_too_long_name_is_refused_before_writing(tmp_path, monkeypatch):
    """For example a parameter of a custom law, whose name the library does not limit."""
    monkeypatch.setattr("warpcontact.experiment.store.MAX_NAME_BYTES", 8)
    experiment = wc.Experiment.from_dict(content(variation={"ball.mass": {"uniform": [1.0, 2.0]}}))
    with pytest.raises(
        wc.ExperimentError, match=r"run: the name of a variable of params must have at most 8 bytes"
    ):
        experiment.run(tmp_path / "run", device="cpu")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["a/b", "../a", ".a", "a\0b", "a b", "ä", "", "a\n", "a:b", "a\\b"])
def test_control_characters_are_refused_in_names(name):
    with pytest.raises(
        wc.ExperimentError, match=r"body\[0\]\.name must be letters, digits, _ and -, not starting"
    ):
        wc.Experiment.from_dict(renamed("body", name))
    with pytest.raises(ValueError, match="name of a body must be letters, digits, _ and -"):
        wc.Scene().add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), name=name)


@pytest.mark.parametrize(
    ("title", "folder"), [("../a/b", "a_b"), (".hidden", "hidden"), ("...", "experiment"), ("/etc", "etc")]
)
def test_title_determines_the_results_folder(title, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text(f"name = {title!r}\n")
    (tmp_path / "results" / folder).mkdir(parents=True)
    (tmp_path / "results" / folder / "mine").write_text("")
    assert main(["run", "study.toml"]) == 2
    assert f"results/{folder}: is not empty" in capsys.readouterr().err
