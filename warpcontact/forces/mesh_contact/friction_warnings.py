"""Warnings about time steps in which a friction would overshoot, measured on the friction itself."""

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
    from warpcontact.model.model import Model
    from warpcontact.scene.scene import Contact

KernelFactory = Callable[[type[Formula], type], wp.Kernel]

# Environments that are looked at, so that a warning does not take longer than the run.
MAX_CHECKED_ENVS = 4096
# Impact speed that estimates assume of bodies that start slower [m/s].
TYPICAL_SPEED = 1.0


def friction_warnings(model: "Environments", contact: "Contact", dt: float) -> list[str]:
    """Returns what to say about the friction models of a contact, a sentence for each whose step is too long.

    Under its share of the weight, and the pull-off force of a law that pulls, with the mass that slip, rolling or
    twist sees.

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
        return []  # nothing rests here by its weight
    gravity = np.linalg.norm(model["scene.gravity"][:envs], axis=1)[:, None]
    # Each body of a set rests on its one contact.
    bearing = 1 if contact.points.spread else contact.count
    load = np.broadcast_to(gravity / mobility["load"] / bearing, (envs, contact.count))
    radius = np.broadcast_to(_radius(model, contact)[:envs], load.shape)
    under = "its weight"
    if contact.material.law.pulls:
        mass = np.broadcast_to(1.0 / mobility["load"], load.shape)
        (tension,) = _run_kernel(model, contact, "law", pull_off.kernel, (mass, radius), outputs=1)
        load, under = load + tension, "its weight and pull-off force"
    # A sphere's patch under that load is a matter of the law; a depth of a thousandth of the radius is usual.
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
                f"{contact.name}: dt = {dt:g} s is too long for its {part}, {kind.__name__}, which overshoots in "
                f"steps of more than {shortest[worst]:.2g} s in environment {model.first_env + worst} under "
                f"{under}"
            )
    return sentences


def steepest_slopes(
    model: "Environments", contact: "Contact", part: str, load: Array, patch: Array
) -> tuple[Array, Array]:
    """Returns the steepest dashpot [N·s/m] and the spring [N/m] of a part, (env, item).

    Args:
        model: The model.
        contact: One of its contacts.
        part: Which of its friction_models.
        load: Normal force of the first environments, (env, item) [N].
        patch: Radius of the patch of a sphere, likewise [m].
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
    """Returns what a kernel measures on a part of a contact in the first environments, each (env, item).

    Args:
        model: The model.
        contact: One of its contacts.
        part: Which of its parts.
        kernel: Returns the kernel, by formula and precision.
        inputs: Its arrays after the coefficients, of the first environments, (env, item).
        outputs: Number of arrays that it writes.
    """
    measured = [
        _run_kernel_on(one, contact, part, kernel, [values[own] for values in inputs], outputs)
        for one, own in model.shares()
        if own.start < len(inputs[0])
    ]
    return [np.concatenate(values) for values in zip(*measured, strict=True)]


def _run_kernel_on(
    model: "Model", contact: "Contact", part: str, kernel: KernelFactory, inputs: Sequence[Array], outputs: int
) -> list[Array]:
    """Returns the same for the first environments of one device."""
    real, device, shape = model.types.real, model.device, inputs[0].shape
    group, first = model.group_of(contact)
    coefficients = getattr(group.coefficients, part)[: shape[0], first : first + contact.count]
    arrays = [wp.array(np.ascontiguousarray(values), dtype=real, device=device) for values in inputs]
    results = [wp.zeros(shape, dtype=real, device=device) for _ in range(outputs)]
    wp.launch(
        kernel(getattr(group.parts, part), real),
        dim=shape,
        inputs=[coefficients, *arrays],
        outputs=results,
        device=device,
    )
    return [result.numpy().astype(np.float64) for result in results]


def _mobilities(model: "Environments", contact: "Contact") -> dict[str, Array]:
    """Returns the inverse masses that slip, rolling and twist see, and that of the load, (env, 1) [1/kg].

    Of points on a set of bodies (env, item).
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
