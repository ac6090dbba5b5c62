"""The state of one environment on the host, in float64: read from a model, and written into it to evaluate it there."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warpcontact.checks import Array
from warpcontact.environments import Environments
from warpcontact.frames import product
from warpcontact.kernels.motions import driven
from warpcontact.model import Model
from warpcontact.parameters import split

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

    def with_velocity(self, velocity: Array) -> "Snapshot":
        """Returns the same with other velocities (6 bodies,)."""
        rows = velocity.reshape(-1, 6)
        return replace(self, linear_velocity=rows[:, :3].copy(), angular_velocity=rows[:, 3:].copy())

    def moved(self, way: Array) -> "Snapshot":
        """Returns the same with poses moved by ``way`` (6 bodies,): displacements [m] and rotation vectors [rad]."""
        rows = way.reshape(-1, 6)
        return replace(
            self, position=self.position + rows[:, :3], orientation=turned(self.orientation, rows[:, 3:])
        )


def turned(orientation: Array, angle: Array) -> Array:
    """Returns quaternions (n, 4) turned by rotation vectors (n, 3) in world axes [rad], of length 1."""
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    # sin(x/2)/x, by its limit where x is 0.
    turn = np.hstack([0.5 * np.sinc(size / (2.0 * np.pi)) * angle, np.cos(0.5 * size)])
    result = product(turn, orientation)
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


def read(model: Model, env: int) -> Snapshot:
    """Returns the current state of an environment of ``model``."""
    state = model.arrays.state
    values = {name: getattr(state, f"body_{name}").numpy()[env].astype(np.float64) for name in _STATE}
    values["position"] = values["position"] + state.body_position_remainder.numpy()[env]
    lengths = np.linalg.norm(values["orientation"], axis=1, keepdims=True)
    values["orientation"] = values["orientation"] / lengths
    return Snapshot(time=float(model.arrays.time.numpy()[env]), **values)


def write(model: Model, env: int, snapshot: Snapshot) -> None:
    """Makes ``snapshot`` the current state of an environment of ``model``; its clock is set as well."""
    state, real = model.arrays.state, wp.dtype_to_numpy(model.types.real)
    position, remainder = split("position", snapshot.position, real)
    values = {name: getattr(snapshot, name) for name in _STATE} | {"position": position}
    values["position_remainder"] = remainder
    for name, value in values.items():
        _put(getattr(state, f"body_{name}"), env, value)
    _put(model.arrays.time, env, snapshot.time)


def follow(model: Model, env: int, snapshot: Snapshot) -> Snapshot:
    """Returns ``snapshot`` with bodies that follow functions of time where they are at its time.

    The current state of the environment is changed.
    """
    if not model.drives:
        return snapshot
    write(model, env, snapshot)
    chosen = wp.array(np.arange(model.envs) == env, dtype=wp.bool, device=model.device)
    a = model.arrays
    for drive in model.drives:
        kernel = driven.start(drive.motion, model.types.real)
        inputs = [chosen, a.time, a.model, *drive.inputs, a.state]
        wp.launch(kernel, dim=(model.envs, drive.count), inputs=inputs, device=model.device)
    return read(model, env)


def _put(array: wp.array, env: int, value: Any) -> None:
    # On the CPU the first is a view, and nothing is left to be sent.
    whole = array.numpy()
    whole[env] = value
    if array.device.is_cuda:
        array.assign(whole)
