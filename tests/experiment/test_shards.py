"""An experiment that does not fit into memory runs in shards, with the same results."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from case_marks import slow_except
from memory_scenes import MIB, set_available_memory
from test_experiment import EXAMPLE, content

import warpcontact as wc
from warpcontact.building.plan import ModelPlan
from warpcontact.experiment import plan, shards, store
from warpcontact.experiment.plan import shard_size
from warpcontact.experiment.shards import ShardRunner
from warpcontact.stepping.frame_buffers import Frame
from warpcontact.stepping.recorder import RecordingSize
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.system import resources

VARIED = {
    "ball.mass": {"uniform": [0.5, 2.0]},
    "ball.position": {"uniform": [[-1, -1, 0.09], [1, 1, 0.2]]},
    "touch.law.stiffness": {"linspace": [1e4, 2e4]},
    "ball.inertia": {"solid_sphere": {"mass": "ball.mass", "radius": "touch.radius"}},
}


def varied(**changes):
    """Environments that differ in separately and jointly stored quantities."""
    bodies = [*content()["body"], {"name": "rock", "mass": 2.0, "inertia": [1, 1, 1], "position": [0, 0, 5]}]
    sensors = ["touch.gap", "touch.status", "scene.kinetic_energy", "touch.normal"]
    return wc.Experiment(content(envs=11, body=bodies, variation=VARIED, record={"sensors": sensors}, **changes))


def stored(run):
    """Returns the recording as read later from the folder of a run."""
    whole = wc.open_run(run.folder).recording.load()
    assert whole.identical(run.recording.load())
    series = xr.open_zarr(run.files["data"], group="series", consolidated=False, chunks=None)
    assert set(series) <= set(whole)
    return whole


@pytest.fixture(scope="module")
def unsharded(device, tmp_path_factory):
    return varied().run(tmp_path_factory.mktemp("once") / "out", device=device)


@pytest.mark.parametrize(
    ("shard", "shards"),
    slow_except([(1, 11), (2, 6), (4, 3), (10, 2), (11, 1), (1000, 1)], lambda case: case[0] == 4),
)
def test_results_do_not_depend_on_shard_size(shard, shards, unsharded, device, tmp_path):
    run = varied().run(tmp_path / "out", device=device, shard=shard)
    assert stored(run).identical(stored(unsharded))
    assert list(stored(run)) == list(stored(unsharded))
    assert run.digest() == unsharded.digest()
    assert run.recording["env"].values.tolist() == list(range(11))
    assert run.recording.scene is not None
    assert (run.summary["shards"], run.summary["envs"]) == (shards, 11)
    assert run.summary["shard"] <= shard
    assert run.summary["steps"] == unsharded.summary["steps"]
    assert set(run.files) == set(unsharded.files)
    # Pictures and animations are equal for any shards.
    assert run.files["picture"].read_bytes() == unsharded.files["picture"].read_bytes()
    assert animation(run) == animation(unsharded)


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize("shard", slow_except([1, 3, 4, 10], lambda shard: shard == 4))
def test_shards_are_split_over_devices(shard, unsharded, device, tmp_path):
    plan = varied().plan(device=[device] * 3, shard=shard)
    run = varied().run(tmp_path / "out", device=[device] * 3, shard=shard)
    whole, split = stored(unsharded), stored(run)
    names = [name.partition(" ")[0] for name in split.attrs.pop("device").split(", ")]
    assert names == [device] * min(3, plan.shard)
    whole.attrs.pop("device")
    assert split.identical(whole)
    assert run.summary["shards"] == plan.shards == -(-11 // plan.shard)


def animation(run):
    from pxr import Sdf

    layer = Sdf.Layer.FindOrOpen(str(run.files["animation"]))
    return layer.ExportToString()


@pytest.mark.usefixtures("no_pictures")
def test_plan_selects_shard_size_by_memory(unsharded, device, tmp_path, monkeypatch):
    from warpcontact.storage import memory_estimate as footprint

    plan = varied().plan(device=device)
    assert (plan.envs, plan.shard, plan.shards) == (11, 11, 1)
    assert "11 environments: one shard" in str(plan)
    # Memory for some of them, in steps that resolve single environments.
    monkeypatch.setattr(footprint, "CAUTIOUS_FRACTION", 0.85)
    monkeypatch.setattr("warpcontact.experiment.plan.CAUTIOUS_FRACTION", 0.85)
    place = plan.footprint.locations[-1]
    set_available_memory(
        monkeypatch, int(varied().plan(device=device, shard=5).footprint.bytes_at(place) / 0.85) + 64
    )
    plan = varied().plan(device=device)
    assert 1 <= plan.shard <= 5
    assert f"11 environments: {plan.shards} shards of {plan.shard}, one after another" in str(plan)
    run = varied().run(tmp_path / "out", device=device)
    assert run.summary["shards"] == plan.shards > 1
    assert stored(run).identical(stored(unsharded))
    with pytest.raises(MemoryError, match=r"shard 11: 11 environments need .*; at most \d+ fit on"):
        varied().run(tmp_path / "more", device=device, shard=11)
    assert not (tmp_path / "more").exists()


def test_plan_considers_memory_of_all_devices(monkeypatch):
    """A shard that fits on the first device may be too large for the second."""
    memory = ModelPlan.memory

    def with_gpus(draft, envs, *varied, **stepping):
        """Each part needs memory of a separate GPU as well."""
        shares = enumerate(draft.shares(envs))
        needs = [MemoryItem("state", f"cuda:{number}", own * MIB, MIB / 2) for number, (_, own) in shares]
        return memory(draft, envs, *varied, **stepping).with_items(needs)

    monkeypatch.setattr(ModelPlan, "memory", with_gpus)
    monkeypatch.setattr(resources, "_host", lambda: None)
    monkeypatch.setattr(resources, "_device", {"cuda:0": 100 * MIB, "cuda:1": 4 * MIB}.get)
    plan = varied().plan(device=["cpu", "cpu"])
    # For shards of 5, 3 would be on the first and 2 on the second, with up to 70 % of its memory; 4 also gives 3
    # shards.
    assert (plan.shard, plan.shards) == (4, 3)
    assert "available: 4 MiB of the memory of cuda:1" in str(plan)
    with pytest.raises(
        MemoryError, match=r"shard 11: 11 environments need 5 MiB of the memory of cuda:1, .* at most 7 fit"
    ):
        varied().plan(device=["cpu", "cpu"], shard=11)


@pytest.mark.usefixtures("no_pictures")
def test_frozen_environments_keep_their_numbers_in_shards(device, tmp_path):
    # A force that overflows float32 in some environments, in several shards.
    stiffness = {"values": [1e4, 1e4, 1e38, 1e4, 1e38, 1e4, 1e38]}
    body = content()["body"][0] | {"position": [0, 0, 0.05]}
    experiment = wc.Experiment(content(envs=7, body=[body], variation={"touch.law.stiffness": stiffness}))
    with pytest.warns(RuntimeWarning, match="3 of 7 environments turned non-finite") as warned:
        run = experiment.run(tmp_path / "out", device=device, shard=3)
    assert sum("non-finite" in str(warning.message) for warning in warned) == 1
    assert run.health.frozen.tolist() == [2, 4, 6]
    assert (run.health.envs, run.health.good) == (7, False)
    assert json.loads(run.files["summary"].read_text())["frozen_environments"] == [2, 4, 6]
    assert stored(run).attrs["frozen_environments"] == [2, 4, 6]
    assert run.outcome["status"].values.astype(bool).tolist() == [False, False, True, False, True, False, True]
    assert "3 of 7 environments turned non-finite" in str(run)


@pytest.mark.usefixtures("no_pictures")
def test_padding_environment_of_the_last_batch_is_not_reported(device, tmp_path):
    body = content()["body"][0] | {"position": [0, 0, 0.05]}
    stiffness = {"values": [1e4, 1e4, 1e4, 1e4, 1e38]}
    experiment = wc.Experiment(content(envs=5, body=[body], variation={"touch.law.stiffness": stiffness}))
    with pytest.warns(RuntimeWarning, match="1 of 5 environments turned non-finite"):
        run = experiment.run(tmp_path / "out", device=device, shard=3)
    assert run.health.frozen.tolist() == [4]
    assert run.recording.sizes["env"] == 5


@pytest.mark.usefixtures("no_pictures")
def test_point_set_with_as_many_points_as_a_shard_has_environments_is_unambiguous(device, tmp_path):
    """With three environments, values per environment are not mistaken for values of three points."""
    points = [{"name": "centre", "body": "ball", "positions": np.eye(3).tolist()}]
    values = {"touch.law.stiffness": {"linspace": [1e4, 2e4]}, "centre.position": {"uniform": [[0] * 3, [1] * 3]}}
    raw = content(envs=6, point=[], points=points, variation=values)
    once = wc.Experiment(raw).run(tmp_path / "once", device=device)
    shards = wc.Experiment(raw).run(tmp_path / "shards", device=device, shard=3)
    assert stored(shards).identical(stored(once))
    assert stored(once)["touch.law.stiffness"].dims == ("env", "item")


@pytest.mark.usefixtures("no_pictures")
def test_warnings_in_shards_name_global_environment_numbers(device, tmp_path):
    stiffness = {"values": [1e3, 1e3, 1e3, 1e3, 1e7, 1e3]}
    experiment = wc.Experiment(content(envs=6, variation={"touch.law.stiffness": stiffness}))
    with pytest.warns(wc.ContactWarning, match="in environment 4, "):
        run = experiment.run(tmp_path / "out", device=device, shard=2)
    assert sum("is too long" in line for line in run.summary["warnings"]) == 1
    # A kind of warning that the first shard has printed is not repeated.
    stiffness = {"values": [1e3, 1e7, 1e3, 1e3, 2e7, 1e3]}
    experiment = wc.Experiment(content(envs=6, variation={"touch.law.stiffness": stiffness}))
    with pytest.warns(wc.ContactWarning, match="in environment 1, "):
        run = experiment.run(tmp_path / "again", device=device, shard=2)
    assert sum("is too long" in line for line in run.summary["warnings"]) == 1


@pytest.mark.usefixtures("no_pictures")
def test_progress_bar_counts_steps_of_all_shards(device, tmp_path, monkeypatch):
    import tqdm

    bars = []

    class Bar(tqdm.tqdm):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            bars.append(self)

    monkeypatch.setattr(tqdm, "tqdm", Bar)
    wc.Experiment(content(envs=5)).run(tmp_path / "out", device=device, shard=2, progress=True)
    # The bar of the animation is not shown and does not count.
    assert [(bar.total, bar.n) for bar in bars if bar.n] == [(5 * 20, 5 * 20)]
    assert bars[0].desc.startswith("5 environments in 3 shards")


@pytest.mark.usefixtures("no_pictures")
def test_interrupted_run_keeps_finished_shards_and_resumes(device, tmp_path, monkeypatch):
    taken = []
    run = ShardRunner.run

    def interrupted(self, shard, *args):
        taken.append(shard.first)
        if len(taken) == 2:
            raise KeyboardInterrupt
        return run(self, shard, *args)

    monkeypatch.setattr(ShardRunner, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        wc.Experiment(content(envs=6)).run(tmp_path, device=device, shard=2)
    assert taken == [0, 2]
    assert json.loads((tmp_path / "run.json").read_text())["state"] == "interrupted"
    kept = wc.open_run(tmp_path)
    assert not kept.finished
    assert kept.recording["env"].values.tolist() == kept.outcome["env"].values.tolist() == [0, 1]
    assert "interrupted: 2 of 6 environments are finished in 3 shards" in str(kept)
    monkeypatch.undo()
    with pytest.raises(wc.ExperimentError, match=r"holds a run that did not finish; .*--resume"):
        wc.Experiment(content(envs=6)).run(tmp_path, device=device)
    resumed = wc.Experiment(content(envs=6)).run(tmp_path, device=device, resume=True)
    assert resumed.finished
    once = wc.Experiment(content(envs=6)).run(tmp_path / "once", device=device)
    assert resumed.digest() == once.digest()


@pytest.mark.usefixtures("no_pictures")
def test_values_out_of_range_are_detected_before_files_are_removed(device, tmp_path):
    wc.Experiment(content()).run(tmp_path, device=device)
    scale = {"values": [1.0, 1.0, 1.0, 1e-60]}  # positive, but zero in float32
    experiment = wc.Experiment(content(variation={"touch.radius": {"value": 0.1}, "ground.scale": scale}))
    with pytest.raises(ValueError, match="does not fit into float32"):
        experiment.run(tmp_path, device=device, overwrite=True, shard=2)
    assert wc.open_run(tmp_path).finished


@pytest.mark.parametrize("shard", [0, -3, 1.5, "many", True])
def test_invalid_shard_size_is_refused(shard, tmp_path):
    with pytest.raises(wc.ExperimentError, match=r"shard must be a whole number of at least 1, got"):
        wc.Experiment(content()).run(tmp_path / "out", shard=shard)
    with pytest.raises(wc.ExperimentError, match=r"shard must be a whole number of at least 1, got"):
        wc.Experiment(content()).plan(shard=shard)
    assert not (tmp_path / "out").exists()


def test_shards_are_of_equal_and_round_size():
    rng = np.random.default_rng(0)
    for _ in range(2000):
        envs = int(np.exp(rng.uniform(0, 16)))
        most = int(np.exp(rng.uniform(0, 16)))
        size = shard_size(most, envs)
        assert 1 <= size <= max(1, min(most, envs))
        if size < envs:
            shards = -(-envs // size)
            # Rounding of the size costs at most 1/32, and rarely one more shard.
            assert size * shards < envs * 33 / 32 + size
            assert shards <= -(-envs // most) * 33 / 32 + 1
            assert size % (1 << max(0, most.bit_length() - 6)) == 0
    assert shard_size(4, 10) == 4
    assert shard_size(7, 10) == 5


@pytest.mark.usefixtures("no_pictures")
def test_chunks_on_disk_are_parts_of_a_shard(device, tmp_path, monkeypatch):
    monkeypatch.setattr("warpcontact.experiment.store.CHUNK", 700)  # a few environments of 21 frames
    run = wc.Experiment(content(envs=20)).run(tmp_path / "out", device=device, shard=8)
    group = zarr.open_group(run.files["data"], path="series", mode="r")
    chunks = {name: array.chunks for name, array in group.arrays()}
    # 21 frames of 24 bytes: one environment; of 4 bytes: eight.
    assert run.summary["shard"] == 8
    assert chunks["ball.position"] == (21, 1, 3)
    assert chunks["touch.gap"] == (21, 8)
    once = wc.Experiment(content(envs=20)).run(tmp_path / "once", device=device)
    assert stored(run).identical(stored(once))


@pytest.mark.usefixtures("no_pictures")
def test_recording_of_shards_is_read_lazily(device, tmp_path):
    run = wc.Experiment(content(envs=6)).run(tmp_path / "out", device=device, shard=2)
    assert not run.recording["ball.position"].variable._in_memory
    assert run.recording["touch.gap"].sel(env=5).values.shape == (21,)
    assert isinstance(run.recording, wc.Recording)
    wc.export_usd(run.recording, tmp_path / "two.usda", envs=[1, 5])
    assert "env_5" in (tmp_path / "two.usda").read_text()


@pytest.mark.usefixtures("no_pictures")
def test_run_command_runs_in_shards(device, tmp_path, capsys):
    from warpcontact.cli import main

    (tmp_path / "study.toml").write_text(
        "duration = 0.01\ndt = 1e-3\nenvs = 5\n"
        '[[body]]\nname = "b"\nmass = 1\ninertia = [1, 1, 1]\n'
        '[variation]\n"b.mass" = { linspace = [1, 2] }\n'
    )
    words = ["run", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out"), "--device", device]
    assert main([*words, "--shard", "2"]) == 0
    out, err = capsys.readouterr()
    assert "3 shards of 2" in err
    assert "5 environments × 0.01 s in 10 steps of 0.001 s" in out
    assert "in 3 shards, " in out
    assert "all 5 environments are active" in out
    assert main([*words, "--overwrite", "--shard", "0"]) == 2
    assert "--shard 0: shard must be" in capsys.readouterr().err


PEAK = """
import ctypes, gc, sys
import warp as wp
wp.config.log_level = wp.LOG_ERROR
import warpcontact as wc

def told(key):
    return 1024 * int(next(line for line in open("/proc/self/status") if line.startswith(key)).split()[1])

file, folder, envs, shard = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
experiment = wc.Experiment.from_toml(file).changed(envs=envs, duration=0.5)
# Everything is loaded then, and the picture drawn once.
experiment.run(folder + "/first", envs=4, device="cpu", progress=False)
gc.collect()
if hasattr(ctypes.CDLL(None), "malloc_trim"):
    ctypes.CDLL(None).malloc_trim(0)  # what is free would be used again
before = told("VmRSS")
plan = experiment.plan(device="cpu", shard=shard)
experiment.run(folder + "/second", device="cpu", shard=shard, progress=False)
print(told("VmHWM") - before, plan.footprint.host_bytes)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="asks Linux how much memory a process has")
@pytest.mark.parametrize("shard", [36864, 73728], ids=["two_shards", "one_shard"])
def test_experiment_plan_matches_memory_of_its_run(shard, tmp_path):
    """Within 15 %, from start to picture, for one and two shards.

    The number of environments is so large that the memory that threads keep in the allocator, which varies by 15
    MB, is small.
    """
    words = [sys.executable, "-c", PEAK, str(EXAMPLE), str(tmp_path), "73728", str(shard)]
    result = subprocess.run(words, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    took, planned = map(int, result.stdout.split()[-2:])
    assert planned == pytest.approx(took, rel=0.15)


@pytest.mark.parametrize(
    ("envs", "frames", "block"),
    [
        (2**17, 3, 3),
        (2**17, 8, 4),  # at least 4 MiB
        (2**17, 100, 13),  # an eighth
        (2**17, 1000, 32),  # at most 32 MiB
        (2**23, 10, 1),
        (1, 10, 10),
        (1, 0, 1),
    ],
)
def test_blocks_of_frames_have_bounded_size(envs, frames, block):
    size = RecordingSize((Frame("ball.speed", 8, 8),), 100, frozenset())
    assert plan.block_size(size, envs, frames) == block
    assert plan.blocks_at_once(frames, block) == 1 + (frames > block)
    (need, _) = size.memory_items("cpu", envs, block, plan.blocks_at_once(frames, block))
    assert need.size == envs * 8 * block * (1 + (frames > block))


@pytest.mark.usefixtures("no_pictures")
def test_stop_request_at_the_end_of_a_shard_is_handled(device, tmp_path, monkeypatch):
    """If a shard takes almost no time, most Ctrl-C arrive between the last check and the commit."""
    finish = shards._ShardAttempt._finish
    finished = []

    def interrupted(self):
        os.kill(os.getpid(), signal.SIGINT)
        finished.append(self.shard.number)
        return finish(self)

    monkeypatch.setattr(shards._ShardAttempt, "_finish", interrupted)
    with pytest.raises(KeyboardInterrupt):
        wc.Experiment(content(envs=6)).run(tmp_path, device=device, shard=2)
    assert finished == [0]
    monkeypatch.undo()
    assert wc.open_run(tmp_path).outcome["env"].values.tolist() == [0, 1]
    assert wc.Experiment(content(envs=6)).run(tmp_path, device=device, resume=True).finished


@pytest.mark.usefixtures("no_pictures")
def test_failed_run_can_be_resumed(device, tmp_path, monkeypatch):
    run = ShardRunner.run

    def fails(self, shard, *args):
        if shard.first == 2:
            raise OSError(28, "No space left on device")
        return run(self, shard, *args)

    with monkeypatch.context() as patch:
        patch.setattr(ShardRunner, "run", fails)
        with pytest.raises(OSError, match="No space left"):
            wc.Experiment(content(envs=6)).run(tmp_path, device=device, shard=2)
    # In the same process, which is still running.
    kept = wc.open_run(tmp_path)
    assert kept.summary["state"] == "failed"
    assert "No space left" in kept.summary["error"]
    resumed = wc.Experiment(content(envs=6)).run(tmp_path, device=device, resume=True)
    assert resumed.finished
    assert "error" not in resumed.summary


@pytest.mark.usefixtures("no_pictures")
def test_uncommitted_results_are_ignored(device, tmp_path):
    experiment = wc.Experiment(
        content(outcome={"never": {"type": "FirstTime", "of": "touch.normal_force", "above": 1e9}})
    )
    run = experiment.run(tmp_path, device=device)
    assert np.isnan(run.outcome["never"]).all()  # no chunk is written for it
    zarr.open_group(run.files["data"], path="outcome", mode="r+")["never"][:] = 1.25
    again = wc.open_run(tmp_path, verify=True)
    assert np.isnan(again.outcome["never"]).all()
    assert again.digest() == run.digest()


def test_prime_number_of_environments_has_few_chunks():
    assert store.largest_divisor(1000, 300) == 250
    assert store.largest_divisor(997, 500) == 997
    assert store.largest_divisor(2 * 997, 500) == 997
    assert store.largest_divisor(7, 100) == 7
    assert store.largest_divisor(7, 0) == 1
