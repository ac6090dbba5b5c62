"""Finds bodies, colliders and joints that were added to an exported stage and are missing in its description.

The scene is built from the description alone, so these prims would be lost without notice.
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
    """Returns what a stage contains in addition to its description, each with the path of its prim.

    Lists rigid bodies, colliders, joints and other physics without a counterpart, unless they have the path and the
    name that an export gives an element; and a changed gravity.

    Args:
        stage: Stage with the description.
        description: Record of the description.
    """
    from pxr import Usd, UsdPhysics

    expected, time = _Expected(description), Usd.TimeCode.EarliestTime()
    found = []
    for prim in below(stage.GetPseudoRoot()):
        role, added = expected.role(prim), []
        if has(prim, "PhysicsRigidBodyAPI") and role != "body":
            enabled = is_on(UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr(), time)
            added += ["a rigid body"] if enabled else []
        if has(prim, "PhysicsCollisionAPI") and role != "collider":
            enabled = is_on(UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr(), time)
            added += ["a collider"] if enabled else []
        if role != "joint":
            added += reasons(prim)
        if prim.IsA(UsdPhysics.Scene):
            added += _gravity(stage, prim, description)
        found += [f"{path_of(prim)}: {what}, missing in the description" for what in added]
    return found


def _gravity(stage: Any, prim: Any, description: Record) -> list[str]:
    """Returns the gravity of a physics scene as text if it is neither the exported nor the described one."""
    written = prim.GetCustomDataByKey("warpcontact:gravity")
    expected = np.array(description["values"].get("gravity") if written is None else written, dtype=np.float64)
    gravity = read_gravity(stage, prim)
    if expected.shape == (3,) and np.linalg.norm(gravity - expected) <= _SINGLE * np.linalg.norm(expected):
        return []
    return [f"a gravity of {np.round(gravity, 6).tolist()} m/s²"]


class _Expected:
    """Paths at which an export places the elements of a description; the description is their sibling."""

    def __init__(self, description: Record) -> None:
        self.world = description["path"].rpartition("/")[0]
        folder = description["children"].get("Elements")
        elements = {} if folder is None else folder["children"]
        kinds = {prim: str(one["values"].get("kind")) for prim, one in elements.items()}
        self.bodies = {prim for prim, kind in kinds.items() if kind == "body"}
        # Carrier of each surface and shape; "Surfaces" for the world. With target "[]" it is derived elsewhere.
        self.carriers = {
            prim: one["targets"].get("body", ["Surfaces"])[0].rpartition("/")[2]
            for prim, one in elements.items()
            if kinds[prim] in ("surface", "shape") and one["targets"].get("body") != []
        }
        self.names = {prim: str(one["values"].get("name")) for prim, one in elements.items()}

    def role(self, prim: Any) -> str | None:
        """Returns whether a prim is a body, collider or joint of the description; ``None`` if neither."""
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

    def _named(self, prim: str, element_name: Any) -> bool:
        """Returns whether a prim name is that of the element whose name is stored on the prim."""
        from pxr import Tf

        if prim in self.names:
            return self.names[prim] == element_name
        # The contact points of contact couplings are not listed in the description.
        return (
            isinstance(element_name, str)
            and element_name not in self.names.values()
            and Tf.MakeValidIdentifier(element_name) == prim
        )
