"""Anderson acceleration of Gauss–Seidel sweeps: combines the last sweeps so that the change by a sweep is smallest.

A sweep maps impulses x to g(x). With the changes f = g(x) − x of the last sweeps and their differences Δf and Δg, the next
sweep starts from g − Σ γ Δg, where γ minimizes the norm of f − Σ γ Δf, in which each row is divided by its effective mass.
D. G. Anderson, "Iterative procedures for nonlinear integral equations", Journal of the ACM 12, 1965; H. Walker, P. Ni,
"Anderson acceleration for fixed-point iterations", SIAM Journal on Numerical Analysis 49, 2011.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from warpcontact.kernels.types import structs

#: Number of differences between sweeps that are combined.
HISTORY = 4
# Growth of the squared norm of the change by a sweep above which the differences are dropped.
MAX_GROWTH = 2.0


class Types(NamedTuple):
    """Types of sums over the stored differences, and of the differences of a row."""

    Products: Any  # one number per difference
    Gram: Any  # products of the differences with each other
    Differences: Any  # of a row: one vector per difference


@functools.cache
def types(real: type) -> Types:
    """Returns the types for ``real``."""
    return Types(
        Products=wp.types.vector(HISTORY, real),
        Gram=wp.types.matrix((HISTORY, HISTORY), real),
        Differences=wp.types.matrix((HISTORY, 3), real),
    )


class Functions(NamedTuple):
    """Device functions of Anderson acceleration."""

    #: ``(scratch, env, index, step, impulse, slot)``: stores the step and the impulse of a row after a sweep, and their
    #: differences to the last sweep in ``slot``. Returns the products of the steps Δf with that difference and with the
    #: step, and the squared norm of the step.
    record_step: wp.Function
    #: ``(scratch, env, index, coefficients)``: impulse of a row from which the next sweep starts, not projected.
    extrapolated: wp.Function
    #: As ``record_step``, of the couple of a row; only with ``rolls``.
    record_couple_step: wp.Function
    #: ``(scratch, env, index, couple, coefficients)``: as ``extrapolated``, of the couple of a row.
    extrapolated_couple: wp.Function


@functools.cache
def combination(real: type) -> wp.Function:
    """Returns the device function of the coefficients γ of the first differences; the others are 0.

    Its arguments are ``(gram, products, number)``: the products of the differences with each other and with the step, and
    the number of differences.
    """
    Products, Gram, _ = types(real)
    one = wp.constant(real(1.0))
    history = wp.constant(HISTORY)
    # Relative increase of the diagonal of the least-squares problem, and smallest relative pivot: rounding error.
    REGULARIZATION = wp.constant(real(8.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))

    @wp.func
    def combination(gram: Gram, products: Products, number: int):
        A = gram
        b = products
        inverse_pivots = Products()
        for i in range(history):
            if i < number:
                limit = REGULARIZATION * gram[i, i]
                pivot = A[i, i] + limit
                if pivot > limit:
                    inverse_pivots[i] = one / pivot
                    for j in range(i + 1, history):
                        factor = A[j, i] / pivot
                        for k in range(i + 1, history):
                            A[j, k] = A[j, k] - factor * A[i, k]
                        b[j] = b[j] - factor * b[i]
        coefficients = Products()
        for reverse in range(history):
            i = history - 1 - reverse
            rest = b[i]
            for j in range(i + 1, history):
                rest -= A[i, j] * coefficients[j]
            if i < number:
                coefficients[i] = rest * inverse_pivots[i]
        return coefficients

    return combination


@functools.cache
def functions(real: type, Scratch: type, rolls: bool) -> Functions:
    """Returns the device functions for ``real``. ``Scratch`` is the struct of a row.

    With ``rolls`` some contacts have rolling or spinning resistance.
    """
    vec3 = structs(real).vec3
    Products, _, Differences = types(real)
    history = wp.constant(HISTORY)
    Scratches = wp.array2d(dtype=Scratch)
    zero = wp.constant(real(0.0))

    @wp.func
    def with_difference(differences: Differences, slot: int, difference: vec3):
        """Returns the differences with another one in ``slot``."""
        changed = differences
        # An index that is not constant would need memory.
        for i in range(history):
            if i == slot:
                changed[i] = difference
        return changed

    @wp.func
    def record_step(scratch: Scratches, env: int, index: int, step: vec3, impulse: vec3, slot: int):
        difference = step - scratch[env, index].last_step
        steps = with_difference(scratch[env, index].step_differences, slot, difference)
        scratch[env, index].step_differences = steps
        scratch[env, index].impulse_differences = with_difference(
            scratch[env, index].impulse_differences, slot, impulse - scratch[env, index].last_impulse
        )
        scratch[env, index].last_step = step
        scratch[env, index].last_impulse = impulse
        weight = scratch[env, index].weight
        return weight * (steps * difference), weight * (steps * step), weight * wp.length_sq(step)

    @wp.func
    def extrapolated(scratch: Scratches, env: int, index: int, coefficients: Products):
        return scratch[env, index].impulse - wp.transpose(scratch[env, index].impulse_differences) * coefficients

    @wp.func
    def record_couple_step(scratch: Scratches, env: int, index: int, step: vec3, couple: vec3, slot: int):
        if wp.static(not rolls):
            return Products(), Products(), zero
        difference = step - scratch[env, index].last_couple_step
        steps = with_difference(scratch[env, index].couple_step_differences, slot, difference)
        scratch[env, index].couple_step_differences = steps
        scratch[env, index].couple_differences = with_difference(
            scratch[env, index].couple_differences, slot, couple - scratch[env, index].last_couple
        )
        scratch[env, index].last_couple_step = step
        scratch[env, index].last_couple = couple
        weight = scratch[env, index].couple_weight
        return weight * (steps * difference), weight * (steps * step), weight * wp.length_sq(step)

    @wp.func
    def extrapolated_couple(scratch: Scratches, env: int, index: int, couple: vec3, coefficients: Products):
        if wp.static(not rolls):
            return couple
        return couple - wp.transpose(scratch[env, index].couple_differences) * coefficients

    return Functions(
        record_step=record_step,
        extrapolated=extrapolated,
        record_couple_step=record_couple_step,
        extrapolated_couple=extrapolated_couple,
    )
