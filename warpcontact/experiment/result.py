"""The folder that a run fills: which folders it may use, and what it writes into them."""

import json
import os
import platform
import shutil
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpcontact._version import __version__
from warpcontact.experiment.catalogue import FileMesh
from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.schema import Settings
from warpcontact.health import Health
from warpcontact.recorder import Recording

RECORDING = "recording.zarr"
ANIMATION = "animation.usdc"
PICTURE = "picture.png"
EXPERIMENT = "experiment.toml"
SUMMARY = "run.json"

# What ``state`` in run.json may be. A run that was killed stays unfinished.
FINISHED = "finished"
UNFINISHED = "unfinished"
INTERRUPTED = "interrupted"

# Arrays are stored in pieces of about this size, each a range of environments [bytes].
CHUNK = 16 * 2**20


@dataclass(frozen=True)
class Run:
    """What a run left behind.

    Attributes:
        folder: Where the files are.
        files: Path of each file by what it is: experiment, recording, animation, picture, summary.
        recording: The readings (time, env, …), and the parameters that varied (env, …).
        health: Which environments turned non-finite.
        summary: Content of ``run.json``: versions, device, seed, times.
    """

    folder: Path
    files: dict[str, Path]
    recording: Recording
    health: Health
    summary: dict[str, Any]

    def __str__(self) -> str:
        s = self.summary
        rate = f"{s['env_steps_per_second']:.3g} environment steps per second"
        lines = [
            f"{s['name']}: {s['envs']} environments × {s['duration']:g} s in {s['steps']} steps of {s['dt']:g} s",
            f"{s['wall_time']:.1f} s on {s['device']}, {rate}",
            str(self.health),
            *(f"  {kind:<11} {path}" for kind, path in sorted(self.files.items())),
        ]
        return "\n".join(lines)


def check_folder(folder: Path, overwrite: bool) -> None:
    """Raises ``ExperimentError`` unless results may go into ``folder``.

    It may be new or empty, or hold a run that did not finish; with ``overwrite`` it may hold any earlier run.
    """
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise ExperimentError(str(folder), ["is not a folder"])
    if not any(folder.iterdir()):
        return
    summary = read_summary(folder)
    if summary is None:
        raise ExperimentError(
            str(folder), ["is not empty, and what is in it is no earlier run; choose a new folder"]
        )
    if _is_running(summary):
        raise ExperimentError(str(folder), [f"process {summary['process']} is running and writes there"])
    if not overwrite and summary.get("state") not in (UNFINISHED, INTERRUPTED):
        raise ExperimentError(
            str(folder), ["holds an earlier run; choose another folder, or overwrite it (--overwrite)"]
        )


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Returns the content of ``run.json``, or ``None`` if ``folder`` holds no run."""
    try:
        summary = json.loads((folder / SUMMARY).read_bytes())
        return summary if str(summary["program"]).startswith("warpcontact ") else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _is_running(summary: Mapping[str, Any]) -> bool:
    """Whether another process of this machine is, as far as one can tell, at work on the run."""
    process = summary.get("process")
    if summary.get("state") != UNFINISHED or summary.get("host") != platform.node() or os.name != "posix":
        return False
    if not isinstance(process, int) or process <= 0 or process == os.getpid():
        return False
    try:
        os.kill(process, 0)  # sends nothing
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return True


def clear_folder(folder: Path, keep: str = "") -> None:
    """Makes ``folder``, or removes the files of the earlier run in it, except ``keep``; others stay."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (RECORDING, ANIMATION, PICTURE, EXPERIMENT, SUMMARY):
        path = folder / name
        if name == keep:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def moved(settings: Settings, old: Path, new: Path) -> Settings:
    """Returns ``settings`` with the names of mesh files made relative to folder ``new`` instead of ``old``."""
    surfaces = []
    for surface in settings.surface:
        mesh = surface.mesh
        if isinstance(mesh, FileMesh) and not Path(mesh.file).is_absolute():
            target = (old / mesh.file).resolve()
            try:
                file = Path(os.path.relpath(target, new.resolve()))
            except ValueError:  # on another drive
                file = target
            mesh = mesh.model_copy(update={"file": file.as_posix()})
        surfaces.append(surface.model_copy(update={"mesh": mesh}))
    return settings.model_copy(update={"surface": tuple(surfaces)})


def write_recording(recording: Recording, path: Path) -> None:
    """Writes ``recording`` as a Zarr v3 group, which ``xarray.open_zarr`` reads."""
    encoding = {}
    for name, variable in recording.data_vars.items():
        row = variable.nbytes // max(1, variable.sizes["env"])
        envs = max(1, min(variable.sizes["env"], CHUNK // max(1, row)))
        chunks = tuple(envs if dim == "env" else size for dim, size in variable.sizes.items())
        encoding[name] = {"chunks": chunks}
    with warnings.catch_warnings():
        # All metadata in one place as well, where xarray looks for it first; others may pass over it.
        warnings.filterwarnings("ignore", message="Consolidated metadata", category=UserWarning)
        recording.to_zarr(path, mode="w-", zarr_format=3, consolidated=True, encoding=encoding)


def write_summary(path: Path, summary: Mapping[str, Any]) -> None:
    """Writes ``run.json``, by which a folder is known to hold a run."""
    content = {"program": f"warpcontact {__version__}", **summary}
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
