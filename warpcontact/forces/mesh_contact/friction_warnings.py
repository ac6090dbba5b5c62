"""Warnings about time steps that are too long for a friction model, from the Jacobian of its force.

With dashpot slope c and spring slope k, explicit integration is stable for dt ≤ min(2 m/c, 2 √(m/k)).
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.friction import Frictionless, friction_jacobian
from warpcontact.kernels.laws import pull_off
from warpcontact.scene.mobility import MIN_MOBILITY, mobility_of
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.elements import Contact

KernelFactory = Callable[[type[Formula], type], wp.Kernel]

# Maximum number of environments that are checked, to limit the time of the checks.
MAX_CHECKED_ENVS = 4096


def friction_warnings(model: "Environments", contact: "Contact", dt: float) -> list[str]:
    """Returns a warning for each friction model of a contact for which the time step is too long.

    The load is the weight per contact, plus the pull-off force of an adhesive law; the mass is the effective mass
    for sliding, rolling or torsion.

    Args:
        model: The model.
        contact: One of its contacts.
        dt: Time step [s].
    """
    envs = min(model.envs, MAX_CHECKED_ENVS)
    parts = {
        part: kind
        for part, kind in contact.material.parts._asdict().items()
        if part != "law" and not issubclass(kind, Frictionless)
    }
    if not parts:
        return []
    mobility = {name: values[:envs] for name, values in _mobilities(model, contact).items()}
    if (mobility["load"] < MIN_MOBILITY).any():
        return []  # immovable bodies carry no weight here
    gravity = np.linalg.norm(model["scene.gravity"][:envs], axis=1)[:, None]
    # Each body of a set has one contact.
    bearing = 1 if contact.points.spread else contact.count
    load = np.broadcast_to(gravity / mobility["load"] / bearing, (envs, contact.count))
    radius = np.broadcast_to(_radius(model, contact)[:envs], load.shape)
    under = "its weight"
    if contact.material.law.pulls:
        mass = np.broadcast_to(1.0 / mobility["load"], load.shape)
        (tension,) = _run_kernel(model, contact, "law", pull_off.kernel, (mass, radius), outputs=1)
        load, under = load + tension, "its weight and pull-off force"
    # The radius of the contact patch depends on the law; assume a typical penetration of R/1000: √(R δ).
    patch = np.sqrt(1.0e-3) * radius
    sentences = []
    for part, kind in parts.items():
        dashpot, spring = steepest_slopes(model, contact, part, load, patch)
        with np.errstate(divide="ignore", over="ignore"):
            mass = 1.0 / mobility[part]
            limit = np.minimum(2.0 * mass / dashpot, 2.0 * np.sqrt(mass / np.maximum(spring, 0.0)))
        shortest = limit.min(axis=1)
        worst = int(np.argmin(shortest))
        if dt > shortest[worst]:
            sentences.append(
                f"{contact.name}: dt = {dt:g} s is too long for its {part}, {kind.__name__}: it is unstable in "
                f"steps of more than {shortest[worst]:.2g} s in environment {model.first_env + worst} under "
                f"{under}. Reduce dt"
            )
    return sentences


def steepest_slopes(
    model: "Environments", contact: "Contact", part: str, load: Array, patch: Array
) -> tuple[Array, Array]:
    """Returns the maximum dashpot slope [N·s/m] and the spring slope [N/m] of a friction model, (env, item).

    Args:
        model: The model.
        contact: One of its contacts.
        part: Name of the part: ``"friction"``, ``"rolling"`` or ``"torsion"``.
        load: Normal force in the first environments, (env, item) [N].
        patch: Radius of the contact patch of a sphere in the first environments, (env, item) [m].
    """
    dashpot, spring = _run_kernel(model, contact, part, friction_jacobian.kernel, (load, patch), outputs=2)
    return dashpot, spring


def _run_kernel(
    model: "Environments",
    contact: "Contact",
    part: str,
    kernel: KernelFactory,
    inputs: Sequence[Array],
    outputs: int,
) -> list[Array]:
    """Returns the outputs of a kernel for a part of a contact in the first environments, each (env, item).

    Args:
        model: The model.
        contact: One of its contacts.
        part: Name of the part.
        kernel: Returns the kernel for a formula and precision.
        inputs: Its arguments after the coefficients, for the first environments, (env, item).
        outputs: Number of output arrays.
    """
    measured = [
        _run_kernel_on(one, contact, part, kernel, [values[own] for values in inputs], outputs)
        for one, own in model.shares()
        if own.start < len(inputs[0])
    ]
    return [np.concatenate(values) for values in zip(*measured, strict=True)]


def _run_kernel_on(
    model: "DeviceModel",
    contact: "Contact",
    part: str,
    kernel: KernelFactory,
    inputs: Sequence[Array],
    outputs: int,
) -> list[Array]:
    """Returns the outputs of ``_run_kernel`` for the first environments of one device."""
    real, device, shape = model.types.real, model.device, inputs[0].shape
    group, first = model.group_of(contact)
    coefficients = getattr(group.coefficients, part)[: shape[0], first : first + contact.count]
    arrays = [wp.array(np.ascontiguousarray(values), dtype=real, device=device) for values in inputs]
    results = [wp.zeros(shape, dtype=real, device=device) for _ in range(outputs)]
    wp.launch(
        kernel(getattr(group.contact_model, part), real),
        dim=shape,
        inputs=[coefficients, *arrays],
        outputs=results,
        device=device,
    )
    return [result.numpy().astype(np.float64) for result in results]


def _mobilities(model: "Environments", contact: "Contact") -> dict[str, Array]:
    """Returns the mobilities for sliding, rolling, torsion and load, (env, 1) [1/kg].

    For points on a set of bodies, (env, item).
    """
    radius = _radius(model, contact)
    name = f"{contact.name}.torsion_radius"
    arm = _columns(model[name]) if name in model else 0.0 * radius
    away = np.linalg.norm(contact.points.places, axis=1)
    reach = (away if contact.points.spread else away.max()) + radius
    total = {key: np.zeros((model.envs, 1)) for key in ("load", "friction", "rolling", "torsion")}
    for body in (contact.points.body, contact.surface.body):
        if body is None:
            continue
        own = mobility_of(model, contact, body)
        lever = reach if body is contact.points.body and own.rotates_with_force else 0.0
        total["load"] = total["load"] + own.linear
        total["friction"] = total["friction"] + own.linear + lever**2 * own.angular
        total["rolling"] = total["rolling"] + radius**2 * own.angular
        total["torsion"] = total["torsion"] + arm**2 * own.angular
    return {key: np.maximum(values, np.finfo(np.float64).tiny) for key, values in total.items()}


def _radius(model: "Environments", contact: "Contact") -> Array:
    return _columns(model[f"{contact.name}.radius"])


def _columns(values: Array) -> Array:
    return values[:, None] if values.ndim == 1 else values
