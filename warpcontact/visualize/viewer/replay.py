"""Page of a run or recording: plays the records of one environment and follows a run in progress."""

import math
import time
from abc import ABC, abstractmethod
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.building.scene import Scene
from warpcontact.drawing.drawing import Drawing, drawing_of
from warpcontact.experiment.folder import SUMMARY
from warpcontact.experiment.progress import run_status
from warpcontact.experiment.records import COMMITS
from warpcontact.experiment.run import Run, open_run
from warpcontact.experiment.user_code import Trust
from warpcontact.files.run_folder import RunPath
from warpcontact.scene.status import FailureCause
from warpcontact.visualize.viewer.page import EnvironmentSelector, LocalServer, ViewerThread
from warpcontact.visualize.viewer.values import rows_of, rows_of_parameters, value_text

Facts = dict[str, list[tuple[str, str]]]

#: Time between checks for newly committed data [s].
UPDATE_INTERVAL = 1.0


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
        return drawing_of(env_data, self.scene, [env])


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


class Replay(ViewerThread):
    """Replays a run or a recording.

    Args:
        server: Server of the page.
        source: Run or recording.
        speed: Simulated time per wall-clock time.

    Attributes:
        source: Run or recording.
        record: Index of the record shown.
    """

    def __init__(self, server: LocalServer, source: Source, speed: float) -> None:
        super().__init__(server, speed)
        self.source = source
        self.record = 0
        self._clock = 0.0
        self._drawing: Drawing | None = None
        self._last_update = 0.0

    def add_panel(self) -> None:
        """Adds all controls and displays to the page."""
        gui = self.server.gui
        self.add_time()
        self.time_input = self.on_change(gui.add_slider("Time [s]", 0.0, 1.0, 1.0, 0.0), self._seek)
        self._steps = gui.add_button_group("Record", ("First", "Back", "On", "Last"))
        self._steps.on_click(lambda event: self.post(lambda: self._step_through(event.target.value)))
        self.picker = EnvironmentSelector(self, self._select_env)
        self.add_display_options()
        self._facts = {}
        for name in ("Outcomes", "Parameters"):
            with gui.add_folder(name):
                self._facts[name] = gui.add_html("")

    def begin(self) -> None:
        """Shows the first environment."""
        self._update_environments()

    def _update_environments(self) -> None:
        """Updates the available environments; selects the first one if none is selected."""
        frozen = np.array(sorted(self.source.frozen), dtype=np.int_)
        self.picker.set_environments(self.source.envs, frozen)
        if self.picker.env is None and len(self.source.envs):
            self.picker.pick(int(self.source.envs[0]))
            self._frame_bodies()
        self._show_state()

    def _select_env(self, env: int) -> None:
        """Shows another environment at the same time."""
        self._drawing = self.source.drawing(env)
        self.stage.largest_pressure = 0.0
        self._write_facts(env)
        self._set_time_range(None)
        if self._drawing is not None:
            self.stage.follow(self._drawing, self.record)

    def _write_facts(self, env: int) -> None:
        facts = self.source.facts(env)
        for name, handle in self._facts.items():
            if facts.get(name):
                self.write_table(handle, facts[name])
            else:
                self.write(handle, "not available yet" if name in facts else "none")
        self.picker.describe(self.source.frozen.get(env, ""))

    def _set_time_range(self, end: float | None) -> None:
        """Fits the time slider to the records; at ``end``, the previous last time [s], moves on to the new last."""
        if self._drawing is None:
            self.stage.clear()
            self._show_state()
            return
        times = self._drawing.times
        slider = self.time_input
        slider.min, slider.max = float(times[0]), float(times[-1])
        step = float(f"{np.diff(times).min():.6g}") if len(times) > 1 else 1.0
        # The page rounds to this number of decimals. Two more than the step needs keep times distinct.
        slider.step, slider.precision = step, max(0, 2 - math.floor(math.log10(step)))
        if end is not None and self._clock >= end and not self.playing:
            self._clock = float(times[-1])
        self._clock = float(np.clip(self._clock, times[0], times[-1]))
        self.redraw()

    def tick(self, seconds: float) -> None:
        """Advances the time by ``seconds`` · ``speed`` and checks for newly committed data."""
        if time.monotonic() - self._last_update > UPDATE_INTERVAL:
            self._last_update = time.monotonic()
            self._load_committed()
        drawing = self._drawing
        if self.playing and drawing is not None:
            self._clock = min(self._clock + self.speed * seconds, float(drawing.times[-1]))
            self.redraw()
            if self._clock >= drawing.times[-1] and self.source.state in ("", "finished"):
                self.pause()

    def _load_committed(self) -> None:
        """Loads newly committed data, if any, and updates the page."""
        if not self.source.refresh():
            self._show_state()
            return
        end = None if self._drawing is None else float(self._drawing.times[-1])
        self._update_environments()
        if self.picker.env is not None:
            self._drawing = self.source.drawing(self.picker.env)
            self._write_facts(self.picker.env)
            self._set_time_range(end)

    def redraw(self) -> None:
        """Draws the record at the current time."""
        drawing = self._drawing
        if drawing is None:
            return
        # The last record that is not later. The slack allows for the rounded times of the slider.
        slack = 1.0e-6 * max(1.0e-9, float(drawing.times[-1] - drawing.times[0]))
        self.record = max(0, int(np.searchsorted(drawing.times, self._clock + slack, side="right")) - 1)
        self.draw(drawing, self.record, drawing.force_scale)
        self.time_input.value = self._clock
        self._show_state()

    def _show_state(self) -> None:
        drawing = self._drawing
        where = "no committed data yet"
        if drawing is not None:
            where = f"record {self.record + 1} of {len(drawing.times)}, at {drawing.times[self.record]:.6g} s"
        self.show_status("\n".join(filter(None, (self.source.state, where))))

    def _seek(self, seconds: float) -> None:
        """Moves to the record nearest to a time [s]."""
        if self._drawing is not None:
            times = self._drawing.times
            self._clock = float(times[int(np.abs(times - seconds).argmin())])
            self.redraw()

    def _step_through(self, where: str) -> None:
        if self._drawing is None:
            return
        times = self._drawing.times
        places = {"First": 0, "Back": self.record - 1, "On": self.record + 1, "Last": len(times) - 1}
        self.pause()
        self._seek(float(times[int(np.clip(places[where], 0, len(times) - 1))]))

    def play(self) -> None:
        """Starts playing, from the first record if the last one is shown and the run is finished."""
        drawing = self._drawing
        if drawing is not None and self._clock >= drawing.times[-1] and self.source.state in ("", "finished"):
            self._clock = float(drawing.times[0])
            self.redraw()
        super().play()

    def current_drawing(self) -> tuple[Drawing, int] | None:
        """Returns the current drawing and the index of the record shown, or ``None``."""
        return None if self._drawing is None else (self._drawing, self.record)
