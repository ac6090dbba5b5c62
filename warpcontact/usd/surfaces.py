"""Surfaces of a stage: shared by all environments, or with pose, scale and mesh per environment."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from warpcontact.drawing.surfaces import INACTIVE, Placement, surface_color
from warpcontact.scene.elements import Surface
from warpcontact.usd.author import add_pose, store_element_name, vectors, write_box
from warpcontact.usd.geometry import set_color


def write_surface(
    stage: Any,
    path: str,
    placement: Placement,
    row: int,
    mesh: str | None = None,
    *,
    physics: bool = True,
    color: bool = True,
) -> None:
    """Writes a surface as in environment ``row`` of the export.

    Args:
        stage: Stage to write to.
        path: Path of the new prim.
        placement: Surface with its poses, scales and meshes.
        row: Index of the environment.
        mesh: Path of a prim to refer to for the mesh; ``None``: writes the mesh.
        physics: Whether the surface collides.
        color: Whether to set the display colors.
    """
    from pxr import Gf, Kind, Usd, UsdGeom

    if mesh is None:
        prim = define_mesh(stage, path, placement.surface, int(placement.mesh[row]), physics=physics, color=color)
    else:
        prim = stage.DefinePrim(path, "Mesh")
        prim.GetReferences().AddInternalReference(mesh)
    xformable = UsdGeom.Xformable(prim)
    add_pose(xformable, placement.position[row], placement.orientation[row])
    if placement.scale[row] != 1.0:
        xformable.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(float(placement.scale[row])))
    if placement.surface.body is None:
        Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
        write_box(prim, *placement.surface.meshes[int(placement.mesh[row])].bounds)


def define_surfaces(stage: Any, path: str, placements: Mapping[str, Placement], names: Mapping[str, str]) -> None:
    """Writes surfaces below ``path`` as in the first environment."""
    for name, placement in placements.items():
        write_surface(stage, f"{path}/{names[name]}", placement, 0)


def define_shapes(
    stage: Any, path: str, placements: Mapping[str, Placement], names: Mapping[str, str], own: Collection[str]
) -> None:
    """Writes the meshes of the surfaces ``own``, which differ between environments, as classes below ``path``."""
    if not own:
        return
    stage.CreateClassPrim(path)
    for name in sorted(own):
        for index in sorted({int(mesh) for mesh in placements[name].mesh}):
            define_mesh(stage, f"{path}/{names[name]}_{index}", placements[name].surface, index)


def define_mesh(
    stage: Any, path: str, surface: Surface, index: int, *, physics: bool = True, color: bool = True
) -> Any:
    """Writes mesh ``index`` of a surface in its own frame, and returns its prim.

    ``physics`` and ``color`` as for ``write_surface``.
    """
    from pxr import UsdGeom, UsdPhysics, Vt

    mesh = UsdGeom.Mesh.Define(stage, path)
    prim = mesh.GetPrim()
    store_element_name(prim, surface.name)
    vertices, faces = surface.meshes[index].vertices, surface.meshes[index].faces
    mesh.CreatePointsAttr(vectors(vertices))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.reshape(-1))))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateExtentAttr(vectors(np.array([vertices.min(axis=0), vertices.max(axis=0)])))
    if not surface.visible:
        mesh.MakeInvisible()
    if color:
        _color_faces(mesh, surface, index)
    if physics:
        UsdPhysics.CollisionAPI.Apply(prim)
        UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.none)
    return prim


def _color_faces(mesh: Any, surface: Surface, index: int) -> None:
    """Sets the color of active faces, dims the others, and defines the active ones as a subset."""
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
    ).GetPrim().SetDocumentation("Active faces, which can be in contact.")
