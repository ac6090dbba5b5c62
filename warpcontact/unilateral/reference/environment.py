"""State of one environment in float64, and the response of its bodies to forces, on the host."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warpcontact.algebra.vectors import cross, inverse, quat_multiply
from warpcontact.kernels.joints import driven
from warpcontact.kernels.types import BALL, FREE, HINGE, PLANAR, SLIDER, TIME_FUNCTION, TRANSLATION
from warpcontact.model.environments import Environments
from warpcontact.model.model import DeviceModel
from warpcontact.storage.parameters import split
from warpcontact.system.launches import launch_kernel
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
    result = quat_multiply(increment, orientation)
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
            launch_kernel(
                driven.start(drive.motion, model.types.real),
                (model.envs, drive.count),
                device=model.device,
                mask=self._mask,
                time=a.time,
                model=a.model,
                state=a.state,
                **drive.inputs,
            )
        return self.read()


class Response(NamedTuple):
    """Response of bodies to forces: their acceleration is ``inverse_mass`` · force + ``bias``.

    Attributes:
        inverse_mass: (6 bodies, 6 bodies), linear and angular part of each body; world axes, at the centers of
            mass. Zero along directions constrained by joints.
        bias: Accelerations (6 bodies,) without applied forces: gyroscopic, and centripetal about the anchor of a
            joint [m/s², rad/s²].
    """

    inverse_mass: Array
    bias: Array


class Bodies:
    """Masses and joints of the bodies of one environment.

    Args:
        model: The model.
        env: Index of the environment in it.
    """

    def __init__(self, model: DeviceModel, env: int) -> None:
        device = model.arrays.model
        self.model, self.env = model, env
        self.count = model.body_count
        self.mass = device.body_mass.numpy()[env].astype(np.float64)
        self.inertia = device.body_inertia.numpy()[env].astype(np.float64)
        self.gravity = device.gravity.numpy()[env, 0].astype(np.float64)
        self.kinds = np.full(self.count, FREE)
        if model.has_joints:
            motions = device.body_motion.numpy()[env]
            self.kinds = motions["kind"].copy()
            self.axis, self.anchor = motions["axis"].copy(), motions["anchor"].copy()
            self.start, self.start_orientation = motions["position"].copy(), motions["orientation"].copy()
        self.anchored = np.isin(self.kinds, (HINGE, BALL))
        self.names = [
            body.name if body.single else f"{body.name}[{item}]"
            for body in model.scene.bodies
            for item in range(body.count)
        ]

    def project_anchors(self, snapshot: Snapshot) -> Snapshot:
        """Returns ``snapshot`` with bodies on hinges and balls exactly at their anchors, by their orientations."""
        if not self.anchored.any():
            return snapshot
        position, velocity = snapshot.position.copy(), snapshot.linear_velocity.copy()
        for body in np.flatnonzero(self.anchored).tolist():
            arm = self._arm(body, snapshot)
            position[body] = self.anchor[body] + arm
            velocity[body] = cross(snapshot.angular_velocity[body], arm)
        return Snapshot(snapshot.time, position, snapshot.orientation, velocity, snapshot.angular_velocity)

    def response(self, snapshot: Snapshot) -> Response:
        """Returns the response of the bodies in a state, without accelerations of prescribed motion."""
        inverse_mass = np.zeros((self.count, 6, self.count, 6))
        bias = np.zeros((self.count, 6))
        rotations = rotation_matrices(snapshot.orientation)
        for body in range(self.count):
            directions = self._free_directions(body, snapshot)
            if not directions.shape[1]:
                continue
            inertia = rotations[body] @ self.inertia[body] @ rotations[body].T
            mass = np.zeros((6, 6))
            mass[:3, :3], mass[3:, 3:] = self.mass[body] * np.eye(3), inertia
            block = directions @ np.linalg.solve(directions.T @ mass @ directions, directions.T)
            inverse_mass[body, :, body, :] = block
            spin = snapshot.angular_velocity[body]
            if self.anchored[body]:
                bias[body, :3] = cross(spin, cross(spin, self._arm(body, snapshot)))
            inertia_force = mass @ bias[body]
            inertia_force[3:] += cross(spin, inertia @ spin)
            bias[body] -= block @ inertia_force
        return Response(inverse_mass.reshape(6 * self.count, 6 * self.count), bias.reshape(-1))

    def prescribed_accelerations(self) -> Array:
        """Returns the accelerations (6 bodies,) of bodies with prescribed motion; 0 for others.

        They are those of the last evaluation (``Model.evaluate_needs`` with "reactions").
        """
        result = np.zeros((self.count, 6))
        own = self.kinds == TIME_FUNCTION
        if own.any():
            (joints,) = self.model.of_family("joints")
            measured = joints.measures["reactions"]
            result[own, :3] = measured.linear.numpy()[self.env][own]
            result[own, 3:] = measured.angular.numpy()[self.env][own]
        return result.reshape(-1)

    def _arm(self, body: int, snapshot: Snapshot) -> Array:
        """Returns the vector from the anchor of a hinge or ball to the center of mass, world axes [m]."""
        rotation = quat_multiply(snapshot.orientation[body], inverse(self.start_orientation[body]))
        return rotation_matrices(rotation[None])[0] @ (self.start[body] - self.anchor[body])

    def _free_directions(self, body: int, snapshot: Snapshot) -> Array:
        """Returns the velocities that the joint of a body admits, as columns (6, degrees of freedom)."""
        kind = self.kinds[body]
        zeros, identity = np.zeros((3, 3)), np.eye(3)
        if kind == FREE:
            return np.eye(6)
        if kind == TRANSLATION:
            return np.vstack([identity, zeros])
        if kind == BALL:
            arm = self._arm(body, snapshot)
            return np.vstack([cross(identity, arm).T, identity])
        axis = self.axis[body]
        if kind == HINGE:
            return np.concatenate([cross(axis, self._arm(body, snapshot)), axis])[:, None]
        if kind == SLIDER:
            return np.concatenate([axis, np.zeros(3)])[:, None]
        if kind == PLANAR:
            across = np.linalg.svd(axis[None])[2][1:].T
            return np.block([[across, np.zeros((3, 1))], [np.zeros((3, 2)), axis[:, None]]])
        return np.zeros((6, 0))


def rotation_matrices(orientation: Array) -> Array:
    """Returns the rotation matrices (n, 3, 3) of unit quaternions (n, 4), x, y, z, w."""
    x, y, z, w = orientation.T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
