"""Launches of kernels with arguments by name, so that their order cannot be wrong."""

from collections.abc import Mapping
from typing import Any

import warp as wp


def in_order(kernel: wp.Kernel, inputs: Mapping[str, Any]) -> list[Any]:
    """Returns the values of ``inputs`` in the order of the arguments of ``kernel``.

    Raises:
        TypeError: If an argument is missing, or a name is none of its arguments.
    """
    names = [argument.label for argument in kernel.adj.args]
    if inputs.keys() != set(names):
        problems = {
            "missing": [name for name in names if name not in inputs],
            "unexpected": [name for name in inputs if name not in names],
        }
        texts = (f"{problem}: {', '.join(found)}" for problem, found in problems.items() if found)
        raise TypeError(f"arguments of kernel {kernel.adj.fun_name}; {'; '.join(texts)}")
    return [inputs[name] for name in names]


def launch_kernel(
    kernel: wp.Kernel, dim: int | tuple[int, ...], /, *, device: wp.Device | None, **inputs: Any
) -> None:
    """Launches a kernel once.

    Args:
        kernel: The kernel.
        dim: Number of threads per dimension.
        device: Device.
        inputs: Arguments of the kernel.

    Raises:
        TypeError: If the names are not those of the arguments of the kernel.
    """
    wp.launch(kernel, dim=dim, inputs=in_order(kernel, inputs), device=device)
