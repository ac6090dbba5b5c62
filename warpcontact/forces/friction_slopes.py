"""Slopes of friction models on the device, and the warning about time steps that are too long for them.

With dashpot slope c and spring slope k, explicit integration is stable for dt ≤ min(2 m/c, 2 √(m/k)).
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.friction import friction_jacobian
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel

KernelFactory = Callable[[type[Formula], type], wp.Kernel]
#: Returns the array of coefficients [env, item] of a formula on one device.
Coefficients = Callable[["DeviceModel"], Any]


def steepest_slopes(
    model: "Environments", friction: type[Formula], coefficients: Coefficients, load: Array, patch: Array
) -> tuple[Array, Array]:
    """Returns the maximum dashpot slope [N·s/m] and the spring slope [N/m] of a friction model, (env, item).

    Args:
        model: The model.
        friction: Class of the friction model.
        coefficients: Finds its coefficients.
        load: Normal force in the first environments, (env, item) [N].
        patch: Radius of the contact patch of a sphere in the first environments, (env, item) [m].
    """
    dashpot, spring = run_formula_kernel(model, friction, coefficients, friction_jacobian.kernel, (load, patch), 2)
    return dashpot, spring


def run_formula_kernel(
    model: "Environments",
    formula: type[Formula],
    coefficients: Coefficients,
    kernel: KernelFactory,
    inputs: Sequence[Array],
    outputs: int,
) -> list[Array]:
    """Returns the outputs of a kernel for a formula in the first environments, each (env, item).

    Args:
        model: The model.
        formula: The formula.
        coefficients: Finds its coefficients.
        kernel: Returns the kernel for a formula and precision.
        inputs: Its arguments after the coefficients, for the first environments, (env, item).
        outputs: Number of output arrays.
    """
    measured = [
        _run_on(one, formula, coefficients, kernel, [values[own] for values in inputs], outputs)
        for one, own in model.shares()
        if own.start < len(inputs[0])
    ]
    return [np.concatenate(values) for values in zip(*measured, strict=True)]


def _run_on(
    model: "DeviceModel",
    formula: type[Formula],
    coefficients: Coefficients,
    kernel: KernelFactory,
    inputs: Sequence[Array],
    outputs: int,
) -> list[Array]:
    """Returns the outputs of ``run_formula_kernel`` for the first environments of one device."""
    real, device, shape = model.types.real, model.device, inputs[0].shape
    arrays = [wp.array(np.ascontiguousarray(values), dtype=real, device=device) for values in inputs]
    results = [wp.zeros(shape, dtype=real, device=device) for _ in range(outputs)]
    wp.launch(
        kernel(formula, real),
        dim=shape,
        inputs=[coefficients(model)[: shape[0]], *arrays],
        outputs=results,
        device=device,
    )
    return [result.numpy().astype(np.float64) for result in results]


def unstable_friction_warning(
    model: "Environments",
    contact: str,
    part: str,
    kind: type[Formula],
    slopes: tuple[Array, Array],
    mass: Array,
    dt: float,
    load: str,
) -> list[str]:
    """Returns a warning if the time step is too long for a friction model.

    Args:
        model: The model.
        contact: Name of the contact.
        part: Part of its material.
        kind: Class of the friction model.
        slopes: Its dashpot and spring slopes, from ``steepest_slopes``.
        mass: Effective mass for its motion, (env, item) or (env, 1) [kg].
        dt: Time step [s].
        load: Name of the normal force, for the message.
    """
    dashpot, spring = slopes
    with np.errstate(divide="ignore", over="ignore"):
        limit = np.minimum(2.0 * mass / dashpot, 2.0 * np.sqrt(mass / np.maximum(spring, 0.0)))
    shortest = limit.min(axis=1)
    worst = int(np.argmin(shortest))
    if dt <= shortest[worst]:
        return []
    return [
        f"{contact}: dt = {dt:g} s is too long for its {part}, {kind.__name__}: it is unstable in "
        f"steps of more than {shortest[worst]:.2g} s in environment {model.first_env + worst} under "
        f"{load}. Reduce dt"
    ]
