"""Materials of UsdPhysics: friction and restitution of what collides, from the contacts that it takes part in."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpcontact.checks import Array
from warpcontact.kernels.frictions import Friction, Frictionless
from warpcontact.replay.replay import Replay
from warpcontact.usd.layout import WORLD

#: Of a friction: parameters that are its static coefficient, and its dynamic one; the first group it has.
STATIC = (("mu_static",), ("mu",), ("mu_1", "mu_2"))
DYNAMIC = (("mu_dynamic",), ("mu",), ("mu_1", "mu_2"))
# Schema attributes by the names of the coefficients.
_ATTRIBUTES = {"static": "StaticFriction", "dynamic": "DynamicFriction", "restitution": "Restitution"}


@dataclass(frozen=True, eq=False)
class Material:
    """What a contact says of what touches in it; ``None``: nothing.

    Attributes:
        name: Name of the first contact that has it.
        values: By ``"static"``, ``"dynamic"`` and ``"restitution"``: coefficients, (env,).
    """

    name: str
    values: dict[str, Array]

    @property
    def shared(self) -> bool:
        """Whether it is the same in all environments."""
        return all(bool((values == values[0]).all()) for values in self.values.values())

    @property
    def key(self) -> tuple[tuple[str, bytes], ...]:
        """Equal for materials that are."""
        return tuple((name, values.tobytes()) for name, values in self.values.items())


class Materials:
    """The material of everything that collides: that of the first of its contacts that has one.

    UsdPhysics has friction by material, and simulators take the mean of two; both sides of a contact get the same.
    """

    def __init__(self, replay: Replay) -> None:
        found: dict[tuple[tuple[str, bytes], ...], Material] = {}
        self._of: dict[tuple[str, str], Material] = {}
        for name, formulas, colliders in _contacts(replay):
            material = _material(replay, name, formulas)
            material = found.setdefault(material.key, material)
            for collider in colliders if material.values else ():
                self._of.setdefault(collider, material)
        used = {id(one) for one in self._of.values()}
        self.all = [one for one in found.values() if id(one) in used]

    def of(self, kind: str, name: str) -> Material | None:
        """Returns that of ``"points"``, a ``"surface"`` or a ``"shape"`` by its name."""
        return self._of.get((kind, name))

    def differ(self, kind: str, name: str) -> bool:
        """Whether something has others in other environments."""
        material = self.of(kind, name)
        return material is not None and not material.shared


def _contacts(replay: Replay) -> Iterator[tuple[str, dict[str, Any], list[tuple[str, str]]]]:
    scene = replay.scene
    for contact in scene.contacts:
        sides = [("points", contact.points.name), ("surface", contact.surface.name)]
        yield contact.name, contact.template.formulas, sides
    for smooth in scene.smooth_contacts:
        yield smooth.name, smooth.formulas, [("shape", shape.name) for shape in smooth.shapes]
    for mutual in scene.mutual_contacts:
        yield mutual.name, mutual.formulas, [("shape", shape.name) for shape in mutual.shapes]


def _material(replay: Replay, contact: str, formulas: dict[str, Any]) -> Material:
    friction: Friction = formulas["friction"]
    values = {}
    for name, groups in (("static", STATIC), ("dynamic", DYNAMIC)):
        group = next((one for one in groups if all(hasattr(friction, key) for key in one)), None)
        if isinstance(friction, Frictionless):
            values[name] = np.zeros(len(replay.envs))
        elif group is not None:
            each = [_values(replay, f"{contact}.friction.{key}", getattr(friction, key)) for key in group]
            values[name] = np.mean(each, axis=0)
    restitution = getattr(formulas["law"], "restitution", None)
    if restitution is not None:
        values["restitution"] = _values(replay, f"{contact}.law.restitution", restitution)
    return Material(contact, values)


def _values(replay: Replay, name: str, default: float) -> Array:
    """Returns a coefficient as recorded, or as in the scene, (env,); of a set whose items differ the mean."""
    count = len(replay.envs)
    if name not in replay.data:
        return np.full(count, float(default))
    recorded: Array = replay.variable(name).transpose("env", ...).values.astype(np.float64).reshape(count, -1)
    return recorded.mean(axis=1)


def material_path(material: Material, names: dict[str, str], env: str) -> str:
    """Returns where a material is: common to all environments, or in each."""
    return f"{WORLD if material.shared else env}/PhysicsMaterials/{names[material.name]}"


def define_material(stage: Any, path: str, material: Material, row: int) -> None:
    """Writes a material as in environment number ``row`` of the export."""
    from pxr import UsdGeom, UsdPhysics, UsdShade

    UsdGeom.Scope.Define(stage, path.rpartition("/")[0])
    prim = UsdShade.Material.Define(stage, path).GetPrim()
    prim.SetDocumentation(f"Friction and restitution of contact {material.name}.")
    UsdPhysics.MaterialAPI.Apply(prim)
    set_material(prim, material, row)


def set_material(prim: Any, material: Material, row: int) -> None:
    """Gives a material the coefficients of environment number ``row``."""
    from pxr import UsdPhysics

    api = UsdPhysics.MaterialAPI(prim)
    for name, values in material.values.items():
        getattr(api, f"Create{_ATTRIBUTES[name]}Attr")(float(values[row]))


def bind_material(prim: Any, path: str) -> None:
    """Lets what collides have the material at ``path``."""
    from pxr import UsdShade

    material = UsdShade.Material(prim.GetStage().GetPrimAtPath(path))
    api = UsdShade.MaterialBindingAPI.Apply(prim)
    api.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
