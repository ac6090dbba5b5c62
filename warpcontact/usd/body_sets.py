"""Sets of bodies on a stage: one prim for the points or spheres on all bodies of a set."""

from typing import Any

import numpy as np

from warpcontact.drawing.body_sets import BodySet
from warpcontact.drawing.spheres import body_color
from warpcontact.usd.author import Samples, integers, store_element_name, vectors
from warpcontact.usd.geometry import set_color


def define_body_set(stage: Any, path: str, body_set: BodySet, width: float) -> None:
    """Writes what is constant over time; ``width`` is the diameter of points [m]."""
    from pxr import UsdGeom, Vt

    if body_set.are_points:
        points = UsdGeom.Points.Define(stage, path)
        points.CreateWidthsAttr(Vt.FloatArray([width]))
        points.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        set_color(points, body_color(body_set.body))
    else:
        spheres = UsdGeom.PointInstancer.Define(stage, path)
        ball = UsdGeom.Sphere.Define(stage, f"{path}/ball")
        ball.CreateRadiusAttr(1.0)
        ball.CreateExtentAttr(vectors(np.array([[-1.0] * 3, [1.0] * 3])))
        set_color(ball, body_color(body_set.body))
        spheres.CreatePrototypesRel().SetTargets([ball.GetPath()])
        spheres.CreateProtoIndicesAttr(integers(np.zeros(body_set.body.count)))
    prim = stage.GetPrimAtPath(path)
    store_element_name(prim, body_set.name)
    if body_set.contacts:
        prim.SetCustomDataByKey("warpcontact:contacts", Vt.StringArray(body_set.contacts))


def write_body_set(prim: Any, samples: Samples, body_set: BodySet, row: int) -> None:
    """Writes the positions over time in environment ``row`` of the export."""
    from pxr import UsdGeom

    places, reach = body_set.places[:, row], body_set.radii[row][:, None]
    if body_set.are_points:
        points = UsdGeom.Points(prim)
        attribute, reach = points.CreatePointsAttr(), np.full((1, 1), 0.5 * points.GetWidthsAttr().Get()[0])
    else:
        spheres = UsdGeom.PointInstancer(prim)
        attribute = spheres.CreatePositionsAttr()
        if samples.defaults:
            spheres.CreateScalesAttr(vectors(np.repeat(reach, 3, axis=1)))
    bounds = np.stack([(places - reach).min(axis=1), (places + reach).max(axis=1)], axis=1)
    samples.write(attribute, [vectors(entry) for entry in places])
    samples.write(UsdGeom.Boundable(prim).CreateExtentAttr(), [vectors(entry) for entry in bounds])
