"""Description of a golden scene, and the run that turns it into named arrays.

A scene module has functions that take ``Names`` and return a ``Plan``: the scene, its steps and its sensors.
``run`` executes a plan and returns its arrays as ``<group>/<name>``. The groups are ``state`` and ``sensors``
(at the end), ``recording``, ``outcomes``, ``events`` and ``results`` (anything else). A plan also declares checks,
because a scene without contact or motion proves nothing.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from golden_scenes.difference import SENSORS
from golden_scenes.names import Names, canonical

Arrays = dict[str, np.ndarray]

#: Arrays of the state of a model, (envs, bodies, …).
STATE = (
    "body_position",
    "body_position_remainder",
    "body_orientation",
    "body_linear_velocity",
    "body_angular_velocity",
)


class CheckError(Exception):
    """Failed check of a scene."""


@dataclass
class Plan:
    """Scene with its steps, sensors and checks.

    Attributes:
        scene: The scene; ``None`` if ``run`` needs none.
        envs: Number of environments.
        dt: Time step [s].
        steps: Number of steps.
        every: Steps from frame to frame of the recording.
        record: Sensors to record, by the names of ``NAMES``.
        values: Parameters to set, by name.
        precision: ``"float32"`` or ``"float64"``.
        integrator: Time integrator; ``None``: the default.
        options: Further arguments of the simulation.
        touches: Recorded sensors that must differ from 0 in at least one frame of each environment.
        still: Whether bodies may stay at their initial poses.
        numbers: Whether no result but gaps may be NaN.
        derivatives: Whether the final sensors include the derivatives of shape contact.
        check: Further check of the arrays; raises ``CheckError``.
        run: Function to use instead of ``simulate``.
    """

    scene: Any = None
    envs: int = 4
    dt: float = 1e-4
    steps: int = 320
    every: int = 40
    record: Sequence[str] = ()
    values: Mapping[str, Any] = field(default_factory=dict)
    precision: str = "float32"
    integrator: Any = None
    options: Mapping[str, Any] = field(default_factory=dict)
    touches: Sequence[str] = ()
    still: bool = False
    numbers: bool = True
    derivatives: bool = False
    check: Callable[[Arrays], None] | None = None
    run: Callable[["Trial"], None] | None = None


class Trial:
    """Run of a plan, with its arrays so far.

    Attributes:
        names: The public API.
        plan: The plan.
        device: Warp device.
        folder: Empty folder for files.
        arrays: The arrays by ``<group>/<name>``.
    """

    def __init__(self, names: Names, plan: Plan, device: str, folder: Path) -> None:
        self.names = names
        self.plan = plan
        self.device = device
        self.folder = folder
        self.arrays: Arrays = {}

    def model(self, scene: Any = None) -> Any:
        """Returns the model of a scene, that of the plan by default, with the values of the plan."""
        plan = self.plan
        scene = plan.scene if scene is None else scene
        model = scene.build(envs=plan.envs, device=self.device, precision=plan.precision)
        for name, values in plan.values.items():
            model[self.names.path(name, model)] = values
        return model

    def simulation(self, model: Any) -> Any:
        """Returns a simulation of a model with the options of the plan."""
        plan = self.plan
        return self.names.call(
            self.names.Simulation, model, dt=plan.dt, integrator=plan.integrator, **plan.options
        )

    def record(self, sim: Any, steps: int, group: str = "recording") -> Any:
        """Takes steps, records the sensors of the plan, stores them as ``group`` and returns the recording."""
        plan = self.plan
        sensors = self.names.sensor_paths(sim.model, plan.record)
        recording = sim.run(steps * plan.dt, record=sensors, every=plan.every * plan.dt, progress=False)
        self.keep_data_set(group, recording)
        return recording

    def keep(self, name: str, values: Any) -> None:
        """Stores an array as ``<group>/<name>``, texts as strings of fixed width, which need no pickling."""
        array = np.array(values)
        self.arrays[name] = array.astype(str) if array.dtype.kind == "O" else array

    def keep_data_set(self, group: str, data: Any) -> None:
        """Stores all variables and coordinates of a labeled data set."""
        for name, variable in {**data.coords, **data.data_vars}.items():
            # The host sums up its clock in chunks of wall-clock duration: its rounding differs between runs.
            if name != "time" or group == "recording" or variable.ndim > 1:
                self.keep(f"{group}/{canonical(str(name))}", variable.values)

    def finish(self, sim: Any) -> None:
        """Stores the final state, all sensors, failures, and the outcomes and events if there are any."""
        plan, model = self.plan, sim.model
        for name in self.names.attribute(model, "sensor_names"):
            # Kernels of the derivatives of shape contact compile for up to 20 s per pair.
            if plan.derivatives or "_by_" not in name:
                self.keep(f"{SENSORS}/{canonical(name)}", self.names.attribute(model, "sensor")(name))
        for name in STATE:
            self.keep(f"state/{name}", getattr(sim.state, name).numpy())
        health = model.health()
        self.keep("state/frozen", health.frozen)
        self.keep("state/frozen_cause", [int(cause) for cause in health.causes])
        self.keep("state/frozen_time", health.times)
        self.keep("state/stopped", health.stopped)
        if plan.options.get("outcomes"):
            self.keep_data_set("outcomes", sim.outcomes())
        if plan.options.get("events") is not None:
            self.keep_data_set("events", sim.events())

    def check(self) -> None:
        """Checks contact, motion and values as the plan declares.

        Raises:
            CheckError: If a check fails; the message names the sensor and the environment.
        """
        plan, arrays = self.plan, self.arrays
        for sensor in plan.touches:
            values = arrays[f"recording/{sensor}"]
            touched = np.any(np.moveaxis(values, 1, 0).reshape(values.shape[1], -1) != 0, axis=1)
            require(touched.all(), f"{sensor} is 0 in all frames of environments {np.flatnonzero(~touched)}")
        if plan.scene is not None and not plan.still:
            poses = [name for name in arrays if name.endswith((".position", ".orientation"))]
            moved = [
                np.any(arrays[name][0] != arrays[name][-1]) for name in poses if name.startswith("recording/")
            ]
            require(any(moved), "no body moved")
        if plan.numbers:
            for name, values in arrays.items():
                if values.dtype.kind == "f" and not name.endswith(".gap") and not name.startswith(SENSORS):
                    require(not np.isnan(values).any(), f"{name} is NaN in places")
        if plan.check is not None:
            plan.check(arrays)


def require(condition: Any, message: str) -> None:
    """Raises ``CheckError`` with ``message`` unless ``condition`` holds."""
    if not condition:
        raise CheckError(message)


def simulate(trial: Trial) -> None:
    """Builds the model of a plan, records its steps and stores the final state."""
    sim = trial.simulation(trial.model())
    trial.record(sim, trial.plan.steps)
    trial.finish(sim)


def run(names: Names, plan: Plan, device: str, folder: Path) -> Arrays:
    """Runs a plan and returns its arrays.

    Args:
        names: The public API.
        plan: The plan.
        device: Warp device.
        folder: Empty folder for files.

    Raises:
        CheckError: If a check of the plan fails.
    """
    trial = Trial(names, plan, device, folder)
    (plan.run or simulate)(trial)
    trial.check()
    return trial.arrays


def forces(contacts: Iterable[str]) -> list[str]:
    """Returns the names of the sensors of normal and friction force of contacts."""
    return [f"{contact}.{force}" for contact in contacts for force in ("normal_force", "friction_force")]


def normal_forces(contacts: Iterable[str]) -> list[str]:
    """Returns the names of the sensors of normal force of contacts."""
    return [f"{contact}.normal_force" for contact in contacts]


def spread(low: Any, high: Any, envs: int = 4) -> np.ndarray:
    """Returns one value per environment, evenly spaced from ``low`` to ``high``, (envs, …)."""
    return np.linspace(low, high, envs)
