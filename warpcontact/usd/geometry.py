"""Shapes of a stage: contact points as spheres or points, colours and looks."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.replay.spheres import Spheres, body_color
from warpcontact.usd.author import mark, vectors


def set_color(gprim: Any, color: ArrayLike) -> None:
    """Gives a shape one colour, RGB in 0…1."""
    gprim.CreateDisplayColorAttr(vectors(np.atleast_2d(color)))


def define_spheres(stage: Any, path: str, group: Spheres, point_width: float) -> None:
    """Writes spheres that collide, as they are in the first environment, or points.

    A single one becomes a prim at ``path``; a set has a child ``item_<number>`` per sphere, or is one
    ``UsdGeom.Points``.
    """
    from pxr import UsdGeom, UsdPhysics, Vt

    if group.are_points:
        points = UsdGeom.Points.Define(stage, path)
        points.CreateWidthsAttr(Vt.FloatArray([point_width]))
        points.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        set_color(points, body_color(group.body))
    else:
        if not group.contacts[0].points.single:
            UsdGeom.Xform.Define(stage, path)
        for item, one in enumerate(_sphere_paths(path, group)):
            sphere = UsdGeom.Sphere.Define(stage, one)
            if group.places[:, item].any():
                sphere.AddTranslateOp()
            set_color(sphere, body_color(group.body))
            UsdPhysics.CollisionAPI.Apply(sphere.GetPrim())
    prim = stage.GetPrimAtPath(path)
    mark(prim, group.name)
    prim.SetCustomDataByKey("warpcontact:contacts", Vt.StringArray([c.name for c in group.contacts]))
    set_spheres(stage, path, group, 0)


def set_spheres(stage: Any, path: str, group: Spheres, row: int) -> None:
    """Gives the spheres or points at ``path`` size and place of environment number ``row`` of the export."""
    from pxr import Gf, UsdGeom

    places = group.places[row]
    if group.are_points:
        points = UsdGeom.Points(stage.GetPrimAtPath(path))
        half = 0.5 * points.GetWidthsAttr().Get()[0]
        points.CreatePointsAttr(vectors(places))
        points.CreateExtentAttr(vectors(np.array([places.min(axis=0) - half, places.max(axis=0) + half])))
        return
    for item, one in enumerate(_sphere_paths(path, group)):
        sphere, radius = UsdGeom.Sphere(stage.GetPrimAtPath(one)), float(group.radii[row, item])
        sphere.CreateRadiusAttr(radius)
        sphere.CreateExtentAttr(vectors(np.array([[-radius] * 3, [radius] * 3])))
        for move in sphere.GetOrderedXformOps():
            move.Set(Gf.Vec3d(*places[item].tolist()))


def _sphere_paths(path: str, group: Spheres) -> list[str]:
    count = group.radii.shape[1]
    return [path] if group.contacts[0].points.single else [f"{path}/item_{item}" for item in range(count)]


def define_look(stage: Any, scope: str, prim: Any) -> None:
    """Writes a material that shows ``displayColor`` into ``scope`` and binds it to ``prim`` and all below.

    Renderers other than Hydra's own draw only what a material says.
    """
    from pxr import Sdf, UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, scope)
    path = f"{scope}/Display"
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.6)
    reader = UsdShade.Shader.Define(stage, f"{path}/Color")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    output = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(output)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
