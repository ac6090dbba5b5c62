"""Areas of body contacts on a stage: one mesh per contact, whose triangles and colors change over time."""

from typing import Any

import numpy as np

from warpcontact.drawing.colors import Scale, linear, pressure_scale
from warpcontact.drawing.contact_pressure import PressurePatches
from warpcontact.drawing.content import Content
from warpcontact.usd.author import Samples, integers, vectors

#: Name of the mesh below the prim of its contact, and of its primvar of pressures.
NAME = "pressure"
# Distance of the mesh from the reference surface, as a multiple of the drawing size: surfaces at the same depth flicker.
LIFT = 1.0e-3


def define_patches(stage: Any, path: str, largest: float) -> None:
    """Defines the mesh of a contact, without triangles.

    Args:
        stage: Stage to write to.
        path: Path of the new prim.
        largest: Pressure of the upper end of the color scale [Pa].
    """
    from pxr import Sdf, UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(NAME, Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex)
    primvar.GetAttr().SetDocumentation("pressure [Pa]")
    mesh.GetPrim().SetDocumentation(
        f"Area of contact on the reference surface, colored by pressure from 0 to {largest:.6g} Pa (plasma)."
    )


def write_patches(
    prims: dict[str, Any], samples: Samples, content: Content, row: int, largest: float, size: float
) -> None:
    """Writes the areas of all contacts of environment ``row`` of the export over time.

    Args:
        prims: Mesh of each contact by name.
        samples: Destination of the values.
        content: Content of the records.
        row: Index of the environment.
        largest: Pressure of the upper end of the color scale [Pa].
        size: Size of the drawing [m].
    """
    from pxr import UsdGeom, Vt

    scale = pressure_scale(largest or 1.0)
    areas: dict[str, list[dict[str, Any]]] = {name: [] for name in prims}
    keys = ((record, row) for record in range(len(content.replay.codes)))
    for patches in content.pressure.each(keys):
        found = {one.name: one for one in patches}
        for name, values in areas.items():
            values.append(_mesh_values(found.get(name), scale, LIFT * size))
    for name, prim in prims.items():
        mesh = UsdGeom.Mesh(prim)
        pressures = UsdGeom.PrimvarsAPI(prim).GetPrimvar(NAME).GetAttr()
        attributes = {
            "points": mesh.GetPointsAttr(),
            "counts": mesh.GetFaceVertexCountsAttr(),
            "indices": mesh.GetFaceVertexIndicesAttr(),
            "colors": mesh.GetDisplayColorAttr(),
            "pressures": pressures,
            "extent": mesh.GetExtentAttr(),
        }
        for key, attribute in attributes.items():
            convert = {"counts": integers, "indices": integers, "pressures": Vt.FloatArray.FromNumpy}.get(
                key, vectors
            )
            samples.write(attribute, [convert(values[key]) for values in areas[name]])


def _mesh_values(patches: PressurePatches | None, scale: Scale, lift: float) -> dict[str, Any]:
    """Returns the values of the attributes of a mesh for the area of a contact; without triangles for ``None``."""
    positions, pressures = np.zeros((0, 3)), np.zeros(0)
    if patches is not None:
        refined = patches.refined(scale.high)
        positions = (refined.positions + lift * refined.normals[:, None]).reshape(-1, 3)
        pressures = refined.pressures.reshape(-1)
    rows, numbers = np.unique(np.column_stack([positions, pressures]), axis=0, return_inverse=True)
    extent = np.zeros((2, 3))
    if len(rows):
        extent = np.stack([rows[:, :3].min(axis=0), rows[:, :3].max(axis=0)])
    return {
        "points": rows[:, :3],
        "counts": np.full(len(positions) // 3, 3),
        "indices": numbers.reshape(-1),
        "colors": linear(scale.colors(rows[:, 3])),
        "pressures": np.ascontiguousarray(rows[:, 3], dtype=np.float32),
        "extent": extent,
    }
