"""Shards as tasks of a local Ray: identical bytes, and after a worker is killed only its shard is rerun."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import types

import pytest
import sharded_runs

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment.cluster import ClusterResources, cluster_resources, connect
from warpcontact.experiment.plan import Plan
from warpcontact.storage.memory_estimate import USABLE_FRACTION, MemoryEstimate, MemoryItem
from warpcontact.system.resources import HOST

WORDS = ("--shard", 4, "--device", "cpu")


@pytest.fixture(scope="module")
def study_folder(tmp_path_factory):
    """A folder with the experiment, and its run without Ray in ``whole``."""
    pytest.importorskip("ray")
    folder = tmp_path_factory.mktemp("cluster")
    code, _, err = sharded_runs.run(sharded_runs.study(folder), "--out", folder / "whole", *WORDS)
    assert code == 0, err
    return folder


def warnings_of(folder):
    return json.loads((folder / "run.json").read_text())["warnings"]


def workers(folder):
    """Returns the process that works on each shard, by shard number."""
    found = {}
    for path in (folder / "progress").glob("shard_*.json"):
        # A shard that ends removes its file, possibly before it is read.
        with contextlib.suppress(FileNotFoundError):
            found[int(path.stem[-6:])] = json.loads(path.read_text())["process"]
    return found


def test_run_without_ray_installed_prints_one_message(tmp_path):
    blocked = "import sys; sys.modules['ray'] = None"
    code, printed, err = sharded_runs.run(
        sharded_runs.study(tmp_path), "--out", tmp_path / "out", "--ray", first=blocked
    )
    assert code == 2
    assert printed == ""
    assert "warpcontact: --ray: Ray is not installed: pip install 'warpcontact[ray]'" in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.ray
def test_unreachable_ray_cluster_prints_one_message(study_folder, tmp_path):
    code, _, err = sharded_runs.run(study_folder / "study.toml", "--out", tmp_path / "out", "--ray", "127.0.0.1:1")
    assert code == 2, err
    assert "--ray 127.0.0.1:1: no cluster of Ray can be reached" in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.ray
def test_ray_run_writes_bitwise_identical_results(study_folder, tmp_path):
    out = tmp_path / "out"
    code, printed, err = sharded_runs.run(study_folder / "study.toml", "--out", out, "--ray", *WORDS)
    assert code == 0, err
    assert "10 environments × 0.2 s in 200 steps" in printed
    assert sharded_runs.hashes(out) == sharded_runs.hashes(study_folder / "whole")
    assert sharded_runs.leftovers(out) == []
    assert wc.open_run(out, verify=True).digest() == wc.open_run(study_folder / "whole").digest()


@pytest.mark.slow
@pytest.mark.ray
def test_shard_of_killed_worker_is_run_again(tmp_path):
    study, out = sharded_runs.study(tmp_path, envs=12, duration=300.0, every=0.5), tmp_path / "out"
    code, _, err = sharded_runs.run(study, "--out", tmp_path / "whole", *WORDS)
    assert code == 0, err
    process = sharded_runs.start_run(study, "--out", out, "--ray", *WORDS, "--checkpoint", 0.2)

    done, on_their_way = {}, {}

    def some_on_their_way():
        done.update(sharded_runs.records(out))
        on_their_way.update(
            (shard, pid)
            for shard, pid in workers(out).items()
            if done.get(shard, {}).get("steps") and not done[shard]["finished"]
        )
        return bool(on_their_way)

    assert sharded_runs.wait_until(some_on_their_way, process)
    shard, pid = next(iter(on_their_way.items()))
    name = subprocess.run(["ps", "-o", "args=", "-p", str(pid)], capture_output=True, text=True, check=True).stdout
    assert name.startswith("ray::")
    others = {number: record for number, record in done.items() if record["finished"]}
    os.kill(pid, signal.SIGKILL)
    code, _, err = sharded_runs.wait_for_end(process)
    assert code == 0, err
    again = [line for line in warnings_of(out) if "is retried" in line]
    assert len(again) == 1, again
    assert again[0].startswith(f"note: shard_{shard:06d} is retried: its worker was lost: ")
    assert again[0] in err
    now = sharded_runs.records(out)
    assert all(now[number] == record for number, record in others.items())
    # The shard was resumed from its checkpoint, so the earlier time counts.
    assert now[shard]["wall_time"] > done[shard]["wall_time"]
    assert sharded_runs.hashes(out) == sharded_runs.hashes(tmp_path / "whole")
    assert sharded_runs.leftovers(out) == []


@pytest.mark.slow
@pytest.mark.ray
def test_shard_failing_three_times_on_cluster_is_reported_and_others_finish(study_folder, tmp_path):
    path, out = sharded_runs.overflowing_study(tmp_path), tmp_path / "out"
    code, printed, err = sharded_runs.run(path, "--out", out, "--ray", "--shard", 2)
    assert code == 3, err
    assert "shard_000001 failed: RuntimeError: pile: a particle had" in printed
    assert "failed: 4 of 6 environments are finished in 3 shards" in printed
    assert err.count("note: shard_000001 is retried: RuntimeError: pile: a particle had") == 1
    assert wc.open_run(out, verify=True).outcome["env"].values.tolist() == [0, 1, 4, 5]


@pytest.mark.slow
@pytest.mark.ray
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_stopped_cluster_run_resumes_without_cluster(number, tmp_path):
    study, out = sharded_runs.study(tmp_path, envs=12, duration=300.0, every=0.5), tmp_path / "out"
    code, _, err = sharded_runs.run(study, "--out", tmp_path / "whole", *WORDS)
    assert code == 0, err
    process = sharded_runs.start_run(study, "--out", out, "--ray", *WORDS)
    assert sharded_runs.wait_until(lambda: workers(out), process)
    pids = list(workers(out).values())
    process.send_signal(number)
    code, _, err = sharded_runs.wait_for_end(process)
    assert code == 130, err
    assert f"warpcontact run --resume --out {out}" in err
    assert sharded_runs.have_ended(pids)
    committed = sharded_runs.check_committed_results(out, wc.open_run(tmp_path / "whole"))
    assert any(record["steps"] for record in committed.values())
    code, _, err = sharded_runs.run("--resume", "--out", out, "--device", "cpu")
    assert code == 0, err
    assert sharded_runs.hashes(out) == sharded_runs.hashes(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.ray
def test_stop_request_before_first_cluster_shard_reports_nothing_stored(study_folder, tmp_path):
    out = tmp_path / "out"
    first = sharded_runs.send_signal_at_stage(signal.SIGTERM, "building")
    code, _, err = sharded_runs.run(study_folder / "study.toml", "--out", out, "--ray", *WORDS, first=first)
    assert code == 130, err
    assert err.endswith("\nwarpcontact: interrupted before anything was saved\n")
    assert not out.exists()


def test_stop_request_while_ray_starts_is_handled(monkeypatch):
    ray = types.SimpleNamespace(is_initialized=lambda: False, init=lambda **_: sys.exit(1))
    monkeypatch.setitem(sys.modules, "ray", ray)
    with pytest.raises(KeyboardInterrupt):
        connect(True, "cpu", "study.toml")


@pytest.mark.slow
@pytest.mark.ray
def test_run_started_in_one_process_resumes_with_ray(study_folder, tmp_path):
    out = tmp_path / "out"
    kill = sharded_runs.kill_at_commit(25)
    code, _, err = sharded_runs.run(
        study_folder / "study.toml", "--out", out, *WORDS, "--checkpoint", 0, first=kill
    )
    assert code == -signal.SIGKILL, err
    code, _, err = sharded_runs.run("--resume", "--out", out, "--device", "cpu", "--ray")
    assert code == 0, err
    assert sharded_runs.hashes(out) == sharded_runs.hashes(study_folder / "whole")
    assert sharded_runs.leftovers(out) == []


class Cluster:
    """Stand-in for Ray, with machines of given cores, GPUs and bytes."""

    def __init__(self, *machines):
        keys = ("CPU", "GPU", "memory")
        self.machines = [dict(zip(keys, machine, strict=True)) for machine in machines]

    def cluster_resources(self):
        return {key: sum(one[key] for one in self.machines) for key in ("CPU", "GPU") if self.machines[0][key]}

    def nodes(self):
        return [{"Alive": True, "Resources": one} for one in self.machines] + [{"Alive": False, "Resources": {}}]


@pytest.mark.parametrize(
    ("machines", "gpus", "places", "there", "message_count"),
    [
        ([(8, 0, 100)], 0, 4, 4, 0),
        ([(8, 0, 35)], 0, 4, 3, 1),
        ([(8, 0, 35), (4, 0, 8), (2, 0, 1000)], 0, 7, 4, 1),
        ([(64, 4, 25), (64, 4, 1000)], 1, 8, 6, 1),
        ([(5, 0, 100)] * 3, 0, 7, 6, 0),
    ],
    ids=["enough", "less", "several machines", "GPUs", "cores left over"],
)
def test_concurrent_shards_are_limited_by_memory(machines, gpus, places, there, message_count, monkeypatch):
    monkeypatch.setattr("warpcontact.experiment.cluster.WORKER_MEMORY", 2)
    # The memory of the planning process does not count.
    plan = Plan(100, 5, 1, MemoryEstimate(5, "cpu", (MemoryItem("state", HOST, 6),)), 0, (), process=50)
    messages = []
    resources = ClusterResources(Cluster(*machines), cores=2, gpus=gpus, slots=places).limit_by_memory(
        plan, messages.append
    )
    # Including the reserve.
    assert (resources.slots, resources.memory) == (there, int(8 / USABLE_FRACTION))
    assert len(messages) == message_count
    if message_count:
        assert (
            f"running {there} shards concurrently instead of {places}, limited by memory: a shard of 5 environm"
            in messages[0]
        )


def test_shard_too_large_for_every_node_is_refused():
    plan = Plan(100, 5, 1, MemoryEstimate(5, "cpu", (MemoryItem("state", HOST, 6 * 2**30),)), 0, (), process=0)
    resources = ClusterResources(Cluster((8, 0, 2**30), (1, 0, 2**40)), cores=2, gpus=0, slots=4)
    message = "takes 7.58 GiB, and a machine has at most 1 GiB; use a smaller shard"
    with pytest.raises(MemoryError, match=message):
        resources.limit_by_memory(plan, print)


@pytest.mark.parametrize("device", ["cuda:0,cuda:1", "cuda:1", "cpu,cpu"])
def test_device_list_is_refused_with_ray(device, tmp_path, capsys):
    study = sharded_runs.study(tmp_path)
    assert main(["run", str(study), "--out", str(tmp_path / "out"), "--ray", "--device", device]) == 2
    assert f"--device {device}: device must be one of 'auto', 'cpu', 'cuda', 'cuda:0' with Ray" in (
        capsys.readouterr().err
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("device", "gpus", "expected"),
    [("auto", 4, (4, 1, 4)), ("cuda:0", 4, (4, 1, 4)), ("cpu", 4, (4, 0, 8)), ("auto", 0, (4, 0, 8))],
)
def test_cluster_resources_match_requested_device(device, gpus, expected):
    resources = cluster_resources(Cluster((16, gpus // 2, 100), (16, gpus // 2, 100)), device, "study.toml")
    assert (resources.cores, resources.gpus, resources.slots) == expected


def test_requested_gpu_missing_from_cluster_is_refused():
    with pytest.raises(wc.ExperimentError) as caught:
        cluster_resources(Cluster((16, 0, 100)), "cuda:0", "study.toml")
    assert str(caught.value) == "study.toml: device must be 'auto' or 'cpu' with Ray here: the cluster has no GPU"


@pytest.mark.slow
@pytest.mark.ray
def test_cpu_shards_use_cores_of_cluster_with_gpus(study_folder, tmp_path):
    gpu = "import ray; ray.init(address='local', num_cpus=4, num_gpus=1, object_store_memory=10**8)"
    out = tmp_path / "out"
    code, _, err = sharded_runs.run(
        study_folder / "study.toml", "--out", out, "--ray", "--device", "cpu", first=gpu
    )
    assert code == 0, err
    # Four shards for each of two slots, not for one GPU.
    assert wc.open_run(out, verify=True).summary["shard"] == 2
    assert wc.open_run(out).digest() == wc.open_run(study_folder / "whole").digest()


@pytest.mark.slow
@pytest.mark.ray
def test_cluster_with_memory_for_one_shard_runs_shards_sequentially(study_folder, tmp_path):
    little = "import ray; ray.init(address='local', num_cpus=2, _memory=0.9e9, object_store_memory=10**8)"
    out = tmp_path / "out"
    code, _, err = sharded_runs.run(study_folder / "study.toml", "--out", out, "--ray", *WORDS, first=little)
    assert code == 0, err
    assert (
        "running 1 shards concurrently instead of 2, limited by memory: a shard of 4 environments, with Python"
        in err
    )
    assert sharded_runs.hashes(out) == sharded_runs.hashes(study_folder / "whole")
    none = little.replace("0.9e9", "0.2e9")
    code, _, err = sharded_runs.run(
        study_folder / "study.toml", "--out", tmp_path / "none", "--ray", *WORDS, first=none
    )
    assert code == 2
    assert "warpcontact: --ray: a shard of 4 environments, with Python" in err
    assert not (tmp_path / "none").exists()
