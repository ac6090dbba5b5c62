"""Projected Gauss–Seidel: one contact after the other is solved exactly, with what the others do held."""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, Work, first_env, structs, task_count
from warpcontact.kernels.unilateral import begin, cone, impulses, relative, standing
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs
from warpcontact.kernels.unique import unique_kernel

# Stages of a solve: the block of a row is made where it is first needed, and made anew, softer, after some sweeps.
RAW, EXACT, SOFTENED = 0, 1, 2
LATE = 50
# How much softer, over a third of its trace: a block without an inverse, and any block late. A row then goes less
# far from where it was, to the same solution; exact steps may go in circles, or grow, where friction is strong.
SOFT, SOFTER = 0.02, 0.3
# How often the direction of a slip is tried before an equation is solved for it.
TURNS = 4
# Sweeps that may pass without a smaller residual where that is of the size of rounding.
PATIENCE = 50


@functools.cache
def scratch(real: type, rolls: bool) -> type:
    """Returns the struct of what a solve keeps of a row."""
    t = structs(real)
    vec3, mat33 = t.vec3, t.mat33

    @wp.struct
    class Scratch:
        stage: wp.int32  # of the solve that the block is of
        rho: real  # [kg]
        free: vec3  # q, W [m/s]
        inverse: mat33  # of the block, W [kg]
        block: mat33  # w over an impulse, (normal, two tangents) [1/kg]
        before: vec3  # impulse before the sweep, W [N·s]
        swept: vec3  # impulse after the sweep before, W [N·s]
        guess: vec3  # impulse before the solve, W [N·s]
        if rolls:
            couple_guess: vec3  # likewise [N·m·s]
            turning: vec3  # relative angular velocity without contact, W [rad/s]

    return Scratch


@functools.cache
def kernel(real: type, moves: bool, rolls: bool, before: bool = False) -> wp.Kernel:
    """Returns the solver of a step; items: one per environment.

    Args:
        real: Precision.
        moves: Whether not all bodies are free.
        rolls: Whether any contact opposes rolling or spinning.
        before: Whether another solver comes after it where it does not converge: from the same guess, since what
            sweeps leave, of heavy bodies on light ones, is slow to go.

    It starts from the guess in ``rows`` and stops at the tolerance, where rounding lets the residual fall no
    more, or after some sweeps. Near the end a sweep looks first: where every row keeps its law nothing is
    changed, and the solve is over. What a sweep finds that changes something belongs to many states, so that
    the last looks alone. Between sweeps impulses go on with Nesterov's momentum, as in ``accelerated``.
    """
    t = structs(real)
    vec3 = t.vec3
    r = row_structs(real)
    Rows, Outcome = r.Rows, r.Outcome
    Moving = wp.array2d(dtype=moving_struct(real, moves))
    Change = wp.array2d(dtype=impulses.change_struct(real))
    Scratch = wp.array2d(dtype=scratch(real, rolls))
    c = cone.functions(real)
    basis, loose_contact = c.basis, c.loose_contact
    f = impulses.functions(real, moves)
    spin_after, spin_changed = relative.functions(real, moves).spin_after, f.spin_changed
    changed_at, push, push_both = f.changed_at, f.push, f.push_both
    turning_ease, in_discs = f.turning_ease, f.in_discs
    block_of, inverse_of, in_cone = f.block, f.inverse_of, f.in_cone
    eased, off_squared = f.eased, f.off_squared
    if not moves:
        stood_still = standing.functions(real, scratch(real, rolls))
        at_rest, stand, settle = stood_still.at_rest, stood_still.stand, stood_still.settle
    first = begin.functions(real, moves, rolls)
    clear, begin_row, spread, scale_of = first.clear, first.begin, first.spread, first.scale
    momentum, take, report = first.momentum, first.take, first.report
    zero, one, three = (wp.constant(real(x)) for x in (0.0, 1.0, 3.0))
    raw, softened = wp.constant(RAW), wp.constant(SOFTENED)
    soft, softer = wp.constant(real(SOFT)), wp.constant(real(SOFTER))
    patience = wp.constant(PATIENCE)
    rounding = np.finfo(wp.dtype_to_numpy(real))
    # What rounding may leave of a residual.
    ROUNDING = wp.constant(real(4.0 * float(rounding.eps)))
    LARGEST = wp.constant(real(float(rounding.max)))
    # Residual over the tolerance, squared, from which the next sweep does not look first.
    ROUGH = wp.constant(real(4.0))
    # Part of the tolerance below which a row is left as it is.
    KEPT = wp.constant(real(0.1))
    # Residual from which impulses on what is at rest are made right: of the size of rounding.
    STEADY = wp.constant(real(8.0 * float(rounding.eps)))
    # The direction of a slip is known where it turns no more than that.
    STRAIGHT = wp.constant(real(16.0 * float(rounding.eps)))
    # Velocity, over that of the impulse alone, squared, up to which a contact may soon stick.
    SLOW = wp.constant(real(0.1))

    @wp.func
    def start(rows: Rows, scratch: Scratch, env: int, count: int):
        """Notes with what sweeps begin."""
        for row in range(count):
            impulse = rows[env, row].impulse
            scratch[env, row].stage = raw
            scratch[env, row].before = impulse
            scratch[env, row].swept = impulse
            if wp.static(before):
                scratch[env, row].guess = impulse
                if wp.static(rolls):
                    scratch[env, row].couple_guess = rows[env, row].couple

    @wp.func
    def slide(rows: Rows, moving: Moving, env: int, row: int, impulse: vec3, w: vec3, rho: real):
        """The impulse of a row that slips fast, and whether it does: where it might stick as well, it need not.

        Friction is against the slip, and turns it little: what is found for one direction gives the next. It is
        not for a row that nothing moves apart.
        """
        n = rows[env, row].normal
        slip = w - wp.dot(w, n) * n
        speed_squared = wp.length_sq(slip)
        if rho * rho * speed_squared <= wp.length_sq(impulse):
            return impulse, 0
        mu = rows[env, row].mu
        one_body = rows[env, row].body_1
        other = rows[env, row].body_2
        arm_1 = rows[env, row].arm_1
        arm_2 = rows[env, row].arm_2
        free = w - eased(moving, env, one_body, arm_1, impulse) - eased(moving, env, other, arm_2, impulse)
        back = slip / wp.sqrt(speed_squared)
        for _ in range(TURNS):
            along = n - mu * back
            moved = eased(moving, env, one_body, arm_1, along) + eased(moving, env, other, arm_2, along)
            parting = wp.dot(moved, n)
            size = -wp.dot(free, n)
            if rho * parting <= soft or size <= zero:
                return impulse, 0
            size = size / parting
            slip = free + size * moved
            slip -= wp.dot(slip, n) * n
            speed = wp.length(slip)
            if speed <= zero:
                return impulse, 0
            turned = slip / speed
            off = wp.length_sq(turned - back)
            back = turned
            if off <= STRAIGHT * STRAIGHT:
                return size * along, 1
        return impulse, 0

    @wp.func
    def exact(
        rows: Rows, moving: Moving, scratch: Scratch, env: int, row: int, impulse: vec3, w: vec3, stage: int
    ):
        """The impulse that solves a row alone, from that which it has and its velocity ``w``, W."""
        n = rows[env, row].normal
        mu = rows[env, row].mu
        across_1, across_2 = basis(n)
        if scratch[env, row].stage != stage:
            scratch[env, row].stage = stage
            rho = scratch[env, row].rho
            W = block_of(moving, env, rows[env, row].body_1, rows[env, row].arm_1)
            W += block_of(moving, env, rows[env, row].body_2, rows[env, row].arm_2)
            inverse, invertible = inverse_of(W)
            if rho > zero and (stage == softened or invertible == 0):
                more = wp.where(stage == softened, softer, soft) / rho
                W += wp.diag(vec3(more, more, more))
                inverse, invertible = inverse_of(W)
            R = wp.matrix_from_cols(n, across_1, across_2)
            scratch[env, row].block = wp.transpose(R) * W * R
            scratch[env, row].inverse = inverse
        # Without slip, if the cone allows.
        new = impulse - scratch[env, row].inverse * w
        along = wp.dot(new, n)
        if along >= zero and wp.length_sq(new) <= (one + mu * mu) * along * along:
            return new
        W = scratch[env, row].block
        local = vec3(wp.dot(impulse, n), wp.dot(impulse, across_1), wp.dot(impulse, across_2))
        b = vec3(wp.dot(w, n), wp.dot(w, across_1), wp.dot(w, across_2)) - W * local
        local = loose_contact(W, b, mu)
        return local[0] * n + local[1] * across_1 + local[2] * across_2

    @unique_kernel()
    def gauss_seidel(
        work: Work,
        status: wp.array(dtype=wp.int32),
        rows: Rows,
        moving: Moving,
        outcome: Outcome,
        tolerance: real,
        iterations: int,
        scratch: Scratch,
        change: Change,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if status[env] != ENV_ACTIVE:
                continue
            count = outcome.count[env]
            if count == 0:
                report(outcome, env, zero, 0, 1)
                continue

            clear(change, env)
            finite = zero  # only if all terms are
            for row in range(count):
                free, rho, _trace, size = begin_row(rows, moving, change, env, row, tolerance)
                finite += size
                scratch[env, row].rho = rho
                scratch[env, row].free = free
                if wp.static(rolls):
                    turning = spin_after(moving, env, rows[env, row].body_1, rows[env, row].body_2)
                    scratch[env, row].turning = turning
            if not wp.isfinite(finite):
                report(outcome, env, finite, 0, 0)
                continue
            spread(rows, change, env, count)

            goal = tolerance * tolerance
            worst = zero
            least = LARGEST
            theta = one
            waited = wp.int32(0)
            last = wp.where(iterations <= 0, 1, 0)
            sweeps = wp.int32(0)
            stood = last
            stops = wp.int32(0)
            begun = wp.int32(0)
            if wp.static(rolls):
                begun = wp.int32(1)
                start(rows, scratch, env, count)
            steady = zero
            if wp.static(not moves):  # noqa: SIM102  only a static condition alone is pruned
                # What is at rest stays there, but for what stopped it in the last step and would push it back now.
                if at_rest(moving, change, env) == 1:
                    steady = STEADY * STEADY
            rough = wp.int32(0)
            stage = wp.int32(EXACT)
            while True:
                worst = zero
                uphill = zero
                changes = rough
                stands = wp.int32(0)
                for row in range(count):
                    one_body = rows[env, row].body_1
                    other = rows[env, row].body_2
                    arm_1 = rows[env, row].arm_1
                    arm_2 = rows[env, row].arm_2
                    n = rows[env, row].normal
                    mu = rows[env, row].mu
                    rho = scratch[env, row].rho
                    impulse = rows[env, row].impulse
                    scale = wp.max(scale_of(change, env, one_body, other, rho), wp.length_sq(impulse))
                    w = scratch[env, row].free + changed_at(change, env, one_body, arm_1)
                    w -= changed_at(change, env, other, arm_2)
                    off = zero
                    if rough == 0:
                        off = off_squared(impulse, w, n, mu, rho) / scale
                        worst = wp.max(worst, off)
                    if wp.static(not moves):  # noqa: SIM102  only a static condition alone is pruned
                        if stood == 0 and off > steady:
                            # Before anything is changed.
                            stood = 1
                            if rho * rho * wp.length_sq(w) < SLOW * wp.length_sq(impulse):
                                stands = stand(rows, moving, change, scratch, env, count)
                            if stands == 1:
                                break
                    if begun == 0 and off > goal:
                        begun = 1
                        start(rows, scratch, env, count)
                    if rough == 1 or (last == 0 and (off > goal or (changes > 0 and off > KEPT * KEPT * goal))):
                        changes += 1
                        slides = wp.int32(0)
                        new = impulse
                        if sweeps == 0:
                            new, slides = slide(rows, moving, env, row, impulse, w, rho)
                        if slides == 0:
                            new = exact(rows, moving, scratch, env, row, impulse, w, stage)
                        if rho > zero:
                            back = scratch[env, row].before - new
                            uphill += wp.dot(back, new - scratch[env, row].swept) / rho
                        step = new - impulse
                        if rough == 1:
                            worst = wp.max(worst, wp.length_sq(step) / scale)
                        rows[env, row].impulse = new
                        turn_1, turn_2 = wp.cross(arm_1, step), -wp.cross(arm_2, step)
                        push_both(moving, change, env, one_body, other, step, turn_1, turn_2)
                        impulse = new
                    if wp.static(rolls):
                        trace = turning_ease(moving, env, one_body) + turning_ease(moving, env, other)
                        if trace > zero:
                            turning = scratch[env, row].turning + spin_changed(change, env, one_body, other)
                            pressed = wp.max(wp.dot(impulse, n), zero)
                            couple = rows[env, row].couple
                            new = in_discs(
                                couple - three / trace * turning,
                                n,
                                rows[env, row].rolling * pressed,
                                rows[env, row].spinning * pressed,
                            )
                            step = new - couple
                            # As an impulse: over the arm at which both move a body as easily.
                            off = rho * trace / three * wp.length_sq(step) / scale
                            worst = wp.max(worst, off)
                            if last == 0 and (off > goal or (changes > 0 and off > KEPT * KEPT * goal)):
                                changes += 1
                                rows[env, row].couple = new
                                push(moving, change, env, one_body, vec3(), step)
                                push(moving, change, env, other, vec3(), -step)
                if stands == 1:
                    sweeps += 1
                    stops = wp.int32(1)
                    last = wp.where(sweeps >= iterations, 1, 0)
                    continue
                stood = 1
                if changes == 0:
                    break
                sweeps += 1
                if sweeps == LATE:
                    stage = softened
                waited += 1
                if worst < least:
                    least = worst
                    waited = 0
                if sweeps >= iterations or (waited >= patience and worst < ROUNDING * ROUNDING):
                    last = 1
                    rough = 0
                    continue
                rough = wp.where(worst > ROUGH * goal, 1, 0)

                # A sweep is a step down a hill. Its momentum leads on, and starts again where it leads uphill.
                if uphill > zero:
                    theta = one
                theta, beta = momentum(theta)
                for row in range(count):
                    swept = rows[env, row].impulse
                    new = swept
                    if beta > zero:
                        n = rows[env, row].normal
                        new = in_cone(swept + beta * (swept - scratch[env, row].swept), n, rows[env, row].mu)
                        rows[env, row].impulse = new
                        step = new - swept
                        one_body = rows[env, row].body_1
                        other = rows[env, row].body_2
                        turn_1 = wp.cross(rows[env, row].arm_1, step)
                        turn_2 = -wp.cross(rows[env, row].arm_2, step)
                        push_both(moving, change, env, one_body, other, step, turn_1, turn_2)
                    scratch[env, row].before = new
                    scratch[env, row].swept = swept

            take(moving, change, env)
            if wp.static(not moves):  # noqa: SIM102  only a static condition alone is pruned
                if worst <= goal and stops == sweeps:
                    settle(rows, moving, change, env, count, stops)
            if wp.static(before):  # noqa: SIM102  Warp would evaluate both sides
                if worst > goal:
                    for row in range(count):
                        rows[env, row].impulse = scratch[env, row].guess
                        if wp.static(rolls):
                            rows[env, row].couple = scratch[env, row].couple_guess
            report(outcome, env, wp.sqrt(worst), sweeps, wp.where(worst <= goal, 1, 0))

    return gauss_seidel
