"""Shards as tasks of Ray, on this machine or on a cluster that shares the folder of the run.

Ray places tasks, no more on a machine than its memory holds, and says which were lost; what counts is in the
folder. A shard whose worker was killed is run again, from its last commit, and no other.
"""

import socket
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.folder import read_summary
from warpcontact.experiment.progress import INTERVAL, ProgressBar, read_progress
from warpcontact.experiment.store import Commit, RunDataError, Shard
from warpcontact.model.quarantine import QuarantineError
from warpcontact.storage.memory_estimate import USABLE_FRACTION, MemoryShortage, env_count_text
from warpcontact.validation.number_format import format_bytes
from warpcontact.validation.warning_levels import RunWarning, WarningLevel, labeled, split_label

if TYPE_CHECKING:
    from warpcontact.experiment.execute import RunJob, ShardRunFunction
    from warpcontact.experiment.plan import Plan
    from warpcontact.experiment.shards import ShardRunner

# Cores that a shard gets on the CPU, at most: more of them are better used by more shards.
MAX_CORES = 4
# How long a cluster may take to answer [s].
CONNECT_TIMEOUT = 10.0
# Shards for each place that runs them, so that none waits long for the last.
SHARDS_PER_SLOT = 4
# Python, the libraries and the kernels of a worker, a process of its own; measured [bytes].
WORKER_MEMORY = 450 * 2**20
# Ray puts what tasks return into memory of its own: here next to nothing, and its default is a third of all.
OBJECT_STORE_MEMORY = 128 * 2**20
#: Devices that a run on a cluster can be asked for.
DEVICES = ("auto", "cpu", "cuda", "cuda:0")


@dataclass(frozen=True)
class ClusterResources:
    """What a cluster has.

    Attributes:
        ray: The module.
        cores: Cores for each shard.
        gpus: GPUs for each shard, 0 or 1.
        slots: How many shards run at once.
        memory: What each takes of the memory of its machine [bytes], once that is known.
    """

    ray: Any
    cores: int
    gpus: int
    slots: int
    memory: int = 0

    def limit_by_memory(self, plan: "Plan", on_stage: Callable[[str], None]) -> "ClusterResources":
        """Returns the same with as many places as there is memory for.

        Args:
            plan: How the shards run.
            on_stage: Is told if these are fewer.

        Raises:
            MemoryShortage: If no machine has room for one.
        """
        shard_memory = int((plan.footprint.host_bytes + WORKER_MEMORY) / USABLE_FRACTION)
        slots, fitting_slots, largest_memory = 0, 0, 0
        for machine in (node["Resources"] for node in self.ray.nodes() if node["Alive"]):
            machine_slots = int(machine.get("GPU", 0)) if self.gpus else int(machine.get("CPU", 0)) // self.cores
            free_memory = int(machine.get("memory", 0))
            slots += machine_slots
            fitting_slots += min(machine_slots, free_memory // shard_memory)
            largest_memory = max(largest_memory, free_memory if machine_slots else 0)
        one = f"a shard of {env_count_text(plan.shard)}, with Python and its libraries, takes {format_bytes(shard_memory)}"
        if not fitting_slots:
            message = f"--ray: {one} of a machine, and Ray has {format_bytes(largest_memory)} at most; take a smaller shard"
            raise MemoryShortage(message, shard_memory, largest_memory)
        # Cores that are left over on several machines make no place.
        slots = min(slots, self.slots)
        if fitting_slots < min(slots, plan.shards):
            on_stage(f"running {fitting_slots} at once, and not {slots}, for want of memory: {one}")
        return replace(self, slots=min(self.slots, fitting_slots), memory=shard_memory)

    def default_shard_size(self, envs: int) -> int:
        """Returns how many of ``envs`` environments a shard has that nobody asked for otherwise, at most."""
        return -(-envs // (SHARDS_PER_SLOT * self.slots))

    def shard_runner(self, job: "RunJob") -> "ShardRunFunction":
        """Returns what runs shards of ``job`` as tasks."""
        # A worker sees the GPUs that it was given, and no other.
        device = "cuda:0" if self.gpus else "cpu"
        options = {"num_cpus": self.cores, "num_gpus": self.gpus, "memory": self.memory, "max_retries": 0}
        task = self.ray.remote(**options)(run_shard)

        def run(remaining: Iterable[Shard], commits: Mapping[int, Commit], bar: ProgressBar) -> dict[str, str]:
            folder = str(job.folder.resolve())
            # A worker trusts the files that this process has run, and no others.
            arguments = (folder, device, self.cores, job.checkpoint_interval, job.laws)
            return _TaskScheduler(self.ray, task, arguments, list(remaining), bar, Path(folder)).run()

        return run


def one_device(device: str | Sequence[str], source: str) -> str:
    """Returns the device on which one shard would run here.

    Raises:
        ExperimentError: If shards cannot be given such a device.
    """
    if not isinstance(device, str) or device not in DEVICES:
        given = device if isinstance(device, str) else list(device)
        allowed = ", ".join(map(repr, DEVICES))
        problem = (
            f"device must be one of {allowed} with Ray, which gives each shard a GPU of its own, got {given!r}"
        )
        raise ExperimentError(source, [problem])
    return "cuda:0" if device == "cuda" else device


def connect(address: bool | str, device: str, source: str) -> ClusterResources:
    """Starts Ray on this machine, or joins the cluster with an address.

    Args:
        address: That of the cluster; ``True``: this machine.
        device: What ``one_device`` returned: ``"auto"`` takes GPUs where the cluster has any.
        source: What to call the experiment in messages.

    Raises:
        ExperimentError: If Ray is not installed, there is no such cluster, or it lacks the GPUs that were asked
            for.
    """
    try:
        import ray
    except ImportError:
        raise ExperimentError(
            "--ray", ["Ray is not installed: pip install 'warpcontact[ray]'; a run on one machine needs none"]
        ) from None
    if not ray.is_initialized():
        options: dict[str, Any] = {"include_dashboard": False, "log_to_driver": False, "logging_level": "error"}
        if isinstance(address, str):
            options["address"] = address
        else:
            # Nobody else is to reach what was started for this run alone.
            options |= {
                "address": "local",
                "_node_ip_address": "127.0.0.1",
                "object_store_memory": OBJECT_STORE_MEMORY,
            }
        try:
            if isinstance(address, str):
                _check_reachable(address)
            ray.init(**options)
        except SystemExit:  # as Ray answers a request to end while it starts
            raise KeyboardInterrupt from None
        except (OSError, ValueError, RuntimeError) as error:
            raise ExperimentError(f"--ray {address}", [f"no cluster of Ray can be reached: {error}"]) from None
    return cluster_resources(ray, device, source)


def cluster_resources(ray: Any, device: str, source: str) -> ClusterResources:
    """Returns how many shards run at once on the cluster that ``ray`` has joined, see ``connect``."""
    total = ray.cluster_resources()
    gpus, cores = int(total.get("GPU", 0)), max(1, int(total.get("CPU", 1)))
    if device == "cuda:0" and not gpus:
        raise ExperimentError(source, ["device must be 'auto' or 'cpu' with Ray here: the cluster has no GPU"])
    if gpus and device != "cpu":
        return ClusterResources(ray, cores=max(1, min(MAX_CORES, cores // gpus)), gpus=1, slots=gpus)
    nodes = max(1, sum(1 for node in ray.nodes() if node["Alive"]))
    cores_per_shard = max(1, min(MAX_CORES, cores // nodes // 2))
    return ClusterResources(ray, cores=cores_per_shard, gpus=0, slots=max(1, cores // cores_per_shard))


def _check_reachable(address: str) -> None:
    """Raises ``OSError`` if nobody answers at an address: Ray itself would try for many minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_TIMEOUT).close()


class _TaskScheduler:
    """Submits a task for each shard, waits for them, and submits again those that were lost or failed."""

    def __init__(
        self,
        ray: Any,
        task: Any,
        arguments: tuple[Any, ...],
        remaining: list[Shard],
        bar: ProgressBar,
        folder: Path,
    ) -> None:
        self.ray = ray
        self.task = task
        self.arguments = arguments
        self.remaining = remaining
        self.bar = bar
        self.folder = folder
        self.tries = dict.fromkeys((shard.number for shard in remaining), 0)
        self.running: dict[Any, Shard] = {}

    def run(self) -> dict[str, str]:
        from warpcontact.experiment.execute import ATTEMPTS

        failed = {}
        for shard in self.remaining:
            self._submit(shard)
        try:
            while self.running:
                done, _ = self.ray.wait(list(self.running), num_returns=1, timeout=INTERVAL)
                self._update_progress()
                for reference in done:
                    shard = self.running.pop(reference)
                    message = self._message(reference, shard)
                    if message is None:
                        continue
                    if self.tries[shard.number] < ATTEMPTS:
                        text = f"{shard.name} is tried again: {message}"
                        warnings.warn(RunWarning(text, WarningLevel.NOTE), stacklevel=2)
                        self._submit(shard)
                    else:
                        failed[shard.name] = message
        except BaseException:
            self._stop()
            raise
        return failed

    def _submit(self, shard: Shard) -> None:
        self.tries[shard.number] += 1
        self.running[self.task.remote(shard.number, *self.arguments)] = shard

    def _message(self, reference: Any, shard: Shard) -> str | None:
        """Returns why the task of a shard failed; ``None``: it did not, and what it has to say is said.

        Raises:
            OSError: If results cannot be written: a full disk is full for all.
            RunDataError: If what was committed was changed.
            QuarantineError: If an environment failed, and the policy is to raise.
        """
        try:
            frozen, labels = self.ray.get(reference)
        except self.ray.exceptions.RayTaskError as error:
            cause = error.cause
            if isinstance(cause, OSError | RunDataError | QuarantineError):
                raise cause from None
            return f"{type(cause).__name__}: {cause}"
        except self.ray.exceptions.RayError as error:
            return f"its worker was lost: {str(error).splitlines()[0]}"
        for label in labels:
            level, text = split_label(label)
            warnings.warn(RunWarning(text, level), stacklevel=4)
        self.bar.finish(shard, frozen)
        return None

    def _update_progress(self) -> None:
        shards = {shard.number: shard for shard in self.running.values()}
        for number, content in read_progress(self.folder):
            if number in shards:
                self.bar.update(shards[number], int(content["steps"]))

    def _stop(self) -> None:
        """Lets all tasks commit what they have done, and end."""
        for reference in self.running:
            self.ray.cancel(reference, force=False)
        deadline = time.monotonic() + 60.0
        while self.running and time.monotonic() < deadline:
            done, _ = self.ray.wait(list(self.running), num_returns=1, timeout=INTERVAL)
            for reference in done:
                del self.running[reference]


#: What runs the shards of a folder in this process, which may be given several.
_RUNNERS: dict[tuple[str, str, str, int, float], "ShardRunner"] = {}


def run_shard(
    number: int, folder: str, device: str, threads: int, checkpoint_interval: float, laws: tuple[str, ...]
) -> tuple[int, list[str]]:
    """Runs a shard of the run in a folder, in a worker.

    Returns:
        Number of its frozen environments, and its warnings behind their levels.
    """
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from warpcontact.experiment.store import Shards

    path = Path(folder)
    summary = read_summary(path) or {}
    key = (folder, str(summary.get("started")), device, threads, checkpoint_interval)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if key not in _RUNNERS:
            _RUNNERS.clear()
            _RUNNERS[key] = _runner(path, summary, device, threads, checkpoint_interval, laws)
        runner = _RUNNERS[key]
        shard = Shards(summary["envs"], summary["shard"])[number]
        commit = runner.ledger.commits().get(number)
        runner.ledger.recover(shard, commit or Commit(number))
        commit = runner.run(shard, commit)
    kinds = UserWarning | RuntimeWarning
    return commit.frozen, [labeled(one.message) for one in caught if issubclass(one.category, kinds)]


def _runner(
    folder: Path,
    summary: Mapping[str, Any],
    device: str,
    threads: int,
    checkpoint_interval: float,
    laws: tuple[str, ...],
) -> "ShardRunner":
    from warpcontact.experiment.run import open_run
    from warpcontact.experiment.shards import SeriesSchedule, ShardRunner

    experiment = open_run(folder, trust=laws).experiment
    settings = experiment.settings
    model = experiment.draft(device).build(summary["shard"])
    frames = SeriesSchedule.of(settings, summary["block"])
    return ShardRunner(model, settings, experiment.design, frames, folder, checkpoint_interval, threads)
