"""Analytic shapes on a stage, as UsdGeom primitives or as meshes."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from warpcontact.algebra.poses import transform_points
from warpcontact.drawing.shapes import PLANE, ShapePlacement, ShapeSet
from warpcontact.kernels.shapes import shapes
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.plane import Plane
from warpcontact.kernels.shapes.torus import Torus
from warpcontact.scene.shape_tessellation import tessellate
from warpcontact.usd.author import Samples, add_pose, integers, quaternions, store_element_name, vectors, write_box
from warpcontact.usd.geometry import set_color
from warpcontact.validation.checks import Array


def write_shape(
    stage: Any,
    path: str,
    form: ShapePlacement,
    row: int,
    size: float,
    *,
    item: int = 0,
    physics: bool = True,
    color: bool = True,
) -> None:
    """Writes a shape as in environment ``row`` of the export.

    Args:
        stage: Stage to write to.
        path: Path of the new prim.
        form: Shape with its poses and sizes.
        row: Index of the environment.
        size: Size of the drawing [m], for planes.
        item: Index within a set of shapes.
        physics: Whether the shape collides.
        color: Whether to set the display color.
    """
    from pxr import Usd, UsdGeom, UsdPhysics

    gprim = define_shape(stage, path, form.shape.kind, form.item_sizes(row, item), PLANE * size)
    prim = gprim.GetPrim()
    shift = (
        np.array([0.0, 0.0, form.sizes["height"][row, item] / 2])
        if issubclass(form.shape.kind, shapes.Cone)
        else np.zeros(3)
    )
    position, orientation = form.positions[row, item], form.orientations[row, item]
    add_pose(UsdGeom.Xformable(prim), transform_points(shift[None], position, orientation)[0], orientation)
    store_element_name(prim, form.shape.name)
    if not form.shape.visible:
        UsdGeom.Imageable(prim).MakeInvisible()
    if color:
        set_color(gprim, form.color)
    if not physics:
        return
    UsdPhysics.CollisionAPI.Apply(prim)
    if prim.IsA(UsdGeom.Mesh):
        hollow = issubclass(form.shape.kind, Torus | ParametricSurface)
        tokens = UsdPhysics.Tokens
        shown = tokens.none if hollow else tokens.convexHull
        UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(shown)
    if form.shape.body is None:
        Usd.ModelAPI(prim).SetKind("component")
        write_box(prim, *np.array(gprim.GetExtentAttr().Get()))


def _sphere(stage: Any, path: str, sizes: Mapping[str, Array]) -> Any:
    from pxr import UsdGeom

    sphere, radius = UsdGeom.Sphere.Define(stage, path), float(sizes.get("radius", 1.0))
    sphere.CreateRadiusAttr(radius)
    sphere.CreateExtentAttr(vectors(np.array([[-radius] * 3, [radius] * 3])))
    return sphere


def _about_axis(schema: str, reach: Callable[[Mapping[str, Array]], tuple[float, float]]) -> Callable[..., Any]:
    """Returns a writer of a primitive about the z axis; ``reach`` returns its height and half its extent along z."""

    def write(stage: Any, path: str, sizes: Mapping[str, Array]) -> Any:
        from pxr import UsdGeom

        gprim, radius = getattr(UsdGeom, schema).Define(stage, path), float(sizes["radius"])
        height, half = reach(sizes)
        gprim.CreateRadiusAttr(radius)
        gprim.CreateHeightAttr(height)
        gprim.CreateAxisAttr("Z")
        gprim.CreateExtentAttr(vectors(np.array([[-radius, -radius, -half], [radius, radius, half]])))
        return gprim

    return write


def _lengths(sizes: Mapping[str, Array]) -> tuple[float, float]:
    return 2.0 * float(sizes["half_length"]), float(sizes["half_length"])


_PRIMITIVES: dict[type[Form], Callable[..., Any]] = {
    shapes.Sphere: _sphere,
    shapes.Cylinder: _about_axis("Cylinder", _lengths),
    shapes.Capsule: _about_axis(
        "Capsule", lambda sizes: (_lengths(sizes)[0], _lengths(sizes)[1] + float(sizes["radius"]))
    ),
    shapes.Cone: _about_axis("Cone", lambda sizes: (float(sizes["height"]), 0.5 * float(sizes["height"]))),
}


def define_shape(stage: Any, path: str, kind: type[Form], sizes: Mapping[str, Array], reach: float) -> Any:
    """Writes a shape without its pose and returns its ``UsdGeom.Gprim``; without sizes, a unit sphere (1 m radius).

    An ellipsoid becomes a mesh, because UsdPhysics does not support collisions of nonuniformly scaled spheres.
    """
    from pxr import UsdGeom, Vt

    if not sizes and issubclass(kind, shapes.Sphere | shapes.Ellipsoid):
        return _sphere(stage, path, sizes)
    if kind in _PRIMITIVES:
        return _PRIMITIVES[kind](stage, path, sizes)
    if issubclass(kind, Plane):
        plane = UsdGeom.Plane.Define(stage, path)
        plane.CreateWidthAttr(2.0 * reach)
        plane.CreateLengthAttr(2.0 * reach)
        plane.CreateAxisAttr("Z")
        plane.CreateExtentAttr(vectors(np.array([[-reach, -reach, 0.0], [reach, reach, 0.0]])))
        return plane
    vertices, faces = tessellate(kind, sizes)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(vectors(vertices))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.reshape(-1), np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateExtentAttr(vectors(np.array([vertices.min(axis=0), vertices.max(axis=0)])))
    return mesh


def define_shape_set(stage: Any, path: str, body_set: ShapeSet, size: float) -> None:
    """Defines an instancer of a set of shapes with everything that is constant over time."""
    from pxr import Sdf, UsdGeom

    shape, items = body_set.placement.shape, body_set.placement.positions.shape[1]
    instancer = UsdGeom.PointInstancer.Define(stage, path)
    targets = []
    for number, first in enumerate([0] if body_set.scaled else body_set.first):
        sizes = {} if body_set.scaled else body_set.placement.item_sizes(first // items, first % items)
        own = f"{path}/form_{number}"
        gprim = define_shape(stage, own, shape.kind, sizes, PLANE * size)
        set_color(gprim, body_set.placement.color)
        targets.append(Sdf.Path(own))
    instancer.CreatePrototypesRel().SetTargets(targets)
    if not shape.visible:
        instancer.MakeInvisible()
    store_element_name(instancer.GetPrim(), shape.name)


def write_shape_set(prim: Any, samples: Samples, body_set: ShapeSet, row: int) -> None:
    """Writes poses, scales and extents of a set of shapes in environment ``row`` of the export."""
    from pxr import UsdGeom

    instancer, sizes = UsdGeom.PointInstancer(prim), body_set.placement.sizes
    # Instances rotate; this is the half-diagonal of their bounding box in their own frame.
    reach = math.sqrt(3.0) * body_set.placement.reach
    if samples.defaults:
        numbers = np.zeros_like(body_set.numbers[row]) if body_set.scaled else body_set.numbers[row]
        instancer.CreateProtoIndicesAttr(integers(numbers))
        if body_set.scaled:
            radii = np.repeat(sizes["radius"][..., None], 3, axis=2) if "radius" in sizes else sizes["semi_axes"]
            instancer.CreateScalesAttr(vectors(radii[row]))
    places = body_set.places[:, row]
    extents = np.stack([places.min(axis=1) - reach, places.max(axis=1) + reach], axis=1)
    samples.write(instancer.CreatePositionsAttr(), [vectors(entry) for entry in places])
    rotations = [quaternions(entry) for entry in body_set.turns[:, row]]
    samples.write(instancer.CreateOrientationsfAttr(), rotations)
    samples.write(instancer.CreateExtentAttr(), [vectors(entry) for entry in extents])
