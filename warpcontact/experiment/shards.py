"""Runs shards of an experiment on one model.

For each shard, ``ShardRunner`` assigns the parameter values, steps the environments, records frames and outcomes,
and commits them to the store with checkpoints in between. A shard that was interrupted resumes from its last commit.
"""

import re
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.experiment.design import Design
from warpcontact.experiment.observation import make_simulation
from warpcontact.experiment.plan import blocks_at_once, recorded_parameters
from warpcontact.experiment.progress import ProgressFile
from warpcontact.experiment.records import COMMITS, ExpectedFiles, RunExtent, created_files, digest
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.store import CHECKPOINTS, Commit, Ledger, Shard, Staging
from warpcontact.files.run_folder import RunPath
from warpcontact.model.environments import Environments
from warpcontact.model.model_traits import CONTACT_NEEDS
from warpcontact.scene.contact_coupling import OUTCOMES
from warpcontact.stepping import checkpoint
from warpcontact.stepping.recorder import Recorder
from warpcontact.stepping.run_warnings import RunWarnings
from warpcontact.stepping.step_counts import frame_count, recorded_steps
from warpcontact.system.process import StopRequest, catch_interrupts
from warpcontact.validation.warning_levels import ContactWarning, RunWarning, WarningLevel

if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.stepping.recording import Recording

#: Number of attempts per shard.
ATTEMPTS = 3
# Largest share of the stepping time for checkpoints: large states are saved less often.
CHECKPOINT_SHARE = 0.05
# Steps of ``run_sample_steps``: the first step after a frame and later ones may use different kernels.
SAMPLE_STEPS = 2


class RunInterrupted(KeyboardInterrupt):
    """The run was interrupted by the user; the steps taken so far are committed."""


@dataclass(frozen=True)
class SeriesSchedule:
    """Schedule of the recorded frames of a run.

    Attributes:
        steps: Number of steps of the run.
        stride: Number of steps between frames.
        count: Number of frames, including that at the start; 0: no series are recorded.
        block: Frames per block, which are written together.
    """

    steps: int
    stride: int
    count: int
    block: int

    @classmethod
    def of(cls, settings: Settings, block: int) -> "SeriesSchedule":
        """Returns the schedule of an experiment, written in blocks of ``block`` frames."""
        steps, stride = recorded_steps(settings.duration, settings.record.every, settings.dt)
        if not settings.record.series:
            # One frame without sensors at the end: ``advance`` requires a frame, and yields chunks for progress.
            return cls(steps, steps, 0, 2)
        return cls(steps, stride, frame_count(steps, stride), block)

    def times(self, dt: float) -> Any:
        """Returns the times of all frames [s]."""
        return np.arange(self.count) * self.stride * dt


class ShardRunner:
    """Runs shards of an experiment on a model, one after another.

    Values and results of an environment do not depend on its shard. A last shard with fewer environments is filled up
    with copies of its last environment, whose results are dropped.

    Args:
        model: A model with as many environments as a shard.
        settings: The experiment, with all defaults.
        design: The varied parameters.
        frames: Schedule of the recorded frames.
        folder: Folder of the run, with its store.
        checkpoint_interval: Minimum time between checkpoints [s].
        threads: Number of CPU threads that step environments; ``None``: one per core.
    """

    def __init__(
        self,
        model: Environments,
        settings: Settings,
        design: Design,
        frames: SeriesSchedule,
        folder: Path,
        checkpoint_interval: float,
        threads: int | None = None,
    ) -> None:
        self.settings = settings
        self.design = design
        self.frames = frames
        self.folder = folder
        self.checkpoint_interval = checkpoint_interval
        self.threads = threads
        self.simulation = make_simulation(model, settings, threads)
        # ``_warn_once`` gives these warnings, once for each kind over all shards.
        self.simulation.warned_at_start = True
        self.ledger = Ledger(folder)
        self._warned: set[str] = set()

    @property
    def model(self) -> Environments:
        """The model."""
        return self.simulation.model

    def kernels(self) -> list[wp.Kernel]:
        """Returns the kernels of steps, frames and the initial check that run on the CPU, each once."""
        return self.simulation.step_kernels(self._evaluations())

    def _evaluations(self) -> list[frozenset[str]]:
        """Returns the needs of the frames and of the initial check."""
        evaluations = [frozenset(self.recorder().needs)]
        if self.simulation.evaluates_start:
            evaluations.append(CONTACT_NEEDS)
        return evaluations

    def warm_up(self) -> None:
        """Loads kernels and takes a step, so that the wall time of the run is that of stepping."""
        self.simulation.load_kernels(self._evaluations())
        self.simulation.step()
        self.simulation.reset()

    def run_sample_steps(self, shard: Shard) -> "Recording":
        """Takes two steps of ``shard`` with their frames as ``run`` does, without writing files.

        All kernels of steps, frames and outcomes are loaded afterwards.

        Returns:
            The recorded frames.
        """
        self.data_layouts()
        self.load_shard(shard)
        steps = min(self.frames.steps, SAMPLE_STEPS)
        recorder = self.recorder(steps + 1)
        recorder.start(self.simulation.frame_memory(recorder.needs))
        remarks = RunWarnings(self.model)
        self.simulation.check()
        stride = min(self.frames.stride, steps)
        for _ in self.simulation.advance(recorder, steps, stride, start=0.0, exclusive=True):
            pass
        self.outcome()
        self.events()
        remarks.new()
        self.frozen(shard)
        return recorder.finish({"dt": self.settings.dt, "integrator": self.settings.integrator.type})

    def load_shard(self, shard: Shard) -> None:
        """Assigns the parameter values of ``shard`` to the model and resets it to the initial state."""
        values = self.design.rows(shard.first, shard.stop)
        model = self.model
        missing = model.envs - shard.envs
        for name, rows in values.items():
            parsed = model.find_parameter(name).parse(rows, shard.envs)
            if missing and len(parsed) == shard.envs:
                parsed = np.concatenate([parsed, np.repeat(parsed[-1:], missing, axis=0)])
            model.assign(name, parsed)
        model.first_env = shard.first
        self.simulation.reset()

    def recorder(self, max_frames: int | None = None) -> Recorder:
        """Returns a recorder of frames, and of the parameters as they are assigned now.

        Args:
            max_frames: Number of frames; ``None``: blocks of frames.
        """
        record = self.settings.record
        sensors = record.sensors or () if record.series else ()
        varied = recorded_parameters(self.model, self.design.names, self.design.envs)
        frames = self.frames
        blocks = blocks_at_once(frames.count, frames.block) if max_frames is None else 1
        return Recorder(
            self.model,
            sensors,
            frames.block if max_frames is None else max_frames,
            poses=True,
            parameters=varied,
            series=record.series,
            blocks=blocks,
        )

    def data_layouts(self) -> "dict[str, xr.Dataset]":
        """Returns a data set of a shard for each group of the store, without frames; the values are arbitrary."""
        recorder = self.recorder()
        found = {"params": recorder.parameters(), "outcome": self.outcome()}
        if self.frames.count:
            found["series"] = recorder.series()
        events = self.events()
        return found if events is None else {**found, "events": events}

    def outcome(self) -> "xr.Dataset":
        """Returns the outcomes (env, …)."""
        model = self.model
        found = self.simulation.outcomes()
        for coupling in model.scene.contact_couplings:
            for key in OUTCOMES:
                name = f"{coupling.name}.{key}"
                sensor = model.find_sensor(name)
                notes = {"units": sensor.unit, "long_name": sensor.meaning}
                found[name] = ("env", model.sensor(name), notes)
        return found

    def events(self) -> "xr.Dataset | None":
        """Returns the events (env, event); ``None``: no events are recorded."""
        return None if self.settings.events is None else self.simulation.events()

    def run(
        self, shard: Shard, commit: Commit | None, progress: Callable[[int, int], None] | None = None
    ) -> Commit:
        """Runs ``shard`` from its last commit, or from the start if there is none.

        Args:
            shard: The shard.
            commit: Its last commit; ``None``: it has none.
            progress: Called about once per second with the number of steps taken by all environments of the shard,
                and the number of frozen ones.

        Returns:
            Its commit, which is finished.

        Raises:
            RunInterrupted: If the user pressed Ctrl-C; all steps until then are committed.
        """
        commit = Commit(shard.number) if commit is None else commit
        self.load_shard(shard)
        recorder = self.recorder()
        recorder.start(self.simulation.frame_memory(recorder.needs))
        # Made before the checkpoint is restored, so that problems before the checkpoint are included.
        remarks = RunWarnings(self.model)
        if commit.steps:
            commit = self._resume(shard, commit, recorder)
        self._warn_once(commit)
        progress_file = ProgressFile(self.folder, shard)

        def report(done: int) -> None:
            if progress_file.write(done) and progress is not None:
                progress(done, self.frozen(shard))

        try:
            with self.ledger.staging(shard, self.threads) as staging, catch_interrupts() as stop_request:
                done = _ShardAttempt(self, shard, commit, recorder, staging, remarks).run(stop_request, report)
                if stop_request.stop_requested:
                    raise RunInterrupted
                return done
        finally:
            progress_file.remove()

    def _resume(self, shard: Shard, commit: Commit, recorder: Recorder) -> Commit:
        """Restores the state of ``commit``; starts the shard again if its checkpoint is missing or invalid."""
        path = RunPath(self.folder) / CHECKPOINTS / str(commit.checkpoint)
        try:
            if commit.checkpoint_sha256 is not None and digest(path) != commit.checkpoint_sha256:
                raise checkpoint.CheckpointError(f"{path}: was changed since it was committed")
            arrays, header = checkpoint.read(path)
            own = self.checkpoint_origin(shard, commit.steps)
            if differing := {key: header.get(key) for key in own if header.get(key) != own[key]}:
                raise checkpoint.CheckpointError(f"{path}: must be of {own}, got {differing}")
            frames = {key.removeprefix("frame/"): a for key, a in arrays.items() if key.startswith("frame/")}
            times = arrays.get("times", np.zeros(0))
            self._check_pending(commit, frames, times, recorder)
            extent = RunExtent(self.settings.envs, self.model.envs, self.frames.steps)
            made = created_files(RunPath(self.folder) / COMMITS)
            if problem := ExpectedFiles(RunPath(self.folder), made, extent).problem(commit):
                raise checkpoint.CheckpointError(problem)
            checkpoint.restore(self.simulation, arrays)
        except (checkpoint.CheckpointError, FileNotFoundError) as error:
            warnings.warn(RunWarning(f"{shard.name} starts again: {error}", WarningLevel.NOTE), stacklevel=3)
            self.simulation.reset()
            return Commit(shard.number, wall_time=commit.wall_time)
        recorder.continue_from(frames, times)
        return commit

    def frozen(self, shard: Shard) -> int:
        """Returns the number of frozen environments of ``shard``."""
        return int((self.model.health().frozen < shard.envs).sum())

    def checkpoint_origin(self, shard: Shard, steps: int) -> dict[str, Any]:
        """Returns the header of a checkpoint, which must be equal when a run is resumed from it."""
        kinds = ["cuda" if device.is_cuda else "cpu" for device in self.model.devices]
        return {"shard": shard.number, "steps": steps, "devices": kinds, "warp": wp.config.version}

    def _check_pending(
        self, commit: Commit, frames: Mapping[str, Any], times: NDArray[Any], recorder: Recorder
    ) -> None:
        """Raises ``CheckpointError`` unless these are the frames that were recorded and not written by ``commit``."""
        own, steps = self.frames, commit.steps
        count = (steps // own.stride + 1 if own.count else 0) - commit.frames
        expected = {name: ((count, *values.shape[1:]), values.dtype) for name, values in recorder.frames().items()}
        found = {name: (values.shape, values.dtype) for name, values in frames.items()}
        fits = steps < own.steps and commit.frames % own.block == 0 and 0 <= count < own.block
        timed = times.dtype == np.float64 and times.shape == (count,) and bool(np.isfinite(times).all())
        if not fits or not timed or found != expected:
            path = self.folder / CHECKPOINTS / str(commit.checkpoint)
            done = f"{steps} of {own.steps} steps and {commit.frames} of {own.count} frames"
            raise checkpoint.CheckpointError(f"{path}: does not continue after {done}")

    def _warn_once(self, commit: Commit) -> None:
        """Gives the warnings of the initial check, except those given for earlier shards."""
        if commit.steps:
            return
        for sentence in self.simulation.check():
            kind = re.sub(r"[\d.,+-]+(e[+-]?\d+)?", "", sentence)
            if kind not in self._warned:
                warnings.warn(ContactWarning(sentence), stacklevel=3)
            self._warned.add(kind)


class _ShardAttempt:
    """One attempt to run a shard to the end."""

    def __init__(
        self,
        runner: ShardRunner,
        shard: Shard,
        commit: Commit,
        recorder: Recorder,
        staging: Staging,
        remarks: RunWarnings,
    ) -> None:
        self.runner = runner
        self.shard = shard
        self.commit = commit
        self.recorder = recorder
        self.staging = staging
        self.remarks = remarks
        self.started = time.perf_counter()
        self.earlier_wall_time = commit.wall_time
        self.last_save = self.started
        self.save_time = 0.0

    def run(self, stop_request: StopRequest, report: Callable[[int], None]) -> Commit:
        runner, frames, commit = self.runner, self.runner.frames, self.commit
        if not commit.steps:
            self.staging.write("params", _values(self.recorder.parameters()))
        taken = commit.frames + self.recorder.taken
        # Without series, the frame without sensors is not counted by the commit.
        taken = taken if frames.count else min(1, commit.steps)
        steps = frames.steps
        for done in runner.simulation.advance(
            self.recorder, steps, frames.stride, start=0.0, done=commit.steps, taken=taken, exclusive=True
        ):
            report(done)
            if frames.count and self.recorder.taken == frames.block:
                self._write_block()
            if done == steps:
                break
            if stop_request.stop_requested:
                self._save(done)
                raise RunInterrupted
            if self._due():
                self._save(done)
        return self._finish()

    def _write_block(self) -> None:
        """Writes the recorded frames in the background and starts the next block."""
        self.staging.write("series", self.recorder.frames(), self.commit.frames)
        self.commit.frames += self.recorder.taken
        self.recorder.rewind()

    def _due(self) -> bool:
        since = time.perf_counter() - self.last_save
        return since >= self.runner.checkpoint_interval and since >= self.save_time / CHECKPOINT_SHARE

    def _save(self, done: int) -> None:
        """Commits the steps taken so far, with a checkpoint."""
        begin = time.perf_counter()
        name = f"{self.shard.name}-{done:012d}.npz"
        arrays = checkpoint.state_of(self.runner.simulation)
        pending = self.recorder.taken if self.runner.frames.count else 0
        arrays |= {f"frame/{key}": values[:pending] for key, values in self.recorder.frames().items()}
        arrays["times"] = self.recorder.times[:pending]
        path = RunPath(self.runner.folder) / CHECKPOINTS / name
        checkpoint.write(path, arrays, self.runner.checkpoint_origin(self.shard, done))
        self.commit.steps, self.commit.checkpoint, self.commit.checkpoint_sha256 = done, name, digest(path)
        self._commit()
        self.last_save = time.perf_counter()
        self.save_time = self.last_save - begin

    def _finish(self) -> Commit:
        runner = self.runner
        if runner.frames.count and self.recorder.taken:
            self._write_block()
        self.staging.write("outcome", _values(runner.outcome()))
        events = runner.events()
        if events is not None:
            self.staging.write("events", _values(events))
        for warning in self.remarks.new():
            warnings.warn(warning, stacklevel=4)
        self.commit.frozen = runner.frozen(self.shard)
        self.commit.steps, self.commit.finished = runner.frames.steps, True
        self.commit.checkpoint = self.commit.checkpoint_sha256 = None
        self._commit()
        self.staging.remove()
        return self.commit

    def _commit(self) -> None:
        self.staging.wait()
        self.commit.wall_time = self.earlier_wall_time + time.perf_counter() - self.started
        if self.commit.empty is not None:
            self.commit.empty = sorted({*self.commit.empty, *self.staging.empty})
        self.runner.ledger.commit(self.shard, self.commit, self.staging.written)
        self.staging.clear()


def _values(data: "xr.Dataset") -> dict[str, NDArray[Any]]:
    """Returns the values of a data set by variable."""
    return {str(name): variable.values for name, variable in data.data_vars.items()}
