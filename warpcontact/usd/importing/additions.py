"""What is on a stage of ours beside what its description says: bodies, colliders and joints that others added.

The description alone makes the scene, so that whatever lies elsewhere than an export puts it would be lost.
"""

import re
from typing import Any

import numpy as np

from warpcontact.usd.importing.findings import path_of
from warpcontact.usd.importing.physics import read_gravity
from warpcontact.usd.importing.prim_types import below, reasons
from warpcontact.usd.importing.records import Record
from warpcontact.usd.importing.schemas import has, is_on

_ENVIRONMENT = re.compile(r"env_\d+")
_ITEM = re.compile(r"item_\d+")
# Directions and magnitudes of gravity are single precision on a stage.
_SINGLE = 1.0e-6


def additions(stage: Any, description: Record) -> list[str]:
    """Returns what a stage has that its description does not have, each with the path of its prim.

    That is rigid bodies, colliders, joints and whatever else of physics has no counterpart, unless they lie where
    an export puts those of an element and have its name; and a gravity that was changed.

    Args:
        stage: The stage.
        description: Its description.
    """
    from pxr import Usd, UsdPhysics

    expected, time = _Expected(description), Usd.TimeCode.EarliestTime()
    found = []
    for prim in below(stage.GetPseudoRoot()):
        role, said = expected.role(prim), []
        if has(prim, "PhysicsRigidBodyAPI") and role != "body":
            enabled = is_on(UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr(), time)
            said += ["a rigid body"] if enabled else []
        if has(prim, "PhysicsCollisionAPI") and role != "collider":
            enabled = is_on(UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr(), time)
            said += ["a collider"] if enabled else []
        if role != "joint":
            said += reasons(prim)
        if prim.IsA(UsdPhysics.Scene):
            said += _gravity(stage, prim, description)
        found += [f"{path_of(prim)}: {what}, which the description does not have" for what in said]
    return found


def _gravity(stage: Any, prim: Any, description: Record) -> list[str]:
    """Returns the gravity of a physics scene in words if it is neither what was exported nor what is described."""
    written = prim.GetCustomDataByKey("warpcontact:gravity")
    expected = np.array(description["values"].get("gravity") if written is None else written, dtype=np.float64)
    gravity = read_gravity(stage, prim)
    if expected.shape == (3,) and np.linalg.norm(gravity - expected) <= _SINGLE * np.linalg.norm(expected):
        return []
    return [f"a gravity of {np.round(gravity, 6).tolist()} m/s²"]


class _Expected:
    """Where an export puts the elements of a description, beside which it lies."""

    def __init__(self, description: Record) -> None:
        self.world = description["path"].rpartition("/")[0]
        folder = description["children"].get("Elements")
        elements = {} if folder is None else folder["children"]
        kinds = {prim: str(one["values"].get("kind")) for prim, one in elements.items()}
        self.bodies = {prim for prim, kind in kinds.items() if kind == "body"}
        # What carries each surface and shape; of others it follows from what they are made of.
        self.carriers = {
            prim: one["targets"].get("body", ["Surfaces"])[0].rpartition("/")[2]
            for prim, one in elements.items()
            if kinds[prim] in ("surface", "shape") and one["targets"].get("body") != []
        }
        self.names = {prim: str(one["values"].get("name")) for prim, one in elements.items()}

    def role(self, prim: Any) -> str | None:
        """Returns whether a prim is a body, collider or joint of the description; ``None``: none of them."""
        path = str(prim.GetPath())
        if not path.startswith(f"{self.world}/"):
            return None
        parts = path.removeprefix(f"{self.world}/").split("/")
        if _ENVIRONMENT.fullmatch(parts[0]):
            parts = parts[1:]
        elif parts[0] != "Surfaces":
            return None
        if len(parts) == 3 and _ITEM.fullmatch(parts[2]):  # one sphere of a set
            prim, parts = prim.GetParent(), parts[:2]
        if not parts or not self._named(parts[-1], prim.GetCustomDataByKey("warpcontact:name")):
            return None
        match parts:
            case [name] if name in self.bodies:
                return "body"
            case ["joints", name] if name in self.bodies:
                return "joint"
            case [carrier, name] if carrier in self.bodies | {"Surfaces", "FixedPoints"}:
                return "collider" if self.carriers.get(name, carrier) == carrier else None
        return None

    def _named(self, prim: str, store_element_name: Any) -> bool:
        """Whether the name of a prim is that of the element whose name it is marked with."""
        from pxr import Tf

        if prim in self.names:
            return self.names[prim] == store_element_name
        # Contacts that a coupling made are elements which the description does not list.
        return (
            isinstance(store_element_name, str)
            and store_element_name not in self.names.values()
            and Tf.MakeValidIdentifier(store_element_name) == prim
        )
