"""Results of an event-driven run: events, and the states between them."""

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.unilateral.reference.environment import Snapshot
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.scene.scene_data import SceneData

_UNITS = {"position": "m", "orientation": "-", "linear_velocity": "m/s", "angular_velocity": "rad/s"}
_COMPONENTS = {3: ("axis", ["x", "y", "z"]), 4: ("component", ["x", "y", "z", "w"])}


class EventKind(StrEnum):
    """Kind of an event at a contact.

    IMPACT: velocities jump. LIFT_OFF: a held contact opens. STICK and SLIP: a closed contact begins to stick, or
    to slip. REST: a series of impacts at decreasing intervals has ended; the contact stays closed.
    """

    IMPACT = "IMPACT"
    LIFT_OFF = "LIFT_OFF"
    STICK = "STICK"
    SLIP = "SLIP"
    REST = "REST"


@dataclass(frozen=True)
class Event:
    """Event at a contact.

    Attributes:
        time: Time [s].
        kind: Kind.
        contact: Name of the contact.
        item: Item of the contact, −1 for a contact without items; for a particle contact the index of the pair.
        label: Label of the pair.
        impulse: Impulse of an IMPACT on the first body at K (3,), world [N·s]; 0 for other kinds.
        approach_speed: Normal speed before, positive on approach [m/s].
        separation_speed: Normal speed after [m/s].
    """

    time: float
    kind: EventKind
    contact: str
    item: int
    label: str
    impulse: Array
    approach_speed: float
    separation_speed: float

    def __str__(self) -> str:
        text = f"{self.time:.9g} s: {self.kind} of {self.label}"
        if self.kind is EventKind.IMPACT:
            size = np.linalg.norm(self.impulse)
            text += f", {self.approach_speed:.6g} → {self.separation_speed:.6g} m/s, {size:.6g} N·s"
        return text


@dataclass(frozen=True)
class EventRun:
    """Result of an event-driven run.

    ``run["ball.position"]`` is a labeled array (time, …) of the position, orientation, linear_velocity or
    angular_velocity of a body.

    Attributes:
        times: Times of the states (n,) [s]. If velocities jump there are two states of one time, unless states are
            stored at fixed intervals.
        states: Poses and velocities of all bodies.
        events: Events in order of time.
        scene: The scene.
    """

    times: Array
    states: tuple[Snapshot, ...]
    events: tuple[Event, ...]
    scene: "SceneData"

    def events_of(self, kind: EventKind | str, contact: str | None = None) -> list[Event]:
        """Returns the events of one kind, optionally of one contact.

        Raises:
            ValueError: If there is no such kind.
            KeyError: If the scene has no such contact.
        """
        wanted = EventKind(checks.choice("kind", kind, tuple(map(str, EventKind))))
        scene = self.scene
        elements: list[Any] = [*scene.contacts, *scene.shape_contacts, *scene.particle_contacts]
        names = [one.name for one in elements]
        if contact is not None and contact not in names:
            raise KeyError(f"no contact {contact!r} in the scene; available: {', '.join(names) or 'none'}")
        return [one for one in self.events if one.kind is wanted and contact in (None, one.contact)]

    def __getitem__(self, name: str) -> "xr.DataArray":
        """Returns a quantity of a body over time.

        Raises:
            KeyError: If there is no quantity of that name.
        """
        import xarray as xr

        element, _, quantity = name.rpartition(".")
        bodies = {body.name: body for body in self.scene.bodies}
        if element not in bodies or quantity not in _UNITS:
            raise KeyError(
                f"no {name!r} in an event-driven run; available: {', '.join(_UNITS)} of {', '.join(bodies)}"
            )
        body = bodies[element]
        values = np.stack([getattr(state, quantity)[body.items] for state in self.states])
        last, labels = _COMPONENTS[values.shape[-1]]
        dims: tuple[str, ...] = ("time", "item", last)
        if body.single:
            values, dims = values[:, 0], ("time", last)
        coordinates: dict[str, Any] = {"time": self.times, last: labels}
        return xr.DataArray(values, dims=dims, coords=coordinates, attrs={"units": _UNITS[quantity]}, name=name)

    def __str__(self) -> str:
        counts = {kind: sum(one.kind is kind for one in self.events) for kind in EventKind}
        counted = ", ".join(f"{count} {kind}" for kind, count in counts.items() if count) or "no events"
        return f"event-driven run from {self.times[0]:g} s to {self.times[-1]:g} s: {counted}"
