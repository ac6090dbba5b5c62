"""Checks of arguments of a scene: options of contacts, meshes with active faces, lever arms and areas."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels.friction import Frictionless
from warpcontact.meshes import Mesh
from warpcontact.meshes.mesh import face_mask
from warpcontact.scene.elements import (
    FORCE_SCALE,
    KAPPA,
    MAX_DEPTH,
    TORSION_RADIUS,
    ContactMaterial,
    Points,
    needs_radius,
)
from warpcontact.validation import checks
from warpcontact.validation.checks import Array


def options_of(
    name: str,
    kappa: float,
    max_depth: float | None,
    torsion_radius: float | None,
    force_scale: float,
    enabled: bool,
    color: ArrayLike | None,
    visible: bool,
) -> dict[str, Any]:
    """Returns the checked options that all kinds of contacts have; arguments are those of ``add_contact``.

    Raises:
        ValueError: If a value is out of range; the message names it.
    """
    depth = math.inf if max_depth is None else max_depth
    return {
        "kappa": checks.numbers(f"{name}.kappa", kappa, (), KAPPA),
        "max_depth": checks.numbers(f"{name}.max_depth", depth, (), MAX_DEPTH),
        "torsion_radius": None
        if torsion_radius is None
        else checks.numbers(f"{name}.torsion_radius", torsion_radius, (), TORSION_RADIUS),
        "force_scale": checks.numbers(f"{name}.force_scale", force_scale, (), FORCE_SCALE),
        "enabled": np.array(float(checks.switch(f"{name}.enabled", enabled))),
        "color": checks.color(f"{name}.color", color),
        "visible": checks.switch(f"{name}.visible", visible),
    }


def check_arms(name: str, material: ContactMaterial, radius: Array, torsion_radius: float | None) -> None:
    """Raises ``ValueError`` if a part of the material has no radius or lever arm."""
    if torsion_radius is not None and isinstance(material.torsion, Frictionless):
        raise ValueError(f"{name}.torsion_radius is given, but its material has no torsion")
    part = needs_radius(material, torsion_radius is not None)
    if (radius == 0.0).any() and part is not None:
        kind = type(getattr(material, part)).__name__
        cure = " or a torsion_radius" if part == "torsion" else ""
        raise ValueError(f"{name}: the {part} of its material, {kind}, needs a radius{cure}, got a radius of 0 m")


def check_areas(name: str, material: ContactMaterial, points: Points) -> None:
    """Raises ``ValueError`` if a part of the material needs areas and the points have none."""
    for part, formula in material.formulas.items():
        if points.areas is None and formula.takes_area:
            raise ValueError(
                f"{name}: the {part} of its material, {type(formula).__name__}, was given no area [m²], and the "
                f"points {points.name!r} have none; create them with wc.sample_surface, pass areas to add_points, or "
                f"give the {part} an area"
            )


def active_of_each(label: str, choices: Any, meshes: Sequence[Mesh]) -> list[NDArray[np.bool_]]:
    """Returns the mask of each of several meshes; ``choices`` has one entry per mesh, or is ``None``."""
    if choices is None:
        choices = [None] * len(meshes)
    listed = isinstance(choices, list | tuple) or getattr(choices, "ndim", 0) > 0
    if not listed or len(choices) != len(meshes):
        got = len(choices) if listed else repr(choices)
        raise ValueError(f"{label} must have one entry for each of {len(meshes)} meshes, got {got}")
    return [
        face_mask(f"{label}[{i}]", choice, mesh)
        for i, (choice, mesh) in enumerate(zip(choices, meshes, strict=True))
    ]


def mesh_of(name: str, mesh: Any) -> Mesh:
    """Returns the checked mesh of surface ``name``."""
    if isinstance(mesh, Mesh):
        return mesh
    if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
        raise TypeError(f"mesh of {name!r} must be a wc.Mesh or have vertices and faces, got {mesh!r}")
    return Mesh(mesh.vertices, mesh.faces, name=name)
