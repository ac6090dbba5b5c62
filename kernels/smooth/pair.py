"""Two convex shapes seen along one direction: the function g(n) that their signed gap is the maximum of.

Spheres that round the edges of a shape only shift g, and are left out: all is of the bodies without their margins.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.formula import coefficient_struct
from warpcontact.kernels.smooth.base import Shape, mat33d, real, vec3d, zero


@wp.func
def tangent(n: vec3d):
    """A unit vector across the unit vector n."""
    if wp.abs(n[0]) < wp.abs(n[2]):
        return wp.normalize(vec3d(zero, n[2], -n[1]))
    return wp.normalize(vec3d(-n[1], n[0], zero))


@functools.cache
def functions(A: type[Shape], B: type[Shape]) -> SimpleNamespace:
    """Returns the struct ``View`` of a pair and the device functions that look at it."""
    Of_a, Of_b = coefficient_struct(A, real), coefficient_struct(B, real)
    count, of_a = A.kinks + B.kinks, A.kinks
    Rows = wp.types.matrix((max(count, 1), 3), real)
    Row = wp.types.vector(max(count, 1), real)

    @wp.struct
    class View:
        value: real  # g [m]
        point_a: vec3d  # of the smooth part of the support function [m]
        point_b: vec3d  # [m]
        hessian_a: mat33d  # of the smooth parts [m]
        hessian_b: mat33d  # [m]
        bend_a: real  # of their first kinks
        bend_b: real
        disc_a: real  # radius of the discs that n stands on [m]
        disc_b: real
        kinks: Rows  # of a, then of b [m]
        at: Row  # n·kink [m]

    @wp.func
    def look(p_a: Of_a, p_b: Of_b, x: vec3d, R: mat33d, n: vec3d):
        """The pair along the unit vector n."""
        view = View()
        a = A.expand(p_a, -(n * R))
        b = B.expand(p_b, n)
        view.point_a = x + R * a.point
        view.point_b = b.point
        view.hessian_a = (R * a.hessian) * wp.transpose(R)
        view.hessian_b = b.hessian
        view.bend_a = a.bend
        view.bend_b = b.bend
        view.disc_a = a.disc
        view.disc_b = b.disc
        view.value = wp.dot(n, view.point_a - view.point_b)
        if wp.static(A.kinks > 0):
            for i in range(wp.static(A.kinks)):
                # As a function of n; the shape is asked for −n.
                view.kinks[i] = -(R * a.kinks[i])
                view.at[i] = wp.dot(n, view.kinks[i])
        if wp.static(B.kinks > 0):
            for i in range(wp.static(B.kinks)):
                view.kinks[of_a + i] = b.kinks[i]
                view.at[of_a + i] = wp.dot(n, b.kinks[i])
        if wp.static(count > 0):
            for i in range(wp.static(count)):
                view.value -= wp.abs(view.at[i])
        return view

    return SimpleNamespace(View=View, Rows=Rows, Row=Row, Of_a=Of_a, Of_b=Of_b, look=look, count=count, of_a=of_a)
