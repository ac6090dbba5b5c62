"""Runs that were killed, interrupted or out of disk space resume to the bytes of an undisturbed run."""

import json
import os
import random
import shutil
import signal
import subprocess
from contextlib import contextmanager

import numpy as np
import pytest
import sharded_runs
from case_marks import slow_except

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment import cluster
from warpcontact.system import resources
from warpcontact.system.process import terminate_as_interrupt

pytestmark = [pytest.mark.installed, pytest.mark.usefixtures("no_pictures")]

WORDS = ("--shard", 4, "--device", "cpu")


@pytest.fixture(scope="module")
def study_folder(tmp_path_factory):
    """A folder with the experiment, whose undisturbed run is in ``undisturbed``."""
    folder = tmp_path_factory.mktemp("resume")
    code, _, err = sharded_runs.run(sharded_runs.study(folder), "--out", folder / "whole", *WORDS)
    assert code == 0, err
    return folder


@pytest.fixture(scope="module")
def undisturbed(study_folder):
    """The undisturbed run."""
    return wc.open_run(study_folder / "whole")


def check_equal(folder, undisturbed):
    """Checks that a finished run has the bytes of ``undisturbed`` and no leftover files."""
    assert sharded_runs.hashes(folder) == sharded_runs.hashes(undisturbed.folder)
    assert sharded_runs.leftovers(folder) == []
    run = wc.open_run(folder, verify=True)
    assert run.summary["state"] == "finished"
    assert run.digest() == undisturbed.digest()


def killed_at_random(out, study, moments, words, undisturbed):
    """Kills runs of ``study`` after each of ``moments`` [s] of stepping; returns the number of interrupted runs."""
    committed, hits = [], 0
    for moment in moments:
        resume = (out / "data.zarr").exists()
        options = ["--resume"] if resume else ["--overwrite"]
        process = sharded_runs.start_run(
            study, "--out", out, *WORDS[2:], *words, *(() if resume else WORDS[:2]), *options
        )
        # Importing and compiling takes most of the time and is not tested here.
        begun = sharded_runs.wait_until(lambda: any((out / "progress").glob("*.json")), process)
        if begun and process.poll() is None:
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                hits += 1
        sharded_runs.kill(process)
        if process.returncode == 0:
            break
        if (out / "data.zarr").exists():
            now = sharded_runs.check_committed_results(out, undisturbed)
            for number, record in committed[-1].items() if committed else ():
                assert now[number]["steps"] >= record["steps"], "what was committed was lost"
            committed.append(now)
    return hits


@pytest.mark.smoke
@pytest.mark.parametrize("where", slow_except(["before", "between", "after"], lambda where: where == "between"))
def test_killed_commit_is_repaired_on_resume(where, study_folder, undisturbed, tmp_path):
    out = tmp_path / "out"
    kill = sharded_runs.kill_at_commit(25, where)
    code, _, err = sharded_runs.run(
        study_folder / "study.toml", "--out", out, *WORDS, "--checkpoint", 0, first=kill
    )
    assert code == -signal.SIGKILL, err
    committed = sharded_runs.check_committed_results(out, undisturbed)
    root = out / "data.zarr"
    names = [name for record in committed.values() for name in record["files"]]
    unmoved = [name for name in names if not (root / name).is_file()]
    assert bool(unmoved) == (where == "between")
    code, _, err = sharded_runs.run("--resume", "--out", out, "--device", "cpu")
    assert code == 0, err
    check_equal(out, undisturbed)


@pytest.mark.slow
def test_partially_rewritten_chunk_is_not_taken_as_committed(study_folder, undisturbed, tmp_path):
    out = tmp_path / "out"
    kill = sharded_runs.kill_at_commit(25)
    code, _, err = sharded_runs.run(
        study_folder / "study.toml", "--out", out, *WORDS, "--checkpoint", 0, first=kill
    )
    assert code == -signal.SIGKILL, err
    number, record = next(item for item in sharded_runs.records(out).items() if item[1]["frames"])
    name = next(name for name in record["files"] if name.startswith("series/"))
    half = out / "staging" / f"shard_{number:06d}" / name
    half.parent.mkdir(parents=True, exist_ok=True)
    half.write_bytes((out / "data.zarr" / name).read_bytes()[:-5])
    sharded_runs.check_committed_results(out, undisturbed)
    wc.Experiment.from_toml(out / "experiment.toml").run(out, device="cpu", resume=True)
    check_equal(out, undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("checkpoint", [0, 0.2])
def test_kills_at_random_times_lose_no_committed_results(checkpoint, tmp_path):
    rng = random.Random(8 + int(10 * checkpoint))
    study = sharded_runs.study(tmp_path, duration=2.0, envs=14)
    code, _, err = sharded_runs.run(study, "--out", tmp_path / "whole", *WORDS)
    assert code == 0, err
    undisturbed = wc.open_run(tmp_path / "whole")
    # So that the last kills still interrupt work.
    moments = [rng.uniform(0.0, 0.04 * undisturbed.summary["wall_time"]) for _ in range(25)]
    out = tmp_path / "out"
    hits = killed_at_random(out, study, moments, ("--checkpoint", checkpoint), undisturbed)
    assert hits >= (25 if checkpoint else 20)
    code, _, err = sharded_runs.run("--resume", "--out", out, "--device", "cpu")
    assert code == 0, err
    check_equal(out, undisturbed)


@pytest.mark.slow
def test_kills_before_first_commit_leave_a_reusable_folder(study_folder, undisturbed, tmp_path):
    out = tmp_path / "out"
    for _ in range(4):
        process = sharded_runs.start_run(study_folder / "study.toml", "--out", out, *WORDS)
        sharded_runs.wait_until(out.exists, process)
        sharded_runs.kill(process)
        if (out / "data.zarr").exists():
            break
        if out.exists() and any(out.iterdir()):
            with pytest.raises(
                wc.ExperimentError, match=r"ended before anything was saved|is missing or incomplete"
            ):
                wc.open_run(out)
    words = ["--resume"] if (out / "data.zarr").exists() else WORDS[:2]
    code, _, err = sharded_runs.run(study_folder / "study.toml", "--out", out, "--device", "cpu", *words)
    assert code == 0, err
    check_equal(out, undisturbed)


# Stop requests


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_stop_signal_prints_resume_command(number, study_folder, undisturbed, tmp_path):
    out = tmp_path / "a folder"
    code, _, err = sharded_runs.run(
        study_folder / "study.toml", "--out", out, *WORDS, first=sharded_runs.send_signal_at_step(number, 37)
    )
    assert code == 130, err
    assert "interrupted; completed steps are saved in" in err
    assert f"warpcontact run --resume --out '{out}'" in err
    assert "Traceback" not in err
    assert wc.open_run(out).summary["state"] == "interrupted"
    committed = sharded_runs.check_committed_results(out, undisturbed)
    # A chunk of steps ends at the end of a block, at the latest.
    (record,) = committed.values()
    assert 37 <= record["steps"] < 100
    code, _, err = sharded_runs.run("--resume", "--out", out, "--device", "cpu")
    assert code == 0, err
    check_equal(out, undisturbed)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_stop_signal_prints_resume_command_without_named_folder(study_folder, tmp_path):
    study, out = study_folder / "study.toml", tmp_path / "results" / "study"
    for steps, words in ((37, WORDS), (74, ("--resume", "--device", "cpu"))):
        code, _, err = sharded_runs.run(
            study, *words, first=sharded_runs.send_signal_at_step(signal.SIGTERM, steps), cwd=tmp_path
        )
        assert code == 130, err
        expected_message = (
            f"completed steps are saved in {out.relative_to(tmp_path)}; to resume:\n    warpcontact run --resume"
        )
        assert expected_message in err
        (record,) = sharded_runs.records(out).values()
        assert steps <= record["steps"] < steps + 63


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
@pytest.mark.parametrize(
    ("number", "stage"),
    [
        (signal.SIGTERM, "reading"),
        (signal.SIGINT, "building"),
        pytest.param(signal.SIGTERM, "building", marks=pytest.mark.slow),
    ],
)
def test_stop_signal_before_the_first_step_reports_nothing_stored(number, stage, study_folder, tmp_path):
    out = tmp_path / "out"
    first = sharded_runs.send_signal_at_stage(number, stage)
    code, printed, err = sharded_runs.run(study_folder / "study.toml", "--out", out, *WORDS, first=first)
    assert code == 130, err
    assert err.endswith("\nwarpcontact: interrupted before anything was saved\n")
    assert "Traceback" not in err
    assert printed == ""
    assert not out.exists()


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
@pytest.mark.parametrize(
    ("stage", "words", "expected_message"),
    [
        ("building", ["--overwrite"], " before anything was saved; {out} is unchanged\n"),
        ("reading", ["--resume"], " before anything was done in {out}; to resume:\n    {resume}\n"),
        ("compiling", ["--overwrite"], "; completed steps are saved in {out}; to resume:\n    {resume}\n"),
        ("writing", ["--resume"], "; the results are complete in {out}; to resume:\n    {resume}\n"),
    ],
)
def test_stop_signal_after_the_last_commit_reports_stored_run(
    stage, words, expected_message, study_folder, undisturbed, tmp_path
):
    out = shutil.copytree(undisturbed.folder, tmp_path / "out")
    first = sharded_runs.send_signal_at_stage(signal.SIGTERM, stage)
    code, _, err = sharded_runs.run(
        study_folder / "study.toml", "--out", out, "--device", "cpu", *words, first=first
    )
    assert code == 130, err
    expected_message = expected_message.format(out=out, resume=f"warpcontact run --resume --out {out}")
    assert err.endswith(f"\nwarpcontact: interrupted{expected_message}")
    assert "Traceback" not in err
    sharded_runs.check_committed_results(out, undisturbed)


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_signal_handler_set_during_a_run_is_preserved():
    usual = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(KeyboardInterrupt), terminate_as_interrupt():
            os.kill(os.getpid(), signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is usual
        with terminate_as_interrupt():
            signal.signal(signal.SIGTERM, print)
        assert signal.getsignal(signal.SIGTERM) is print
    finally:
        signal.signal(signal.SIGTERM, usual)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_second_stop_signal_exits_immediately_and_keeps_committed_results(study_folder, undisturbed, tmp_path):
    out = tmp_path / "out"
    # A first commit, then a chunk of steps that ends only at the end of a block.
    process = sharded_runs.start_run(
        study_folder / "study.toml", "--out", out, *WORDS, "--checkpoint", 0, first=sharded_runs.COMMIT_OFTEN
    )
    assert sharded_runs.wait_until(lambda: sharded_runs.records(out), process)
    before = sharded_runs.records(out)
    for _ in range(20):
        process.send_signal(signal.SIGINT)
    code, _, err = sharded_runs.wait_for_end(process)
    assert code in (130, -signal.SIGINT), err
    now = sharded_runs.check_committed_results(out, undisturbed)
    assert all(now[number]["steps"] >= record["steps"] for number, record in before.items())
    code, _, err = sharded_runs.run("--resume", "--out", out, "--device", "cpu")
    assert code == 0, err
    check_equal(out, undisturbed)


# Full disks


@contextmanager
def small_disk(path, size):
    """Mounts a file system of ``size`` in memory."""
    path.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(path)]
    if shutil.which("mount") is None or subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("a file system may not be mounted here")
    try:
        yield path
    finally:
        subprocess.run(["umount", "-l", str(path)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("size", ["400k", "550k"])
def test_full_disk_is_one_message_and_the_run_can_be_resumed(size, study_folder, undisturbed, tmp_path):
    with small_disk(tmp_path / "disk", size) as disk:
        out = disk / "out"
        code, _, err = sharded_runs.run(
            study_folder / "study.toml", "--out", out, *WORDS, "--checkpoint", 0, first=sharded_runs.COMMIT_OFTEN
        )
        assert code == 2, err
        assert "Traceback" not in err
        assert f"No space left on device: '{out}" in err
        assert f"what was committed is kept in {out}; go on with:\n    warpcontact run --resume --out {out}" in err
        committed = sharded_runs.check_committed_results(out, undisturbed)
        assert committed
        code, _, err = sharded_runs.run("--resume", "--out", out, "--device", "cpu")  # still full
        assert code == 2, err
        assert sharded_runs.check_committed_results(out, undisturbed).keys() >= committed.keys()
        subprocess.run(["mount", "-o", "remount,size=8m", str(disk)], check=True)
        code, _, err = sharded_runs.run("--resume", "--out", out, "--device", "cpu")
        assert code == 0, err
        check_equal(out, undisturbed)


@pytest.mark.slow
def test_full_disk_at_the_start_leaves_no_results(study_folder, tmp_path):
    with small_disk(tmp_path / "disk", "40k") as disk:
        out = disk / "out"
        code, _, err = sharded_runs.run(study_folder / "study.toml", "--out", out, *WORDS)
        assert code == 2, err
        assert f"No space left on device: '{out}" in err
        assert "Traceback" not in err
        assert "--resume" not in err
        subprocess.run(["mount", "-o", "remount,size=8m", str(disk)], check=True)
        code, _, err = sharded_runs.run(study_folder / "study.toml", "--out", out, *WORDS)
        assert code == 0, err


# Options that must not change the results


@pytest.mark.parametrize("shard", slow_except([1, 7, 64], lambda shard: shard == 7))
def test_results_do_not_depend_on_shards_and_threads(shard, study_folder, undisturbed, tmp_path):
    experiment = wc.Experiment.from_toml(study_folder / "study.toml")
    for threads in (1, 2):
        run = experiment.run(
            tmp_path / f"{threads}",
            device="cpu",
            shard=shard,
            threads=threads,
            checkpoint=0.0 if threads == 1 else 60.0,
        )
        assert run.digest() == undisturbed.digest()
        assert run.series.identical(undisturbed.series)


def test_resume_with_another_shard_size_is_refused(study_folder, undisturbed, tmp_path, capsys):
    out = shutil.copytree(undisturbed.folder, tmp_path / "out")
    words = ["run", "--resume", "--out", str(out), "--device", "cpu", "--shard"]
    for shard in (2, 5, 100):
        assert main([*words, str(shard)]) == 2
        expected_message = (
            f"{out}: holds a run with another shard size: shard is 4 there, {shard} here; omit it to resume"
        )
        assert expected_message in capsys.readouterr().err
    (out / "commit" / "shard_000002.json").unlink()
    assert main([*words, "4"]) == 0
    check_equal(out, undisturbed)
    # ``shard`` is a maximum: all environments are one shard.
    study = wc.Experiment.from_toml(study_folder / "study.toml")
    study.run(tmp_path / "one", device="cpu", shard=100)
    assert study.run(tmp_path / "one", device="cpu", shard=64, resume=True).summary["shard"] == 10


def test_resume_of_a_finished_run_changes_nothing(study_folder, undisturbed, tmp_path):
    out = shutil.copytree(undisturbed.folder, tmp_path / "out")
    (out / "picture.png").unlink()
    run = wc.Experiment.from_toml(study_folder / "study.toml").run(out, device="cpu", resume=True)
    assert run.summary["wall_time"] == undisturbed.summary["wall_time"]
    assert "picture" in run.files
    check_equal(out, undisturbed)


@pytest.mark.parametrize("ray", [False, True])
def test_resume_of_finished_shards_needs_no_memory(ray, study_folder, undisturbed, tmp_path, monkeypatch):
    out = shutil.copytree(undisturbed.folder, tmp_path / "out")
    summary = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(summary | {"state": "unfinished"}))
    (out / "picture.png").unlink()
    experiment = wc.Experiment.from_toml(study_folder / "study.toml")
    # The plan uses no memory limit and no Ray.
    monkeypatch.setattr(resources, "_host", lambda: 1)
    monkeypatch.setattr(cluster, "connect", lambda *_: pytest.fail("there is nothing to run"))
    run = experiment.run(out, device="cpu", resume=True, ray=ray)
    assert "picture" in run.files
    check_equal(out, undisturbed)


# Failing shards


@pytest.mark.slow
def test_shard_failing_three_times_is_reported_and_others_finish(tmp_path):
    path, out = sharded_runs.overflowing_study(tmp_path), tmp_path / "out"
    for options in (["--shard", 2], ["--resume"]):
        code, printed, err = sharded_runs.run(path, "--out", out, "--device", "cpu", *options)
        assert code == 3, err
        assert "shard_000001 failed: RuntimeError: pile: a particle had" in printed
        assert "failed: 4 of 6 environments are finished in 3 shards" in printed
        assert err.count("note: shard_000001 is retried: pile: a particle had") == 1
        assert "Traceback" not in err
        run = wc.open_run(out, verify=True)
        assert run.summary["state"] == "failed"
        assert list(run.summary["failed"]) == ["shard_000001"]
        assert run.outcome["env"].values.tolist() == [0, 1, 4, 5]
        assert np.isfinite(run.series["pile.contacts"].sel(env=[0, 1, 4, 5])).all()
    assert sharded_runs.leftovers(out) == []
