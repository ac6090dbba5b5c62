"""Shapes of analytic form on a stage: as the primitives that USD has, or as meshes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpcontact.checks import Array
from warpcontact.frames import placed, product
from warpcontact.kernels.smooth import shapes
from warpcontact.kernels.smooth.base import Shape as Form
from warpcontact.kernels.smooth.plane import Plane
from warpcontact.smooth.elements import Shape
from warpcontact.smooth.tessellate import tessellate
from warpcontact.usd.author import add_pose, mark, vectors, write_samples
from warpcontact.usd.geometry import body_color, set_color
from warpcontact.usd.replay import Replay

# Half the side of what is drawn of a half-space, in sizes of the scene.
PLANE = 10.0


@dataclass(frozen=True)
class FormPlacement:
    """A shape in the environments of an export; arrays are (env, item, …).

    Attributes:
        shape: The shape, or a set of them.
        positions: Origins of their frames in those of their carriers [m].
        orientations: Rotations to those, x, y, z, w.
        sizes: Their parameters by name.
    """

    shape: Shape
    positions: Array
    orientations: Array
    sizes: dict[str, Array]

    @classmethod
    def of(cls, replay: Replay, shape: Shape) -> "FormPlacement":
        """Returns the shape as recorded, or else as in the scene."""

        def setting(key: str, default: Array) -> Array:
            found = replay.setting(f"{shape.name}.{key}", default[0] if shape.single else default)
            return found[:, None] if shape.single else found

        return cls(
            shape,
            setting("position", shape.positions),
            setting("orientation", shape.orientations),
            {key: setting(key, values) for key, values in shape.sizes.items()},
        )

    @property
    def shared(self) -> bool:
        """Whether it is the same in all environments."""
        arrays = (self.positions, self.orientations, *self.sizes.values())
        return all(bool((values == values[:1]).all()) for values in arrays)

    @property
    def reach(self) -> float:
        """How far it reaches at most from the origin of its carrier [m]; 0 of a half-space."""
        if issubclass(self.shape.kind, Plane):
            return 0.0
        far = [np.linalg.norm(tessellate(self.shape.kind, self.of_item(0, 0))[0], axis=1).max()]
        return float(max(far) + np.linalg.norm(self.positions, axis=-1).max())

    def of_item(self, row: int, item: int) -> dict[str, Array]:
        """Returns the parameters of one of them in environment number ``row``."""
        return {key: values[row, item] for key, values in self.sizes.items()}

    def write(self, stage: Any, path: str, row: int, size: float) -> None:
        """Writes a single shape as in environment number ``row``; ``size`` is that of the scene [m]."""
        from pxr import Usd, UsdGeom, UsdPhysics

        gprim = define_form(stage, path, self.shape.kind, self.of_item(row, 0), PLANE * size)
        prim = gprim.GetPrim()
        shift = np.array([0.0, 0.0, self.sizes["height"][row, 0] / 2]) if self._is_cone else np.zeros(3)
        position, orientation = self.positions[row, 0], self.orientations[row, 0]
        add_pose(UsdGeom.Xformable(prim), placed(shift[None], position, orientation)[0], orientation)
        color = body_color(self.shape.body) if self.shape.color is None else self.shape.color
        set_color(gprim, color)
        mark(prim, self.shape.name)
        UsdPhysics.CollisionAPI.Apply(prim)
        if not self.shape.visible:
            UsdGeom.Imageable(prim).MakeInvisible()
        if self.shape.body is None:
            Usd.ModelAPI(prim).SetKind("component")

    @property
    def _is_cone(self) -> bool:
        return issubclass(self.shape.kind, shapes.Cone)


def _sphere(stage: Any, path: str, sizes: Mapping[str, Array]) -> Any:
    from pxr import UsdGeom

    sphere, radius = UsdGeom.Sphere.Define(stage, path), float(sizes.get("radius", 1.0))
    sphere.CreateRadiusAttr(radius)
    sphere.CreateExtentAttr(vectors(np.array([[-radius] * 3, [radius] * 3])))
    return sphere


def _about_axis(schema: str, reach: Callable[[Mapping[str, Array]], tuple[float, float]]) -> Callable[..., Any]:
    """Returns what writes a primitive about the z axis; ``reach`` tells its height and how far its extent goes."""

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


def define_form(stage: Any, path: str, kind: type[Form], sizes: Mapping[str, Array], reach: float) -> Any:
    """Writes a shape without its pose; without sizes a sphere of 1 m. Returns its ``UsdGeom.Gprim``.

    An ellipsoid is a mesh: a sphere that is scaled unevenly cannot collide on a stage.
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


class FormSwarm:
    """Shapes on the bodies of a set, one ``UsdGeom.PointInstancer`` that moves.

    Args:
        placement: The shapes.
        poses: Positions (time, env, item, 3) and orientations of the bodies.
    """

    def __init__(self, placement: FormPlacement, poses: tuple[Array, Array]) -> None:
        self.placement = placement
        positions, orientations = poses
        self.places = placed(placement.positions[..., None, :], positions, orientations)[..., 0, :]
        turns = np.broadcast_to(placement.orientations, orientations.shape)
        self.turns = product(orientations, turns)
        # One prototype for all of one size; spheres and ellipsoids are scaled from one.
        sizes = placement.sizes
        self._scaled = issubclass(placement.shape.kind, shapes.Sphere | shapes.Ellipsoid)
        shape = placement.positions.shape[:2]
        rows = np.concatenate([values.reshape(*shape, -1) for values in sizes.values()], axis=-1)
        flat = rows.reshape(shape[0] * shape[1], -1)
        _, self._first, numbers = np.unique(flat, axis=0, return_index=True, return_inverse=True)
        self._numbers = numbers.reshape(shape)

    def declare(self, stage: Any, path: str, size: float) -> None:
        """Writes what they have in common in all environments."""
        from pxr import Sdf, UsdGeom

        shape, items = self.placement.shape, self.placement.positions.shape[1]
        instancer = UsdGeom.PointInstancer.Define(stage, path)
        targets = []
        for number, first in enumerate([0] if self._scaled else self._first):
            sizes = {} if self._scaled else self.placement.of_item(first // items, first % items)
            own = f"{path}/form_{number}"
            gprim = define_form(stage, own, shape.kind, sizes, PLANE * size)
            set_color(gprim, body_color(shape.body) if shape.color is None else shape.color)
            targets.append(Sdf.Path(own))
        instancer.CreatePrototypesRel().SetTargets(targets)
        if not shape.visible:
            instancer.MakeInvisible()
        mark(instancer.GetPrim(), shape.name)

    def write(self, prim: Any, codes: Sequence[float], row: int) -> None:
        """Writes where they are in environment number ``row`` of the export."""
        from pxr import UsdGeom, Vt

        instancer, sizes = UsdGeom.PointInstancer(prim), self.placement.sizes
        numbers = np.zeros_like(self._numbers[row]) if self._scaled else self._numbers[row]
        instancer.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(numbers.astype(np.int32)))
        if self._scaled:
            scales = (
                sizes["semi_axes"] if "semi_axes" in sizes else np.repeat(sizes["radius"][..., None], 3, axis=2)
            )
            instancer.CreateScalesAttr(vectors(scales[row]))
        write_samples(instancer.CreatePositionsAttr(), codes, [vectors(entry) for entry in self.places[:, row]])
        turns = [Vt.QuathArray([_half(q) for q in entry]) for entry in self.turns[:, row]]
        write_samples(instancer.CreateOrientationsAttr(), codes, turns)


def _half(q: Array) -> Any:
    from pxr import Gf

    x, y, z, w = q.tolist()
    return Gf.Quath(w, x, y, z)
