"""Cables that are shared by several tests of catenaries, and the solver without a model."""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.couplings.elastic_line import solve, solve_grounded, span, suspended_weight


@functools.cache
def _kernels():
    @wp.kernel(module="unique", enable_backward=False)
    def solve_free(
        warm: wp.array(dtype=wp.vec2d),
        lines: wp.array(dtype=wp.vec4d),
        found: wp.array(dtype=wp.vec2d),
        off: wp.array(dtype=wp.float64),
        used: wp.array(dtype=wp.int32),
        met: wp.array(dtype=wp.bool),
    ):
        i = wp.tid()
        line = lines[i]
        solution, evaluations, solved = solve(warm[i], line[0], line[1], line[2], line[3])
        place = span(solution[0], solution[1], line[2], line[3])
        found[i] = solution
        off[i] = wp.length(place - wp.vec2d(line[0], line[1]))
        used[i] = evaluations
        met[i] = solved

    @wp.kernel(module="unique", enable_backward=False)
    def solve_floor(
        warm: wp.array(dtype=wp.float64),
        heights: wp.array(dtype=wp.vec2d),
        lines: wp.array(dtype=wp.vec4d),
        found: wp.array(dtype=wp.vec3d),
        used: wp.array(dtype=wp.int32),
        met: wp.array(dtype=wp.bool),
    ):
        i = wp.tid()
        line = lines[i]
        height = heights[i]
        h, evaluations, solved = solve_grounded(warm[i], line[0], height[0], height[1], line[2], line[3])
        low = suspended_weight(h, height[0], line[2], line[3])
        high = suspended_weight(h, height[1], line[2], line[3])
        found[i] = wp.vec3d(h, low[0], high[0])
        used[i] = evaluations
        met[i] = solved

    return solve_free, solve_floor


def _arrays(count, *dtypes):
    return [wp.zeros(count, dtype=dtype, device="cpu") for dtype in dtypes]


def solve_suspended(lines, warm=None):
    """Solves suspended cables (x, y, weight, compliance): returns (h, v), span error, evaluations, convergence."""
    count = len(lines)
    start = np.zeros((count, 2)) if warm is None else warm
    inputs = [wp.array(start, dtype=wp.vec2d, device="cpu"), wp.array(lines, dtype=wp.vec4d, device="cpu")]
    outputs = _arrays(count, wp.vec2d, wp.float64, wp.int32, wp.bool)
    wp.launch(_kernels()[0], dim=count, inputs=inputs, outputs=outputs, device="cpu")
    return [output.numpy() for output in outputs]


def solve_with_seabed(lines, heights, warm=None):
    """Solves cables on a seabed: returns (h, V of lower end, V of upper end), evaluations, convergence."""
    count = len(lines)
    inputs = [
        wp.array(np.zeros(count) if warm is None else warm, dtype=wp.float64, device="cpu"),
        wp.array(heights, dtype=wp.vec2d, device="cpu"),
        wp.array(lines, dtype=wp.vec4d, device="cpu"),
    ]
    outputs = _arrays(count, wp.vec3d, wp.int32, wp.bool)
    wp.launch(_kernels()[1], dim=count, inputs=inputs, outputs=outputs, device="cpu")
    return [output.numpy() for output in outputs]


def in_elastic_units(x, y, stiffness_over_weight):
    """Returns cables (x, y, weight, compliance) in the unit of force of ``elastic_line.scale``."""
    weight = 1.0 / (1.0 + stiffness_over_weight * np.maximum(np.hypot(x, y) - 1.0, 0.0))
    return np.stack([x, y, weight, 1.0 / (weight * stiffness_over_weight)], axis=1)


def random_lines(count, seed=0):
    """Random cables: slack, within 1e-8 of taut, stretched, nearly vertical; stiff and soft."""
    rng = np.random.default_rng(seed)
    chord = rng.uniform(0.01, 1.5, count)
    nearly_taut = 1.0 + rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-8.0, -1.0, count)
    chord = np.where(rng.random(count) < 0.4, nearly_taut, chord)
    from_upright = np.where(
        rng.random(count) < 0.5, 10.0 ** rng.uniform(-9.0, 0.0, count), rng.uniform(0.0, np.pi / 2, count)
    )
    stiffness_over_weight = 10.0 ** rng.uniform(np.log10(2.0), 8.0, count)
    return in_elastic_units(chord * np.sin(from_upright), chord * np.cos(from_upright), stiffness_over_weight)
