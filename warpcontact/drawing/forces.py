"""Contact forces as lines: points where they act, vectors and drawing scale."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from warpcontact.algebra.vectors import transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.drawing.shapes import ShapePlacement
from warpcontact.scene.elements import Contact
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.shapes import ShapeContact
from warpcontact.validation.checks import Array

FORCE_COLOR = (0.9, 0.25, 0.1)
# Length of the longest force line, as a multiple of the size.
LONGEST = 1.5


class ForceLines:
    """Forces of a contact on the body of its points, with the points where they act.

    Attributes:
        contact: The contact; for a contact coupling, the first of its contacts.
        name: Name of the element.
        meaning: Description, a sentence.
        start: Point K where the force acts, (time, env, item, 3), world [m].
        force: Force, (time, env, item, 3), world [N]; zero without contact.
        color: RGB in 0…1.
    """

    def __init__(
        self,
        contact: Contact | ShapeContact | ParticleContact,
        start: Array,
        force: Array,
        name: str | None = None,
        meaning: str = "Force on the body of the points, from the point where it acts.",
    ) -> None:
        self.contact = contact
        self.name = contact.name if name is None else name
        self.meaning = meaning
        self.color = np.array(FORCE_COLOR) if contact.color is None else contact.color
        # Frozen environments may hold NaN, which must not enter the geometry.
        good = np.all(np.isfinite(force) & np.isfinite(start), axis=-1, keepdims=True)
        self.force = np.where(good, force, 0.0)
        self.start = np.where(np.isfinite(start), start, 0.0)

    @classmethod
    def of(cls, replay: Replay, contact: Contact | ShapeContact) -> "ForceLines | None":
        """Returns the lines, or ``None`` unless normal force, normal and point were recorded."""
        shape = (len(replay.codes), len(replay.envs), contact.count)
        parts = {}
        for key in ("normal_force", "normal", "point", "friction_force"):
            values = replay.series(f"{contact.name}.{key}")
            if values is not None:
                length = () if key == "normal_force" else (3,)
                parts[key] = values.astype(np.float64).reshape(*shape, *length)
            elif key != "friction_force":
                return None
        with np.errstate(invalid="ignore"):  # ∞ × 0
            force = parts["normal_force"][..., None] * parts["normal"] + parts.get("friction_force", 0.0)
        return cls(contact, parts["point"], force)

    def peak(self) -> float:
        """Returns the largest force [N]."""
        return float(np.linalg.norm(self.force, axis=-1).max())


def resultant_lines(
    replay: Replay, poses: Mapping[str, tuple[Array, Array]], lines: list[ForceLines]
) -> list[ForceLines]:
    """Returns resultant forces: of contact couplings at the center of mass, of particle contacts on each shape.

    A coupling is omitted if ``lines`` contain the forces of all its contacts.
    """
    found, drawn = [], {line.name for line in lines}
    shape = (len(replay.codes), len(replay.envs))
    for coupling in replay.scene.contact_couplings:
        body, force = coupling.surface_a.body, replay.series(f"{coupling.name}.force")
        if body is None or force is None or drawn.issuperset(one.name for one in coupling.contacts):
            continue
        start = poses[body.name][0][:, :, None]
        meaning = "Force on the body of the first surface, from its center of mass."
        each = force.astype(np.float64).reshape(*shape, 1, 3)
        found.append(ForceLines(coupling.contacts[0], start, each, coupling.name, meaning))
    for particle_contact in replay.scene.particle_contacts:
        force = replay.series(f"{particle_contact.name}.force")
        if force is not None:
            start = np.concatenate([_centers(replay, poses, one) for one in particle_contact.shapes], axis=2)
            each = force.astype(np.float64).reshape(*shape, particle_contact.count, 3)
            meaning = "Force of the other particles on each shape, from its center."
            found.append(ForceLines(particle_contact, start, each, meaning=meaning))
    return found


def _centers(replay: Replay, poses: Mapping[str, tuple[Array, Array]], shape: Any) -> Array:
    """Returns the origins of shapes, (time, env, item, 3), world [m]."""
    local = ShapePlacement.of(replay, shape).positions
    if shape.body is None:
        return np.broadcast_to(local, (len(replay.codes), *local.shape))
    positions, orientations = poses[shape.body.name]
    if shape.single:
        return transform_points(np.broadcast_to(local, (len(positions), *local.shape)), positions, orientations)
    return transform_points(local[..., None, :], positions, orientations)[..., 0, :]


def length_scale(lines: list[ForceLines], size: float) -> float:
    """Returns the arrow length per force [m/N] that draws the largest force at ``LONGEST`` times ``size`` [m]."""
    peak = max((line.peak() for line in lines), default=0.0)
    return LONGEST * size / peak if peak > 0.0 else 1.0
