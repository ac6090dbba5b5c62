"""Page of a simulation that steps while it is shown and whose parameters can be changed meanwhile."""

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpcontact.drawing.drawing import Drawing, drawing_of
from warpcontact.experiment.observation import default_sensors
from warpcontact.model.environments import Environments
from warpcontact.scene.status import FailureCause
from warpcontact.stepping.recorder import Recorder
from warpcontact.stepping.simulation import Simulation
from warpcontact.visualize.viewer.page import FRAME_TIME, EnvironmentSelector, LocalServer, ViewerThread, shortened
from warpcontact.visualize.viewer.values import ParameterText, rows_of, value_text

#: Largest number of parameters with a permanent field; the others are chosen from a list.
MAX_FIELDS = 8

# Sensors recorded for each contact: drawn as arrows and listed as values.
_CONTACT_SENSORS = ("gap", "normal_force", "normal", "point", "point_force", "friction_force", "force", "center")
# Sensors of bodies from which pressures are computed, in addition to their poses.
_BODY_SENSORS = ("linear_velocity", "angular_velocity")
#: Fraction of the frame time that is spent in steps.
STEPPING = 0.7
#: Growth of the arrow scale per frame after a large force.
FADE = 1.02
# Number of contact sets whose sensors are listed.
_MAX_CONTACTS = 8
#: Time between updates of outcomes and frozen environments [s].
UPDATE_INTERVAL = 0.5


class Parameters:
    """Fields of the varied parameters, and one field for any parameter chosen from a list.

    A value is set when Enter or the button is pressed, not while it is typed.

    Args:
        viewer_thread: Viewer thread of the page.
        model: Model whose parameters are changed.
        first: Names of the parameters with permanent fields; the first ``MAX_FIELDS`` are used.

    Attributes:
        fields: Text fields of the varied parameters, by parameter name.
        chosen: Name of the parameter chosen from the list.
        field: Text field of the chosen parameter.
        item: Text field for the index of an item of the chosen parameter; empty: all items.
    """

    def __init__(self, viewer_thread: "Live", model: Environments, first: Sequence[str]) -> None:
        self.viewer_thread = viewer_thread
        self.model = model
        self.fields: dict[str, Any] = {}
        self._displayed: dict[str, str] = {}
        gui = viewer_thread.server.gui
        names = list(first)[:MAX_FIELDS]
        if names:
            with gui.add_form("Varied parameters") as form:
                for name in names:
                    self.fields[name] = gui.add_text(shortened(name, 40), "", hint=self._hint(name))
                self.set_button = viewer_thread.button("Set", lambda: self._set_all(form))
            form.on_submit(lambda event: self._submitted(event, self._set_all))
        # Shortened names may coincide; their number makes them unique.
        self._names = {f"{i + 1}. {shortened(name, 60)}": name for i, name in enumerate(model)}
        with gui.add_form("Any parameter", expand_by_default=not names) as form_of_one:
            self.choice = viewer_thread.on_change(gui.add_dropdown("Name", list(self._names)), self._choose)
            self.item = viewer_thread.on_change(
                gui.add_text("Item", "", hint="index from 0; empty: all"), self._show_item
            )
            self.field = gui.add_text("Value", "")
            self.set_one_button = viewer_thread.button("Set", lambda: self._set_one(form_of_one))
        form_of_one.on_submit(lambda event: self._submitted(event, self._set_one))
        self._result = gui.add_html("")
        self.chosen = next(iter(model))

    def _submitted(self, event: Any, command: Callable[[], None]) -> None:
        # Only submissions with Enter on the page. ``form.submit()`` of this thread has no client.
        if event.client is not None:
            self.viewer_thread.post(command)

    def _hint(self, name: str) -> str:
        text = ParameterText(self.model, name)
        notes = [shortened(name, 200), "" if text.unit == "-" else f"in {text.unit}"]
        notes.append("takes effect at the next reset" if text.is_initial else "")
        return ", ".join(filter(None, notes))

    def show_env(self, env: int) -> None:
        """Shows the parameter values of an environment."""
        for name, field in self.fields.items():
            self._write(name, field, ParameterText(self.model, name).read(env))
        self._show_one()

    def _write(self, name: str, field: Any, text: str) -> None:
        self._displayed[name] = field.value = text

    def _choose(self, label: str) -> None:
        self.chosen = self._names[label]
        self.item.value = ""
        self._show_one()

    def _show_item(self, text: str) -> None:
        if not text or text.isdecimal():
            self._show_one()

    def _show_one(self) -> None:
        text = ParameterText(self.model, self.chosen)
        self.item.visible = text.is_set
        self.field.hint = self._hint(self.chosen)
        env = self.viewer_thread.picker.env
        if env is not None:
            self.field.value = text.read(env, self._item(text))

    def _item(self, text: ParameterText) -> int | None:
        written = self.item.value.strip()
        if not text.is_set or not written:
            return None
        if not written.isdecimal():
            raise ValueError(f"the item of {text.name} must be its index, from 0, got {written[:40]!r}")
        return int(written)

    def _set_all(self, form: Any = None) -> None:
        """Sets the parameters whose field differs from the displayed value."""
        changed = {
            name: field.value for name, field in self.fields.items() if field.value != self._displayed[name]
        }
        self._set({name: (value, None) for name, value in changed.items()})
        self._acknowledge(form)

    def _set_one(self, form: Any = None) -> None:
        text = ParameterText(self.model, self.chosen)
        self._set({self.chosen: (self.field.value, self._item(text))})
        self._acknowledge(form)

    def _acknowledge(self, form: Any) -> None:
        """Notifies the page that the input was processed."""
        if form is not None:
            form.submit()

    def _set(self, values: dict[str, tuple[str, int | None]]) -> None:
        """Sets parameters of the selected environment. An invalid value does not prevent setting the others."""
        env = self.viewer_thread.picker.env
        if env is None:
            return
        done, wrong, initial = [], [], False
        for name, (value, item) in values.items():
            text = ParameterText(self.model, name)
            try:
                text.write(env, value, item)
            except (ValueError, MemoryError) as error:
                wrong.append(str(error))
                continue
            done.append(f"{name} = {text.read(env, item)}")
            initial = initial or (text.is_initial and not self.model.at_start)
            if name in self.fields:
                self._write(name, self.fields[name], text.read(env))
        if initial:
            done.append("(initial value: takes effect at the next reset)")
        self.viewer_thread.write(self._result, f"environment {env}: {'; '.join(done)}" if done else "")
        self.viewer_thread.show_problem("\n".join(wrong))
        if done:
            self._show_one()
            self.viewer_thread.refresh()


class Live(ViewerThread):
    """Steps a simulation and shows one of its environments.

    Args:
        server: Server of the page.
        simulation: Simulation to step. It must not be stepped elsewhere until the page is closed.
        name: Name shown on the page.
        speed: Simulated time per wall-clock time.
        varied: Names of the parameters that have fields on the page.

    Attributes:
        simulation: Simulation that is stepped.
        rate: Simulated time per wall-clock time over about the last second. Below ``speed`` if steps take longer.
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
        self._pending_steps = 0.0
        self._steps_per_second = 0.0
        self._last_update = 0.0
        scene, names = simulation.model.scene, simulation.model.sensor_names
        force_elements: list[Any] = [*scene.contacts, *scene.shape_contacts, *scene.body_contacts]
        self._displayed_sensors = list(
            dict.fromkeys([*default_sensors(simulation.model, with_gap=True), *self._set_sensors()])
        )
        drawn = [f"{one.name}.{key}" for one in force_elements for key in _CONTACT_SENSORS]
        drawn += [f"{coupling.name}.status" for coupling in scene.couplings]
        if scene.body_contacts:
            drawn += [f"{body.name}.{key}" for body in scene.bodies for key in _BODY_SENSORS]
        self._recorder = Recorder(
            simulation.model,
            [name for name in [*self._displayed_sensors, *drawn] if name in names],
            frames=1,
            poses=True,
        )

    def _set_sensors(self) -> list[str]:
        """Returns gap and normal force sensors of contact sets, which experiments do not record by default."""
        contacts = [one for one in self.simulation.model.scene.contacts if not one.points.single]
        return [f"{one.name}.{key}" for one in contacts[:_MAX_CONTACTS] for key in ("gap", "normal_force")]

    def add_panel(self) -> None:
        """Adds all controls and displays to the page."""
        gui = self.server.gui
        self.add_time()
        self.step_button = self.button("Step", self._step, hint="one time step of all environments")
        self._resets = gui.add_button_group("Reset", ("This one", "All"))
        self._resets.on_click(lambda event: self.post(lambda: self._reset(event.target.value)))
        self.picker = EnvironmentSelector(self, self._select_env)
        self.add_display_options()
        with gui.add_folder("Sensors"):
            self._sensors = gui.add_html("")
        self.parameters = Parameters(self, self.simulation.model, self._varied)
        self._outcomes = None
        if self.simulation.monitor_settings.outcomes or self.simulation.monitor_settings.stops:
            with gui.add_folder("Outcomes", expand_by_default=False):
                self._outcomes = gui.add_html("")
        self._notes = gui.add_html("")

    def begin(self) -> None:
        """Compiles the step kernels and shows the initial state."""
        simulation = self.simulation
        self.show_status("compiling …")
        self._recorder.start()
        if simulation.model.at_start:
            self.write(self._notes, "\n".join(f"Caution: {sentence}" for sentence in simulation.check()))
            simulation.warned_at_start = True
            # This step compiles. The caller may have changed the state, so restore it afterwards.
            with tempfile.TemporaryDirectory() as folder:
                state = Path(folder) / "state.npz"
                simulation.save(state)
                simulation.step()
                simulation.load(state)
        self._update_environments()
        self.picker.pick(0)
        self._frame_bodies()

    def _update_environments(self) -> None:
        self._health = self.simulation.model.health()
        self.picker.set_environments(np.arange(self.simulation.model.envs), self._health.frozen)

    def _select_env(self, env: int) -> None:
        self._force_scale = np.inf
        self.stage.largest_pressure = 0.0
        self._capture_state()
        if self._drawing is not None:
            self.stage.follow(self._drawing, 0)
        self.parameters.show_env(env)
        self._describe()

    def _describe(self) -> None:
        """Shows the status of the selected environment and its current outcomes."""
        env, health = self.picker.env, self._health
        if env is None:
            return
        description = ""
        frozen = np.flatnonzero(health.frozen == env)
        if len(frozen):
            at, cause = health.times[frozen[0]], FailureCause(health.causes[frozen[0]])
            description = f"frozen: {cause.name}, at {value_text(float(at))} s"
        elif env in health.stopped:
            description = "stopped by a condition"
        self.picker.describe(description)
        if self._outcomes is not None:
            self.write_table(self._outcomes, rows_of(self.simulation.outcomes().isel(env=env)))

    def tick(self, seconds: float) -> None:
        """Steps for ``seconds`` of wall-clock time at most and shows the state."""
        if self.playing:
            self._step_until(seconds)
        if time.monotonic() - self._last_update > UPDATE_INTERVAL and self.picker.env is not None:
            self._last_update = time.monotonic()
            self._update_environments()
            self._describe()

    def _step_until(self, seconds: float) -> None:
        simulation = self.simulation
        begin = time.perf_counter()
        before = simulation.steps
        self._pending_steps += self.speed * seconds / simulation.dt
        # Take as many steps as fit into half of the remaining time, by the last measured step rate.
        while self._pending_steps >= 1.0:
            remaining = STEPPING * FRAME_TIME - (time.perf_counter() - begin)
            if remaining <= 0.0:
                # The machine is too slow for this speed: drop the overdue steps.
                self._pending_steps = 0.0
                break
            count = int(min(self._pending_steps, max(1.0, 0.5 * remaining * self._steps_per_second)))
            start = time.perf_counter()
            simulation.step(count)
            self._finish_queued()
            self._steps_per_second = count / max(time.perf_counter() - start, 1.0e-6)
            self._pending_steps -= count
        done = (simulation.steps - before) * simulation.dt
        # Moving average over about half a second.
        self.rate += min(1.0, 2.0 * seconds) * (done / max(seconds, 1.0e-6) - self.rate)
        self._capture_state()

    def _finish_queued(self) -> None:
        """Waits for queued GPU steps, because the next step count follows from their run time."""
        import warp as wp

        for device in self.simulation.model.devices:
            if device.is_cuda:
                wp.synchronize_device(device)

    def _capture_state(self) -> None:
        """Evaluates the sensors of the current state and draws it."""
        env = self.picker.env
        if env is None:
            return
        recorder = self._recorder
        recorder.rewind()
        recorder.take(self.simulation.time)
        recording = recorder.finish(self.simulation.integrator_attributes())
        self._drawing = drawing = drawing_of(recording, envs=[env])
        if any(contact.forces.any() for contact in drawing.contact_forces):
            # Keep arrows comparable for a few seconds: the scale follows the largest recent force.
            self._force_scale = min(self._force_scale * FADE, drawing.force_scale)
        self.redraw()
        own = recording[self._displayed_sensors].isel(time=0).sel(env=env)
        self.write_table(self._sensors, rows_of(own))
        self._show_state()

    def _show_state(self) -> None:
        simulation = self.simulation
        paced = f", {self.rate:.3g} × real time" if self.playing else ""
        self.show_status(f"{self.name}\n{simulation.time:.6g} s, step {simulation.steps}{paced}")

    def redraw(self) -> None:
        """Draws the last evaluated state again."""
        if self._drawing is not None:
            scale = self._force_scale if np.isfinite(self._force_scale) else self._drawing.force_scale
            self.draw(self._drawing, 0, scale)

    def _step(self) -> None:
        self.pause()
        self.show_problem("")
        self.simulation.step()
        self._capture_state()

    def _reset(self, which: str) -> None:
        mask = None
        if which == "This one":
            mask = np.arange(self.simulation.model.envs) == self.picker.env
        self.simulation.reset(mask)
        self.show_problem("")
        self.refresh()

    def refresh(self) -> None:
        """Shows the state after a change other than a step."""
        self._force_scale = np.inf
        self.stage.largest_pressure = 0.0
        self._capture_state()
        self._update_environments()
        self._describe()

    def play(self) -> None:
        """Starts stepping."""
        self._pending_steps, self.rate = 0.0, 0.0
        super().play()

    def pause(self) -> None:
        """Stops stepping."""
        super().pause()
        self._show_state()

    def current_drawing(self) -> tuple[Drawing, int] | None:
        """Returns the current drawing and the record shown (0), or ``None``."""
        return None if self._drawing is None else (self._drawing, 0)
