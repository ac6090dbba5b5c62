"""Reads and writes the state of one environment on the host, in float64."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warpcontact.algebra.poses import product
from warpcontact.kernels.joints import driven
from warpcontact.model.environments import Environments
from warpcontact.model.model import DeviceModel
from warpcontact.storage.parameters import split
from warpcontact.validation.checks import Array

_STATE = ("position", "orientation", "linear_velocity", "angular_velocity")


@dataclass(frozen=True)
class Snapshot:
    """Poses and velocities of all bodies of one environment at one time.

    Attributes:
        time: Time [s].
        position: Centers of mass (bodies, 3), world [m].
        orientation: Rotations body → world (bodies, 4), quaternions (x, y, z, w).
        linear_velocity: Velocities of the centers of mass (bodies, 3), world [m/s].
        angular_velocity: Angular velocities (bodies, 3), world axes [rad/s].
    """

    time: float
    position: Array
    orientation: Array
    linear_velocity: Array
    angular_velocity: Array

    @property
    def velocity(self) -> Array:
        """Linear and angular velocity of each body, concatenated, (6 bodies,)."""
        return np.hstack([self.linear_velocity, self.angular_velocity]).reshape(-1)

    def at(self, time: float) -> "Snapshot":
        """Returns a copy at another time [s]."""
        return replace(self, time=time)

    def with_velocity(self, velocity: Array) -> "Snapshot":
        """Returns a copy with other velocities (6 bodies,)."""
        rows = velocity.reshape(-1, 6)
        return replace(self, linear_velocity=rows[:, :3].copy(), angular_velocity=rows[:, 3:].copy())

    def displaced(self, displacement: Array) -> "Snapshot":
        """Returns a copy with poses moved by (6 bodies,): displacements and rotation vectors [m, rad]."""
        rows = displacement.reshape(-1, 6)
        return replace(
            self,
            position=self.position + rows[:, :3],
            orientation=rotate_quaternions(self.orientation, rows[:, 3:]),
        )


def rotate_quaternions(orientation: Array, angle: Array) -> Array:
    """Returns unit quaternions (n, 4) rotated by rotation vectors (n, 3) in world axes [rad]."""
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    # sin(x/2)/x, with its limit at x = 0.
    increment = np.hstack([0.5 * np.sinc(size / (2.0 * np.pi)) * angle, np.cos(0.5 * size)])
    result = product(increment, orientation)
    return result / np.linalg.norm(result, axis=1, keepdims=True)


def find_environment(model: Any, env: int) -> tuple[DeviceModel, int]:
    """Returns the device model that has environment ``env``, and the index of the environment in it.

    Raises:
        TypeError: If ``model`` is not a model.
        ValueError: If there is no such environment.
    """
    if not isinstance(model, Environments):
        raise TypeError(f"model must come from Scene.build, got {model!r}")
    if isinstance(env, bool) or not isinstance(env, int | np.integer) or not 0 <= env < model.envs:
        raise ValueError(f"env must be a whole number from 0 to {model.envs - 1}, got {env!r}")
    for part, own in model.shares():
        if own.start <= env < own.stop:
            return part, int(env) - own.start
    raise AssertionError("the parts of a model have all its environments")


class EnvironmentAccess:
    """Access to one environment of a model, in float64.

    Args:
        model: The model.
        env: Index of the environment in it.
    """

    def __init__(self, model: DeviceModel, env: int) -> None:
        self.model, self.env = model, env
        state = model.arrays.state
        self._arrays = {name: getattr(state, f"body_{name}") for name in (*_STATE, "position_remainder")}
        self._arrays["time"] = model.arrays.time
        # On the CPU these are views; state arrays are not reallocated during the life of the model.
        self._views = {name: array.numpy() for name, array in self._arrays.items()} if model.device.is_cpu else {}
        self._real = wp.dtype_to_numpy(model.types.real)
        chosen = np.arange(model.envs) == env
        self.prescribed_motions = [
            one for joints in model.of_family("joints") for one in joints.prescribed_motions
        ]
        self._mask = wp.array(chosen, dtype=wp.bool, device=model.device) if self.prescribed_motions else None

    def read(self) -> Snapshot:
        """Returns the current state."""
        views = self._views or {name: array.numpy() for name, array in self._arrays.items()}
        values = {name: views[name][self.env].astype(np.float64) for name in _STATE}
        values["position"] += views["position_remainder"][self.env]
        values["orientation"] /= np.linalg.norm(values["orientation"], axis=1, keepdims=True)
        return Snapshot(time=float(views["time"][self.env]), **values)

    def write(self, snapshot: Snapshot) -> None:
        """Sets the current state to ``snapshot``, including the clock of the environment."""
        position, remainder = snapshot.position, 0.0 * snapshot.position
        if self._real is not np.float64:
            position, remainder = split("position", snapshot.position, self._real)
        values: dict[str, Any] = {name: getattr(snapshot, name) for name in _STATE}
        values |= {"position": position, "position_remainder": remainder, "time": snapshot.time}
        self._assign(values)

    @contextmanager
    def preserved_state(self) -> Iterator[None]:
        """Restores the state on exit, bitwise; a context manager."""
        before = {name: array.numpy()[self.env].copy() for name, array in self._arrays.items()}
        try:
            yield
        finally:
            self._assign(before)

    def _assign(self, values: dict[str, Any]) -> None:
        for name, array in self._arrays.items():
            array_view = self._views[name] if self._views else array.numpy()
            array_view[self.env] = values[name]
            if not self._views:
                array.assign(array_view)

    def apply_prescribed_motion(self, snapshot: Snapshot) -> Snapshot:
        """Returns ``snapshot`` with prescribed bodies at their poses at its time.

        If there are any, the result also becomes the current state.
        """
        model, a = self.model, self.model.arrays
        if not self.prescribed_motions:
            return snapshot
        self.write(snapshot)
        for drive in self.prescribed_motions:
            kernel = driven.start(drive.motion, model.types.real)
            inputs = [self._mask, a.time, a.model, *drive.inputs, a.state]
            wp.launch(kernel, dim=(model.envs, drive.count), inputs=inputs, device=model.device)
        return self.read()
