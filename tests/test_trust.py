"""Python files of a run folder are run if a run of this user has written them, or if they were trusted."""

import hashlib
import os
import shutil

import pytest
import runs
from test_experiment import content

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment import cluster, trust
from warpcontact.experiment.folder import read_summary
from warpcontact.experiment.toml import to_toml
from warpcontact.viewer.sources import RunSource

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
def made(tmp_path_factory):
    """A folder with a study, which has files of laws and outcomes, and with a run of it that has not drawn yet."""

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
def study(made, tmp_path):
    """A copy of the study."""
    return shutil.copytree(made / "study", tmp_path / "study")


@pytest.fixture
def run(made, tmp_path):
    """A copy of the run."""
    return shutil.copytree(made / "run", tmp_path / "run")


@pytest.fixture
def strange(run, monkeypatch, tmp_path):
    """The same, from another user."""
    monkeypatch.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_STATE_HOME", str(tmp_path / "mine"))
    return run


def ran(folder):
    return (folder / "ran").exists()


def acts(folder):
    """All that reads the scene or the experiment of a run folder, by names."""
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
    assert main(acts(run)["resume"]) == 0
    assert ran(run)
    assert wc.open_run(run).scene.contacts[0].material.law.stiffness == 1e4
    assert wc.open_run(run).experiment.settings.outcome
    assert main(acts(run)["report"]) == 0


@pytest.mark.parametrize("act", acts(trust.Path("run")))
def test_run_from_elsewhere_runs_no_code_and_names_its_files(act, strange, capsys):
    if act.startswith("view"):
        pytest.importorskip("viser")
    assert main(acts(strange)[act]) == 2
    told = capsys.readouterr().err
    lines = [line for line in told.splitlines() if "--trust" in line]
    assert lines == [
        f"warpcontact: {strange}: would run laws.py, outcomes.py, Python code that no run of this user has "
        "written there; read it, then run it with --trust (Python: trust=True)"
    ]
    assert not ran(strange)
    assert not trust.records().exists()


@pytest.mark.parametrize("act", acts(trust.Path("run")))
def test_trust_is_an_option_of_each_command_that_may_need_it(act, capsys):
    with pytest.raises(SystemExit) as ended:
        main([acts(trust.Path("run"))[act][0], "--help"])
    assert ended.value.code == 0
    assert "--trust" in capsys.readouterr().out


def test_results_from_elsewhere_are_read_without_trust(strange, tmp_path, capsys):
    seen = wc.open_run(strange, verify=True)
    assert seen.to_dataframe()["deepest"].notna().all()
    for words in (["status", str(strange)], ["export", str(strange), "--csv", str(tmp_path / "a.csv")]):
        assert main(words) == 0
    print(seen)
    capsys.readouterr()
    for read in (lambda: seen.scene, lambda: seen.settings, lambda: seen.experiment, lambda: wc.report(strange)):
        with pytest.raises(wc.ExperimentError, match=r"would run laws\.py, outcomes\.py, Python code"):
            read()
    assert not ran(strange)


def test_what_was_trusted_once_needs_no_flag_again(strange):
    assert wc.open_run(strange, trust=True).scene.contacts
    assert ran(strange)
    assert len(list(trust.records().iterdir())) == 2
    assert wc.open_run(strange).scene.contacts
    moved = shutil.copytree(strange, strange.parent / "moved")
    assert wc.Experiment.from_toml(moved / "experiment.toml").settings.outcome
    with (moved / "outcomes.py").open("a") as file:
        file.write("# changed\n")
    with pytest.raises(wc.ExperimentError, match=r"moved: would run outcomes\.py, Python code"):
        wc.Experiment.from_toml(moved / "experiment.toml")


def test_files_are_trusted_by_their_content(strange):
    digests = [hashlib.sha256((strange / name).read_bytes()).hexdigest() for name in ("laws.py", "outcomes.py")]
    assert wc.open_run(strange, trust=digests).settings.outcome
    assert not trust.records().exists()
    with pytest.raises(wc.ExperimentError, match=r"would run outcomes\.py, Python"):
        _ = wc.open_run(strange, trust=digests[:1]).settings


def test_worker_of_a_cluster_runs_the_files_of_the_run_that_it_is_part_of(strange):
    """Also where the user of the worker has no record of them."""
    digests = tuple(trust.digest_of((strange / name).read_bytes()) for name in ("laws.py", "outcomes.py"))
    summary = read_summary(strange)
    with pytest.raises(wc.ExperimentError, match=r"would run outcomes\.py, Python"):
        cluster._runner(strange, summary, "cpu", 1, 60.0, digests[:1])
    assert not ran(strange)
    assert cluster._runner(strange, summary, "cpu", 1, 60.0, digests).settings.outcome


def test_study_of_the_user_needs_no_flag(study, strange, capsys):
    """Also one whose run is from elsewhere: what is run is the file next to the study."""
    (study / "ran").unlink(missing_ok=True)
    (strange / "laws.py").write_text("raise AssertionError\n")
    assert main(["run", str(study / "study.toml"), "--resume", "--out", str(strange), "--device", "cpu"]) == 0
    capsys.readouterr()


@pytest.mark.filterwarnings("ignore:the files with laws:RuntimeWarning")
def test_run_just_made_is_read_without_a_state_folder(study, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_STATE_HOME", str(tmp_path / "file"))
    made = wc.Experiment.from_toml(study / "study.toml").run(tmp_path / "out", device="cpu")
    assert made.settings.outcome
    assert made.experiment.settings.outcome
    with pytest.raises(wc.ExperimentError, match=r"would run laws\.py, outcomes\.py, Python code"):
        _ = wc.open_run(tmp_path / "out").settings


def test_trust_in_a_run_lasts_when_its_view_is_refreshed(strange, monkeypatch):
    digests = [trust.digest_of((strange / name).read_bytes()) for name in ("laws.py", "outcomes.py")]
    runs.change(strange / "run.json", state="unfinished")
    source = RunSource(strange, trust=digests)
    runs.change(strange / "run.json", wall_time=1.0)  # as if more were committed
    assert source.refresh()
    assert source.run.settings.outcome
    assert not trust.records().exists()


def test_missing_state_folder_is_warned_of(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_STATE_HOME", str(tmp_path / "file"))
    with pytest.warns(
        wc.RunWarning, match="could not be recorded as trusted: Not a directory; to resume or draw"
    ) as heard:
        trust.record([b"code"])
    assert heard[0].message.level is wc.WarningLevel.CAUTION
    assert heard[0].filename == __file__
    assert not trust.may_run(b"code", trust=False)
