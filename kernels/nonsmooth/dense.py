"""Iterative solvers for contact problems w = W l + q with dense matrices, one thread per problem.

A contact has ``dim`` rows: its normal, then one or two tangents. W, mu and rho may be shared by all problems.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth import cone

zero = wp.constant(wp.float64(0.0))
half = wp.constant(wp.float64(0.5))
one = wp.constant(wp.float64(1.0))
four = wp.constant(wp.float64(4.0))
# Iterations of the power method, and factor on its result, which is a lower bound.
POWER_ITERATIONS = 30
MARGIN = wp.constant(wp.float64(1.1))
# Gauss–Seidel: number of sweeps between checks, residual ratio that counts as stagnation, factor on the relaxation
# in that case, and its minimum.
PATIENCE = wp.constant(wp.int32(200))
STAGNATION = wp.constant(wp.float64(0.9))
REDUCTION = wp.constant(wp.float64(0.7))
MIN_RELAXATION = wp.constant(wp.float64(0.05))
# The problem with a fixed shift is solved to this fraction of the error of the shift before the shift is updated.
INNER_FRACTION = wp.constant(wp.float64(0.1))


@wp.struct
class Dense:
    """Problems w = W l + q with friction coefficients and solver data."""

    W: wp.array3d(dtype=wp.float64)  # [problem or 0, row, row]
    q: wp.array2d(dtype=wp.float64)  # [problem, row]
    mu: wp.array2d(dtype=wp.float64)  # [problem or 0, contact]
    rho: wp.array2d(dtype=wp.float64)  # [problem or 0, contact] ρ of the residual
    unit: wp.array2d(dtype=wp.float64)  # [problem, contact] scale of the residual, a force
    step: wp.array2d(dtype=wp.float64)  # [problem, contact] step length r of prox and of projected gradients
    lam: wp.array2d(dtype=wp.float64)  # [problem, row] l; in: the initial guess
    w: wp.array2d(dtype=wp.float64)  # [problem, row] scratch
    extrapolated: wp.array2d(dtype=wp.float64)  # [problem, row] scratch
    shift: wp.array2d(dtype=wp.float64)  # [problem, contact] scratch
    residual: wp.array(dtype=wp.float64)  # [problem]
    iterations: wp.array(dtype=wp.int32)  # [problem] number of iterations


class _Functions(NamedTuple):
    """Device functions of problems with a dense matrix."""

    load: wp.Function  # vector of one contact
    store: wp.Function  # sets the vector of one contact
    velocity: wp.Function  # W x + q of one contact
    velocities: wp.Function  # writes W x + q to ``w``; residual of x
    project: wp.Function  # point of the cone that is nearest to a vector
    residual: wp.Function  # relative violation of the contact law by one contact
    one_contact: wp.Function  # solution of one contact, exact to rounding


@functools.cache
def _functions(dim: int) -> _Functions:
    f = cone.functions(wp.float64)
    cone_residual = f.residual

    @wp.func
    def residual(lam: wp.vec3d, w: wp.vec3d, mu: wp.float64, rho: wp.float64, unit: wp.float64):
        """Returns the relative violation of Coulomb's law or of Signorini's condition, the larger one."""
        deviation = cone_residual(lam, w, mu, rho)
        if wp.static(dim > 1):
            deviation = wp.max(deviation, wp.abs(lam[0] - wp.max(lam[0] - rho * w[0], zero)))
        return deviation / unit

    @wp.func
    def load(x: wp.array2d(dtype=wp.float64), e: int, i: int):
        v = wp.vec3d()
        for a in range(dim):
            v[a] = x[e, dim * i + a]
        return v

    @wp.func
    def store(x: wp.array2d(dtype=wp.float64), e: int, i: int, v: wp.vec3d):
        for a in range(dim):
            x[e, dim * i + a] = v[a]

    @wp.func
    def velocity(p: Dense, x: wp.array2d(dtype=wp.float64), e: int, k: int, i: int):
        """Returns W x + q of contact ``i``."""
        v = load(p.q, e, i)
        for j in range(x.shape[1]):
            for a in range(dim):
                v[a] += p.W[k, dim * i + a, j] * x[e, j]
        return v

    @wp.func
    def velocities(p: Dense, x: wp.array2d(dtype=wp.float64), e: int, k: int):
        """Writes W x + q to ``w``; returns the residual of ``x``."""
        largest = zero
        for i in range(p.step.shape[1]):
            v = velocity(p, x, e, k, i)
            store(p.w, e, i, v)
            mu = p.mu[e % p.mu.shape[0], i]
            largest = wp.max(largest, residual(load(x, e, i), v, mu, p.rho[k, i], p.unit[e, i]))
        return largest

    return _Functions(load=load, store=store, velocity=velocity, velocities=velocities,
                           project=f.project, residual=residual, one_contact=f.one_contact)  # fmt: skip


@functools.cache
def steps(dim: int) -> wp.Kernel:
    """Returns the kernel of ``step``: ρ over the largest eigenvalue of √ρ W √ρ. Launch with dim problems."""

    @unique_kernel()
    def dense_steps(p: Dense):
        e = wp.tid()
        k = e % p.W.shape[0]
        rows = p.q.shape[1]
        for j in range(rows):
            # An irregular start vector, unlikely to be orthogonal to the eigenvector.
            p.extrapolated[e, j] = one + half * wp.sin(wp.float64(3 * j * j + j))
        largest = zero
        for _ in range(POWER_ITERATIONS):
            before = zero
            after = zero
            for i in range(rows):
                s = zero
                for j in range(rows):
                    s += p.W[k, i, j] * wp.sqrt(p.rho[k, j // dim]) * p.extrapolated[e, j]
                s *= wp.sqrt(p.rho[k, i // dim])
                p.w[e, i] = s
                after += s * s
                before += p.extrapolated[e, i] * p.extrapolated[e, i]
            largest = wp.sqrt(after / before)
            if after <= zero:
                break
            for i in range(rows):
                p.extrapolated[e, i] = p.w[e, i] / wp.sqrt(after)
        for i in range(p.step.shape[1]):
            p.step[e, i] = p.rho[k, i]
            if largest > zero:
                p.step[e, i] = p.rho[k, i] / (MARGIN * largest)

    return dense_steps


@functools.cache
def gauss_seidel(dim: int) -> wp.Kernel:
    """Returns the kernel of projected Gauss–Seidel. Launch with dim problems."""
    f = _functions(dim)
    load, store, velocity, velocities = f.load, f.store, f.velocity, f.velocities
    one_contact, residual = f.one_contact, f.residual

    @unique_kernel()
    def dense_gauss_seidel(p: Dense, tolerance: wp.float64, iterations: int):
        e = wp.tid()
        k = e % p.W.shape[0]
        contacts = p.step.shape[1]
        largest_residual = velocities(p, p.lam, e, k)
        relaxation = one
        last = wp.float64(wp.inf)
        iteration_count = wp.int32(0)
        while iteration_count < iterations and largest_residual > tolerance:
            largest = zero
            for i in range(contacts):
                mu = p.mu[e % p.mu.shape[0], i]
                v = velocity(p, p.lam, e, k, i)
                old = load(p.lam, e, i)
                largest = wp.max(largest, residual(old, v, mu, p.rho[k, i], p.unit[e, i]))
                W = wp.identity(n=3, dtype=wp.float64)
                for a in range(dim):
                    for b in range(dim):
                        W[a, b] = p.W[k, dim * i + a, dim * i + b]
                if wp.static(dim == 2):
                    W[2, 2] = W[1, 1]
                store(p.lam, e, i, old + relaxation * (one_contact(W, v - W * old, mu) - old))
            iteration_count += 1
            if wp.static(dim > 1) and iteration_count % PATIENCE == 0:
                # Strong coupling through friction can cause cycles; smaller changes end many of them.
                if largest > STAGNATION * last:
                    relaxation = wp.max(REDUCTION * relaxation, MIN_RELAXATION)
                last = largest
            # The residual during a sweep is close to that after it.
            if largest <= four * tolerance or iteration_count == iterations:
                largest_residual = velocities(p, p.lam, e, k)
        p.residual[e] = largest_residual
        p.iterations[e] = iteration_count

    return dense_gauss_seidel


@functools.cache
def prox(dim: int) -> wp.Kernel:
    """Returns the kernel of Uzawa's iteration l ← P(l − r ŵ) of all contacts. Launch with dim problems."""
    f = _functions(dim)
    load, store, velocities, project = f.load, f.store, f.velocities, f.project

    @unique_kernel()
    def dense_prox(p: Dense, tolerance: wp.float64, iterations: int):
        e = wp.tid()
        k = e % p.W.shape[0]
        largest_residual = velocities(p, p.lam, e, k)
        iteration_count = wp.int32(0)
        while iteration_count < iterations and largest_residual > tolerance:
            for i in range(p.step.shape[1]):
                v = load(p.w, e, i)
                mu = p.mu[e % p.mu.shape[0], i]
                v[0] += mu * wp.sqrt(v[1] * v[1] + v[2] * v[2])
                store(p.lam, e, i, project(load(p.lam, e, i) - p.step[e, i] * v, mu))
            largest_residual = velocities(p, p.lam, e, k)
            iteration_count += 1
        p.residual[e] = largest_residual
        p.iterations[e] = iteration_count

    return dense_prox


@functools.cache
def energy(dim: int) -> wp.Kernel:
    """Returns the kernel that minimizes ½ l·W l + (q + s)·l over the cones. Launch with dim problems.

    Projected gradients with Nesterov's momentum, restarted whenever it leads uphill. The shift s = μ |w_t| of the
    normals is fixed until the minimum is found to a tenth of the error of the shift, and then updated.
    """
    f = _functions(dim)
    load, store, velocities = f.load, f.store, f.velocities
    project = f.project

    @unique_kernel()
    def dense_energy(p: Dense, tolerance: wp.float64, iterations: int):
        e = wp.tid()
        k = e % p.W.shape[0]
        contacts = p.step.shape[1]
        for j in range(p.q.shape[1]):
            p.extrapolated[e, j] = p.lam[e, j]
        # w and the residual belong to ``extrapolated``, from which the step is taken.
        largest_residual = velocities(p, p.extrapolated, e, k)
        for i in range(contacts):
            v = load(p.w, e, i)
            p.shift[e, i] = p.mu[e % p.mu.shape[0], i] * wp.sqrt(v[1] * v[1] + v[2] * v[2])
        momentum = one
        relaxation = one
        last = wp.float64(wp.inf)
        iteration_count = wp.int32(0)
        while iteration_count < iterations and largest_residual > tolerance:
            inner = zero
            for i in range(contacts):
                v = load(p.w, e, i)
                v[0] += p.shift[e, i]
                mu = p.mu[e % p.mu.shape[0], i]
                y = load(p.extrapolated, e, i)
                inner = wp.max(inner, wp.length(y - project(y - p.rho[k, i] * v, mu)) / p.unit[e, i])
            if inner <= INNER_FRACTION * largest_residual:
                # Relaxed update of the shift; a smaller relaxation if the residual has grown.
                if largest_residual > last:
                    relaxation = wp.max(half * relaxation, wp.float64(0.05))
                last = largest_residual
                for i in range(contacts):
                    v = load(p.w, e, i)
                    target_shift = p.mu[e % p.mu.shape[0], i] * wp.sqrt(v[1] * v[1] + v[2] * v[2])
                    p.shift[e, i] += relaxation * (target_shift - p.shift[e, i])
                    store(p.lam, e, i, load(p.extrapolated, e, i))
                momentum = one
            ascent = zero
            for i in range(contacts):
                v = load(p.w, e, i)
                v[0] += p.shift[e, i]
                y = load(p.extrapolated, e, i)
                old = load(p.lam, e, i)
                new = project(y - p.step[e, i] * v, p.mu[e % p.mu.shape[0], i])
                ascent += wp.dot(y - new, new - old) / p.step[e, i]
                # Store the new l; ``w`` holds the step from the old one.
                store(p.lam, e, i, new)
                store(p.w, e, i, new - old)
            following = half * (one + wp.sqrt(one + four * momentum * momentum))
            weight = (momentum - one) / following
            momentum = following
            if ascent > zero:
                weight = zero
                momentum = one
            for j in range(p.q.shape[1]):
                p.extrapolated[e, j] = p.lam[e, j] + weight * p.w[e, j]
            largest_residual = velocities(p, p.extrapolated, e, k)
            iteration_count += 1
        for i in range(contacts):
            store(p.lam, e, i, project(load(p.extrapolated, e, i), p.mu[e % p.mu.shape[0], i]))
        p.residual[e] = largest_residual
        p.iterations[e] = iteration_count

    return dense_energy
