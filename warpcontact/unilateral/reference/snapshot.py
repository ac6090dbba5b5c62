"""The state of one environment on the host, in float64: read from a model, and written into it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warpcontact.algebra.poses import product
from warpcontact.kernels.joints import driven
from warpcontact.model.environments import Environments
from warpcontact.model.model import Model
from warpcontact.storage.parameters import split
from warpcontact.validation.checks import Array

_STATE = ("position", "orientation", "linear_velocity", "angular_velocity")


@dataclass(frozen=True)
class Snapshot:
    """Poses and velocities of all bodies of one environment at one time.

    Attributes:
        time: Time [s].
        position: Centres of mass (bodies, 3), world [m].
        orientation: Rotations body → world (bodies, 4), quaternions (x, y, z, w).
        linear_velocity: Of the centres of mass (bodies, 3), world [m/s].
        angular_velocity: (bodies, 3), world axes [rad/s].
    """

    time: float
    position: Array
    orientation: Array
    linear_velocity: Array
    angular_velocity: Array

    @property
    def velocity(self) -> Array:
        """Linear and angular velocity of each body, one after the other, (6 bodies,)."""
        return np.hstack([self.linear_velocity, self.angular_velocity]).reshape(-1)

    def at(self, time: float) -> "Snapshot":
        """Returns the same at another time [s]."""
        return replace(self, time=time)

    def with_velocity(self, velocity: Array) -> "Snapshot":
        """Returns the same with other velocities (6 bodies,)."""
        rows = velocity.reshape(-1, 6)
        return replace(self, linear_velocity=rows[:, :3].copy(), angular_velocity=rows[:, 3:].copy())

    def displaced(self, displacement: Array) -> "Snapshot":
        """Returns the same with poses moved by (6 bodies,): displacements and rotation vectors [m, rad]."""
        rows = displacement.reshape(-1, 6)
        return replace(
            self,
            position=self.position + rows[:, :3],
            orientation=rotate_quaternions(self.orientation, rows[:, 3:]),
        )


def rotate_quaternions(orientation: Array, angle: Array) -> Array:
    """Returns quaternions (n, 4) turned by rotation vectors (n, 3) in world axes [rad], of length 1."""
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    # sin(x/2)/x, by its limit where x is 0.
    increment = np.hstack([0.5 * np.sinc(size / (2.0 * np.pi)) * angle, np.cos(0.5 * size)])
    result = product(increment, orientation)
    return result / np.linalg.norm(result, axis=1, keepdims=True)


def find_environment(model: Any, env: int) -> tuple[Model, int]:
    """Returns the part of ``model`` that has environment ``env``, and its number there.

    Raises:
        TypeError: If ``model`` is none.
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
    """One environment of a model, to be read and written in float64.

    Args:
        model: The model.
        env: Number of the environment in it.
    """

    def __init__(self, model: Model, env: int) -> None:
        self.model, self.env = model, env
        state = model.arrays.state
        self._arrays = {name: getattr(state, f"body_{name}") for name in (*_STATE, "position_remainder")}
        self._arrays["time"] = model.arrays.time
        # On the CPU they are views, and the arrays of a state stay where they are for the life of the model.
        self._views = {name: array.numpy() for name, array in self._arrays.items()} if model.device.is_cpu else {}
        self._real = wp.dtype_to_numpy(model.types.real)
        chosen = np.arange(model.envs) == env
        self._mask = wp.array(chosen, dtype=wp.bool, device=model.device) if model.prescribed_motions else None

    def read(self) -> Snapshot:
        """Returns the current state."""
        views = self._views or {name: array.numpy() for name, array in self._arrays.items()}
        values = {name: views[name][self.env].astype(np.float64) for name in _STATE}
        values["position"] += views["position_remainder"][self.env]
        values["orientation"] /= np.linalg.norm(values["orientation"], axis=1, keepdims=True)
        return Snapshot(time=float(views["time"][self.env]), **values)

    def write(self, snapshot: Snapshot) -> None:
        """Makes ``snapshot`` the current state; the clock of the environment is set as well."""
        position, remainder = snapshot.position, 0.0 * snapshot.position
        if self._real is not np.float64:
            position, remainder = split("position", snapshot.position, self._real)
        values: dict[str, Any] = {name: getattr(snapshot, name) for name in _STATE}
        values |= {"position": position, "position_remainder": remainder, "time": snapshot.time}
        self._assign(values)

    @contextmanager
    def preserved_state(self) -> Iterator[None]:
        """Puts the state back afterwards as it was, to the bit."""
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
        """Returns ``snapshot`` with bodies that follow functions of time where they are at its time.

        If there are any, that is the current state then.
        """
        model, a = self.model, self.model.arrays
        if not model.prescribed_motions:
            return snapshot
        self.write(snapshot)
        for drive in model.prescribed_motions:
            kernel = driven.start(drive.motion, model.types.real)
            inputs = [self._mask, a.time, a.model, *drive.inputs, a.state]
            wp.launch(kernel, dim=(model.envs, drive.count), inputs=inputs, device=model.device)
        return self.read()
