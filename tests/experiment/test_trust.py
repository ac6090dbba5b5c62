"""Python files of a run folder are executed only if a run of this user wrote them, or if they are trusted."""

import hashlib
import os
import shutil

import pytest
import sharded_runs
from test_experiment import content

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment import execute, user_code
from warpcontact.experiment.experiment_copy import to_toml
from warpcontact.experiment.folder import read_summary
from warpcontact.visualize.viewer.replay import RunSource

LAWS = """
from pathlib import Path

import warpcontact as wc

Path(__file__).with_name("ran").touch()


class Stiff(wc.laws.Hooke):
    pass
"""
OUTCOMES = """
import warpcontact as wc


class Deepest(wc.outcomes.Max):
    pass
"""


@pytest.fixture(scope="module")
def study_and_run(tmp_path_factory):
    """A folder with a study that has files of custom laws and outcomes, and its run without a picture."""

    def interrupt(stage):
        if stage == "writing":
            raise KeyboardInterrupt

    folder = tmp_path_factory.mktemp("made")
    (folder / "study" / "more").mkdir(parents=True)
    (folder / "study" / "laws.py").write_text(LAWS)
    (folder / "study" / "more" / "outcomes.py").write_text(OUTCOMES)
    material = {"name": "rubber", "law": {"type": "laws.py:Stiff", "stiffness": 1e4}}
    outcome = {"deepest": {"type": "more/outcomes.py:Deepest", "of": "touch.penetration"}}
    raw = content(material=[material], outcome=outcome, output={"usd_envs": 0}, duration=4e-3)
    experiment = wc.Experiment.from_dict(raw, folder / "study")
    (folder / "study" / "study.toml").write_text(to_toml(experiment.settings, "A study."))
    with pytest.raises(KeyboardInterrupt):
        experiment.run(folder / "run", device="cpu", on_stage=interrupt)
    return folder


@pytest.fixture
def study(study_and_run, tmp_path):
    """A copy of the study."""
    return shutil.copytree(study_and_run / "study", tmp_path / "study")


@pytest.fixture
def run(study_and_run, tmp_path):
    """A copy of the run."""
    return shutil.copytree(study_and_run / "run", tmp_path / "run")


@pytest.fixture
def foreign_run(run, monkeypatch, tmp_path):
    """The same run, from another user."""
    monkeypatch.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_STATE_HOME", str(tmp_path / "mine"))
    return run


def has_run_code(folder):
    return (folder / "ran").exists()


def commands(folder):
    """All functions and commands that read the scene or the experiment of a run folder, by name."""
    text, file = str(folder), str(folder / "experiment.toml")
    return {
        "resume": ["run", "--resume", "--out", text, "--device", "cpu"],
        "run again": ["run", file, "--out", f"{text}_again", "--device", "cpu"],
        "plan": ["plan", file, "--no-probe", "--device", "cpu"],
        "report": ["report", text],
        "render": ["render", text, "-o", f"{text}.png"],
        "view": ["view", text, "--port", "0", "--no-open"],
        "view experiment": ["view", file, "--port", "0", "--no-open"],
        "export": ["export", text, "--usd", f"{text}.usdc"],
        "build-kernels": ["build-kernels", file, "--device", "cpu"],
    }


def test_run_of_the_same_user_is_resumed_and_read_without_a_flag(run):
    (run / "ran").unlink(missing_ok=True)
    assert main(commands(run)["resume"]) == 0
    assert has_run_code(run)
    assert wc.open_run(run).scene.contacts[0].material.law.stiffness == 1e4
    assert wc.open_run(run).experiment.settings.outcome
    assert main(commands(run)["report"]) == 0


@pytest.mark.parametrize("act", commands(user_code.Path("run")))
def test_run_of_another_user_runs_no_code_and_lists_its_files(act, foreign_run, capsys):
    if act.startswith("view"):
        pytest.importorskip("viser")
    assert main(commands(foreign_run)[act]) == 2
    error_output = capsys.readouterr().err
    lines = [line for line in error_output.splitlines() if "--trust" in line]
    assert lines == [
        f"warpcontact: {foreign_run}: would run laws.py, outcomes.py, Python code that no run of this user has "
        "written there; read it, then run it with --trust (Python: trust=True)"
    ]
    assert not has_run_code(foreign_run)
    assert not user_code.trusted_folder().exists()


@pytest.mark.parametrize("act", commands(user_code.Path("run")))
def test_trust_is_an_option_of_each_command_that_may_need_it(act, capsys):
    with pytest.raises(SystemExit) as ended:
        main([commands(user_code.Path("run"))[act][0], "--help"])
    assert ended.value.code == 0
    assert "--trust" in capsys.readouterr().out


def test_results_of_another_user_are_read_without_trust(foreign_run, tmp_path, capsys):
    seen = wc.open_run(foreign_run, verify=True)
    assert seen.to_dataframe()["deepest"].notna().all()
    for words in (["status", str(foreign_run)], ["export", str(foreign_run), "--csv", str(tmp_path / "a.csv")]):
        assert main(words) == 0
    print(seen)
    capsys.readouterr()
    for read in (
        lambda: seen.scene,
        lambda: seen.settings,
        lambda: seen.experiment,
        lambda: wc.report(foreign_run),
    ):
        with pytest.raises(wc.ExperimentError, match=r"would run laws\.py, outcomes\.py, Python code"):
            read()
    assert not has_run_code(foreign_run)


def test_trusted_run_needs_no_flag_again(foreign_run):
    assert wc.open_run(foreign_run, trust=True).scene.contacts
    assert has_run_code(foreign_run)
    assert len(list(user_code.trusted_folder().iterdir())) == 2
    assert wc.open_run(foreign_run).scene.contacts
    moved = shutil.copytree(foreign_run, foreign_run.parent / "moved")
    assert wc.Experiment.from_toml(moved / "experiment.toml").settings.outcome
    with (moved / "outcomes.py").open("a") as file:
        file.write("# changed\n")
    with pytest.raises(wc.ExperimentError, match=r"moved: would run outcomes\.py, Python code"):
        wc.Experiment.from_toml(moved / "experiment.toml")


def test_files_are_trusted_by_their_content(foreign_run):
    digests = [
        hashlib.sha256((foreign_run / name).read_bytes()).hexdigest() for name in ("laws.py", "outcomes.py")
    ]
    assert wc.open_run(foreign_run, trust=digests).settings.outcome
    assert not user_code.trusted_folder().exists()
    with pytest.raises(wc.ExperimentError, match=r"would run outcomes\.py, Python"):
        _ = wc.open_run(foreign_run, trust=digests[:1]).settings


def test_cluster_worker_runs_the_files_of_its_run(foreign_run):
    """Also if the user of the worker has no record of them."""
    digests = tuple(user_code.digest_of((foreign_run / name).read_bytes()) for name in ("laws.py", "outcomes.py"))
    summary = read_summary(foreign_run)
    with pytest.raises(wc.ExperimentError, match=r"would run outcomes\.py, Python"):
        execute._worker_runner(foreign_run, summary, "cpu", 1, 60.0, digests[:1])
    assert not has_run_code(foreign_run)
    assert execute._worker_runner(foreign_run, summary, "cpu", 1, 60.0, digests).settings.outcome


def test_study_of_the_user_needs_no_flag(study, foreign_run, capsys):
    """Also if its run is from another user: the executed file is the one next to the study."""
    (study / "ran").unlink(missing_ok=True)
    (foreign_run / "laws.py").write_text("raise AssertionError\n")
    assert main(["run", str(study / "study.toml"), "--resume", "--out", str(foreign_run), "--device", "cpu"]) == 0
    capsys.readouterr()


@pytest.mark.filterwarnings("ignore:the law files:RuntimeWarning")
def test_new_run_is_read_without_a_state_folder(study, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_STATE_HOME", str(tmp_path / "file"))
    made = wc.Experiment.from_toml(study / "study.toml").run(tmp_path / "out", device="cpu")
    assert made.settings.outcome
    assert made.experiment.settings.outcome
    with pytest.raises(wc.ExperimentError, match=r"would run laws\.py, outcomes\.py, Python code"):
        _ = wc.open_run(tmp_path / "out").settings


def test_trust_in_a_run_is_kept_when_its_view_is_refreshed(foreign_run, monkeypatch):
    digests = [user_code.digest_of((foreign_run / name).read_bytes()) for name in ("laws.py", "outcomes.py")]
    sharded_runs.change(foreign_run / "run.json", state="unfinished")
    source = RunSource(foreign_run, trust=digests)
    sharded_runs.change(foreign_run / "run.json", wall_time=1.0)  # as if more had been committed
    assert source.refresh()
    assert source.run.settings.outcome
    assert not user_code.trusted_folder().exists()


def test_missing_state_folder_causes_a_warning(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_STATE_HOME", str(tmp_path / "file"))
    with pytest.warns(
        wc.RunWarning, match="could not be recorded as trusted: Not a directory; to resume or render"
    ) as caught:
        user_code.record_trusted([b"code"])
    assert caught[0].message.level is wc.WarningLevel.CAUTION
    assert caught[0].filename == __file__
    assert not user_code.may_run(b"code", trust=False)
