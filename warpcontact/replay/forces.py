"""Contact forces: where they act, and how long to draw them."""

import numpy as np

from warpcontact.checks import Array
from warpcontact.replay.replay import Replay
from warpcontact.scene import Contact
from warpcontact.smooth.elements import SmoothContact

FORCE_COLOR = (0.9, 0.25, 0.1)
# Length of the longest force line, in sizes of the largest body.
LONGEST = 1.5


class ForceLines:
    """The force of a contact on the body of its points, from where it acts.

    Attributes:
        contact: The contact.
        start: Point K where the force acts, (time, env, item, 3), world [m].
        force: The force, (time, env, item, 3), world [N]; zero where there is none.
        color: RGB in 0…1.
    """

    def __init__(self, contact: Contact | SmoothContact, start: Array, force: Array) -> None:
        self.contact = contact
        self.color = np.array(FORCE_COLOR) if contact.color is None else contact.color
        # A failed environment may hold NaN, which must not get into the geometry.
        good = np.all(np.isfinite(force) & np.isfinite(start), axis=-1, keepdims=True)
        self.force = np.where(good, force, 0.0)
        self.start = np.where(np.isfinite(start), start, 0.0)

    @classmethod
    def of(cls, replay: Replay, contact: Contact | SmoothContact) -> "ForceLines | None":
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
        force = parts["normal_force"][..., None] * parts["normal"] + parts.get("friction_force", 0.0)
        return cls(contact, parts["point"], force)

    def peak(self) -> float:
        """Returns the largest force [N]."""
        return float(np.linalg.norm(self.force, axis=-1).max())


def length_scale(lines: list[ForceLines], size: float) -> float:
    """Returns the metres per newton that draw the largest force at ``LONGEST`` times ``size`` [m]."""
    peak = max((line.peak() for line in lines), default=0.0)
    return LONGEST * size / peak if peak > 0.0 else 1.0
