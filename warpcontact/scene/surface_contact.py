"""Contact of two surfaces by sample points on one or both of them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.meshes import SurfaceSamples, sample_surface
from warpcontact.scene.elements import Contact, ContactMaterial, ContactOptions, Surface
from warpcontact.validation import checks

if TYPE_CHECKING:
    from warpcontact.scene.scene_data import SceneData

SIDES = ("first", "average")
#: Sampling methods with a fixed number of points.
COUNTED = ("vertices", "centroids")


def add_surface_contact(
    scene: "SceneData",
    surface_a: Surface,
    surface_b: Surface,
    material: ContactMaterial,
    samples: int | str | Sequence[int | str],
    *,
    seed: int,
    sides: str,
    name: str | None,
    options: ContactOptions,
) -> tuple[Contact, ...]:
    """Implements ``Scene.add_surface_contact``. If it raises an error, the scene is unchanged."""
    name = scene.new_name("contact", name)
    checks.choice(f"{name}.sides", sides, SIDES)
    scene.check_surface(f"{name}.surface_a", surface_a)
    scene.check_surface(f"{name}.surface_b", surface_b)
    pair = _pair(name, samples, sides)
    runs = [(surface_a, surface_b, pair[0], name)]
    if sides == "average":
        share = 0.5 * float(checks.numbers(f"{name}.force_scale", options.get("force_scale", 1.0), ()))
        options = {**options, "force_scale": share}
        runs = [
            (surface_a, surface_b, pair[0], f"{name}_first"),
            (surface_b, surface_a, pair[1], f"{name}_second"),
        ]
    made = []
    with scene.unchanged_on_error():
        for own, other, amount, label in runs:
            samples_of_own = sample_points(own, amount, seed, f"{name}.samples")
            points = scene.add_points(own, samples_of_own, name=f"{label}_points")
            made.append(scene.add_contact(points, other, material, name=label, **options))
    return tuple(made)


def sample_points(surface: Surface, amount: Any, seed: int, label: str) -> SurfaceSamples:
    """Returns sample points on the active faces of a surface, in the mesh frame.

    Args:
        surface: The surface.
        amount: Number of points, or one of ``COUNTED``.
        seed: Seed of the random distribution.
        label: Name of ``amount`` in messages.
    """
    amount = check_amount(label, amount)
    if len(surface.meshes) > 1:
        raise ValueError(
            f"{label}: {surface.name!r} must have one mesh, got {len(surface.meshes)}. Sample the other surface "
            "instead; or create points of each mesh with wc.sample_surface and add_points, add a contact for each, "
            f"and set <contact>.enabled to 1 if {surface.name}.mesh is that mesh, else to 0"
        )
    if not surface.active_faces.any():
        raise ValueError(f"{label}: {surface.name!r} has no active face to sample")
    if isinstance(amount, str):
        return sample_surface(surface.mesh, method=amount, faces=surface.active_faces)
    return sample_surface(surface.mesh, amount, seed=seed, faces=surface.active_faces)


def check_amount(label: str, amount: Any) -> int | str:
    """Returns ``amount`` if it is a number of points or one of ``COUNTED``, or raises ``ValueError``."""
    if isinstance(amount, str) and amount in COUNTED:
        return amount
    if isinstance(amount, int | np.integer) and not isinstance(amount, bool) and amount >= 1:
        return int(amount)
    options = " or ".join(map(repr, COUNTED))
    raise ValueError(f"{label} must be a whole number of points, at least 1, or {options}, got {amount!r}")


def _pair(name: str, samples: Any, sides: str) -> tuple[Any, Any]:
    if isinstance(samples, str) or not isinstance(samples, Sequence):
        return samples, samples
    if sides != "average" or len(samples) != 2:
        raise ValueError(
            f"{name}.samples must be one entry, or with sides='average' two, one for each surface, got {samples!r}"
        )
    return samples[0], samples[1]
