"""Moving curves of a stage: polylines with one width and one color."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.usd.author import Samples, vectors
from warpcontact.usd.geometry import set_color
from warpcontact.validation.checks import Array

#: Width of curves, as a multiple of the drawing size.
WIDTH = 0.03


def define_curves(stage: Any, path: str, counts: list[int], width: float, color: ArrayLike, meaning: str) -> Any:
    """Defines polylines without their points, and returns their prim.

    Args:
        stage: Stage to write to.
        path: Path of the new prim.
        counts: Number of points of each polyline.
        width: Width of all polylines [m].
        color: RGB in 0…1.
        meaning: Description of the curves, a sentence.
    """
    from pxr import UsdGeom, Vt

    curves = UsdGeom.BasisCurves.Define(stage, path)
    curves.CreateTypeAttr(UsdGeom.Tokens.linear)
    curves.CreateCurveVertexCountsAttr(Vt.IntArray(counts))
    curves.CreateWidthsAttr(Vt.FloatArray([width]))
    curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    set_color(curves, color)
    curves.GetPrim().SetDocumentation(meaning)
    return curves.GetPrim()


def write_curves(prim: Any, samples: Samples, points: Array, shown: list[bool], width: float) -> None:
    """Writes the points of polylines over time.

    Args:
        prim: Prim of the polylines.
        samples: Destination of the values.
        points: Points of all polylines, (time, n, 3) [m].
        shown: Visibility in each record.
        width: Width of the polylines [m].
    """
    from pxr import UsdGeom

    half = 0.5 * width
    extents = np.stack([points.min(axis=1) - half, points.max(axis=1) + half], axis=1)
    tokens = UsdGeom.Tokens
    curves = UsdGeom.BasisCurves(prim)
    samples.write(curves.CreatePointsAttr(), [vectors(frame) for frame in points])
    samples.write(curves.CreateExtentAttr(), [vectors(frame) for frame in extents])
    visibility = [tokens.inherited if some else tokens.invisible for some in shown]
    samples.write(curves.CreateVisibilityAttr(), visibility)
