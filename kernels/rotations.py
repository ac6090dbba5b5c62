"""Rotations: matrices, quaternion normalization and rotation vectors."""

import functools
import math
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import numbers


class Functions(NamedTuple):
    """Device functions of rotations, for one precision."""

    matrix: wp.Function  # matrix of a quaternion
    rotated: wp.Function  # quaternion rotated by a rotation vector in W, normalized
    rotated_split: wp.Function  # the same for a quaternion and its rounding remainder, as a ``SplitQuaternion``
    rotation_vector: wp.Function  # rotation vector of a quaternion, at most π long
    spin: wp.Function  # angular velocity of a body from its angular momentum, W


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``."""
    n = numbers(real)
    vec3, quat, mat33 = n.vec3, n.quat, n.mat33
    one, two, half = wp.constant(real(1.0)), wp.constant(real(2.0)), wp.constant(real(0.5))
    # Coefficients of (sin √x)/√x and cos √x up to x⁴.
    s_1, s_2, s_3, s_4 = (wp.constant(real((-1) ** k / math.factorial(2 * k + 1))) for k in range(1, 5))
    c_1, c_2, c_3, c_4 = (wp.constant(real((-1) ** k / math.factorial(2 * k))) for k in range(1, 5))
    # A Newton step to unit length leaves 3/8 of the squared excess, which is below rounding for this excess.
    nearly = wp.constant(real(n.epsilon**0.5 / 4.0))

    @wp.struct
    class SplitQuaternion:
        """The rotation of the sum of a quaternion and its rounding remainder."""

        rounded: quat
        remainder: quat

    @wp.func
    def matrix(q: quat):
        """Returns the matrix of ``wp.quat_rotate``, also for ``q`` that is not of unit length.

        Cheaper than ``wp.quat_to_matrix``, which rotates the three unit vectors.
        """
        x = two * q[0]
        y = two * q[1]
        z = two * q[2]
        xx = x * q[0]
        xy = x * q[1]
        xz = x * q[2]
        xw = x * q[3]
        yy = y * q[1]
        yz = y * q[2]
        yw = y * q[3]
        zz = z * q[2]
        zw = z * q[3]
        ww = two * q[3] * q[3] - one
        return mat33(
            ww + xx, xy - zw, xz + yw,
            xy + zw, ww + yy, yz - xw,
            xz - yw, yz + xw, ww + zz,
        )  # fmt: skip

    @wp.func
    def unit(q: quat):
        """Returns ``q``, of nearly unit length, normalized to rounding."""
        excess = wp.dot(q, q) - one
        if wp.abs(excess) < nearly:
            return (one - half * excess) * q
        return wp.normalize(q)

    @wp.func
    def rotated(q: quat, angle_W: vec3):
        """Returns ``q`` rotated by the rotation vector ``angle_W`` in W: exp(angle/2) q, normalized."""
        squared = real(0.25) * wp.dot(angle_W, angle_W)
        sinc = one
        cosine = one
        if squared < real(0.01):
            # Rotations within one step are small: the series is exact to rounding.
            sinc = one + squared * (s_1 + squared * (s_2 + squared * (s_3 + squared * s_4)))
            cosine = one + squared * (c_1 + squared * (c_2 + squared * (c_3 + squared * c_4)))
        else:
            angle = wp.sqrt(squared)
            sinc = wp.sin(angle) / angle
            cosine = wp.cos(angle)
        axis = (half * sinc) * angle_W
        return unit(quat(axis[0], axis[1], axis[2], cosine) * q)

    @wp.func
    def rotated_split(q: quat, remainder: quat, angle_W: vec3):
        """Returns ``q + remainder`` rotated by the rotation vector ``angle_W`` in W, as a ``SplitQuaternion``.

        A compensated sum: a rotation per step is often smaller than the rounding of the quaternion.
        """
        squared = real(0.25) * wp.dot(angle_W, angle_W)
        sinc = one
        cosine_excess = real(0.0)
        if squared < real(0.01):
            sinc = one + squared * (s_1 + squared * (s_2 + squared * (s_3 + squared * s_4)))
            cosine_excess = squared * (c_1 + squared * (c_2 + squared * (c_3 + squared * c_4)))
        else:
            angle = wp.sqrt(squared)
            sinc = wp.sin(angle) / angle
            cosine_excess = wp.cos(angle) - one
        axis = (half * sinc) * angle_W
        start = q
        excess = wp.dot(q, q) - one
        if wp.abs(excess) >= nearly:
            # A value that the user set.
            start = wp.normalize(q)
            excess = real(0.0)
        increment = quat(axis[0], axis[1], axis[2], cosine_excess) * start + remainder
        # A Newton step towards unit length is along the quaternion, so its rounding does not rotate.
        increment = increment - (half * excess) * start
        result = SplitQuaternion()
        result.rounded = start + increment
        rounded_increment = result.rounded - start
        result.remainder = (start - (result.rounded - rounded_increment)) + (increment - rounded_increment)
        return result

    @wp.func
    def rotation_vector(q: quat):
        """Returns the rotation vector of ``q``, at most π long; inverse of ``rotated``."""
        v = vec3(q[0], q[1], q[2])
        cosine = q[3]
        if cosine < real(0.0):
            v = -v
            cosine = -cosine
        sine = wp.length(v)
        if sine < real(1.0e-4):
            # asin(s)/s, exact to rounding.
            return (two + sine * sine / real(3.0)) * v
        return (two * wp.atan2(sine, cosine) / sine) * v

    @wp.func
    def spin(inverse_inertia_B: mat33, q_WB: quat, momentum_W: vec3):
        """Returns the angular velocity of a body with angular momentum ``momentum_W``, W [rad/s]."""
        return wp.quat_rotate(q_WB, inverse_inertia_B * wp.quat_rotate_inv(q_WB, momentum_W))

    return Functions(
        matrix=matrix,
        rotated=rotated,
        rotated_split=rotated_split,
        rotation_vector=rotation_vector,
        spin=spin,
    )
