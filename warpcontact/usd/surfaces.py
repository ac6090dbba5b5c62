"""Surfaces of a stage: as they are in all environments, or in each its own pose, size and mesh."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from warpcontact.replay.surfaces import INACTIVE, Placement, surface_color
from warpcontact.scene import Surface
from warpcontact.usd.author import add_pose, mark, vectors
from warpcontact.usd.geometry import set_color


def write_surface(stage: Any, path: str, placement: Placement, row: int, mesh: str | None = None) -> None:
    """Writes it as in environment number ``row``; ``mesh``: a prim to refer to for its shape."""
    from pxr import Gf, Kind, Usd, UsdGeom

    if mesh is None:
        prim = define_mesh(stage, path, placement.surface, int(placement.mesh[row]))
    else:
        prim = stage.DefinePrim(path, "Mesh")
        prim.GetReferences().AddInternalReference(mesh)
    xformable = UsdGeom.Xformable(prim)
    add_pose(xformable, placement.position[row], placement.orientation[row])
    if placement.scale[row] != 1.0:
        xformable.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(float(placement.scale[row])))
    if placement.surface.body is None:
        Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)


def define_surfaces(stage: Any, path: str, placements: Mapping[str, Placement], names: Mapping[str, str]) -> None:
    """Writes the surfaces that are fixed to the world and the same everywhere, below ``path``."""
    from pxr import Kind, Usd, UsdGeom

    scope = UsdGeom.Scope.Define(stage, path)
    Usd.ModelAPI(scope).SetKind(Kind.Tokens.group)
    for name, placement in placements.items():
        if placement.surface.body is None and placement.shared:
            write_surface(stage, f"{path}/{names[name]}", placement, 0)


def define_shapes(stage: Any, path: str, placements: Mapping[str, Placement], names: Mapping[str, str]) -> None:
    """Writes the meshes of the surfaces that differ between environments, as classes below ``path``."""
    own = {name: placement for name, placement in placements.items() if not placement.shared}
    if not own:
        return
    stage.CreateClassPrim(path)
    for name, placement in own.items():
        for index in sorted({int(mesh) for mesh in placement.mesh}):
            define_mesh(stage, f"{path}/{names[name]}_{index}", placement.surface, index)


def define_mesh(stage: Any, path: str, surface: Surface, index: int) -> Any:
    """Writes mesh number ``index`` of a surface as one that collides, in its own frame, and returns its prim."""
    from pxr import UsdGeom, UsdPhysics, Vt

    mesh = UsdGeom.Mesh.Define(stage, path)
    prim = mesh.GetPrim()
    mark(prim, surface.name)
    vertices, faces = surface.meshes[index].vertices, surface.meshes[index].faces
    mesh.CreatePointsAttr(vectors(vertices))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.reshape(-1))))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateExtentAttr(vectors(np.array([vertices.min(axis=0), vertices.max(axis=0)])))
    _color_faces(mesh, surface, index)
    if not surface.visible:
        mesh.MakeInvisible()
    UsdPhysics.CollisionAPI.Apply(prim)
    UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.none)
    return prim


def _color_faces(mesh: Any, surface: Surface, index: int) -> None:
    """Colours the active faces, dims the others, and names the active ones as a subset."""
    from pxr import UsdGeom, Vt

    color = surface_color(surface)
    active = surface.active[index]
    if active.all():
        set_color(mesh, color)
        return
    primvar = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.uniform)
    primvar.Set(vectors(np.array([color, INACTIVE * color])))
    primvar.SetIndices(Vt.IntArray.FromNumpy((~active).astype(np.int32)))
    UsdGeom.Subset.CreateGeomSubset(
        mesh,
        "active",
        UsdGeom.Tokens.face,
        Vt.IntArray.FromNumpy(np.flatnonzero(active).astype(np.int32)),
        "warpcontact",
        UsdGeom.Tokens.unrestricted,
    ).GetPrim().SetDocumentation("Faces that can touch.")
