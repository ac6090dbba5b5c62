"""Vectorized test of the cached faces of a contact on a CPU."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.switches import is_enabled

#: Number of faces per test. The capacity of face lists is a multiple of it.
WIDTH = 8


@functools.cache
def candidates_within(real: type) -> wp.Function:
    """Returns the device function that tests which of the next cached faces may be as near as ``distance``.

    It tests at most ``WIDTH`` of ``count`` faces from index ``start`` on and returns them as bits, without the
    face ``first``. ``gone`` is the displacement of the point from the center of the list, ``slack`` the rounding
    error of the bounds. For the bound see ``face_cache.candidate_lower_bound``. A GPU tests one face after the
    other.
    """
    vec3 = {wp.float32: wp.vec3f, wp.float64: wp.vec3d}[real]
    Rows, Distances, Slopes = wp.array2d(dtype=wp.int32), wp.array2d(dtype=real), wp.array2d(dtype=vec3)
    scalar = {wp.float32: "float", wp.float64: "double"}[real]

    if not is_enabled("simd"):

        @wp.func
        def candidates_one_by_one(
            distances: Distances,
            slopes: Slopes,
            rows: Rows,
            env: int,
            start: int,
            count: int,
            gone: vec3,
            slack: real,
            distance: real,
            first: int,
        ):
            candidates = wp.int32(0)
            for k in range(wp.min(count, wp.static(WIDTH))):
                bound = distances[env, start + k] + wp.dot(slopes[env, start + k], gone) - slack
                if bound <= distance and rows[env, start + k] != first:
                    candidates = candidates | (1 << k)
            return candidates

        return candidates_one_by_one

    # Vector extensions of Clang, which splits vectors wider than a register. The components of a gradient are
    # adjacent.
    @wp.func_native(
        f"""
        const {scalar}* distance_of = wp::address(distances, env, start);
        const {scalar}* distance_gradient = reinterpret_cast<const {scalar}*>(wp::address(slopes, env, start));
        const int* row_of = wp::address(rows, env, start);
        #if defined(__CUDA_ARCH__)
        int those = 0;
        for (int k = 0; k < {WIDTH} && k < count; ++k) {{
            const {scalar}* slope = distance_gradient + 3 * k;
            const {scalar} along = slope[0] * gone[0] + slope[1] * gone[1] + slope[2] * gone[2];
            if (distance_of[k] + along - slack <= distance && row_of[k] != first) those |= 1 << k;
        }}
        return those;
        #else
        typedef {scalar} Numbers __attribute__((ext_vector_type({WIDTH})));
        typedef int Integers __attribute__((ext_vector_type({WIDTH})));
        typedef bool Flags __attribute__((ext_vector_type({WIDTH})));
        Numbers a, b, c, lower_bound;
        Integers row;
        memcpy(&a, distance_gradient, sizeof(a));
        memcpy(&b, distance_gradient + {WIDTH}, sizeof(b));
        memcpy(&c, distance_gradient + 2 * {WIDTH}, sizeof(c));
        memcpy(&lower_bound, distance_of, sizeof(lower_bound));
        memcpy(&row, row_of, sizeof(row));
        Numbers x = __builtin_shufflevector(a, b, 0, 3, 6, 9, 12, 15, 0, 0);
        Numbers y = __builtin_shufflevector(a, b, 1, 4, 7, 10, 13, 0, 0, 0);
        Numbers z = __builtin_shufflevector(a, b, 2, 5, 8, 11, 14, 0, 0, 0);
        x = __builtin_shufflevector(x, c, 0, 1, 2, 3, 4, 5, 10, 13);
        y = __builtin_shufflevector(y, c, 0, 1, 2, 3, 4, 8, 11, 14);
        z = __builtin_shufflevector(z, c, 0, 1, 2, 3, 4, 9, 12, 15);
        lower_bound = lower_bound + (x * gone[0] + y * gone[1] + z * gone[2]) - slack;
        const Flags those = __builtin_convertvector(lower_bound <= distance, Flags)
            & __builtin_convertvector(row != first, Flags);
        unsigned char bits;
        memcpy(&bits, &those, sizeof(bits));
        return count < {WIDTH} ? bits & ((1 << count) - 1) : bits;
        #endif
        """
    )
    def candidates_within(
        distances: Distances,
        slopes: Slopes,
        rows: Rows,
        env: int,
        start: int,
        count: int,
        gone: vec3,
        slack: real,
        distance: real,
        first: int,
    ) -> int: ...

    return candidates_within
