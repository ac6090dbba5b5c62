"""Shapes of a stage: contact points as spheres or points, sizes and looks."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.checks import Array
from warpcontact.scene import Body, Contact
from warpcontact.usd.author import mark, vectors
from warpcontact.usd.replay import Replay

if TYPE_CHECKING:
    from warpcontact.usd.surfaces import Placement

WORLD_COLOR = (0.55, 0.55, 0.5)
BODY_COLOR = (0.35, 0.5, 0.7)


@dataclass(frozen=True)
class Spheres:
    """Spheres, or points, that one or several contacts have in common.

    Attributes:
        contacts: The contacts, of the same points and radius.
        radii: Radius of each, (env, item) [m]; all zero: points.
        places: Centres in the frame of the body, (env, item, 3) [m].
    """

    contacts: list[Contact]
    radii: Array
    places: Array

    @property
    def name(self) -> str:
        """Name of the first contact."""
        return self.contacts[0].name

    @property
    def body(self) -> Body | None:
        """Body that carries them; ``None``: the world."""
        return self.contacts[0].points.body

    @property
    def are_points(self) -> bool:
        """Whether no environment gives any of them a size."""
        return not self.radii.any()

    def differs(self, row: int) -> bool:
        """Whether they are others in environment number ``row`` of the export than in the first."""
        return bool((self.radii[row] != self.radii[0]).any() or (self.places[row] != self.places[0]).any())


def spheres_of(replay: Replay) -> list[Spheres]:
    """Returns the spheres and points of all contacts, each once however many contacts it is part of."""
    found: dict[tuple[str, bytes], Spheres] = {}
    for contact in replay.scene.contacts:
        radii = replay.radii(contact)
        key = (contact.points.name, radii.tobytes())
        if key not in found:
            found[key] = Spheres([], radii, replay.places(contact.points))
        found[key].contacts.append(contact)
    return list(found.values())


def body_size(body: Body, placements: Iterable["Placement"], spheres: Iterable[Spheres]) -> float:
    """Returns the diameter about its centre of mass of everything a body carries in any environment [m]."""
    reach = [placement.reach for placement in placements if placement.surface.body is body]
    reach += [
        float((np.linalg.norm(group.places, axis=-1) + group.radii).max())
        for group in spheres
        if group.body is body
    ]
    return 2.0 * max(reach, default=0.0)


def scene_size(replay: Replay, placements: Sequence["Placement"], spheres: Sequence[Spheres]) -> float:
    """Returns a length to draw arrows and points by [m]: the largest body's, or a tenth of the space they need."""
    bodies = replay.scene.bodies
    largest = max((body_size(body, placements, spheres) for body in bodies), default=0.0)
    if largest > 0.0:
        return largest
    places = [replay.pose(body)[0].reshape(-1, 3) for body in bodies]
    places += [placement.corners for placement in placements]
    if not places:
        return 1.0
    return 0.1 * float(np.linalg.norm(np.ptp(np.concatenate(places), axis=0))) or 1.0


def set_color(gprim: Any, color: ArrayLike) -> None:
    """Gives a shape one colour, RGB in 0…1."""
    gprim.CreateDisplayColorAttr(vectors(np.atleast_2d(color)))


def body_color(body: Body | None) -> NDArray[np.float64]:
    """Returns the colour of what a body carries."""
    if body is None:
        return np.array(WORLD_COLOR)
    return np.array(BODY_COLOR) if body.color is None else body.color


def define_spheres(stage: Any, path: str, group: Spheres, point_width: float) -> None:
    """Writes spheres that collide, as they are in the first environment, or points.

    A single one becomes a prim at ``path``; a set has a child ``item_<number>`` per sphere, or is one
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
    mark(prim, group.name)
    prim.SetCustomDataByKey("warpcontact:contacts", Vt.StringArray([c.name for c in group.contacts]))
    set_spheres(stage, path, group, 0)


def set_spheres(stage: Any, path: str, group: Spheres, row: int) -> None:
    """Gives the spheres or points at ``path`` size and place of environment number ``row`` of the export."""
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


def define_look(stage: Any, scope: str, prim: Any) -> None:
    """Writes a material that shows ``displayColor`` into ``scope`` and binds it to ``prim`` and all below.

    Renderers other than Hydra's own draw only what a material says.
    """
    from pxr import Sdf, UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, scope)
    path = f"{scope}/Display"
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.6)
    reader = UsdShade.Shader.Define(stage, f"{path}/Color")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    output = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(output)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
