"""Free disk space for results: plan, warnings of a run, and error when the disk is full."""

import errno
import shutil
from types import SimpleNamespace

import pytest
import sharded_runs

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment import store

KIB = 1024


@pytest.fixture
def free(monkeypatch):
    """Sets the free space of every disk; returns the folders that were queried."""
    queried_folders = []

    def set_free(size):
        def usage(path):
            queried_folders.append(path)
            return SimpleNamespace(free=size)

        monkeypatch.setattr(shutil, "disk_usage", usage)
        return queried_folders

    return set_free


def test_plan_command_prints_free_disk_space(tmp_path, free, capsys, monkeypatch):
    study = sharded_runs.study(tmp_path)
    monkeypatch.chdir(tmp_path)
    words = ["plan", str(study), "--device", "cpu", "--no-probe"]
    queried_folders = free(200 * KIB)
    assert main(words) == 0
    assert queried_folders == [tmp_path]  # the folder of the results does not exist yet
    output = "on disk: up to 103 KiB, before compression; 200 KiB is free on the disk of results/study"
    assert f"{output}\n" in capsys.readouterr().out
    (tmp_path / "other").mkdir()
    free(100 * KIB)
    assert main([*words, "--out", "other/out"]) == 0
    assert queried_folders[-1] == tmp_path / "other"
    output = "on disk: up to 103 KiB, before compression; 100 KiB is free on the disk of other/out, not enough"
    assert f"{output}\n" in capsys.readouterr().out
    assert not (tmp_path / "other" / "out").exists()


@pytest.mark.filterwarnings("always:the (remaining )?results")
def test_run_warns_if_results_may_fill_the_disk(tmp_path, free):
    experiment = wc.Experiment.from_toml(sharded_runs.study(tmp_path))

    def warnings(size, out, **options):
        free(size)
        messages, stages = [], []
        options |= {"device": "cpu", "shard": 5, "on_stage": stages.append}
        experiment.run(out, on_warning=lambda text: messages.append((text, *stages[-1:])), **options)
        return messages

    assert warnings(104 * KIB, tmp_path / "enough") == []
    ((text, stage),) = warnings(102 * KIB, tmp_path / "little")
    assert text.startswith("caution: the results take up to 103 KiB before compression, and 102 KiB is free on ")
    assert stage.startswith("building")  # before the first step
    # One of two shards is finished.
    for name in ("enough", "little"):
        (tmp_path / name / "commit" / "shard_000001.json").unlink()
    assert warnings(52 * KIB, tmp_path / "enough", resume=True) == []
    ((text, _),) = warnings(51 * KIB, tmp_path / "little", resume=True)
    assert text.startswith("caution: the remaining results take up to 51.6 KiB before compression")


@pytest.mark.filterwarnings("always:the (remaining )?results")
@pytest.mark.parametrize("begun", [False, True])
def test_full_disk_error_states_shard_size_and_stored_shards(begun, tmp_path, free, capsys, monkeypatch):
    free(3 * KIB)
    commit = store.Ledger.commit

    def full(self, shard, *words):
        if begun and shard.number == 0:
            return commit(self, shard, *words)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(store.Ledger, "commit", full)
    out = tmp_path / "out"
    words = ["run", str(sharded_runs.study(tmp_path)), "--device", "cpu", "--shard", "5", "--out", str(out)]
    assert main(words) == 2
    output = capsys.readouterr().err
    kept = "" if begun else "nothing is committed yet; "
    assert f"warpcontact: [Errno 28] No space left on device: '{out}'\n" in output
    assert (
        f"warpcontact: {kept}a shard of 5 environments takes up to 51.6 KiB of results before compression, plus "
        f"its checkpoints; 3 KiB is free on the disk of {out}\n"
    ) in output
    kept = "committed results are saved" if begun else "nothing is saved yet"
    assert f"{kept} in {out}; to resume:\n    warpcontact run --resume --out {out}\n" in output
    monkeypatch.setattr(store.Ledger, "commit", commit)
    assert main(["run", "--resume", "--device", "cpu", "--out", str(out)]) == 0
