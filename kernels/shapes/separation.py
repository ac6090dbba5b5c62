"""Evaluates the separation g(n) of two convex shapes along one direction; its maximum is the signed gap.

Margins (spheres that round the edges) only shift g and are excluded: all values are of the shrunk bodies.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes.base import Shape, mat33d, real, vec3d, zero
from warpcontact.kernels.types import Struct


@wp.func
def perpendicular(n: vec3d):
    """Returns a unit vector normal to the unit vector n."""
    if wp.abs(n[0]) < wp.abs(n[2]):
        return wp.normalize(vec3d(zero, n[2], -n[1]))
    return wp.normalize(vec3d(-n[1], n[0], zero))


class SeparationFunctions(NamedTuple):
    """Types and the device function of the separation of a pair of shape classes."""

    KinkMatrix: type  # matrix with one row per kink, at least one
    KinkVector: type  # vector with one element per kink, at least one
    CoefficientsA: Struct  # coefficients of shape a
    CoefficientsB: Struct  # coefficients of shape b
    evaluate_separation: wp.Function  # separation along a unit vector
    kink_count: int  # number of kinks of both shapes
    kink_count_a: int  # number of kinks of shape a, which come first


@functools.cache
def separation_functions(A: type[Shape], B: type[Shape]) -> SeparationFunctions:
    """Returns the device function of the separation of a pair, and its types."""
    CoefficientsA, CoefficientsB = coefficient_struct(A, real), coefficient_struct(B, real)
    kink_count, kink_count_a = A.kinks + B.kinks, A.kinks
    KinkMatrix = wp.types.matrix((max(kink_count, 1), 3), real)
    KinkVector = wp.types.vector(max(kink_count, 1), real)

    @wp.struct
    class Separation:
        value: real  # g [m]
        point_a: vec3d  # support point of the smooth part [m]
        point_b: vec3d  # [m]
        hessian_a: mat33d  # of the smooth parts [m]
        hessian_b: mat33d  # [m]
        kink_curvature_a: real  # of the first kinks
        kink_curvature_b: real
        disc_radius_a: real  # radius of the disc whose normal is −n [m]
        disc_radius_b: real
        kinks: KinkMatrix  # of a, then of b [m]
        kink_values: KinkVector  # n·kink [m]

    @wp.func
    def evaluate_separation(p_a: CoefficientsA, p_b: CoefficientsB, x: vec3d, R: mat33d, n: vec3d):
        """Evaluates the pair along the unit vector n."""
        separation = Separation()
        a = A.expand(p_a, -(n * R))
        b = B.expand(p_b, n)
        separation.point_a = x + R * a.point
        separation.point_b = b.point
        separation.hessian_a = (R * a.hessian) * wp.transpose(R)
        separation.hessian_b = b.hessian
        separation.kink_curvature_a = a.kink_curvature
        separation.kink_curvature_b = b.kink_curvature
        separation.disc_radius_a = a.disc_radius
        separation.disc_radius_b = b.disc_radius
        separation.value = wp.dot(n, separation.point_a - separation.point_b)
        if wp.static(A.kinks > 0):
            for i in range(wp.static(A.kinks)):
                # As a function of n; the expansion of a is along −n.
                separation.kinks[i] = -(R * a.kinks[i])
                separation.kink_values[i] = wp.dot(n, separation.kinks[i])
        if wp.static(B.kinks > 0):
            for i in range(wp.static(B.kinks)):
                separation.kinks[kink_count_a + i] = b.kinks[i]
                separation.kink_values[kink_count_a + i] = wp.dot(n, b.kinks[i])
        if wp.static(kink_count > 0):
            for i in range(wp.static(kink_count)):
                separation.value -= wp.abs(separation.kink_values[i])
        return separation

    return SeparationFunctions(
        KinkMatrix=KinkMatrix,
        KinkVector=KinkVector,
        CoefficientsA=CoefficientsA,
        CoefficientsB=CoefficientsB,
        evaluate_separation=evaluate_separation,
        kink_count=kink_count,
        kink_count_a=kink_count_a,
    )
