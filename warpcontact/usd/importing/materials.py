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
# Attributes without a counterpart; they have an effect if they are greater than 0.
_UNUSED = {
    "newton:contactFrictionGain": "friction sticks by a spring that follows from the stiffness",
    "newton:contactAdhesion": "the contact does not attract",
}


def read_material(prim: Any, time: Any, metres: float, kilograms: float, findings: Findings) -> dict[str, Any]:
    """Returns the authored values of a material.

    Fallbacks of the schemas are not values of the material: unauthored friction would be zero, and rolling and
    torsional friction would depend on whether the plug-in of Newton's schemas is loaded.

    Args:
        prim: The prim of the material.
        time: Time code to read at.
        metres: Size of the stage's unit of length [m].
        kilograms: Size of its unit of mass [kg].
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
            findings.remark(prim, f"{name} {value:g} is not used: {reason}")
    if found["static"] is None and found["dynamic"] is None:
        findings.remark(
            prim, "the material has no authored friction: that of colliders without a material is taken"
        )
    return found


def is_material(prim: Any) -> bool:
    """Returns whether a prim is a physics material."""
    return has(prim, "PhysicsMaterialAPI")
