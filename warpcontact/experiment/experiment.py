"""The class ``Experiment``: a validated experiment file, which can be planned, built and run."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpcontact.building.model import Model, SplitModel
from warpcontact.building.plan import ModelPlan, plan_model
from warpcontact.building.scene import Scene
from warpcontact.experiment.assemble import FileCache, SceneBuilder, check_build
from warpcontact.experiment.catalogue import FileMesh
from warpcontact.experiment.design import Design
from warpcontact.experiment.errors import ExperimentError, Problems
from warpcontact.experiment.observation import check_monitors, default_interval, default_sensors, monitor_arguments
from warpcontact.experiment.parser import ExperimentParts, apply_overrides, load_toml, read_settings
from warpcontact.experiment.plan import Plan, TimeEstimate, estimate_time, find_disk, make_plan, recording_size
from warpcontact.experiment.sampling import Sobol
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.user_code import Trust, UserFiles
from warpcontact.experiment.variation import Variation, truncated
from warpcontact.forces.nonsmooth.sensors import is_nonsmooth_sensor, sensor_hint
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.names import stored_name
from warpcontact.model.environments import Environments
from warpcontact.stepping.integrators.base import formulas_of
from warpcontact.stepping.simulation import Simulation
from warpcontact.stepping.step_counts import whole_steps
from warpcontact.storage.memory_estimate import env_count_text
from warpcontact.system import process
from warpcontact.validation.warning_levels import RunWarning

if TYPE_CHECKING:
    from warpcontact.experiment.progress import WarningLog
    from warpcontact.experiment.run import Run

#: Default time between checkpoints [s].
CHECKPOINT = 60.0


@explain_keywords_of
class Experiment:
    """A scene, the design of its parameters, a duration and the recorded sensors, fully validated.

    Args:
        content: Content of an experiment file, as nested dictionaries and lists.
        folder: Folder to which the names of mesh files and law files are relative.
        source: Name of the experiment in messages.
        on_stage: Called with a short description before a stage that may take long, and before a law file of the
            user is executed.
        trust: Whether to execute law files of a run folder that no run of this user wrote there; or the SHA-256 of
            those that may be executed.

    Attributes:
        settings: All settings, with defaults filled in.

    Raises:
        ExperimentError: If the experiment is invalid; the message lists all problems with their keys.
    """

    def __init__(
        self,
        content: Mapping[str, Any],
        folder: str | PathLike[str] = ".",
        *,
        source: str = "experiment",
        on_stage: Callable[[str], None] | None = None,
        trust: Trust = False,
    ) -> None:
        self.folder = Path(folder)
        self.source = source
        self._file_cache = FileCache()
        self._user_files = UserFiles(self.folder, on_stage or _ignore_stage, trust)
        self._check(content)

    def __repr__(self) -> str:
        s = self.settings
        return f"<Experiment {s.name}: {env_count_text(s.envs)} × {s.duration:g} s, dt = {s.dt:g} s>"

    @classmethod
    def from_toml(
        cls,
        path: str | PathLike[str],
        *,
        changes: Iterable[str] = (),
        on_stage: Callable[[str], None] | None = None,
        trust: Trust = False,
    ) -> "Experiment":
        """Reads an experiment file; names of other files in it are relative to its folder.

        Args:
            path: The file.
            changes: Overrides of entries of the file, such as ``'body[0].mass=2.0'``,
                ``'material.rubber.law.stiffness=1e6'`` or ``'variation."ball.mass"={ uniform = [1, 2] }'``.
            on_stage: As for the class.
            trust: As for the class.

        Raises:
            ExperimentError: If the file cannot be read or is not valid TOML (with line and column), a change names no
                entry, or the experiment is invalid; the message lists all problems with their keys.
            TypeError: If ``changes`` is a string.
        """
        if isinstance(changes, str):
            raise TypeError(f"changes must be a list of texts PATH=VALUE, got the string {changes!r}")
        path = Path(path)
        return cls(read_content(path, changes), path.parent, source=str(path), on_stage=on_stage, trust=trust)

    @classmethod
    def from_dict(
        cls,
        content: Mapping[str, Any],
        folder: str | PathLike[str] = ".",
        *,
        on_stage: Callable[[str], None] | None = None,
        trust: Trust = False,
    ) -> "Experiment":
        """Returns an experiment from a dictionary with the form of an experiment file; arguments as for the class.

        Raises:
            ExperimentError: If the experiment is invalid; the message lists all problems with their keys.
        """
        return cls(content, folder, on_stage=on_stage, trust=trust)

    def scene(self) -> Scene:
        """Returns a new scene of this experiment."""
        problems = Problems()
        scene = SceneBuilder(ExperimentParts.from_settings(self.settings), self.folder, self._file_cache).scene(
            problems
        )
        problems.raise_if_any(self.source)
        return scene

    def model(self, envs: int | None = None, device: str | Sequence[str] = "auto") -> Model | SplitModel:
        """Builds the environments, each with its own values of the varied parameters.

        Args:
            envs: Number of environments; ``None``: that of the experiment.
            device: ``"cpu"``, ``"cuda:0"``, …; ``"auto"``: one GPU if available; ``"cuda"``: all GPUs; or a list of
                devices over which the environments are split.

        Raises:
            ExperimentError: If the device does not exist, or a value is out of range.
            MemoryError: If the environments do not fit into memory; ``run`` uses shards in that case.
        """
        with self._user_files.named_errors():
            return self.changed(envs=envs)._build(device)

    def changed(self, *, envs: int | None = None, duration: float | None = None) -> "Experiment":
        """Returns the experiment with another number of environments or duration [s].

        Raises:
            ExperimentError: If the changed experiment is invalid.
        """
        changes = {key: v for key, v in (("envs", envs), ("duration", duration)) if v is not None}
        if not changes:
            return self
        content = self._given.model_dump(exclude_none=True) | changes
        if duration is not None and self._given.record.every == default_interval(self._given):
            content["record"].pop("every")  # the saved copy of an experiment states the default interval
        if isinstance(envs, int):
            shorter = truncated(self._given.variation, envs)
            content["variation"] = {name: entry.model_dump(exclude_none=True) for name, entry in shorter.items()}
        other = Experiment.__new__(Experiment)
        other.folder, other.source = self.folder, self.source
        other._file_cache, other._user_files = self._file_cache, self._user_files
        other._check(content)
        return other

    def run(
        self,
        out: str | PathLike[str],
        *,
        envs: int | None = None,
        device: str | Sequence[str] = "auto",
        duration: float | None = None,
        overwrite: bool = False,
        resume: bool = False,
        ray: bool | str = False,
        progress: bool | None = None,
        shard: int | None = None,
        threads: int | None = None,
        checkpoint: float = CHECKPOINT,
        on_stage: Callable[[str], None] | None = None,
        on_warning: Callable[[str], None] | None = None,
    ) -> "Run":
        """Runs the experiment and writes the results into a folder.

        The folder receives the results (``data.zarr``), a picture, an animation, the complete ``experiment.toml``
        that repeats the run, copies of law files, and ``run.json`` with versions and times. If a run is interrupted
        for any reason, committed results are preserved, and ``resume`` continues to bitwise identical results.

        Args:
            out: The folder; created if it does not exist.
            envs: Number of environments; ``None``: that of the experiment.
            device: ``"cpu"``, ``"cuda:0"``, …; ``"auto"``: one GPU if available; ``"cuda"``: all GPUs; or a list of
                devices over which the environments are split.
            duration: Simulated time [s]; ``None``: that of the experiment.
            overwrite: Whether to replace the files of an earlier run in the folder.
            resume: Whether to resume the run in the folder, which must be of the same experiment.
            ray: Whether to run shards as Ray tasks, on this machine or on the cluster with this address.
            progress: Whether to show a progress bar; ``None``: on runs of over a second, in a terminal.
            shard: Maximum number of environments per shard, which are run and committed together; ``None``: as many as
                fit into memory; with ``resume``, it must be the earlier number or ``None``. Does not change results.
            threads: Number of CPU threads that step environments; ``None``: one per core.
            checkpoint: Time between checkpoints of a shard [s]; 0: as often as possible.
            on_stage: Called with a short description before a stage that may take long.
            on_warning: Called with each warning of a mesh file or of the simulation, prefixed with its level
                (``caution: …``), instead of Python's ``warnings``. ``run.json`` lists the warnings in both cases.

        Returns:
            The run. Some of its shards may have failed, see ``run.summary["failed"]``.

        Raises:
            ExperimentError: If the folder holds a finished run or other files; with ``resume``, if it holds no run of
                this experiment or has another shard size; if the device does not exist, or a value is out of range.
            MemoryError: If ``shard`` environments, or a single one, do not fit into memory.
            KeyboardInterrupt: If Ctrl-C was pressed or SIGTERM received; the steps taken so far are committed.
            OSError: If the results cannot be written; committed results are preserved.
        """
        # Imported here, because validation does not need these modules.
        from warpcontact.experiment import cluster
        from warpcontact.experiment import folder as files_of
        from warpcontact.experiment.execute import (
            RunJob,
            all_finished,
            check_resumable,
            run_in_process,
            run_remaining,
            run_shard,
            start,
        )
        from warpcontact.experiment.experiment_copy import copy_experiment
        from warpcontact.experiment.progress import WarningLog
        from warpcontact.system.process import terminate_as_interrupt

        _check_shard(shard, self.source)
        _check_threads_and_checkpoint(threads, checkpoint, self.source)
        folder = Path(out)
        # Before stages that may take long.
        files_of.check_usable(folder, overwrite=overwrite, resume=resume)
        experiment = self.changed(envs=envs, duration=duration)
        copy = copy_experiment(experiment.settings, experiment.folder, folder, experiment._user_files)
        warning_log = WarningLog(on_warning)
        report_stage = on_stage or _ignore_stage
        with (
            warning_log.collect_warnings(),
            experiment._user_files.named_errors(),
            contextlib.ExitStack() as exit_stack,
        ):
            exit_stack.enter_context(terminate_as_interrupt())
            if ray:
                device = cluster.one_device(device, experiment.source)
            summary = None
            if resume:
                if folder.is_dir():
                    exit_stack.enter_context(files_of.write_lock(folder))
                summary = files_of.check_started(folder)
                _check_same_shard(shard, summary, folder)
            else:
                files_of.check_replaced(folder, copy.files)
            experiment._report_meshes(warning_log)
            experiment._warn_about_sampling(warning_log)
            draft = experiment.draft(device)
            # If all shards are finished, only the picture and the animation are missing.
            done = summary is not None and all_finished(folder, summary)
            resources = cluster.connect(ray, str(device), experiment.source) if ray and not done else None
            if resources is not None:
                exit_stack.enter_context(terminate_as_interrupt())  # Ray has replaced the signal handler
            if summary is not None:
                shard = None if done else summary["shard"]
            elif resources is not None and shard is None:
                shard = resources.default_shard_size(experiment.settings.envs)
            plan = make_plan(draft, experiment._size, experiment.settings, experiment.design, shard)
            if not done:
                plan.require()
            if summary is not None:
                plan = plan.resumed(summary)
            if resources is not None:
                resources = resources.limit_by_memory(plan, report_stage)
            job = RunJob(
                settings=experiment.settings,
                scene=experiment.scene(),
                design=experiment.design,
                plan=plan,
                copy=copy,
                folder=folder,
                progress=progress,
                on_stage=report_stage,
                warning_log=warning_log,
                checkpoint_interval=checkpoint,
                threads=threads,
            )
            if summary is not None:
                check_resumable(summary, job)
            if done:
                return run_remaining(job, lambda remaining, commits, bar: {})
            if resources is not None and summary is not None:
                return run_remaining(job, resources.shard_runner(job, run_shard))
            report_stage(f"building {plan.shard} environments")
            runner = job.runner(draft.build(plan.shard))
            if summary is None:
                start(runner, job, exit_stack)
            if resources is not None:
                del runner, draft  # frees memory for the workers
                return run_remaining(job, resources.shard_runner(job, run_shard))
            return run_remaining(job, run_in_process(runner, job))

    def _report_meshes(self, warning_log: "WarningLog") -> None:
        for i, surface in enumerate(self.settings.surface):
            for mesh in surface.meshes.values():
                if isinstance(mesh, FileMesh):
                    warning_log.add_mesh(mesh.file, self._file_cache.meshes[f"surface[{i}]", mesh].report)

    def _warn_about_sampling(self, warning_log: "WarningLog") -> None:
        if isinstance(self.design.sampler, Sobol) and (envs := self.settings.envs) & (envs - 1):
            below = 1 << envs.bit_length() - 1
            text = (
                f"sampling.method = 'sobol' with {envs} environments: Sobol' points fill their space evenly if "
                f"there is a power of two of them; nearest: {below} and {2 * below}"
            )
            warning_log.add(RunWarning(text))

    def plan(
        self,
        *,
        envs: int | None = None,
        device: str | Sequence[str] = "auto",
        duration: float | None = None,
        shard: int | None = None,
        out: str | PathLike[str] | None = None,
    ) -> Plan:
        """Returns the memory, disk space and shards of a run, without running it.

        Arguments and errors are those of ``run``, except that ``shard`` of the plan is 0 if not even one environment
        fits. With ``out``, which need not exist, the plan includes the free space on the disk of that folder.
        """
        _check_shard(shard, self.source)
        with self._user_files.named_errors():
            changed = self.changed(envs=envs, duration=duration)
            plan = make_plan(changed.draft(device), changed._size, changed.settings, changed.design, shard)
        if out is None:
            return plan
        return dataclasses.replace(plan, disk=find_disk(Path(out)))

    def probe(self, *, device: str | Sequence[str] = "auto", shard: int | None = None) -> TimeEstimate:
        """Steps at most ``shard`` environments for a few seconds; returns an estimate of the duration of a run."""
        with self._user_files.named_errors():
            return estimate_time(self.draft(device), self.settings, self.design, shard or self.settings.envs)

    def draft(self, device: str | Sequence[str] = "auto") -> ModelPlan:
        """Returns the plan of a model on ``device`` for any number of environments, with the values of the scene."""
        try:
            return plan_model(self.scene(), device, self.settings.precision, self._file_cache.take_query_meshes())
        except ValueError as error:
            raise ExperimentError(self.source, [str(error)]) from None

    def _build(self, device: str | Sequence[str]) -> Model | SplitModel:
        """Builds all environments on ``device``."""
        model = self.draft(device).build(self.settings.envs)
        for name, values in self.design.rows(0, self.settings.envs).items():
            model[name] = values
        return model

    def _check(self, content: Mapping[str, Any]) -> None:
        """Sets the validated settings of ``content``, or raises ``ExperimentError`` with all problems."""
        problems = Problems()
        parts = read_settings(content, self._user_files, problems)
        if not content.get("body") and not content.get("bodies"):
            problems.add("body", "is missing: an experiment needs a [[body]]")
            parts.unnamed.add("body")
        # The garbage collector is paused: ``check_build`` creates kernels, which are permanent.
        with process.gc_paused():
            model = check_build(parts, self.folder, self._file_cache, problems)
        if model is not None:
            self._check_with(model, parts, problems)
        problems.raise_if_any(self.source)

    def _check_with(self, model: Environments, parts: ExperimentParts, problems: Problems) -> None:
        """Checks settings that refer to parameters and sensors of the model, and fills in its defaults."""
        present = set(model.scene.element_names())

        def is_invalid(name: str) -> bool:
            """Whether ``name`` is, or may be, of an element with reported problems."""
            element = name.partition(".")[0]
            return element not in present and parts.may_refer_to(element)

        settings = parts.settings
        seed = 0 if settings is None else settings.seed
        varied = Variation(parts.variation, model, parts.envs, seed, self.folder, problems, is_invalid)
        method, correlation = (settings.sampling.method, settings.correlation) if settings else ("random", ())
        self.design: Design = varied.design(method, correlation)
        if settings is None:
            return
        steps = self._check_integrator(model, settings, problems, is_invalid)
        for i, name in enumerate(settings.record.sensors or ()):
            if not steps and is_nonsmooth_sensor(name):
                continue
            if stored_name(name) not in model.sensor_names and not is_invalid(name):
                hint = sensor_hint(name, model.sensor_names, model.scene)
                problems.add(f"record.sensors[{i}]", f"must be the name of a sensor, got {name!r}{hint}")
        every = self._interval(model, settings, problems)
        self._given = settings
        sensors = tuple(dict.fromkeys(map(stored_name, settings.record.sensors or default_sensors(model))))
        record = settings.record.model_copy(update={"every": every, "sensors": sensors})
        self.settings: Settings = settings.model_copy(update={"record": record})
        if not problems:
            self._size = recording_size(model, sensors, self.design.names, settings)

    @staticmethod
    def _check_integrator(
        model: Environments, settings: Settings, problems: Problems, is_invalid: Callable[[str], bool]
    ) -> bool:
        """Checks the integrator, the sensors of its contacts, and the monitors; returns whether all are valid."""
        before = len(problems.lines)
        if any(line.startswith("integrator") for line in problems.lines):
            return False
        available = list(formulas_of(model.scene))
        for i, name in enumerate(settings.integrator.compliant or ()):
            if name not in available and not is_invalid(name):
                problems.add_unknown_name(f"integrator.compliant[{i}]", name, "contact", available)
        if len(problems.lines) > before:
            return False
        integrator = settings.integrator.make()
        try:
            Simulation(model, settings.dt, integrator)
        except ValueError as error:
            problems.add("integrator", f": {error}")
            return False
        check_monitors(model, integrator, settings, problems, is_invalid)
        if not problems:
            try:
                Simulation(model, settings.dt, integrator, **monitor_arguments(settings))
            except TypeError as error:  # from a user-defined outcome
                problems.add("outcome", f": {error}")
        return len(problems.lines) == before

    @staticmethod
    def _interval(model: Environments, settings: Settings, problems: Problems) -> float:
        """Returns the time between frames [s]."""
        every = settings.record.every
        if every is None:
            return default_interval(settings)
        if every > settings.duration:
            problems.add("record.every", f"must be at most the duration, {settings.duration:g} s, got {every:g} s")
            return every
        try:
            whole_steps("record.every", every, settings.dt, exact=True)
        except ValueError as error:
            problems.add("record.every", str(error).removeprefix("record.every "))
        return every


def read_content(path: Path, changes: Iterable[str]) -> dict[str, Any]:
    """Returns the content of an experiment file with a default name and with ``changes``, without validation."""
    return apply_overrides({"name": path.stem} | load_toml(path), changes)


def _check_shard(shard: object, source: str) -> None:
    """Raises ``ExperimentError`` unless ``shard`` is a number of environments, or ``None``."""
    is_integer = isinstance(shard, int) and not isinstance(shard, bool)
    if shard is not None and not (is_integer and shard >= 1):  # type: ignore[operator]
        raise ExperimentError(source, [f"shard must be a whole number of at least 1, got {shard!r}"])


def _check_same_shard(shard: int | None, summary: Mapping[str, Any], folder: Path) -> None:
    """Raises ``ExperimentError`` unless ``shard`` is that of the run with ``summary``, or ``None``."""
    stored = summary["shard"]
    if shard is not None and min(shard, summary["envs"]) != stored:
        raise ExperimentError(
            str(folder),
            [f"holds a run with another shard size: shard is {stored} there, {shard} here; omit it to resume"],
        )


def _check_threads_and_checkpoint(threads: object, checkpoint: object, source: str) -> None:
    """Raises ``ExperimentError`` unless ``threads`` is a positive integer or ``None``, and ``checkpoint`` a time."""
    is_integer = isinstance(threads, int) and not isinstance(threads, bool)
    if threads is not None and not (is_integer and threads >= 1):  # type: ignore[operator]
        raise ExperimentError(source, [f"threads must be a whole number of at least 1, got {threads!r}"])
    number = isinstance(checkpoint, int | float) and not isinstance(checkpoint, bool)
    if not (number and checkpoint >= 0.0):  # type: ignore[operator]
        raise ExperimentError(source, [f"checkpoint must be a time of at least 0 s, got {checkpoint!r}"])


def _ignore_stage(stage: str) -> None:
    pass
