"""Response of the bodies of one environment to forces: inverse mass matrices and accelerations, on the host."""

from typing import NamedTuple

import numpy as np

from warpcontact.algebra.poses import inverse, product
from warpcontact.algebra.vectors import cross
from warpcontact.kernels.types import BALL, FREE, HINGE, PLANAR, SLIDER, TIME_FUNCTION, TRANSLATION
from warpcontact.model.model import DeviceModel
from warpcontact.unilateral.reference.snapshot import Snapshot
from warpcontact.validation.checks import Array


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
        rotation = product(snapshot.orientation[body], inverse(self.start_orientation[body]))
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
