"""Vectorized traversal of an eight-wide BVH on a CPU, eight children per instruction."""

import functools
from typing import Any

import numpy as np
import warp as wp


@functools.cache
def next_leaf_function(real: type, Traversal: Any, PruningReference: Any, error: float) -> wp.Function:
    """Returns the device function that continues a traversal to the next leaf.

    Args:
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        Traversal: Struct of the state of a traversal, see ``narrowphase/bvh_search.py``.
        PruningReference: Struct of a closest point that is used to prune faces.
        error: Rounding error of a distance, in units of the float32 epsilon and its size.
    """
    vec3 = {wp.float32: wp.vec3f, wp.float64: wp.vec3d}[real]
    scalar, tiny = {wp.float32: ("float", "1e-37f"), wp.float64: ("double", "1e-300")}[real]
    # Bounds are stored in float32, including the unit normal of the disk.
    rounding = error * float(np.finfo(np.float32).eps)

    # Vector extensions of Clang, which splits vectors that are wider than a register. GPUs use no BVH of this
    # kind.
    @wp.func_native(
        f"""
        #if defined(__CUDA_ARCH__)
        return -1;
        #else
        typedef {scalar} Reals __attribute__((ext_vector_type(8)));
        typedef float Floats __attribute__((ext_vector_type(8)));
        typedef bool Flags __attribute__((ext_vector_type(8)));
        const Reals zero = 0, tiny = {tiny};
        const {scalar} rounding = {rounding};
        while (traversal.count > 0) {{
            const int node = traversal.node[--traversal.count];
            // Skip nodes that a closer face has excluded since they were pushed, and nodes with a NaN distance.
            if (!(traversal.lower_bound[traversal.count] <= within)) continue;
            if (node >= tree[1]) return tree[3] + node - tree[1];
            const float* numbers = bounds.data + 64 * (size_t(tree[0]) + node);
            auto read = [&](int which) {{
                Floats some;
                memcpy(&some, numbers + 8 * which, sizeof(some));
                return __builtin_convertvector(some, Reals);
            }};
            const Reals x = p[0] - read(0), y = p[1] - read(1), z = p[2] - read(2), radius = read(3);
            const Reals n_x = read(4), n_y = read(5), n_z = read(6);
            const Reals height = x * n_x + y * n_y + z * n_z;
            // Lateral distance from the components: a difference of squares would lose its digits to rounding.
            const Reals a = x - height * n_x, b = y - height * n_y, c = z - height * n_z;
            const Reals lateral = __builtin_elementwise_sqrt(a * a + b * b + c * c);
            const Reals above = __builtin_elementwise_abs(height);
            const Reals over = __builtin_elementwise_max(above - read(7), zero);
            const Reals beside = __builtin_elementwise_max(lateral - radius, zero);
            const Reals distance = __builtin_elementwise_sqrt(over * over + beside * beside);
            const Reals slack = rounding * (lateral + above + radius);
            const Reals lower_bound = distance - slack;
            Flags those = __builtin_convertvector(lower_bound <= within, Flags);
            if (reference.far > 0) {{
                // Condition of ``lead_distance`` without a root, with the gradient of the disk distance.
                const {scalar} far = reference.far, d = reference.distance;
                const Reals ahead = lower_bound - d;
                const Reals turning = ahead / far - (far / d + reference.rounding)
                    - slack / __builtin_elementwise_max(distance, tiny);
                const Reals up = over / __builtin_elementwise_max(distance, tiny);
                const Reals side = beside / __builtin_elementwise_max(distance * lateral, tiny);
                const Reals along = __builtin_elementwise_copysign(up, height);
                const Reals u = along * n_x + side * a - reference.direction[0];
                const Reals v = along * n_y + side * b - reference.direction[1];
                const Reals w = along * n_z + side * c - reference.direction[2];
                const Flags behind = __builtin_convertvector(ahead >= 2 * far, Flags);
                const Flags turned = __builtin_convertvector(turning > 0, Flags)
                    & __builtin_convertvector(u * u + v * v + w * w < turning * turning, Flags);
                those = those & ~(far < ({scalar})0.5 * d ? behind | turned : behind);
            }}
            unsigned char bits;
            memcpy(&bits, &those, sizeof(bits));
            const int child = node == 0 ? 1 : 8 * node + tree[2] - 7;
            const int start = traversal.count;
            for (int left = bits; left != 0; left &= left - 1) {{
                const int k = __builtin_ctz(left);
                int at = traversal.count++;
                while (at > start && traversal.lower_bound[at - 1] < lower_bound[k]) {{
                    traversal.lower_bound[at] = traversal.lower_bound[at - 1];
                    traversal.node[at] = traversal.node[at - 1];
                    --at;
                }}
                traversal.lower_bound[at] = lower_bound[k];
                traversal.node[at] = child + k;
            }}
        }}
        return -1;
        #endif
        """
    )
    def next_leaf(
        traversal: wp.ref[Traversal],
        bounds: wp.array(dtype=wp.float32),  # ``Model.bvh_bound``
        tree: wp.vec4i,
        p: vec3,
        within: real,
        reference: PruningReference,
    ) -> int:
        """Returns the index in ``Model.bvh_face`` of the next face that may be ``within`` reach; −1: none.

        Faces that ``reference`` dominates are skipped.
        """
        ...

    return next_leaf
