"""Materials of UsdPhysics and Newton: friction, restitution and stiffness of colliders, from their contacts."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warpcontact.drawing.replay import Replay
from warpcontact.kernels import shapes
from warpcontact.kernels.friction import Friction, Frictionless
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.scene.body_contact import BodyContact
from warpcontact.scene.elements import Contact, ContactMaterial
from warpcontact.scene.shapes import Shape, ShapeContact
from warpcontact.usd.author import WORLD, identifiers
from warpcontact.validation.checks import Array

_FLAT = (shapes.Plane, shapes.RoundedBox)

#: Parameters of a friction model that give its static and dynamic coefficient: the first group that it has.
STATIC = (("mu_static",), ("mu",), ("mu_1", "mu_2"))
DYNAMIC = (("mu_dynamic",), ("mu",), ("mu_1", "mu_2"))
# Schema attributes by the names of the coefficients.
_ATTRIBUTES = {"static": "StaticFriction", "dynamic": "DynamicFriction", "restitution": "Restitution"}
# Attributes of NewtonMaterialAPI, all of type float.
_NEWTON_ATTRIBUTES = {
    "stiffness": "newton:contactStiffness",
    "damping": "newton:contactDamping",
    "rolling": "newton:rollingFriction",
    "torsion": "newton:torsionalFriction",
}
# Units of stiffness and damping of laws with linear force; other laws have no counterpart.
_LINEAR = {"stiffness": "N/m", "damping": "N·s/m"}


def rolling_radius(form: Form, other: Form) -> float | None:
    """Returns the rolling radius R of two shapes [m]; see ``Scene.add_shape_contact``.

    ``None`` if R depends on the contact point. Edges of boxes and end faces of cylinders are ignored, because
    nothing rolls on them.
    """
    for one, two in ((form, other), (other, form)):
        if isinstance(one, shapes.Sphere | shapes.Capsule | shapes.Cylinder) and isinstance(two, _FLAT):
            return one.radius
        if isinstance(one, shapes.Sphere) and isinstance(two, shapes.Sphere | shapes.Capsule):
            return one.radius * two.radius / (one.radius + two.radius)
    return None


@dataclass(frozen=True, eq=False)
class UsdMaterial:
    """Material properties given by a contact; properties without a counterpart are missing.

    Attributes:
        name: Name of the first contact with this material.
        prim: Name of its prim if the contact has a table of contact materials; otherwise that of the contact.
        values: Coefficients ``"static"``, ``"dynamic"`` and ``"restitution"``, and the values of NewtonMaterialAPI
            ``"stiffness"`` [N/m], ``"damping"`` [N·s/m], ``"rolling"`` [m] and ``"torsion"`` [m], each (env,).
    """

    name: str
    values: dict[str, Array]
    prim: str | None = None

    @property
    def shared(self) -> bool:
        """Whether the material is the same in all environments."""
        return all(bool((values == values[0]).all()) for values in self.values.values())

    @property
    def key(self) -> tuple[tuple[str, bytes], ...]:
        """Hashable value that is equal for equal materials."""
        return tuple((name, values.tobytes()) for name, values in self.values.items())


class UsdMaterials:
    """Materials of all colliders. A collider has the material of its first contact that gives one.

    UsdPhysics assigns friction to materials, and simulators combine two materials, for example by their mean. Both
    sides of a contact get the same material.
    """

    def __init__(self, replay: Replay) -> None:
        found: dict[tuple[tuple[str, bytes], ...], UsdMaterial] = {}
        self._by_collider: dict[tuple[str, str], UsdMaterial] = {}
        contacts = list(_contacts(replay))
        parts = [f"{contact.name}_{part.name}" for contact, part, _ in contacts if part is not None]
        prims = identifiers(parts, reserved=replay.scene.element_names())
        for contact, part, colliders in contacts:
            material = _material(replay, contact, part)
            if part is not None:
                material = replace(material, prim=prims[f"{contact.name}_{part.name}"])
            material = found.setdefault(material.key, material)
            for collider in colliders if material.values else ():
                self._by_collider.setdefault(collider, material)
        used = {id(one) for one in self._by_collider.values()}
        self.all = [one for one in found.values() if id(one) in used]

    def of(self, kind: str, name: str) -> UsdMaterial | None:
        """Returns the material of a collider; ``kind`` is ``"points"``, ``"surface"`` or ``"shape"``."""
        return self._by_collider.get((kind, name))

    def differ(self, kind: str, name: str) -> bool:
        """Returns whether the material of a collider differs between environments."""
        material = self.of(kind, name)
        return material is not None and not material.shared


@dataclass(frozen=True)
class _TablePart:
    """Pairs of a body contact that give the material of solids of one physics material.

    Attributes:
        name: The physics material.
        material: Contact material of the pairs.
        items: Numbers of the pairs.
    """

    name: str
    material: ContactMaterial
    items: list[int]


def _contacts(replay: Replay) -> Iterator[tuple[Any, _TablePart | None, list[tuple[str, str]]]]:
    """Yields contacts, a part of those with a table of contact materials, and their colliders."""
    scene = replay.scene
    for contact in scene.contacts:
        yield contact, None, [("points", contact.points.name), ("surface", contact.surface.name)]
    for shape_contact in scene.shape_contacts:
        yield shape_contact, None, [("shape", shape.name) for shape in shape_contact.shapes]
    for particle_contact in scene.particle_contacts:
        yield particle_contact, None, [("shape", shape.name) for shape in particle_contact.shapes]
    for body_contact in scene.body_contacts:
        solids = dict.fromkeys((*body_contact.first, *body_contact.second))
        named = {one: ("shape" if isinstance(one, Shape) else "surface", one.name) for one in solids}
        if body_contact.table is None:
            yield body_contact, None, list(named.values())
            continue
        for part in _table_parts(body_contact):
            yield body_contact, part, [key for one, key in named.items() if one.physics_material == part.name]


def _table_parts(contact: BodyContact) -> Iterator[_TablePart]:
    """Yields the part of each physics material: pairs with itself, or, without them, with the first other one."""
    pairs = [(first.physics_material, second.physics_material) for first, second in contact.pairs]
    for name in sorted({one for pair in pairs for one in pair if one is not None}):
        own = [pair for pair in pairs if name in pair]
        chosen = (name, name) if (name, name) in own else own[0]
        items = [i for i, pair in enumerate(pairs) if set(pair) == set(chosen)]
        yield _TablePart(name, contact.materials[items[0]], items)


def _material(replay: Replay, contact: Any, part: _TablePart | None) -> UsdMaterial:
    formulas = (contact if part is None else part).material.formulas
    items = None if part is None else part.items
    values: dict[str, Array] = {}
    for name, groups in (("static", STATIC), ("dynamic", DYNAMIC)):
        found = _coefficient(replay, contact.name, "friction", formulas["friction"], groups, items)
        if found is not None:
            values[name] = found
    law = formulas["law"]
    restitution = getattr(law, "restitution", None)
    if restitution is not None:
        values["restitution"] = _values(replay, f"{contact.name}.law.restitution", restitution, items)
    for name in _LINEAR if law.power == 1.0 else ():
        value = getattr(law, name, None)
        if value is not None and law.limits(name)["unit"] == _LINEAR[name]:
            values[name] = _values(replay, f"{contact.name}.law.{name}", value, items)
    if "stiffness" in values and {"restitution", "damping"}.isdisjoint(law.parameters()):
        values["damping"] = np.zeros(
            len(replay.envs)
        )  # elastic; without a value, importers use their default damping
    for name, arm_of in (("rolling", _rolling_arm), ("torsion", _torsion_arm)):
        if not isinstance(formulas[name], Frictionless):
            found, arm = _coefficient(replay, contact.name, name, formulas[name], DYNAMIC), arm_of(replay, contact)
            if found is not None and arm is not None:
                values[name] = found * arm
    return UsdMaterial(contact.name, values)


def _coefficient(
    replay: Replay,
    contact: str,
    part: str,
    friction: Friction,
    groups: tuple[tuple[str, ...], ...],
    items: list[int] | None = None,
) -> Array | None:
    """Returns a coefficient of friction, rolling or torsion of a contact, (env,), or ``None`` if it has none."""
    if isinstance(friction, Frictionless):
        return np.zeros(len(replay.envs))
    group = next((one for one in groups if all(hasattr(friction, key) for key in one)), None)
    if group is None:
        return None
    each = [_values(replay, f"{contact}.{part}.{key}", getattr(friction, key), items) for key in group]
    return np.asarray(np.mean(each, axis=0))


def _rolling_arm(replay: Replay, contact: Any) -> Array | None:
    """Returns the rolling radius of a contact, (env,) [m], or ``None`` if it is not a single number."""
    count = len(replay.envs)
    if isinstance(contact, Contact):
        radii = replay.radii(contact)
        return radii[:, 0] if radii.size and (radii == radii[:, :1]).all() and radii[:, 0].all() else None
    shapes = contact.shapes
    if any(f"{shape.name}.{size}" in replay.data for shape in shapes for size in shape.sizes):
        return None  # sizes differ between environments
    forms = [shape.form(item) for shape in shapes for item in range(shape.count)]
    if isinstance(contact, ShapeContact):
        radius = rolling_radius(*forms) if len(forms) == 2 else None
    else:
        sizes: set[float] = {form.radius for form in forms}
        radius = 0.5 * sizes.pop() if len(sizes) == 1 else None
    return None if radius is None else np.full(count, radius)


def _torsion_arm(replay: Replay, contact: Any) -> Array | None:
    """Returns the torsion radius of a contact, (env,) [m], or ``None`` if it depends on the penetration."""
    if contact.torsion_radius is None:
        return None
    return _values(replay, f"{contact.name}.torsion_radius", contact.torsion_radius)


def _values(replay: Replay, name: str, default: float, items: list[int] | None = None) -> Array:
    """Returns a coefficient, recorded or from the scene, (env,); for a set, the mean over its items, or over ``items``."""
    count = len(replay.envs)
    if name not in replay.data:
        return np.full(count, float(default))
    recorded: Array = replay.variable(name).transpose("env", ...).values.astype(np.float64).reshape(count, -1)
    return (recorded if items is None else recorded[:, items]).mean(axis=1)


def material_path(material: UsdMaterial, names: dict[str, str], env: str) -> str:
    """Returns the path of a material: below the world if shared, else below the environment ``env``."""
    name = names[material.name] if material.prim is None else material.prim
    return f"{WORLD if material.shared else env}/PhysicsMaterials/{name}"


def define_material(stage: Any, path: str, material: UsdMaterial, row: int) -> None:
    """Writes a material as in environment ``row`` of the export."""
    from pxr import UsdGeom, UsdPhysics, UsdShade

    UsdGeom.Scope.Define(stage, path.rpartition("/")[0])
    prim = UsdShade.Material.Define(stage, path).GetPrim()
    prim.SetDocumentation(f"Friction and restitution of contact {material.name}.")
    UsdPhysics.MaterialAPI.Apply(prim)
    if not _NEWTON_ATTRIBUTES.keys().isdisjoint(material.values):
        prim.AddAppliedSchema("NewtonMaterialAPI")
    set_material(prim, material, row)


def set_material(prim: Any, material: UsdMaterial, row: int) -> None:
    """Sets the coefficients of a material to those of environment ``row``."""
    from pxr import Sdf, UsdPhysics

    api = UsdPhysics.MaterialAPI(prim)
    for name, values in material.values.items():
        if name in _ATTRIBUTES:
            getattr(api, f"Create{_ATTRIBUTES[name]}Attr")(float(values[row]))
        else:
            prim.CreateAttribute(_NEWTON_ATTRIBUTES[name], Sdf.ValueTypeNames.Float, False).Set(float(values[row]))


def bind_material(prim: Any, path: str) -> None:
    """Binds the material at ``path`` to a collider."""
    from pxr import UsdShade

    material = UsdShade.Material(prim.GetStage().GetPrimAtPath(path))
    api = UsdShade.MaterialBindingAPI.Apply(prim)
    api.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
