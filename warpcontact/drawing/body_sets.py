"""Points or spheres on sets of bodies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from warpcontact.algebra.vectors import transform_points
from warpcontact.drawing.spheres import Spheres
from warpcontact.scene.elements import Body
from warpcontact.scene.scene_data import SceneData
from warpcontact.validation.checks import Array

#: Name used for the centers of mass of a set without contacts.
CENTRES = "centres"


@dataclass(frozen=True)
class BodySet:
    """Spheres or points, one on each body of a set.

    Attributes:
        body: Set of bodies.
        name: Name of their first contact; ``"centres"``: centers of mass of a set without contacts.
        contacts: Names of their contacts.
        places: Centers, (time, env, item, 3), world [m].
        radii: Radii, (env, item) [m]; all zero: points.
    """

    body: Body
    name: str
    contacts: list[str]
    places: Array
    radii: Array

    @property
    def are_points(self) -> bool:
        """Whether all radii are zero."""
        return not self.radii.any()


def body_sets_of(
    scene: SceneData, spheres: Sequence[Spheres], poses: Mapping[str, tuple[Array, Array]]
) -> list[BodySet]:
    """Returns the spheres and points on all sets of bodies.

    Args:
        scene: Scene of the recording.
        spheres: Spheres and points of all contacts.
        poses: Positions and orientations of the bodies by name.
    """
    found = []
    for body in scene.bodies:
        if body.single:
            continue
        positions, orientations = poses[body.name]
        groups = [group for group in spheres if group.body is body]
        for group in groups:
            places = transform_points(group.places[..., None, :], positions, orientations)[..., 0, :]
            found.append(BodySet(body, group.name, [one.name for one in group.contacts], places, group.radii))
        if not groups:
            found.append(BodySet(body, CENTRES, [], positions, np.zeros(positions.shape[1:3])))
    return found
