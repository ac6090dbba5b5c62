"""Sets of bodies on a stage: what moves with each of them, as one prim."""

from typing import Any

import numpy as np

from warpcontact.replay.spheres import body_color
from warpcontact.replay.swarms import Swarm
from warpcontact.usd.author import Samples, integers, mark, vectors
from warpcontact.usd.geometry import set_color


def declare_swarm(stage: Any, path: str, swarm: Swarm, width: float) -> None:
    """Writes what they have in common in all environments; ``width`` is that of points [m]."""
    from pxr import UsdGeom, Vt

    if swarm.are_points:
        points = UsdGeom.Points.Define(stage, path)
        points.CreateWidthsAttr(Vt.FloatArray([width]))
        points.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        set_color(points, body_color(swarm.body))
    else:
        spheres = UsdGeom.PointInstancer.Define(stage, path)
        ball = UsdGeom.Sphere.Define(stage, f"{path}/ball")
        ball.CreateRadiusAttr(1.0)
        ball.CreateExtentAttr(vectors(np.array([[-1.0] * 3, [1.0] * 3])))
        set_color(ball, body_color(swarm.body))
        spheres.CreatePrototypesRel().SetTargets([ball.GetPath()])
        spheres.CreateProtoIndicesAttr(integers(np.zeros(swarm.body.count)))
    prim = stage.GetPrimAtPath(path)
    mark(prim, swarm.name)
    if swarm.contacts:
        prim.SetCustomDataByKey("warpcontact:contacts", Vt.StringArray(swarm.contacts))


def write_swarm(prim: Any, samples: Samples, swarm: Swarm, row: int) -> None:
    """Writes where they are in environment number ``row`` of the export."""
    from pxr import UsdGeom

    places, reach = swarm.places[:, row], swarm.radii[row][:, None]
    if swarm.are_points:
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
