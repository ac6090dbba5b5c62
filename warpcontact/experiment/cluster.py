"""Runs shards as Ray tasks, on this machine or on a cluster that shares the run folder.

Ray starts a task where enough memory is free, and reports tasks that were lost. Results are in the folder, so only the
shard of a lost task is run again, from its last commit.
"""

import socket
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.progress import INTERVAL, ProgressBar, read_progress
from warpcontact.experiment.shards import ATTEMPTS
from warpcontact.experiment.store import Commit, RunDataError, Shard
from warpcontact.model.quarantine import QuarantineError
from warpcontact.storage.memory_estimate import USABLE_FRACTION, MemoryShortage, env_count_text
from warpcontact.validation.number_format import format_bytes
from warpcontact.validation.warning_levels import RunWarning, WarningLevel, split_label

if TYPE_CHECKING:
    from warpcontact.experiment.execute import RunJob, ShardRunFunction
    from warpcontact.experiment.plan import Plan

# Largest number of cores per shard on the CPU: further cores are used better by more shards.
MAX_CORES = 4
# Time limit for a connection to a cluster [s].
CONNECT_TIMEOUT = 10.0
# Shards per slot, so that the slots finish at about the same time.
SHARDS_PER_SLOT = 4
# Memory of Python, the libraries and the kernels in a worker process [bytes]; measured.
WORKER_MEMORY = 450 * 2**20
# Memory that Ray reserves for return values of tasks [bytes]. They are small, and the default is 30 % of the memory.
OBJECT_STORE_MEMORY = 128 * 2**20
#: Values of ``device`` that are allowed with Ray.
DEVICES = ("auto", "cpu", "cuda", "cuda:0")


@dataclass(frozen=True)
class ClusterResources:
    """Resources of a cluster.

    Attributes:
        ray: The module ``ray``.
        cores: Cores per shard.
        gpus: GPUs per shard, 0 or 1.
        slots: Number of shards that run concurrently.
        memory: Memory per shard on its machine [bytes]; 0: not yet determined.
    """

    ray: Any
    cores: int
    gpus: int
    slots: int
    memory: int = 0

    def limit_by_memory(self, plan: "Plan", on_stage: Callable[[str], None]) -> "ClusterResources":
        """Returns a copy with at most as many slots as shards fit into memory.

        Args:
            plan: Plan of the run.
            on_stage: Called with a message if there are fewer slots.

        Raises:
            MemoryShortage: If a shard does not fit on any machine.
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
            message = (
                f"--ray: {one}, and a machine has at most {format_bytes(largest_memory)}; use a smaller shard"
            )
            raise MemoryShortage(message, shard_memory, largest_memory)
        # Remaining cores of several machines cannot be combined to a slot.
        slots = min(slots, self.slots)
        if fitting_slots < min(slots, plan.shards):
            on_stage(f"running {fitting_slots} shards concurrently instead of {slots}, limited by memory: {one}")
        return replace(self, slots=min(self.slots, fitting_slots), memory=shard_memory)

    def default_shard_size(self, envs: int) -> int:
        """Returns the default maximum number of environments per shard, of ``envs``."""
        return -(-envs // (SHARDS_PER_SLOT * self.slots))

    def shard_runner(self, job: "RunJob", run_shard: Callable[..., tuple[int, list[str]]]) -> "ShardRunFunction":
        """Returns a function that runs shards of ``job`` as tasks, with the function ``run_shard`` of ``execute``."""
        # Ray makes only the assigned GPU visible to a worker.
        device = "cuda:0" if self.gpus else "cpu"
        options = {"num_cpus": self.cores, "num_gpus": self.gpus, "memory": self.memory, "max_retries": 0}
        task = self.ray.remote(**options)(run_shard)

        def run(remaining: Iterable[Shard], commits: Mapping[int, Commit], bar: ProgressBar) -> dict[str, str]:
            folder = str(job.folder.resolve())
            # A worker trusts only the law files that this process has executed.
            arguments = (folder, device, self.cores, job.checkpoint_interval, job.laws)
            return _TaskScheduler(self.ray, task, arguments, list(remaining), bar, Path(folder)).run()

        return run


def one_device(device: str | Sequence[str], source: str) -> str:
    """Returns the device on which each shard runs.

    Raises:
        ExperimentError: If the device is not allowed with Ray.
    """
    if not isinstance(device, str) or device not in DEVICES:
        given = device if isinstance(device, str) else list(device)
        allowed = ", ".join(map(repr, DEVICES))
        problem = f"device must be one of {allowed} with Ray, which assigns one GPU to each shard, got {given!r}"
        raise ExperimentError(source, [problem])
    return "cuda:0" if device == "cuda" else device


def connect(address: bool | str, device: str, source: str) -> ClusterResources:
    """Starts Ray on this machine, or connects to a cluster.

    Args:
        address: Address of the cluster; ``True``: this machine.
        device: Result of ``one_device``; ``"auto"``: GPUs if the cluster has any.
        source: Name of the experiment in messages.

    Raises:
        ExperimentError: If Ray is not installed, the cluster cannot be reached, or it has no GPU and one is requested.
    """
    try:
        import ray
    except ImportError:
        raise ExperimentError(
            "--ray", ["Ray is not installed: pip install 'warpcontact[ray]'; runs on one machine do not need it"]
        ) from None
    if not ray.is_initialized():
        options: dict[str, Any] = {"include_dashboard": False, "log_to_driver": False, "logging_level": "error"}
        if isinstance(address, str):
            options["address"] = address
        else:
            # Bind to the loopback interface: only this process uses the local cluster.
            options |= {
                "address": "local",
                "_node_ip_address": "127.0.0.1",
                "object_store_memory": OBJECT_STORE_MEMORY,
            }
        try:
            if isinstance(address, str):
                _check_reachable(address)
            ray.init(**options)
        except SystemExit:  # Ray exits if SIGINT arrives while it starts
            raise KeyboardInterrupt from None
        except (OSError, ValueError, RuntimeError) as error:
            raise ExperimentError(f"--ray {address}", [f"no cluster of Ray can be reached: {error}"]) from None
    return cluster_resources(ray, device, source)


def cluster_resources(ray: Any, device: str, source: str) -> ClusterResources:
    """Returns the slots of the cluster that ``ray`` is connected to, see ``connect``."""
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
    """Raises ``OSError`` if an address does not accept connections; Ray itself would retry for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_TIMEOUT).close()


class _TaskScheduler:
    """Submits a task for each shard, waits for them, and resubmits those that were lost or failed."""

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
                        text = f"{shard.name} is retried: {message}"
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
        """Returns the error message of the task of a shard; ``None``: it succeeded, and its warnings are given.

        Raises:
            OSError: If results cannot be written: a full disk fails for all shards.
            RunDataError: If what was committed was changed.
            QuarantineError: If an environment failed with the policy ``"raise"``.
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
        """Cancels all tasks and waits up to 60 s until they have committed their progress."""
        for reference in self.running:
            self.ray.cancel(reference, force=False)
        deadline = time.monotonic() + 60.0
        while self.running and time.monotonic() < deadline:
            done, _ = self.ray.wait(list(self.running), num_returns=1, timeout=INTERVAL)
            for reference in done:
                del self.running[reference]
