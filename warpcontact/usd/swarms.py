"""Sets of bodies on a stage: what moves with each of them, as one prim."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpcontact.checks import Array
from warpcontact.frames import placed
from warpcontact.scene import Body, Scene
from warpcontact.usd.author import mark, vectors, write_samples
from warpcontact.usd.geometry import Spheres, body_color, set_color

#: Of a set without contacts.
CENTRES = "centres"


@dataclass(frozen=True)
class Swarm:
    """Spheres, or points, one on each body of a set.

    Attributes:
        body: The set.
        name: Name of their first contact; ``"centres"``: the centres of mass of a set without contacts.
        contacts: Names of their contacts.
        places: Their centres, (time, env, item, 3), world [m].
        radii: Radius of each, (env, item) [m]; all zero: points.
    """

    body: Body
    name: str
    contacts: list[str]
    places: Array
    radii: Array

    @property
    def are_points(self) -> bool:
        """Whether no environment gives any of them a size."""
        return not self.radii.any()

    def declare(self, stage: Any, path: str, width: float) -> None:
        """Writes what they have in common in all environments; ``width`` is that of points [m]."""
        from pxr import UsdGeom, Vt

        if self.are_points:
            points = UsdGeom.Points.Define(stage, path)
            points.CreateWidthsAttr(Vt.FloatArray([width]))
            points.SetWidthsInterpolation(UsdGeom.Tokens.constant)
            set_color(points, body_color(self.body))
        else:
            spheres = UsdGeom.PointInstancer.Define(stage, path)
            ball = UsdGeom.Sphere.Define(stage, f"{path}/ball")
            ball.CreateRadiusAttr(1.0)
            ball.CreateExtentAttr(vectors(np.array([[-1.0] * 3, [1.0] * 3])))
            set_color(ball, body_color(self.body))
            spheres.CreatePrototypesRel().SetTargets([ball.GetPath()])
            spheres.CreateProtoIndicesAttr(Vt.IntArray(self.body.count, 0))
        prim = stage.GetPrimAtPath(path)
        mark(prim, self.name)
        if self.contacts:
            prim.SetCustomDataByKey("warpcontact:contacts", Vt.StringArray(self.contacts))

    def write(self, prim: Any, codes: Sequence[float], row: int) -> None:
        """Writes where they are in environment number ``row`` of the export."""
        from pxr import UsdGeom

        places, reach = self.places[:, row], self.radii[row][:, None]
        if self.are_points:
            points = UsdGeom.Points(prim)
            attribute, reach = points.CreatePointsAttr(), np.full((1, 1), 0.5 * points.GetWidthsAttr().Get()[0])
        else:
            spheres = UsdGeom.PointInstancer(prim)
            attribute = spheres.CreatePositionsAttr()
            spheres.CreateScalesAttr(vectors(np.repeat(reach, 3, axis=1)))
        bounds = np.stack([(places - reach).min(axis=1), (places + reach).max(axis=1)], axis=1)
        write_samples(attribute, codes, [vectors(entry) for entry in places])
        write_samples(UsdGeom.Boundable(prim).CreateExtentAttr(), codes, [vectors(entry) for entry in bounds])


def swarms_of(scene: Scene, spheres: Sequence[Spheres], poses: Mapping[str, tuple[Array, Array]]) -> list[Swarm]:
    """Returns what the sets of bodies carry.

    Args:
        scene: What was simulated.
        spheres: Spheres and points of all contacts.
        poses: Positions and orientations of the bodies by their names.
    """
    found = []
    for body in scene.bodies:
        if body.single:
            continue
        positions, orientations = poses[body.name]
        own = [group for group in spheres if group.body is body]
        for group in own:
            places = placed(group.places[..., None, :], positions, orientations)[..., 0, :]
            found.append(Swarm(body, group.name, [one.name for one in group.contacts], places, group.radii))
        if not own:
            found.append(Swarm(body, CENTRES, [], positions, np.zeros(positions.shape[1:3])))
    return found
