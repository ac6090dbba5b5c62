"""One run: from the built environments to the files in the folder of results."""

import datetime
import hashlib
import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpcontact._version import __version__
from warpcontact.checks import Array
from warpcontact.contact_coupling_report import CouplingReport, joined
from warpcontact.environments import Environments
from warpcontact.experiment import result
from warpcontact.experiment.batches import Batches, opened
from warpcontact.experiment.notices import Notices
from warpcontact.experiment.observation import watching
from warpcontact.experiment.plan import Plan
from warpcontact.experiment.result import Copy, Run
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.toml import to_toml
from warpcontact.health import Health
from warpcontact.recorder import Recording
from warpcontact.simulation import Simulation


@dataclass(frozen=True)
class Job:
    """What is to be done with the environments of an experiment.

    Attributes:
        settings: The experiment, with all defaults.
        varied: Values of the parameters that vary, of all environments.
        plan: How many environments are in a batch, and how many batches there are.
        copy: What repeats the run.
        folder: Where the results go.
        progress: Whether to show a progress bar; ``None``: on runs of over a second, in a terminal.
        say: Called when a stage that may take long begins.
        notices: Receives warnings.
    """

    settings: Settings
    varied: Mapping[str, Array]
    plan: Plan
    copy: Copy
    folder: Path
    progress: bool | None
    say: Callable[[str], None]
    notices: Notices


def execute(model: Environments, job: Job) -> Run:
    """Runs ``job`` and writes the results; if interrupted, only ``run.json`` is left, which says so.

    Args:
        model: The environments of a batch, built, with values that do not vary.
        job: What to do.

    Raises:
        ValueError: If a value does not fit into the precision of the device, before anything is removed.
    """
    settings = job.settings
    simulation = Simulation(
        model,
        dt=settings.dt,
        integrator=settings.integrator.make(),
        crossing_steps=settings.crossing_steps,
        **watching(settings),
    )
    run: _AtOnce | _InBatches = (_AtOnce if job.plan.batches == 1 else _InBatches)(simulation, job)
    result.clear_folder(job.folder)
    summary = _first_summary(model, job)
    try:
        return _execute(simulation, run, job, summary)
    except KeyboardInterrupt:
        result.write_summary(job.folder / result.SUMMARY, summary | {"state": result.INTERRUPTED})
        result.clear_folder(job.folder, keep=result.SUMMARY)
        raise


def _first_summary(model: Environments, job: Job) -> dict[str, Any]:
    settings = job.settings
    laws = {name: hashlib.sha256(content).hexdigest() for name, content in job.copy.files.items()}
    return {
        "state": result.UNFINISHED,
        "process": os.getpid(),
        "name": settings.name,
        "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {
            "warpcontact": __version__,
            "warp": wp.config.version,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "machine": platform.platform(),
        "host": platform.node(),
        "device": ", ".join(str(one) if one.is_cpu else f"{one} ({one.name})" for one in model.devices),
        "precision": settings.precision,
        "seed": settings.seed,
        "envs": settings.envs,
        "batches": job.plan.batches,
        "batch": job.plan.batch,
        "dt": settings.dt,
        "integrator": settings.integrator.type,
        result.LAW_FILES: laws,
    }


def _execute(simulation: Simulation, run: "_AtOnce | _InBatches", job: Job, summary: dict[str, Any]) -> Run:
    settings, folder = job.settings, job.folder
    files = {"experiment": folder / result.EXPERIMENT, "summary": folder / result.SUMMARY}
    result.write_summary(files["summary"], summary)
    comment = f"The experiment as warpcontact {__version__} ran it, with all defaults."
    files["experiment"].write_text(to_toml(job.copy.settings, comment), encoding="utf-8")
    for name, content in job.copy.files.items():
        files[name] = folder / name
        files[name].write_bytes(content)

    job.say(f"compiling for {', '.join(map(str, simulation.model.devices))}")
    simulation.step()  # compiles what is not in the cache; the time of the run is then that of stepping
    simulation.reset()
    files["recording"] = folder / result.RECORDING
    recording, health, wall_time = run(files["recording"])
    reports = run.reports()
    _show(recording, settings, list(job.varied), folder, files)
    summary = summary | {
        "state": result.FINISHED,
        "duration": float(f"{simulation.time:.12g}"),  # a sum of steps
        "steps": simulation.steps,
        "wall_time": wall_time,
        "env_steps_per_second": settings.envs * simulation.steps / wall_time,
        "frozen_environments": health.frozen.tolist(),
        "contact_couplings": {report.name: str(report).split("\n") for report in reports},
        "warnings": job.notices.lines,
    }
    result.write_summary(files["summary"], summary)
    return Run(folder=folder, files=files, recording=recording, health=health, reports=reports, summary=summary)


class _AtOnce:
    """Runs all environments together; called, returns the recording, their health, and the time it took [s]."""

    def __init__(self, simulation: Simulation, job: Job) -> None:
        self.simulation, self.job = simulation, job
        for name, values in job.varied.items():
            simulation.model[name] = values

    def __call__(self, path: Path) -> tuple[Recording, Health, float]:
        job, settings = self.job, self.job.settings
        job.say("running")
        start = time.perf_counter()
        recording = self.simulation.run(
            settings.duration,
            settings.record.readings or (),
            settings.record.every,
            parameters=list(job.varied),
            progress=job.progress,
        )
        wall_time = time.perf_counter() - start
        recording.attrs |= {"name": settings.name, "seed": settings.seed}
        job.say("writing")
        result.write_recording(recording, path)
        return recording, self.simulation.model.health(), wall_time

    def reports(self) -> tuple[CouplingReport, ...]:
        """Returns what became of the contact couplings."""
        model = self.simulation.model
        return tuple(coupling.report(model) for coupling in model.scene.contact_couplings)


class _InBatches:
    """The same, one batch after the other."""

    def __init__(self, simulation: Simulation, job: Job) -> None:
        self.simulation, self.job = simulation, job
        self.batches = Batches(simulation, job.plan, job.settings, job.varied)
        # All of them, so that values that do not fit are found now; the first one last.
        for number in reversed(range(job.plan.batches)):
            self.batches.take(number)

    def __call__(self, path: Path) -> tuple[Recording, Health, float]:
        plan = self.job.plan
        self.job.say(f"running {plan.batches} batches of {plan.batch} environments")
        self.batches.run(path, self.job.progress)
        self.job.say("writing")
        return opened(path, self.simulation.model.scene), self.batches.health, self.batches.wall_time

    def reports(self) -> tuple[CouplingReport, ...]:
        """Returns what became of the contact couplings, of all batches."""
        return tuple(joined(of_batches) for of_batches in zip(*self.batches.reports, strict=True))


def _show(
    recording: Recording, settings: Settings, varied: list[str], folder: Path, files: dict[str, Path]
) -> None:
    """Writes what shows the recording."""
    from warpcontact.experiment.picture import write_picture
    from warpcontact.usd import export_usd

    usd_envs = min(settings.output.usd_envs, settings.envs)
    if usd_envs:
        files["animation"] = folder / result.ANIMATION
        export_usd(recording, files["animation"], envs=range(usd_envs))
    files["picture"] = folder / result.PICTURE
    write_picture(files["picture"], recording, settings.name, varied)
