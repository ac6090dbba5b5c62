"""Sets of bodies: what moves with each of them, as one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from warpcontact.algebra.poses import transform_points
from warpcontact.drawing.spheres import Spheres
from warpcontact.scene.scene import Body, Scene
from warpcontact.validation.checks import Array

#: Of a set without contacts.
CENTRES = "centres"


@dataclass(frozen=True)
class BodySet:
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


def body_sets_of(
    scene: Scene, spheres: Sequence[Spheres], poses: Mapping[str, tuple[Array, Array]]
) -> list[BodySet]:
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
            places = transform_points(group.places[..., None, :], positions, orientations)[..., 0, :]
            found.append(BodySet(body, group.name, [one.name for one in group.contacts], places, group.radii))
        if not own:
            found.append(BodySet(body, CENTRES, [], positions, np.zeros(positions.shape[1:3])))
    return found
