"""Page of a run or recording: plays the records of one environment and follows a run in progress."""

import math
import time

import numpy as np

from warpcontact.drawing.drawing import Drawing
from warpcontact.visualize.viewer.environments import Picker
from warpcontact.visualize.viewer.page import LocalServer
from warpcontact.visualize.viewer.sources import Source
from warpcontact.visualize.viewer.viewer_thread import ViewerThread

#: Time between checks for newly committed data [s].
UPDATE_INTERVAL = 1.0


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
        self.picker = Picker(self, self._select_env)
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
