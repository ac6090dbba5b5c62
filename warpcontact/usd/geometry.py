"""Geometry of a stage: contact points, surfaces and analytic shapes, and their display colors."""

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.algebra.vectors import transform_points
from warpcontact.drawing.geometry import (
    INACTIVE,
    PLANE,
    Placement,
    ShapePlacement,
    ShapeSet,
    Spheres,
    body_color,
    surface_color,
)
from warpcontact.kernels import shapes
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.scene.elements import Body, Surface
from warpcontact.scene.shapes import tessellate
from warpcontact.usd.author import Samples, add_pose, integers, quaternions, store_element_name, vectors, write_box
from warpcontact.validation.checks import Array


def set_color(gprim: Any, color: ArrayLike) -> None:
    """Sets the display color of a prim, RGB in 0…1."""
    gprim.CreateDisplayColorAttr(vectors(np.atleast_2d(color)))


def define_points(stage: Any, path: str, width: float, body: Body | None) -> None:
    """Defines points of diameter ``width`` [m] in the color of a body, without positions."""
    from pxr import UsdGeom, Vt

    points = UsdGeom.Points.Define(stage, path)
    points.CreateWidthsAttr(Vt.FloatArray([width]))
    points.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    set_color(points, body_color(body))


def define_spheres(stage: Any, path: str, group: Spheres, point_width: float) -> None:
    """Writes contact points: colliding spheres, as in the first environment, or points without radius.

    A single sphere becomes a prim at ``path``. A set has a child ``item_<number>`` per sphere. Points are one
    ``UsdGeom.Points``.
    """
    from pxr import UsdGeom, UsdPhysics, Vt

    if group.are_points:
        define_points(stage, path, point_width, group.body)
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
    from pxr import UsdPhysics

    triangles = surface.meshes[index]
    mesh = _define_triangles(stage, path, triangles.vertices, triangles.faces, double_sided=True)
    prim = mesh.GetPrim()
    store_element_name(prim, surface.name)
    if not surface.visible:
        mesh.MakeInvisible()
    if color:
        _color_faces(mesh, surface, index)
    if physics:
        UsdPhysics.CollisionAPI.Apply(prim)
        UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.none)
    return prim


def _define_triangles(
    stage: Any, path: str, vertices: Array, faces: NDArray[np.integer[Any]], *, double_sided: bool = False
) -> Any:
    """Defines a mesh of triangles (n, 3) with counterclockwise outer sides, and returns it."""
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(vectors(vertices))
    mesh.CreateFaceVertexCountsAttr(integers(np.full(len(faces), 3)))
    mesh.CreateFaceVertexIndicesAttr(integers(faces.reshape(-1)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    if double_sided:
        mesh.CreateDoubleSidedAttr(True)
    mesh.CreateExtentAttr(vectors(np.array([vertices.min(axis=0), vertices.max(axis=0)])))
    return mesh


def _color_faces(mesh: Any, surface: Surface, index: int) -> None:
    """Sets the color of active faces, dims the others, and defines the active ones as a subset."""
    from pxr import UsdGeom

    color = surface_color(surface)
    active = surface.active[index]
    if active.all():
        set_color(mesh, color)
        return
    primvar = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.uniform)
    primvar.Set(vectors(np.array([color, INACTIVE * color])))
    primvar.SetIndices(integers(~active))
    UsdGeom.Subset.CreateGeomSubset(
        mesh,
        "active",
        UsdGeom.Tokens.face,
        integers(np.flatnonzero(active)),
        "warpcontact",
        UsdGeom.Tokens.unrestricted,
    ).GetPrim().SetDocumentation("Active faces, which can be in contact.")


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
    from pxr import UsdGeom

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
    return _define_triangles(stage, path, *tessellate(kind, sizes))


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
