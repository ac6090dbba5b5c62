"""Coulomb's friction cone K = {(n, t): |t| ≤ μ n}, in contact axes (normal, two tangents).

l is the force or impulse on the first body and w the corresponding velocity (or gap and slip), w = W l + b. With
De Saxcé's ŵ = (w_n + μ |w_t|, w_t), Coulomb's law with Signorini's condition is: l in K, ŵ in the dual cone, l·ŵ =
0. Equivalently, l = P(l − ρ ŵ) with the projection P onto K and any ρ > 0.
"""

import functools
from typing import NamedTuple

import numpy as np
import warp as wp
from warpcontact.kernels.types import structs

# Enough for bisection alone, without any Newton step.
MAX_STEPS = 80


class Functions(NamedTuple):
    """Device functions of the friction cone, in contact axes."""

    basis: wp.Function  # two unit vectors normal to a unit vector; the three are right-handed
    project: wp.Function  # point of the cone that is nearest to a vector
    residual: wp.Function  # violation of the contact law, in units of the impulse
    one_contact: wp.Function  # solution of one contact, exact to rounding
    open_or_slipping_contact: wp.Function  # solution of a contact that cannot stick


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``, ``wp.float32`` or ``wp.float64``."""
    t = structs(real)
    vec3, mat33 = t.vec3, t.mat33
    zero, half, one, two = (wp.constant(real(x)) for x in (0.0, 0.5, 1.0, 2.0))
    rounding = float(np.finfo(wp.dtype_to_numpy(real)).eps)
    # A block with a smaller determinant, relative to the square of its trace, has a direction without mobility. A
    # velocity that is smaller, relative to its terms, counts as zero.
    SINGULAR = wp.constant(real(64.0 * rounding))
    TINY_RATIO = wp.constant(real(rounding * rounding))
    # Tolerance of |l_t|/(μ l_n) = 1 in slip.
    SLIP_TOLERANCE = wp.constant(real(4.0 * rounding))
    TINY = wp.constant(real(np.finfo(wp.dtype_to_numpy(real)).tiny))

    @wp.func
    def basis(n: vec3):
        """Returns two unit vectors normal to a unit vector ``n``; (n, first, second) is right-handed.

        Duff et al., "Building an orthonormal basis, revisited", 2017: without branches, exact to rounding.
        """
        side = wp.where(n[2] < zero, -one, one)
        a = -one / (side + n[2])
        b = n[0] * n[1] * a
        first = vec3(one + side * n[0] * n[0] * a, side * b, -side * n[0])
        second = vec3(b, side + n[1] * n[1] * a, -n[1])
        return first, second

    @wp.func
    def project(z: vec3, mu: real):
        """Returns the point of the cone that is nearest to ``z``."""
        across = wp.sqrt(z[1] * z[1] + z[2] * z[2])
        nearest = vec3()
        if z[0] >= zero and across <= mu * z[0]:
            nearest = z
        elif mu * across > -z[0]:
            a = (z[0] + mu * across) / (one + mu * mu)
            s = zero
            if across > zero:
                s = a * mu / across
            nearest = vec3(a, s * z[1], s * z[2])
        return nearest

    @wp.func
    def residual(lam: vec3, w: vec3, mu: real, rho: real):
        """Returns the violation of the contact law by ``lam`` at ``w``: │l − P(l − ρ ŵ)│, in units of l."""
        shift = mu * wp.sqrt(w[1] * w[1] + w[2] * w[2])
        return wp.length(lam - project(lam - rho * (w + vec3(shift, zero, zero)), mu))

    @wp.func
    def tangential_block(W: mat33, c1: real, c2: real):
        """Returns S, the change of w_t per l_t at constant w_n; entries (1, 1), (1, 2), (2, 2)."""
        return W[1, 1] - c1 * W[1, 0], W[1, 2] - c1 * W[2, 0], W[2, 2] - c2 * W[2, 0]

    @wp.func
    def open_or_slipping_contact(W: mat33, b: vec3, mu: real):
        """Returns ``one_contact`` of a contact that cannot stick: it is open or slips."""
        # An approach below the squared rounding of the slip counts as zero.
        least_approach = TINY_RATIO * (wp.abs(b[1]) + wp.abs(b[2]))
        if b[0] + least_approach >= zero or W[0, 0] <= TINY:
            return vec3()
        inverse = one / W[0, 0]
        frictionless_impulse = -b[0] * inverse  # l_n without friction
        if mu <= zero:
            return vec3(frictionless_impulse, zero, zero)

        # With w_n = 0: l_n = press − c·l_t and w_t = S l_t + e.
        c1 = W[1, 0] * inverse
        c2 = W[2, 0] * inverse
        S11, S12, S22 = tangential_block(W, c1, c2)
        e1 = b[1] - c1 * b[0]
        e2 = b[2] - c2 * b[0]
        trace = W[1, 1] + W[2, 2]
        det = S11 * S22 - S12 * S12
        regular = det > SINGULAR * trace * trace
        size = wp.sqrt(e1 * e1 + e2 * e2)
        noise = SINGULAR * (wp.abs(b[1]) + wp.abs(b[2]) + (wp.abs(c1) + wp.abs(c2)) * wp.abs(b[0])) + TINY
        if size <= noise:
            return vec3(frictionless_impulse, zero, zero)

        # Slip: w_t = −σ l_t, hence (S + σ) l_t = −e. Dimensionless: S and σ divided by the trace, l by
        # frictionless_impulse, in the principal axes of S, largest first: l_t = m p / det.
        unit = one / wp.where(trace > TINY_RATIO * W[0, 0], trace, W[0, 0])
        S11 *= unit
        S12 *= unit
        S22 *= unit
        half_difference = half * (S11 - S22)
        radius = wp.sqrt(half_difference * half_difference + S12 * S12)
        largest = wp.max(half * (S11 + S22) + radius, TINY_RATIO)
        smallest = (S11 * S22 - S12 * S12) / largest
        x1 = one
        x2 = zero
        if radius > zero:
            # Half of an angle, in the form without cancellation.
            along = wp.abs(half_difference) + radius
            x1 = wp.where(half_difference < zero, S12, along)
            x2 = wp.where(half_difference < zero, along, S12)
            inverse_length = one / wp.sqrt(x1 * x1 + x2 * x2)
            x1 *= inverse_length
            x2 *= inverse_length
        inverse_length = one / size
        q1 = (x1 * e1 + x2 * e2) * inverse_length
        q2 = (x1 * e2 - x2 * e1) * inverse_length
        d1 = x1 * c1 + x2 * c2
        d2 = x1 * c2 - x2 * c1
        if not regular:
            smallest = zero
            if wp.abs(q2) * size <= noise or mu * d2 * wp.sign(q2) >= one - SLIP_TOLERANCE:
                # No mobility in this direction. Either no motion is required, or there is no solution: the contact
                # would jam, with friction and normal impulse growing without bound.
                q2 = zero
                smallest = largest
        m = size * unit / frictionless_impulse
        # Solve g = μ l_n / |l_t| − 1 = 0. g is negative at low and positive at high. It is almost linear, and
        # linear for isotropic S. Newton's method, bracketed, starts at the root for slip in the presence of
        # isotropic S; the error is of the order of the square of S over σ.
        load_coupling = d1 * q1 + d2 * q2
        low = zero
        high = two * m * (one + mu * (wp.abs(d1) + wp.abs(d2))) / mu
        sigma = wp.max(m * (one / mu - load_coupling) - largest * q1 * q1 - smallest * q2 * q2, zero)
        p1 = zero
        p2 = zero
        for _ in range(MAX_STEPS):
            p1 = -q1 * (smallest + sigma)
            p2 = -q2 * (largest + sigma)
            det = (largest + sigma) * (smallest + sigma)
            inverse_length = one / wp.sqrt(p1 * p1 + p2 * p2)
            pressed = (det - m * (d1 * p1 + d2 * p2)) * inverse_length  # l_n det / |p|
            g = mu * pressed - m  # times m
            if wp.abs(g) <= SLIP_TOLERANCE * m or (g > zero and sigma == zero):
                break
            if g < zero:
                low = sigma
            else:
                high = sigma
            new = half * (low + high)
            slope = (
                largest
                + smallest
                + two * sigma
                + m * load_coupling
                + pressed * (p1 * q1 + p2 * q2) * inverse_length
            )
            if slope > zero:
                newton = sigma - g / (mu * inverse_length * slope)
                if newton > low and newton < high:
                    new = newton
            if new == sigma:
                break
            sigma = new
        scale = frictionless_impulse * m / det
        l1 = scale * (x1 * p1 - x2 * p2)
        l2 = scale * (x2 * p1 + x1 * p2)
        return vec3(frictionless_impulse - c1 * l1 - c2 * l2, l1, l2)

    @wp.func
    def one_contact(W: mat33, b: vec3, mu: real):
        """Returns the l of one contact with w = W l + ``b``, exact to rounding.

        W is symmetric and positive semidefinite. The contact is open if b_n ≥ 0. Otherwise it sticks, w = 0, if
        the cone admits it, and else slips with w_t opposite to l_t. If there is no normal mobility, l is 0. If
        there are several solutions, one of them is returned. There is a solution unless W is singular and ``b``
        requires motion without mobility; then a finite l that violates the law is returned.
        """
        if b[0] < zero and W[0, 0] > TINY and mu > zero:
            # Stick: S l_t = −e, by Cramer's rule.
            inverse = one / W[0, 0]
            c1 = W[1, 0] * inverse
            c2 = W[2, 0] * inverse
            S11, S12, S22 = tangential_block(W, c1, c2)
            e1 = b[1] - c1 * b[0]
            e2 = b[2] - c2 * b[0]
            det = S11 * S22 - S12 * S12
            if det > SINGULAR * (W[1, 1] + W[2, 2]) * (W[1, 1] + W[2, 2]):
                l1 = (S12 * e2 - S22 * e1) / det
                l2 = (S12 * e1 - S11 * e2) / det
                l_n = -b[0] * inverse - c1 * l1 - c2 * l2
                if l_n >= zero and l1 * l1 + l2 * l2 <= mu * mu * l_n * l_n:
                    return vec3(l_n, l1, l2)
        return open_or_slipping_contact(W, b, mu)

    return Functions(
        basis=basis,
        project=project,
        residual=residual,
        one_contact=one_contact,
        open_or_slipping_contact=open_or_slipping_contact,
    )
