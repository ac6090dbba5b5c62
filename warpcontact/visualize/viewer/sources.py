"""Sources of a replay: the folder of a finished or running run, or a recording in memory."""

from abc import ABC, abstractmethod
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.building.scene import Scene
from warpcontact.drawing.drawing import Drawing
from warpcontact.experiment.folder import SUMMARY
from warpcontact.experiment.records import COMMITS
from warpcontact.experiment.run import Run, open_run
from warpcontact.experiment.status import run_status
from warpcontact.experiment.trust import Trust
from warpcontact.files.run_folder import RunPath
from warpcontact.scene.status import FailureCause
from warpcontact.visualize.viewer.values import rows_of, rows_of_parameters, value_text

Facts = dict[str, list[tuple[str, str]]]


class Source(ABC):
    """Source of a replay.

    Attributes:
        name: Name shown on the page.
        recording: Sensors and parameters, (time, env, …).
        scene: Scene of the recording.
    """

    name: str
    recording: xr.Dataset
    scene: Scene

    def refresh(self) -> bool:
        """Loads newly committed data; returns whether there were any."""
        return False

    @property
    def state(self) -> str:
        """Progress as text; empty if the source is complete."""
        return ""

    @property
    def envs(self) -> NDArray[np.int_]:
        """Numbers of the environments with data."""
        return self.recording["env"].values

    @property
    @abstractmethod
    def frozen(self) -> dict[int, str]:
        """Description of each frozen environment, by its number."""

    @abstractmethod
    def facts(self, env: int) -> Facts:
        """Returns tables of parameters and outcomes of an environment, by title; an empty table: not available yet."""

    def drawing(self, env: int) -> Drawing | None:
        """Returns the drawing of an environment over time, or ``None`` if it has no records yet.

        Raises:
            ValueError: If poses of its bodies were not recorded.
        """
        env_data = self.recording.sel(env=[env])
        poses = [f"{body.name}.position" for body in self.scene.bodies if f"{body.name}.position" in env_data]
        if poses:
            # Records that are not committed yet are NaN, from some time on.
            positions = env_data[poses[0]].values
            finite = np.isfinite(positions).reshape(len(positions), -1).all(axis=1)
            count = len(finite) if finite.all() else int(finite.argmin())
            if not count:
                return None
            env_data = env_data.isel(time=slice(0, count))
        return Drawing.of(env_data, self.scene, [env])


class RecordingSource(Source):
    """A recording in memory, as ``Simulation.run`` returns it.

    Raises:
        ValueError: If the recording has lost its scene, for example by an xarray operation.
    """

    def __init__(self, recording: xr.Dataset) -> None:
        scene = getattr(recording, "scene", None)
        if not isinstance(scene, Scene):
            raise ValueError("the recording has no scene (xarray operations drop it): pass the original recording")
        self.name = "recording"
        self.recording = recording
        self.scene = scene

    @property
    def frozen(self) -> dict[int, str]:
        """Frozen environments, by number."""
        return {int(env): "frozen" for env in self.recording.attrs.get("frozen_environments", ())}

    def facts(self, env: int) -> Facts:
        """Returns the parameters of an environment."""
        env_data = self.recording.sel(env=env)
        return {"Parameters": rows_of_parameters(env_data.drop_dims("time"))}


class RunSource(Source):
    """Folder of a run; ``refresh`` loads data committed since.

    Args:
        folder: Folder of the run.
        scene: Scene of the run; ``None``: read from the folder.
        trust: As for ``open_run``.

    Raises:
        ExperimentError: If the folder contains no run.
        RunDataError: If committed data are missing.
        ValueError: If no sensors were recorded over time.
    """

    def __init__(self, folder: str | PathLike[str], scene: Scene | None = None, trust: Trust = False) -> None:
        self.folder = Path(folder)
        self._last_signature = self._signature()
        self._open(open_run(folder, trust=trust), scene)

    def _open(self, run: Run, scene: Scene | None) -> None:
        # Reusing the scene saves most of the time, which is spent on reading it.
        self.run = replace(run, _scene=scene)
        self.scene = self.run.scene
        self.name = str(run.summary["name"])
        self.recording = self.run.recording
        self._table = self.run.table()
        self._frozen = _frozen_texts(self.run)
        self._state = run_status(self.folder)

    def _signature(self) -> tuple[tuple[str, int, int], ...]:
        """Returns name, modification time [ns] and size [bytes] of the commit files, which change with each commit."""
        commits = RunPath(self.folder) / COMMITS
        found = []
        for path in (*(commits / name for name in commits.names()), RunPath(self.folder) / SUMMARY):
            status = path.status()
            if status is not None:
                found.append((path.name, status.st_mtime_ns, status.st_size))
        return tuple(found)

    def refresh(self) -> bool:
        """Opens the folder again if data were committed since; returns whether there were any."""
        if self._state.state == "finished":
            return False
        signature = self._signature()
        if signature == self._last_signature:
            # A run reports its progress between commits as well.
            self._state = run_status(self.folder)
            return False
        self._open(open_run(self.folder, trust=self.run._trust), self.scene)
        self._last_signature = signature
        return True

    @property
    def state(self) -> str:
        """State of the run, with the fractions done and committed."""
        status = self._state
        if status.state == "finished":
            return "finished"
        done, committed = (steps / status.total for steps in (status.running_steps, status.env_steps))
        return f"{status.state}: {done:.0%} done, {committed:.0%} committed"

    @property
    def frozen(self) -> dict[int, str]:
        """Cause and time of failure of each finished environment that is frozen, by number."""
        return self._frozen

    def facts(self, env: int) -> Facts:
        """Returns outcomes and parameters of an environment, as far as they are committed."""
        found: Facts = {"Outcomes": [], "Parameters": []}
        parameters = [str(name) for name in self.run.params.data_vars]
        if env in self._table["env"].values:
            env_data = self._table.sel(env=env)
            found["Outcomes"] = rows_of(
                env_data[[name for name in env_data.data_vars if str(name) not in parameters]]
            )
        if env in self.run.params["env"].values:
            found["Parameters"] = rows_of_parameters(self.run.params.sel(env=env))
        return found


def _frozen_texts(run: Run) -> dict[int, str]:
    health = run.health
    return {
        int(env): f"frozen: {FailureCause(cause).name}, at {value_text(float(time))} s"
        for env, cause, time in zip(health.frozen, health.causes, health.times, strict=True)
    }
