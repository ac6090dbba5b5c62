"""Data of a stage over time besides poses: force arrows, curves of couplings, sets of bodies, and sensors."""

import math
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from warpcontact.algebra.vectors import shortest_rotations
from warpcontact.drawing.geometry import BodySet, body_color
from warpcontact.drawing.lines import ForceLines
from warpcontact.drawing.replay import Replay
from warpcontact.usd.author import (
    Samples,
    attribute_name,
    attribute_type,
    integers,
    long_integers,
    plain,
    quaternions,
    series,
    store_element_name,
    vectors,
)
from warpcontact.usd.geometry import define_points, set_color
from warpcontact.validation.checks import Array

# Radius of a shaft, as a multiple of the drawing size. Radius and length of a head, in shaft radii.
SHAFT = 0.012
HEAD = 2.5
HEAD_LENGTH = 7.0
# Largest length of the head, as a fraction of the arrow. Shorter arrows are scaled down.
MAX_HEAD = 0.5

#: Width of curves, as a multiple of the drawing size.
WIDTH = 0.03

_KINDS = {"axis": "vector", "component": "quaternion"}
_ROLES = {"point": "Point3", "normal": "Normal3"}
# Poses are written as transforms of the prims.
_POSES = ("position", "orientation")


def define_arrows(stage: Any, path: str, count: int, color: ArrayLike, meaning: str, scale: float) -> None:
    """Defines an instancer of arrows with everything that does not change over time.

    Args:
        stage: Stage to write to.
        path: Path of the new prim.
        count: Number of arrows.
        color: RGB in 0…1.
        meaning: Description of the forces, a sentence.
        scale: Arrow length per force [m/N].
    """
    from pxr import UsdGeom

    arrows = UsdGeom.PointInstancer.Define(stage, path)
    shaft, head = UsdGeom.Cylinder.Define(stage, f"{path}/shaft"), UsdGeom.Cone.Define(stage, f"{path}/head")
    for part in (shaft, head):
        part.CreateRadiusAttr(1.0)
        part.CreateHeightAttr(1.0)
        part.CreateAxisAttr(UsdGeom.Tokens.z)
        part.CreateExtentAttr(vectors(np.array([[-1.0, -1.0, -0.5], [1.0, 1.0, 0.5]])))
        set_color(part, color)
    arrows.CreatePrototypesRel().SetTargets([shaft.GetPath(), head.GetPath()])
    arrows.CreateProtoIndicesAttr(integers(np.repeat([0, 1], count)))
    arrows.CreateIdsAttr(long_integers(np.arange(2 * count)))
    arrows.GetPrim().SetDocumentation(f"{meaning} {scale:g} m for 1 N. Shafts come first, then heads.")


def write_arrows(prim: Any, samples: Samples, lines: ForceLines, row: int, scale: float, size: float) -> None:
    """Writes the arrows of environment ``row`` of the export, ``scale`` m/N long; hidden where the force is 0."""
    from pxr import UsdGeom

    start, vector = lines.start[:, row], scale * lines.force[:, row]
    poses, hidden = _arrow_shapes(start, vector, SHAFT * size)
    positions, orientations, scales = poses
    arrows = UsdGeom.PointInstancer(prim)
    samples.write(arrows.CreatePositionsAttr(), [vectors(frame) for frame in positions])
    samples.write(arrows.CreateOrientationsfAttr(), [quaternions(frame) for frame in orientations])
    samples.write(arrows.CreateScalesAttr(), [vectors(frame) for frame in scales])
    masked = [long_integers(np.flatnonzero(frame)) for frame in hidden]
    samples.write(arrows.CreateInvisibleIdsAttr(), masked)
    # Heads rotate; this is the half-diagonal of the bounding square of a head.
    reach = math.sqrt(2.0) * HEAD * SHAFT * size
    ends = np.concatenate([start, start + vector], axis=1)
    extents = np.stack([ends.min(axis=1) - reach, ends.max(axis=1) + reach], axis=1)
    samples.write(arrows.CreateExtentAttr(), [vectors(frame) for frame in extents])


def _arrow_shapes(start: Array, vector: Array, radius: float) -> tuple[tuple[Array, Array, Array], Array]:
    """Returns positions, orientations and scales of shafts and heads, (time, 2 n, …), and which are hidden.

    Args:
        start: Starting points of the arrows, world, (time, n, 3) [m].
        vector: Vectors from start to tip, world, (time, n, 3) [m].
        radius: Shaft radius of an arrow that is not scaled down [m].
    """
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    hidden = length <= 0.0
    along = np.where(hidden, (0.0, 0.0, 1.0), vector / np.where(hidden, 1.0, length))
    shrunk = np.where(hidden, 1.0, np.minimum(1.0, MAX_HEAD * length / (HEAD_LENGTH * radius)))
    head = shrunk * HEAD_LENGTH * radius
    shaft = np.where(hidden, 1.0, length - head)
    middles = np.concatenate([start + 0.5 * shaft * along, start + (shaft + 0.5 * head) * along], axis=1)
    width = shrunk * radius
    shafts = np.concatenate([width, width, shaft], axis=-1)
    heads = np.concatenate([HEAD * width, HEAD * width, head], axis=-1)
    scales = np.concatenate([shafts, heads], axis=1)
    orientations = shortest_rotations((0.0, 0.0, 1.0), along)
    both = np.concatenate([hidden, hidden], axis=1)
    # Hidden arrows are equal in all frames, so that files store them once.
    return (np.where(both, 0.0, middles), np.concatenate([orientations, orientations], axis=1), scales), both[
        ..., 0
    ]


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


def define_body_set(stage: Any, path: str, body_set: BodySet, width: float) -> None:
    """Writes what is constant over time; ``width`` is the diameter of points [m]."""
    from pxr import UsdGeom, Vt

    if body_set.are_points:
        define_points(stage, path, width, body_set.body)
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


class Sensors:
    """Numeric sensors recorded for one element, ready to be written to a prim per environment.

    Args:
        replay: Replay that is exported.
        element: Name of an element, or ``"scene"``.
    """

    def __init__(self, replay: Replay, element: str) -> None:
        self.found: list[tuple[str, xr.DataArray, NDArray[Any], str, bool]] = []
        for quantity, data in replay.of_element(element):
            kind = _KINDS.get(str(data.dims[-1]), "number") if data.dims else "number"
            over_time = "time" in data.dims
            leading = ("time", "env") if over_time else ("env",)
            items = len(data.dims) - len(leading) - (kind != "number")
            fits = set(leading) <= set(data.dims) and items in (0, 1) and data.dtype.kind in "fiub"
            if not fits or quantity in _POSES:
                continue
            values = plain(data.transpose(*leading, ...).values)
            if kind != "number" and values.dtype.kind != "f":
                values = values.astype(np.float64)
            if not over_time:
                values = values[None]
            self.found.append((quantity, data, values, kind, items == 1))

    def declare(self, prim: Any) -> None:
        """Declares the attributes on a prim, with unit and meaning, without values."""
        for quantity, data, values, kind, is_array in self.found:
            role = _ROLES.get(quantity, "Vector3")
            attribute = prim.CreateAttribute(
                attribute_name(quantity), attribute_type(values.dtype, kind, is_array, role), custom=True
            )
            unit = str(data.attrs.get("units", "-"))
            meaning = str(data.attrs.get("long_name", quantity))
            if "flag_meanings" in data.attrs:
                flags = zip(data.attrs["flag_values"], str(data.attrs["flag_meanings"]).split(), strict=True)
                meaning += ": " + ", ".join(f"{value} {name}" for value, name in flags)
            attribute.SetDocumentation(f"{meaning} [{unit}]")
            attribute.SetCustomDataByKey("warpcontact:name", data.name)
            attribute.SetCustomDataByKey("warpcontact:unit", unit)

    def write(self, prim: Any, samples: Samples, row: int) -> None:
        """Writes the values of environment ``row`` of the export."""
        for quantity, data, values, kind, is_array in self.found:
            attribute = prim.GetAttribute(attribute_name(quantity))
            env_values = series(values[:, row], kind, is_array)
            if "time" in data.dims:
                samples.write(attribute, env_values)
            elif samples.defaults:
                attribute.Set(env_values[0])
