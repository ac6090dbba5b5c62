"""Curves of a stage that move: polylines with one width and one colour."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.usd.author import Samples, vectors
from warpcontact.usd.geometry import set_color
from warpcontact.validation.checks import Array

#: Width of curves, in sizes of the largest body.
WIDTH = 0.03


def define_curves(stage: Any, path: str, counts: list[int], width: float, color: ArrayLike, meaning: str) -> Any:
    """Writes polylines without their points, and returns their prim.

    Args:
        stage: The stage.
        path: Where to.
        counts: Number of points of each.
        width: Width of all [m].
        color: RGB in 0…1.
        meaning: What they are, in a sentence.
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
    """Writes where polylines are over time.

    Args:
        prim: Their prim.
        samples: Receives it.
        points: All points of them, (time, n, 3) [m].
        shown: Whether they are seen, for each record.
        width: Their width [m].
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
