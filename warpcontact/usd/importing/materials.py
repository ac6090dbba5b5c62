"""Physics materials of a stage: PhysicsMaterialAPI and NewtonMaterialAPI, in SI units."""

from math import inf
from typing import Any

from warpcontact.usd.importing.findings import Findings, number
from warpcontact.usd.importing.schemas import has, is_authored, value_of

#: Attributes of NewtonMaterialAPI by the name of the value, with the powers of the units of length and mass.
NEWTON = {
    "stiffness": ("newton:contactStiffness", 0, 1),
    "damping": ("newton:contactDamping", 0, 1),
    "rolling": ("newton:rollingFriction", 1, 0),
    "torsion": ("newton:torsionalFriction", 1, 0),
}
# Unsupported attributes; they would have an effect if greater than 0.
_UNUSED = {
    "newton:contactFrictionGain": "the tangential stiffness follows from the normal stiffness",
    "newton:contactAdhesion": "contacts do not attract",
}


def read_material(prim: Any, time: Any, metres: float, kilograms: float, findings: Findings) -> dict[str, Any]:
    """Returns the authored values of a material.

    Fallbacks of the schemas are ignored: unauthored friction would be zero, and rolling and torsional friction would
    depend on whether the plug-in of Newton's schemas is loaded.

    Args:
        prim: Prim of the material.
        time: Time code to read at.
        metres: Length unit of the stage [m].
        kilograms: Mass unit of the stage [kg].
        findings: Receives remarks.

    Returns:
        ``static``, ``dynamic``, ``restitution`` [-], ``stiffness`` [N/m], ``damping`` [N·s/m], ``rolling`` and
        ``torsion`` [m], ``None`` if not authored; ``density`` [kg/m³], 0 if not authored.

    Raises:
        InvalidValue: If a value is out of range.
    """
    from pxr import UsdPhysics

    api = UsdPhysics.MaterialAPI(prim)
    found: dict[str, Any] = {
        key: number(attribute, time, least=0.0, most=most) if is_authored(attribute) else None
        for key, attribute, most in (
            ("static", api.GetStaticFrictionAttr(), inf),
            ("dynamic", api.GetDynamicFrictionAttr(), inf),
            ("restitution", api.GetRestitutionAttr(), 1.0),
        )
    }
    found["density"] = number(api.GetDensityAttr(), time, least=0.0) * kilograms / metres**3
    for key, (name, length, mass) in NEWTON.items():
        attribute = prim.GetAttribute(name)
        found[key] = None
        # -inf requests the default of the engine.
        if is_authored(attribute) and value_of(attribute, time, -inf) != -inf:
            limits = {"above": 0.0} if key == "stiffness" else {"least": 0.0}
            found[key] = number(attribute, time, **limits) * metres**length * kilograms**mass
    for name, reason in _UNUSED.items():
        attribute = prim.GetAttribute(name)
        value = value_of(attribute, time, -inf) if is_authored(attribute) else -inf
        if value > 0.0:
            findings.remark(prim, f"{name} {value:g} is ignored: {reason}")
    if found["static"] is None and found["dynamic"] is None:
        findings.remark(
            prim, "the material has no authored friction: the default of colliders without a material is used"
        )
    return found


def is_material(prim: Any) -> bool:
    """Returns whether a prim is a physics material."""
    return has(prim, "PhysicsMaterialAPI")
