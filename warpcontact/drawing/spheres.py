"""Contact points as spheres or points; sizes and colors of bodies."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpcontact.drawing.replay import Replay
from warpcontact.scene.elements import Body, Contact
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.drawing.surfaces import Placement

WORLD_COLOR = (0.55, 0.55, 0.5)
BODY_COLOR = (0.35, 0.5, 0.7)


@dataclass(frozen=True)
class Spheres:
    """Spheres or points shared by one or several contacts.

    Attributes:
        contacts: Contacts with the same points and radii.
        radii: Radii, (env, item) [m]; all zero: points.
        places: Centers in the frame of the body, (env, item, 3) [m].
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
        """Body of the points; ``None``: the world."""
        return self.contacts[0].points.body

    @property
    def are_points(self) -> bool:
        """Whether all radii are zero."""
        return not self.radii.any()

    def differs(self, row: int) -> bool:
        """Returns whether radii or positions in environment ``row`` differ from those in the first one."""
        return bool((self.radii[row] != self.radii[0]).any() or (self.places[row] != self.places[0]).any())


def find_spheres(replay: Replay) -> list[Spheres]:
    """Returns the spheres and points of all contacts, without duplicates."""
    found: dict[tuple[str, bytes], Spheres] = {}
    for contact in replay.scene.contacts:
        radii = replay.radii(contact)
        key = (contact.points.name, radii.tobytes())
        if key not in found:
            found[key] = Spheres([], radii, replay.places(contact.points))
        found[key].contacts.append(contact)
    return list(found.values())


def body_size(body: Body, placements: Iterable["Placement"], spheres: Iterable[Spheres]) -> float:
    """Returns twice the largest distance of a body's surfaces and spheres from its center of mass [m]."""
    reach = [placement.reach for placement in placements if placement.surface.body is body]
    reach += [
        float((np.linalg.norm(group.places, axis=-1) + group.radii).max())
        for group in spheres
        if group.body is body
    ]
    return 2.0 * max(reach, default=0.0)


def scene_size(replay: Replay, placements: Sequence["Placement"], spheres: Sequence[Spheres]) -> float:
    """Returns the size of the drawing [m]: that of the largest body, or a tenth of the occupied space."""
    bodies = replay.scene.bodies
    largest = max((body_size(body, placements, spheres) for body in bodies), default=0.0)
    if largest > 0.0:
        return largest
    places = [replay.pose(body)[0].reshape(-1, 3) for body in bodies]
    places += [placement.corners for placement in placements]
    if not places:
        return 1.0
    return 0.1 * float(np.linalg.norm(np.ptp(np.concatenate(places), axis=0))) or 1.0


def body_color(body: Body | None) -> NDArray[np.float64]:
    """Returns the color of the geometry on a body, RGB in 0…1; ``None``: the world."""
    if body is None:
        return np.array(WORLD_COLOR)
    return np.array(BODY_COLOR) if body.color is None else body.color
