"""Reader of USD: the meshes of a stage. Names of prims and of face subsets become groups."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.readers.content import Content, Integers, Unreadable, split_warning
from warpcontact.meshes.readers.parts import Parts
from warpcontact.meshes.readers.polygons import triangulate
from warpcontact.meshes.readers.usd_layers import check_layers, reason


def read_usd(path: Path, prim: str | None, most_faces: int, *, confined: bool) -> Content:
    """Returns the visible meshes of a stage with purpose default or render, or those of one prim.

    Args:
        path: The file.
        prim: Path of a mesh, which is read for any visibility and purpose, or of a group of prims; ``None``: the
            whole stage.
        most_faces: Largest number of triangles.
        confined: Whether all layers of the stage must lie in or below the folder of the file.
    """
    from pxr import Tf, Usd, UsdGeom

    path = path.resolve()
    check_layers(path, confined=confined)
    try:
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
    except Tf.ErrorException as error:
        raise Unreadable(f"not valid USD: {reason(error)}") from error
    root = stage.GetPseudoRoot() if prim is None else _prim(stage, prim)
    time = Usd.TimeCode.EarliestTime()
    places = UsdGeom.XformCache(time)
    parts, split, others, cages = Parts(most_faces), [0, 0], dict[str, int](), 0
    for found in _gprims(root, time):
        if not found.IsA(UsdGeom.Mesh):
            kind = str(found.GetTypeName())
            others[kind] = others.get(kind, 0) + 1
            continue
        mesh = UsdGeom.Mesh(found)
        vertices, counts, corners = polygons(mesh, time)
        faces, owner = triangulate(vertices, counts, corners)
        kept = without_holes(mesh, time, len(counts))[owner]
        faces, owner = faces[kept], owner[kept]
        split[0] += len(np.unique(owner))
        split[1] += len(faces)
        cages += str(mesh.GetSubdivisionSchemeAttr().Get()) != "none"
        parts.add(
            str(found.GetPath()),
            vertices,
            faces,
            np.array(places.GetLocalToWorldTransform(found)).T,  # Gf uses row vectors
            names=[found.GetName()],
            groups=list(_subsets(found, time, owner, len(counts))),
            flip=str(mesh.GetOrientationAttr().Get(time)) == "leftHanded",
        )
    content = parts.content()
    content.unit = float(UsdGeom.GetStageMetersPerUnit(stage))
    _remark(content, stage, split, others, cages)
    return content


def _prim(stage: Any, path: str) -> Any:
    from pxr import Sdf, UsdGeom

    if not Sdf.Path.IsValidPathString(path) or not path.startswith("/"):
        raise Unreadable(f"prim must be a path such as '/World/part', got {path!r}")
    prim = stage.GetPrimAtPath(path)
    if prim:
        return prim
    meshes = [str(found.GetPath()) for found in stage.Traverse() if found.IsA(UsdGeom.Mesh)]
    listed = ", ".join(meshes[:10]) + (", …" if len(meshes) > 10 else "")
    raise Unreadable(f"the prim {path!r} does not exist; meshes: {listed or 'none'}")


def _gprims(root: Any, time: Any) -> Iterator[Any]:
    """Iterates over visible, renderable shapes at and below ``root``, including those in instances."""
    from pxr import Usd, UsdGeom

    if root.IsA(UsdGeom.Mesh):
        yield root
        return
    prims = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)))
    for prim in prims:
        if prim.IsA(UsdGeom.PointInstancer):
            yield prim
            prims.PruneChildren()  # prototypes are not drawn where they are defined
        elif prim.IsA(UsdGeom.Gprim):
            shape = UsdGeom.Imageable(prim)
            if str(shape.ComputeVisibility(time)) == "invisible":
                continue
            if str(shape.ComputePurpose()) in ("default", "render"):
                yield prim


def polygons(mesh: Any, time: Any) -> tuple[npt.NDArray[np.float64], Integers, Integers]:
    """Returns vertices (V, 3), numbers of vertices (n,) and vertex indices of the polygons of a ``UsdGeom.Mesh``."""
    path = mesh.GetPath()
    points, counts, corners = (
        attribute.Get(time)
        for attribute in (mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
    )
    vertices = np.array(points if points else np.empty((0, 3)), dtype=np.float64)
    sizes = np.array(counts if counts else [], dtype=np.int64)
    indices = np.array(corners if corners else [], dtype=np.int64)
    if (sizes < 3).any():
        i = int((sizes < 3).argmax())
        raise Unreadable(f"{path}.faceVertexCounts[{i}] must be 3 or more, got {sizes[i]}")
    if sizes.sum() != len(indices):
        raise Unreadable(
            f"{path}.faceVertexCounts add up to {sizes.sum()} vertices, but faceVertexIndices has {len(indices)}"
        )
    return vertices, sizes, indices


def without_holes(mesh: Any, time: Any, count: int) -> npt.NDArray[np.bool]:
    """Returns which of the ``count`` polygons of a ``UsdGeom.Mesh`` are not holes."""
    holes = mesh.GetHoleIndicesAttr().Get(time)
    kept = np.ones(count, dtype=bool)
    if holes:
        kept[_in_range(np.array(holes, dtype=np.int64), count, f"{mesh.GetPath()}.holeIndices")] = False
    return kept


def _subsets(prim: Any, time: Any, owner: Integers, count: int) -> Iterator[tuple[str, Integers]]:
    """Iterates over names and triangles of the face subsets of a mesh; ``owner`` is the polygon of each triangle."""
    from pxr import Usd, UsdGeom

    for child in prim.GetFilteredChildren(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        subset = UsdGeom.Subset(child)
        if not subset or str(subset.GetElementTypeAttr().Get()) != "face":
            continue
        chosen = np.array(subset.GetIndicesAttr().Get(time) or [], dtype=np.int64)
        member = np.zeros(count, dtype=bool)
        member[_in_range(chosen, count, f"{child.GetPath()}.indices")] = True
        yield child.GetName(), np.flatnonzero(member[owner])


def _in_range(numbers: Integers, count: int, label: str) -> Integers:
    outside = numbers[(numbers < 0) | (numbers >= count)]
    if len(outside):
        raise Unreadable(f"{label} must be face numbers from 0 to {count - 1}, got {outside[0]}")
    return numbers


def _remark(content: Content, stage: Any, split: list[int], others: dict[str, int], cages: int) -> None:
    """Adds warnings and notes about omissions and conversions."""
    from pxr import UsdGeom

    if split[0] != split[1]:
        content.warnings.append(split_warning(*split))
    if others:
        listed = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
        content.warnings.append(f"shapes other than meshes were omitted: {listed}")
    if not UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        content.unit_warning = "metersPerUnit is not authored: the unit is 0.01 m, the default of USD"
    content.notes.append(f"the up axis is {UsdGeom.GetStageUpAxis(stage)}; the mesh is not rotated")
    if cages:
        content.notes.append(f"subdivision is ignored: the control meshes of {cages} prims are used")
