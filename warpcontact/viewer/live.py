"""The page of a simulation that steps while it is looked at, and whose parameters can be changed meanwhile."""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpcontact.experiment.defaults import default_sensors
from warpcontact.recorder import Recorder
from warpcontact.replay.drawing import Drawing
from warpcontact.simulation import Simulation
from warpcontact.status import FailureCause
from warpcontact.viewer.environments import Picker
from warpcontact.viewer.page import LocalServer
from warpcontact.viewer.parameters import Parameters
from warpcontact.viewer.show import PICTURE, Show
from warpcontact.viewer.values import rows_of, spoken

# What is recorded of each contact, to be drawn and read.
_OF_CONTACTS = ("gap", "normal_force", "normal", "point", "friction_force")
#: The part of the time from picture to picture that goes into steps.
STEPPING = 0.7
#: How much longer arrows become from picture to picture after a large force.
FADE = 1.02
# Of so many contacts sensors are written out.
_READ = 8
#: Time between looks at outcomes and at what failed [s].
LOOK = 0.5


class Live(Show):
    """Steps a simulation and shows one of its environments.

    Args:
        server: The server of the page.
        simulation: What is stepped; from now on by this alone.
        name: What to call it.
        speed: Simulated time to that on the wall.
        varied: Names of the parameters that are offered first.

    Attributes:
        simulation: What is stepped.
        rate: Simulated time to that on the wall, as of late; it falls behind ``speed`` where steps take longer.
    """

    def __init__(
        self, server: LocalServer, simulation: Simulation, name: str, speed: float, varied: Sequence[str] = ()
    ) -> None:
        super().__init__(server, speed)
        self.simulation = simulation
        self.name = name
        self.rate = 0.0
        self._varied = varied
        self._drawing: Drawing | None = None
        self._force_scale = np.inf
        self._owed = 0.0
        self._steps_per_second = 0.0
        self._looked = 0.0
        scene, names = simulation.model.scene, simulation.model.sensor_names
        pushing: list[Any] = [*scene.contacts, *scene.shape_contacts]
        self._read = list(dict.fromkeys([*default_sensors(simulation.model, far=True), *self._of_sets()]))
        drawn = [f"{one.name}.{key}" for one in pushing for key in _OF_CONTACTS]
        drawn += [f"{coupling.name}.status" for coupling in scene.couplings]
        self._recorder = Recorder(
            simulation.model, [name for name in [*self._read, *drawn] if name in names], frames=1, poses=True
        )

    def _of_sets(self) -> list[str]:
        """Returns gaps and forces of sets of contacts, of which an experiment records nothing unless asked."""
        contacts = [one for one in self.simulation.model.scene.contacts if not one.points.single]
        return [f"{one.name}.{key}" for one in contacts[:_READ] for key in ("gap", "normal_force")]

    def add_panel(self) -> None:
        """Puts all that can be read and done on the page."""
        gui = self.server.gui
        self.add_time()
        self.step_button = self.button("Step", self._step, hint="one time step of all environments")
        self._resets = gui.add_button_group("Reset", ("This one", "All"))
        self._resets.on_click(lambda event: self.do(lambda: self._reset(event.target.value)))
        self.picker = Picker(self, self._choose)
        self.add_looks()
        with gui.add_folder("Sensors"):
            self._sensors = gui.add_html("")
        self.parameters = Parameters(self, self.simulation.model, self._varied)
        self._outcomes = None
        if self.simulation.watch.outcomes or self.simulation.watch.stops:
            with gui.add_folder("Outcomes", expand_by_default=False):
                self._outcomes = gui.add_html("")
        self._notes = gui.add_html("")

    def begin(self) -> None:
        """Compiles what steps, and shows the start."""
        simulation = self.simulation
        self.say("compiling …")
        self._recorder.start()
        if simulation.model.at_start:
            self.write(self._notes, "\n".join(f"Caution: {sentence}" for sentence in simulation.check()))
            simulation.advised = True
            # Compiles; whoever made the simulation may have put it into another state than that at the start.
            with tempfile.TemporaryDirectory() as folder:
                state = Path(folder) / "state.npz"
                simulation.save(state)
                simulation.step()
                simulation.load(state)
        self._offer()
        self.picker.pick(0)
        self._look()

    def _offer(self) -> None:
        self._health = self.simulation.model.health()
        self.picker.offer(np.arange(self.simulation.model.envs), self._health.frozen)

    def _choose(self, env: int) -> None:
        self._force_scale = np.inf
        self._take()
        if self._drawing is not None:
            self.stage.aim(self._drawing, 0)
        self.parameters.show_env(env)
        self._describe()

    def _describe(self) -> None:
        """Tells what became of the environment, and its outcomes so far."""
        env, health = self.picker.env, self._health
        if env is None:
            return
        told = ""
        frozen = np.flatnonzero(health.frozen == env)
        if len(frozen):
            at, cause = health.times[frozen[0]], FailureCause(health.causes[frozen[0]])
            told = f"frozen: {cause.name}, at {spoken(float(at))} s"
        elif env in health.stopped:
            told = "stopped by a condition"
        self.picker.describe(told)
        if self._outcomes is not None:
            self.write_table(self._outcomes, rows_of(self.simulation.outcomes().isel(env=env)))

    def tick(self, seconds: float) -> None:
        """Steps as far as the time on the wall went, if steps are fast enough, and shows the state."""
        if self.playing:
            self._go_on(seconds)
        if time.monotonic() - self._looked > LOOK and self.picker.env is not None:
            self._looked = time.monotonic()
            self._offer()
            self._describe()

    def _go_on(self, seconds: float) -> None:
        simulation = self.simulation
        begin = time.perf_counter()
        before = simulation.steps
        self._owed += self.speed * seconds / simulation.dt
        # As many at once as take half of what is left of the time, as far as is known.
        while self._owed >= 1.0:
            left = STEPPING * PICTURE - (time.perf_counter() - begin)
            if left <= 0.0:
                # The machine is too slow for this speed: what it owes is let go.
                self._owed = 0.0
                break
            count = int(min(self._owed, max(1.0, 0.5 * left * self._steps_per_second)))
            start = time.perf_counter()
            simulation.step(count)
            self._finish_queued()
            self._steps_per_second = count / max(time.perf_counter() - start, 1.0e-6)
            self._owed -= count
        done = (simulation.steps - before) * simulation.dt
        # Of the last second or so.
        self.rate += min(1.0, 2.0 * seconds) * (done / max(seconds, 1.0e-6) - self.rate)
        self._take()

    def _finish_queued(self) -> None:
        """Waits for a GPU, which queues steps: the next count is by how long they take."""
        import warp as wp

        for device in self.simulation.model.devices:
            if device.is_cuda:
                wp.synchronize_device(device)

    def _take(self) -> None:
        """Looks at the state and draws it."""
        env = self.picker.env
        if env is None:
            return
        recorder = self._recorder
        recorder.rewind()
        recorder.take(self.simulation.time)
        recording = recorder.finish({})
        self._drawing = drawing = Drawing.of(recording, envs=[env])
        if any(touch.forces.any() for touch in drawing.touches):
            # Arrows are comparable over some seconds: the longest is of the largest force of late.
            self._force_scale = min(self._force_scale * FADE, drawing.force_scale)
        self.redraw()
        own = recording[self._read].isel(time=0).sel(env=env)
        self.write_table(self._sensors, rows_of(own))
        self._tell()

    def _tell(self) -> None:
        simulation = self.simulation
        paced = f", {self.rate:.3g} × real time" if self.playing else ""
        self.say(f"{self.name}\n{simulation.time:.6g} s, step {simulation.steps}{paced}")

    def redraw(self) -> None:
        """Draws the state that was taken last."""
        if self._drawing is not None:
            scale = self._force_scale if np.isfinite(self._force_scale) else self._drawing.force_scale
            self.draw(self._drawing, 0, scale)

    def _step(self) -> None:
        self.pause()
        self.tell("")
        self.simulation.step()
        self._take()

    def _reset(self, which: str) -> None:
        mask = None
        if which == "This one":
            mask = np.arange(self.simulation.model.envs) == self.picker.env
        self.simulation.reset(mask)
        self.tell("")
        self.refresh()

    def refresh(self) -> None:
        """Shows the state after it was changed other than by steps."""
        self._force_scale = np.inf
        self._take()
        self._offer()
        self._describe()

    def play(self) -> None:
        """Lets time go on."""
        self._owed, self.rate = 0.0, 0.0
        super().play()

    def pause(self) -> None:
        """Stops the time."""
        super().pause()
        self._tell()

    def drawn(self) -> tuple[Drawing, int] | None:
        """Returns what is seen, and the record of it."""
        return None if self._drawing is None else (self._drawing, 0)
