"""Shapes of colliders as UsdGeom describes them, with validated values."""

from typing import Any

import numpy as np

from warpcontact.meshes.readers.polygons import triangulate
from warpcontact.meshes.readers.usd import polygons, without_holes
from warpcontact.usd.importing.findings import InvalidValue, Unsupported, number
from warpcontact.usd.importing.schemas import has, value_of

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
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InvalidValue(f"points[{bad[0]}] must be finite, got {vertices[bad[0]].tolist()}")
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
