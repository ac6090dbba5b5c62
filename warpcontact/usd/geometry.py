"""Contact points of a stage as spheres or points, and display colors."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.drawing.spheres import Spheres, body_color
from warpcontact.usd.author import store_element_name, vectors


def set_color(gprim: Any, color: ArrayLike) -> None:
    """Sets the display color of a prim, RGB in 0…1."""
    gprim.CreateDisplayColorAttr(vectors(np.atleast_2d(color)))


def define_spheres(stage: Any, path: str, group: Spheres, point_width: float) -> None:
    """Writes contact points: colliding spheres, as in the first environment, or points without radius.

    A single sphere becomes a prim at ``path``. A set has a child ``item_<number>`` per sphere. Points are one
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
    store_element_name(prim, group.name)
    prim.SetCustomDataByKey("warpcontact:contacts", Vt.StringArray([c.name for c in group.contacts]))
    set_spheres(stage, path, group, 0)


def set_spheres(stage: Any, path: str, group: Spheres, row: int) -> None:
    """Sets radii and positions of the spheres or points at ``path`` to those of environment ``row`` of the export."""
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
