"""One run: from the built environments to the files in the folder of results."""

import datetime
import hashlib
import os
import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpcontact._version import __version__
from warpcontact.checks import Array
from warpcontact.environments import Environments
from warpcontact.experiment import result
from warpcontact.experiment.notices import Notices
from warpcontact.experiment.result import Copy, Run
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.toml import to_toml
from warpcontact.simulation import Simulation


def execute(
    model: Environments,
    settings: Settings,
    varied: Mapping[str, Array],
    copy: Copy,
    folder: Path,
    progress: bool | None,
    say: Callable[[str], None],
    notices: Notices,
) -> Run:
    """Runs ``model`` and writes the results; if interrupted, only ``run.json`` is left, which says so.

    Args:
        model: The environments, built.
        settings: What to do with them, with all defaults.
        varied: Values of the parameters that vary.
        copy: What repeats the run.
        folder: Where the results go.
        progress: Whether to show a progress bar; ``None``: on runs of over a second, in a terminal.
        say: Called when a stage that may take long begins.
        notices: Receives warnings.
    """
    result.clear_folder(folder)
    summary = _first_summary(model, settings, copy)
    try:
        return _execute(model, settings, varied, copy, folder, progress, say, notices, summary)
    except KeyboardInterrupt:
        result.write_summary(folder / result.SUMMARY, summary | {"state": result.INTERRUPTED})
        result.clear_folder(folder, keep=result.SUMMARY)
        raise


def _first_summary(model: Environments, settings: Settings, copy: Copy) -> dict[str, Any]:
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
        "dt": settings.dt,
        result.LAW_FILES: {name: hashlib.sha256(content).hexdigest() for name, content in copy.files.items()},
    }


def _execute(
    model: Environments,
    settings: Settings,
    varied: Mapping[str, Array],
    copy: Copy,
    folder: Path,
    progress: bool | None,
    say: Callable[[str], None],
    notices: Notices,
    summary: dict[str, Any],
) -> Run:
    files = {"experiment": folder / result.EXPERIMENT, "summary": folder / result.SUMMARY}
    result.write_summary(files["summary"], summary)
    comment = f"The experiment as warpcontact {__version__} ran it, with all defaults."
    files["experiment"].write_text(to_toml(copy.settings, comment), encoding="utf-8")
    for name, content in copy.files.items():
        files[name] = folder / name
        files[name].write_bytes(content)

    simulation = Simulation(model, dt=settings.dt, crossing_steps=settings.crossing_steps)
    say(f"compiling for {', '.join(map(str, model.devices))}")
    simulation.step()  # compiles what is not in the cache; the time of the run is then that of stepping
    simulation.reset()
    say("running")
    start = time.perf_counter()
    recording = simulation.run(
        settings.duration,
        settings.record.readings or (),
        settings.record.every,
        parameters=list(varied),
        progress=progress,
    )
    wall_time = time.perf_counter() - start
    recording.attrs |= {"name": settings.name, "seed": settings.seed}

    say("writing")
    _write(recording, settings, list(varied), folder, files)
    health = model.health()
    summary = summary | {
        "state": result.FINISHED,
        "duration": float(f"{simulation.time:.12g}"),  # a sum of steps
        "steps": simulation.steps,
        "wall_time": wall_time,
        "env_steps_per_second": settings.envs * simulation.steps / wall_time,
        "frozen_environments": health.frozen.tolist(),
        "warnings": notices.lines,
    }
    result.write_summary(files["summary"], summary)
    return Run(folder=folder, files=files, recording=recording, health=health, summary=summary)


def _write(
    recording: result.Recording, settings: Settings, varied: list[str], folder: Path, files: dict[str, Path]
) -> None:
    from warpcontact.experiment.picture import write_picture
    from warpcontact.usd import export_usd

    files["recording"] = folder / result.RECORDING
    result.write_recording(recording, files["recording"])
    usd_envs = min(settings.output.usd_envs, settings.envs)
    if usd_envs:
        files["animation"] = folder / result.ANIMATION
        export_usd(recording, files["animation"], envs=range(usd_envs))
    files["picture"] = folder / result.PICTURE
    write_picture(files["picture"], recording, settings.name, varied)
