"""Arguments of kernels are passed by name."""

import numpy as np
import pytest
import warp as wp

from warpcontact.system.launches import in_order, launch_kernel


@wp.kernel(module="unique", enable_backward=False)
def subtract(a: wp.array(dtype=wp.float32), b: wp.float32, difference: wp.array(dtype=wp.float32)):
    i = wp.tid()
    difference[i] = a[i] - b


def test_order_of_names_does_not_matter(device):
    a = wp.array([1.0, 2.0], dtype=wp.float32, device=device)
    result = wp.zeros_like(a)
    launch_kernel(subtract, 2, device=device, difference=result, b=0.5, a=a)
    np.testing.assert_array_equal(result.numpy(), [0.5, 1.5])


def test_missing_and_unexpected_names_are_refused():
    assert in_order(subtract, {"b": 1, "difference": 2, "a": 0}) == [0, 1, 2]
    message = "arguments of kernel subtract; missing: b, difference; unexpected: c"
    with pytest.raises(TypeError, match=message):
        in_order(subtract, {"a": 0, "c": 1})
