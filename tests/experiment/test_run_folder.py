"""Run folders: rejection of other folders, locking and resuming, and reading of results."""

import csv
import json
import os
import shutil
import signal

import numpy as np
import pytest
import sharded_runs

import warpcontact as wc
from warpcontact.cli import main

pytestmark = pytest.mark.usefixtures("no_pictures")

SHA = "0" * 64


# Folders without a run


def test_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(wc.ExperimentError, match="none: is not a folder"):
        wc.open_run(tmp_path / "none")
    (tmp_path / "file").write_text("text")
    with pytest.raises(wc.ExperimentError, match="file: is not a folder"):
        wc.open_run(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "run.json").write_text('{"program": "another 1.0", "schema": 1}')
    for name in ("empty", "other"):
        with pytest.raises(wc.ExperimentError, match=rf"{name}: holds no run: run\.json is missing or incomplete"):
            wc.open_run(tmp_path / name)
        with pytest.raises(wc.ExperimentError, match=f"{name}: holds no run to resume"):
            wc.Experiment.from_toml(sharded_runs.study(tmp_path)).run(tmp_path / name, device="cpu", resume=True)


@pytest.mark.parametrize("content", ["", "{", '{"program": "warpc', "[]", "null", "\x00\xff", "[" * 100_000])
def test_truncated_run_json_is_not_a_run(content, whole_run, copied_run):
    folder = copied_run(whole_run)
    (folder / "run.json").write_text(content)
    with pytest.raises(wc.ExperimentError, match=r"holds no run: run\.json is missing or incomplete"):
        wc.open_run(folder)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"schema": 1}, "schema must be 2, got 1, written by warpcontact"),
        ({"schema": "2"}, "schema must be 2, got '2'"),
        ({"schema": None}, "schema must be 2, got None"),
        ({"envs": 0}, "envs must be a whole number from 1 to 2147483647, got 0"),
        ({"envs": 10**30}, "envs must be a whole number from 1 to 2147483647, got 10{30}"),
        ({"envs": 11}, r"envs must be 10, as in experiment\.toml, got 11"),
        ({"shard": "4"}, "shard must be a whole number from 1 to 2147483647, got '4'"),
        ({"shard": 5}, "shards must be 2 for these envs and shard, got 3"),
        ({"block": -1}, "block must be a whole number from 1 to 2147483647, got -1"),
        ({"steps": True}, "steps must be a whole number from 1 to 2147483647, got True"),
        ({"dt": 0}, "dt must be a time above 0 s, got 0"),
        ({"duration": [1]}, r"duration must be a time above 0 s, got \[1\]"),
        ({"state": "done"}, "state must be one of finished, unfinished, interrupted, failed, got 'done'"),
        ({"state": ["x"]}, r"state must be a text, got \['x'\]"),
        ({"failed": "all"}, "failed must be a table, got 'all'"),
        ({"law_files": 1}, "law_files must be a table, got 1"),
    ],
)
def test_invalid_run_json_entries_are_reported(entries, message, whole_run, copied_run):
    folder = copied_run(whole_run)
    sharded_runs.change(folder / "run.json", **entries)
    with pytest.raises(wc.ExperimentError, match=f"run\\.json.*{message}"):
        wc.open_run(folder)


def test_missing_run_json_entries_are_all_reported(whole_run, copied_run):
    folder = copied_run(whole_run)
    kept = {key: json.loads((folder / "run.json").read_text())[key] for key in ("program", "schema", "envs")}
    (folder / "run.json").write_text(json.dumps(kept))
    with pytest.raises(wc.ExperimentError, match="has 10 problems") as error:
        wc.open_run(folder)
    assert "  - shard is missing" in str(error.value)


def test_file_names_in_run_json_cannot_leave_the_folder(whole_run, copied_run):
    folder = copied_run(whole_run)
    (folder.parent / "secret.py").write_text("secret = 1")
    sharded_runs.change(folder / "run.json", law_files={"../secret.py": SHA, "/etc/passwd": SHA})
    assert set(wc.open_run(folder).files) == {"commits", "data", "experiment", "picture", "summary"}


def test_complete_run_folder_is_valid(whole_run):
    run = wc.open_run(whole_run, verify=True)
    assert run.finished
    run.check()
    assert sharded_runs.leftovers(whole_run) == []
    assert str(whole_run / "data.zarr") in str(run)


# Resuming and locking


def test_run_of_another_experiment_is_reported_with_differing_keys(part_run, copied_run):
    folder = copied_run(part_run)
    path = sharded_runs.study(folder.parent, mass="1.5", every="2e-3", seed="4")
    before = sorted(folder.rglob("*"))
    with pytest.raises(wc.ExperimentError) as error:
        wc.Experiment.from_toml(path).run(folder, device="cpu", resume=True)
    text = str(error.value)
    assert text.startswith(f"{folder}: holds the run of another experiment: ")
    for difference in ("seed is 3 there, 4 here", "body[0].mass is 1.0 there, 1.5 here", "record.every is 0.001"):
        assert difference in text
    assert sorted(folder.rglob("*")) == before


def test_changed_mesh_file_makes_another_experiment(tmp_path):
    ground = tmp_path / "ground.obj"
    ground.write_text("v -2 -2 0\nv 2 -2 0\nv 2 2 0\nv -2 2 0\nf 1 2 3\nf 1 3 4\n")
    path = sharded_runs.study(tmp_path, mesh='{ file = "ground.obj" }', duration="2e-3")
    wc.Experiment.from_toml(path).run(tmp_path / "out", device="cpu")
    ground.write_text(ground.read_text().replace("v 2 2 0", "v 2 2 0.1"))
    with pytest.raises(wc.ExperimentError, match="another experiment: files that it names have changed since"):
        wc.Experiment.from_toml(path).run(tmp_path / "out", device="cpu", resume=True)


@pytest.mark.skipif(os.name != "posix", reason="other systems have no locks on folders")
def test_run_in_progress_can_be_read_but_not_resumed(whole_run, tmp_path):
    folder = tmp_path / "out"
    reference = wc.open_run(whole_run)
    seen = set()

    def read():
        values = wc.open_run(folder).series["touch.gap"]
        there = ~np.isnan(values.values)
        expected = reference.series["touch.gap"].sel(env=values["env"]).values
        np.testing.assert_array_equal(values.values[there], expected[there])
        seen.add(int(there.sum()))

    process = sharded_runs.start_run(
        sharded_runs.study(tmp_path), "--out", folder, *sharded_runs.OPTIONS, first=sharded_runs.COMMIT_OFTEN
    )
    try:
        assert sharded_runs.wait_until(lambda: sharded_runs.records(folder), process)
        os.kill(process.pid, signal.SIGSTOP)
        experiment = wc.Experiment.from_toml(folder / "experiment.toml")
        for options in ({"resume": True}, {"overwrite": True}):
            with pytest.raises(wc.ExperimentError, match="another process is running and writes there"):
                experiment.run(folder, device="cpu", **options)
        read()
        os.kill(process.pid, signal.SIGCONT)
        while process.poll() is None and len(seen) < 6:
            read()  # concurrently with commits, moves and removals
    finally:
        process.send_signal(signal.SIGCONT)
        code, _, err = sharded_runs.wait_for_end(process)
    assert code == 0, err
    read()
    assert len(seen) > 1
    assert sharded_runs.hashes(folder) == sharded_runs.hashes(whole_run)


# Results


def test_unfinished_run_shows_committed_results(whole_run, part_run):
    committed = sharded_runs.check_committed_results(part_run, wc.open_run(whole_run))
    run = wc.open_run(part_run)
    assert not run.finished
    assert committed[0]["finished"]
    assert not committed[1]["finished"]
    assert run.to_dataframe().index.tolist() == [0, 1, 2, 3]
    assert run.health.good
    assert "unfinished: 4 of 10 environments are finished in 3 shards" in str(run)
    assert run.digest() != wc.open_run(whole_run).digest()


@pytest.mark.parametrize("begun", [True, False])
def test_run_without_commits_is_reported(begun, part_run, copied_run, tmp_path, capsys):
    folder = copied_run(part_run)
    for path in (folder / "commit").glob("shard_*.json"):
        path.unlink()
    if begun:  # an initial checkpoint, without records
        shutil.copy(part_run / "commit" / "shard_000001.json", folder / "commit")
        sharded_runs.change(folder / "commit" / "shard_000001.json", frames=0, steps=0, files={})
    resume = f"to resume: warpcontact run --resume --out {folder}"
    for words in (["export", folder, "--usd", tmp_path / "a.usda"], ["render", folder, "-o", tmp_path / "a.png"]):
        assert main([str(word) for word in words]) == 2
        output = capsys.readouterr().err
        assert f"{folder}: no frame is committed yet in this run; {resume}\n" in output
    assert main(["export", str(folder), "--csv", str(tmp_path / "a.csv")]) == 0
    assert f"is finished yet: the table has no rows; {resume}" in capsys.readouterr().err


def test_records_only_in_a_checkpoint_are_reported_as_stored(part_run, copied_run, tmp_path, capsys):
    """Half of a shard is done, but no complete block of it."""
    folder = copied_run(part_run)
    for number in (0, 1):
        sharded_runs.change(folder / "commit" / f"shard_{number:06d}.json", frames=0)
    resume = f"to resume: warpcontact run --resume --out {folder}"
    kept = (
        "frames are written in blocks of 19, those after the last block are stored in checkpoints and can be read "
        "as the"
    )
    for words in (["export", folder, "--usd", tmp_path / "a.usda"], ["render", folder, "-o", tmp_path / "a.png"]):
        assert main([str(word) for word in words]) == 2
        output = capsys.readouterr().err
        assert f"{folder}: no frame can be read yet: {kept} run continues; {resume}\n" in output
    assert f"\n4 environments started, with 0 or more frames: {kept} run continues\n" in str(wc.open_run(folder))


def test_summary_of_an_unfinished_run_states_number_of_finished_environments(part_run, whole_run):
    assert "\nof the 4 of 10 that are finished: all 4 environments are active\n" in str(wc.open_run(part_run))
    assert "\nall 10 environments are active\n" in str(wc.open_run(whole_run))
    assert " started, " not in str(wc.open_run(whole_run))


def test_animation_of_an_unfinished_run_ends_at_the_last_record(part_run, tmp_path, capsys):
    frames = sharded_runs.records(part_run)[1]["frames"]
    out = tmp_path / "a.usda"
    assert main(["export", str(part_run), "--usd", str(out), "--envs", "0", "5"]) == 0
    printed, output = capsys.readouterr()
    assert printed == f"{out}\n"
    end = f"{(frames - 1) * 1e-3:g}"
    assert (
        f"caution: {part_run} is not finished: the animation ends at {end} s, and has 8 of 10 environments\n"
        in output
    )
    assert f"endTimeCode = {frames - 1}\n" in out.read_text()
    assert main(["export", str(part_run), "--usd", str(out), "--envs", "0"]) == 0
    assert "the animation ends at 0.2 s, and has 4 of 10 environments" in capsys.readouterr().err
    assert main(["export", str(part_run), "--usd", str(out), "--envs", "9"]) == 2
    assert "environment 9 has no frame yet in this run: it has not started; " in capsys.readouterr().err


def test_results_are_read_without_building_a_model(whole_run, tmp_path, monkeypatch):
    settings = wc.open_run(whole_run).experiment.settings

    def build(*_, **__):
        raise AssertionError("a model is built, which compiles kernels")

    monkeypatch.setattr(wc.Scene, "build", build)
    run = wc.open_run(whole_run)
    assert run.settings == settings
    assert [contact.name for contact in run.recording.scene.contacts] == ["touch"]
    assert wc.convergence(run, "end_time")["estimate"].sizes["n"] > 1
    assert wc.quantile_fan(run, "touch.gap").sizes["quantile"] == 5
    assert run.table().sizes["env"] == run.settings.envs
    assert "touch" in wc.report(run, tmp_path / "report.html").read_text(encoding="utf-8")


def test_tables_round_trip_through_files(whole_run, tmp_path):
    pd = pytest.importorskip("pandas")
    run = wc.open_run(whole_run)
    frame = run.to_dataframe()
    assert frame.index.tolist() == list(range(10))
    assert frame["ball.mass"].tolist() == run.params["ball.mass"].values.tolist()
    sideways = run.params["ball.linear_velocity.initial"].sel(axis="y")
    np.testing.assert_array_equal(frame["ball.linear_velocity.initial.y"], sideways)
    run.to_csv(tmp_path / "table.csv")
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for name, column in frame.reset_index().items():
        read = str if column.dtype == "category" else float
        assert [read(row[name]) for row in rows] == column.tolist()
    pytest.importorskip("pyarrow")
    run.to_parquet(tmp_path / "table.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "table.parquet"), frame)


def test_digest_depends_on_results_only(whole_run, copied_run):
    folder = copied_run(whole_run)
    digest = wc.open_run(whole_run).digest()
    sharded_runs.change(folder / "run.json", name="another", wall_time=1.0)
    assert wc.open_run(folder).digest() == digest
    run = wc.Experiment.from_toml(folder / "experiment.toml").run(folder.parent / "again", device="cpu", shard=3)
    assert run.digest() == digest
    other = wc.Experiment.from_toml(sharded_runs.study(folder.parent, seed="4"))
    assert other.run(folder.parent / "other", device="cpu").digest() != digest
