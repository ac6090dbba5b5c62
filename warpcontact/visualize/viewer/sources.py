"""Where a replay comes from: the folder of a run, finished or not, or a recording."""

from abc import ABC, abstractmethod
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.drawing.drawing import Drawing
from warpcontact.experiment.folder import SUMMARY
from warpcontact.experiment.records import COMMITS
from warpcontact.experiment.run import Run, open_run
from warpcontact.experiment.status import run_status
from warpcontact.experiment.trust import Trust
from warpcontact.files.run_folder import RunPath
from warpcontact.scene.scene import Scene
from warpcontact.scene.status import FailureCause
from warpcontact.visualize.viewer.values import rows_of, rows_of_parameters, value_text

Facts = dict[str, list[tuple[str, str]]]


class Source(ABC):
    """What is replayed.

    Attributes:
        name: What to call it.
        recording: Sensors and parameters, (time, env, …).
        scene: What ran.
    """

    name: str
    recording: xr.Dataset
    scene: Scene

    def refresh(self) -> bool:
        """Looks whether there is more by now; returns whether there is."""
        return False

    @property
    def state(self) -> str:
        """How far it is, in a few words; empty: it is whole."""
        return ""

    @property
    def envs(self) -> NDArray[np.int_]:
        """Numbers of the environments that there is something of."""
        return self.recording["env"].values

    @property
    @abstractmethod
    def frozen(self) -> dict[int, str]:
        """What became of the environments that failed, by their numbers."""

    @abstractmethod
    def facts(self, env: int) -> Facts:
        """Returns parameters and outcomes of an environment, by what they are; empty: they are not known yet."""

    def drawing(self, env: int) -> Drawing | None:
        """Returns what is seen of an environment over time; ``None``: there is no record of it yet.

        Raises:
            ValueError: If its poses were not recorded.
        """
        env_data = self.recording.sel(env=[env])
        poses = [f"{body.name}.position" for body in self.scene.bodies if f"{body.name}.position" in env_data]
        if poses:
            # Records that are not committed yet are NaN, from some time on.
            places = env_data[poses[0]].values
            known = np.isfinite(places).reshape(len(places), -1).all(axis=1)
            count = len(known) if known.all() else int(known.argmin())
            if not count:
                return None
            env_data = env_data.isel(time=slice(0, count))
        return Drawing.of(env_data, self.scene, [env])


class RecordingSource(Source):
    """A recording in memory, as ``Simulation.run`` returns it.

    Raises:
        ValueError: If it does not know its scene, or lacks the dimension of environments.
    """

    def __init__(self, recording: xr.Dataset) -> None:
        scene = getattr(recording, "scene", None)
        if not isinstance(scene, Scene):
            raise ValueError(
                "the recording does not know its scene (xarray operations drop it): view the whole one"
            )
        self.name = "recording"
        self.recording = recording
        self.scene = scene

    @property
    def frozen(self) -> dict[int, str]:
        """The environments that failed."""
        return {int(env): "frozen" for env in self.recording.attrs.get("frozen_environments", ())}

    def facts(self, env: int) -> Facts:
        """Returns the parameters of an environment."""
        env_data = self.recording.sel(env=env)
        return {"Parameters": rows_of_parameters(env_data.drop_dims("time"))}


class RunSource(Source):
    """A folder of a run; what is committed meanwhile is found by ``refresh``.

    Args:
        folder: The folder.
        scene: What ran; ``None``: as the folder says.
        trust: As for ``open_run``.

    Raises:
        ExperimentError: If it holds no run.
        RunDataError: If what was committed is not there.
        ValueError: If nothing was recorded over time.
    """

    def __init__(self, folder: str | PathLike[str], scene: Scene | None = None, trust: Trust = False) -> None:
        self.folder = Path(folder)
        self._last_signature = self._signature()
        self._open(open_run(folder, trust=trust), scene)

    def _open(self, run: Run, scene: Scene | None) -> None:
        # To read the scene takes longer than the rest.
        self.run = replace(run, _scene=scene)
        self.scene = self.run.scene
        self.name = str(run.summary["name"])
        self.recording = self.run.recording
        self._table = self.run.table()
        self._frozen = _frozen_texts(self.run)
        self._state = run_status(self.folder)

    def _signature(self) -> tuple[tuple[str, int, int], ...]:
        """Returns what changes when anything is committed."""
        commits = RunPath(self.folder) / COMMITS
        found = []
        for path in (*(commits / name for name in commits.names()), RunPath(self.folder) / SUMMARY):
            known = path.status()
            if known is not None:
                found.append((path.name, known.st_mtime_ns, known.st_size))
        return tuple(found)

    def refresh(self) -> bool:
        """Opens the folder anew if anything was committed; returns whether it was."""
        if self._state.state == "finished":
            return False
        signature = self._signature()
        if signature == self._last_signature:
            # What runs and does not commit yet tells how far it is all the same.
            self._state = run_status(self.folder)
            return False
        self._open(open_run(self.folder, trust=self.run._trust), self.scene)
        self._last_signature = signature
        return True

    @property
    def state(self) -> str:
        """How far the run is."""
        status = self._state
        if status.state == "finished":
            return "finished"
        done, committed = (steps / status.total for steps in (status.running_steps, status.env_steps))
        return f"{status.state}: {done:.0%} done, {committed:.0%} committed"

    @property
    def frozen(self) -> dict[int, str]:
        """The environments that failed, of those that are finished: why, and when."""
        return self._frozen

    def facts(self, env: int) -> Facts:
        """Returns outcomes and parameters of an environment."""
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
