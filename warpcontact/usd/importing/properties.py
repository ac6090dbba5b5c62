"""Mass properties, physics materials in SI units, and shapes of colliders, from UsdPhysics, NewtonPhysics and UsdGeom."""

from math import inf, isfinite
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from warpcontact.meshes.readers.polygons import triangulate
from warpcontact.meshes.readers.usd import polygons, without_holes
from warpcontact.usd.importing.findings import (
    Findings,
    InvalidValue,
    Unsupported,
    has,
    is_authored,
    number,
    value_of,
    vector,
)

Array = npt.NDArray[np.float64]
# Negative principal moments up to this fraction of the largest one are attributed to rounding.
_ROUNDING = 1.0e-9

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

# Treatment of a mesh, by the authored approximation; other approximations have no counterpart.
APPROXIMATIONS = {
    "none": "mesh",
    "convexHull": "hull",
    "boundingCube": "box",
    "boundingSphere": "sphere",
    "convexDecomposition": "mesh",
    "meshSimplification": "mesh",
    "sdf": "mesh",
    "sdfMesh": "mesh",
}
#: Rotation by the ``axis`` attribute: rows are the x, y and z axes of the shape in the frame of its prim.
AXES = {
    "X": [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
    "Y": [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    "Z": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
}


def read_mass(prim: Any, placement: Array, time: Any, metres: float, kilograms: float) -> dict[str, Any]:
    """Returns the authored mass properties of a body or collider.

    Args:
        prim: Prim of the body or collider.
        placement: Matrix (4, 4) from prim to world [m], for column vectors.
        time: Time code to read at.
        metres: Length unit of the stage [m].
        kilograms: Mass unit of the stage [kg].

    Returns:
        ``mass`` [kg] and ``density`` [kg/m³], 0 if not given; and, ``None`` if not given, ``moments`` (3,) [kg·m²],
        ``axes`` (4,), quaternion (x, y, z, w) from principal axes to prim, and ``centre`` (3,), world [m].

    Raises:
        InvalidValue: If a value is out of range.
    """
    from pxr import UsdPhysics

    found: dict[str, Any] = {"mass": 0.0, "density": 0.0, "moments": None, "axes": None, "centre": None}
    if not has(prim, "PhysicsMassAPI"):
        return found
    api = UsdPhysics.MassAPI(prim)
    found["mass"] = kilograms * number(api.GetMassAttr(), time, least=0.0)
    found["name"] = str(prim.GetName())
    found["density"] = number(api.GetDensityAttr(), time, least=0.0) * kilograms / metres**3
    moments, axes = _tensor(prim, time)
    if moments is None:
        moments, axes = vector(api.GetDiagonalInertiaAttr(), time), _principal_axes(api, time)
    if moments.any():
        if (moments < 0.0).any():
            raise InvalidValue(f"physics:diagonalInertia must be positive, got {moments.tolist()}")
        found["moments"], found["axes"] = kilograms * metres**2 * moments, axes
    # The fallback, -inf in all components, means "not given".
    if value_of(api.GetCenterOfMassAttr(), time, (-inf,) * 3) != (-inf,) * 3:
        centre = vector(api.GetCenterOfMassAttr(), time)
        found["centre"] = placement[:3, :3] @ centre + placement[:3, 3]
    return found


def _principal_axes(api: Any, time: Any) -> Array | None:
    """Returns the authored principal axes, a quaternion (x, y, z, w) of unit length."""
    axes = value_of(api.GetPrincipalAxesAttr(), time)
    if axes is None:
        return None
    quaternion = np.array([*axes.GetImaginary(), axes.GetReal()], dtype=np.float64)
    length = float(np.linalg.norm(quaternion))
    if not isfinite(length):
        raise InvalidValue(f"physics:principalAxes must be finite, got {quaternion.tolist()}")
    return quaternion / length if length > 0.0 else None


def _tensor(prim: Any, time: Any) -> tuple[Array | None, Array | None]:
    """Returns principal moments and axes of ``newton:inertia``, which overrides those of PhysicsMassAPI."""
    attribute = prim.GetAttribute("newton:inertia")
    given = value_of(attribute, time, ()) if is_authored(attribute) else ()
    if not len(given):
        return None, None
    values = np.array(given, dtype=np.float64)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise InvalidValue(f"newton:inertia must be 6 finite numbers, got {values.tolist()}")
    xx, yy, zz, xy, xz, yz = values
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if moments[0] < -_ROUNDING * moments[2] or not moments[2] > 0.0:
        raise InvalidValue(f"newton:inertia must have positive principal moments, got {moments.tolist()}")
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return np.maximum(moments, 0.0), Rotation.from_matrix(axes).as_quat()


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
        ``name`` of the prim; ``static``, ``dynamic``, ``restitution`` [-], ``stiffness`` [N/m], ``damping`` [N·s/m], ``rolling`` and
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
    found["name"] = str(prim.GetName())
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


def shape_of(prim: Any, time: Any, most_faces: int) -> dict[str, Any]:
    """Returns the shape of a collider in the frame of its prim, in units of the stage.

    ``kind`` is "sphere" (``radius``), "box" (``half``, (3,)), "capsule" or "cylinder" (``radius``, ``half``),
    "cone" (``radius``, ``half``), "plane", or "mesh" (``vertices`` (V, 3), ``faces`` (F, 3), ``approximation``).
    All but sphere, box and mesh have ``axes`` (3, 3), whose rows are the shape's x, y and z axes in that frame.

    Raises:
        InvalidValue: If a value is invalid.
        Unsupported: If the shape has no counterpart.
    """
    from pxr import UsdGeom

    kind = str(prim.GetTypeName())
    if prim.IsA(UsdGeom.Mesh):
        return _mesh(prim, time, most_faces)
    if kind == "Sphere":
        return {"kind": "sphere", "radius": _length(prim, "radius", time)}
    if kind == "Cube":
        return {"kind": "box", "half": np.full(3, 0.5 * _length(prim, "size", time))}
    if kind == "Plane":
        return {"kind": "plane", "axes": _axes(prim, time)}
    if kind in ("Capsule", "Cylinder", "Cone"):
        sizes = {"radius": _length(prim, "radius", time), "half": 0.5 * _length(prim, "height", time)}
        return {"kind": kind.lower(), **sizes, "axes": _axes(prim, time)}
    if kind in ("Capsule_1", "Cylinder_1"):
        first, second = (_length(prim, name, time) for name in ("radiusBottom", "radiusTop"))
        if first != second:
            raise Unsupported(f"a {kind} of two radii, {first:g} and {second:g}, has no counterpart")
        sizes = {"radius": first, "half": 0.5 * _length(prim, "height", time)}
        return {"kind": kind.removesuffix("_1").lower(), **sizes, "axes": _axes(prim, time)}
    raise Unsupported(
        f"a collider of type {kind or 'none'}; allowed: Mesh, Sphere, Cube, Capsule, Cylinder, Cone, Plane"
    )


def _length(prim: Any, name: str, time: Any) -> float:
    return number(prim.GetAttribute(name), time, above=0.0)


def _axes(prim: Any, time: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    axis = str(prim.GetAttribute("axis").Get(time))
    if axis not in AXES:
        raise InvalidValue(f"axis must be one of {', '.join(AXES)}, got {axis!r}")
    return np.array(AXES[axis])


def _mesh(prim: Any, time: Any, most_faces: int) -> dict[str, Any]:
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh(prim)
    vertices, counts, corners = polygons(mesh, time)
    if max(counts.sum() - 2 * len(counts), len(vertices) / 3) > most_faces:
        raise InvalidValue(
            f"the mesh has {len(counts)} faces or more; allowed: {most_faces} triangles, see Limits"
        )
    invalid = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(invalid):
        raise InvalidValue(f"points[{invalid[0]}] must be finite, got {vertices[invalid[0]].tolist()}")
    outside = np.flatnonzero((corners < 0) | (corners >= len(vertices)))
    if len(outside):
        got = corners[outside[0]]
        raise InvalidValue(f"faceVertexIndices[{outside[0]}] must be from 0 to {len(vertices) - 1}, got {got}")
    faces, owner = triangulate(vertices, counts, corners)
    faces = faces[without_holes(mesh, time, len(counts))[owner]]
    if not len(faces):
        raise InvalidValue("the mesh has no faces")
    if str(mesh.GetOrientationAttr().Get(time)) == "leftHanded":
        faces = faces[:, ::-1]
    requested = "none"
    if has(prim, "PhysicsMeshCollisionAPI"):
        requested = str(value_of(prim.GetAttribute("physics:approximation"), time) or "none")
    if requested not in APPROXIMATIONS:
        raise Unsupported(f"the approximation {requested!r}; allowed: {', '.join(APPROXIMATIONS)}")
    return {"kind": "mesh", "vertices": vertices, "faces": faces, "approximation": requested}
