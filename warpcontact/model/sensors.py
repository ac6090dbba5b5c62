"""Sensors of a model: names, units, shapes and device arrays.

``sensors_of`` returns all sensors of a scene; ``sensor_evaluation.py`` computes their values.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.contact_coupling.contact_couplings import ContactCouplings
from warpcontact.forces.contact_groups import ContactGroup
from warpcontact.forces.sensor import CONTACT_SENSORS, Sensor, shape_in
from warpcontact.kernels.couplings import contact_coupling
from warpcontact.kernels.joints import Motion
from warpcontact.kernels.joints.measures import Coordinates, Reactions
from warpcontact.kernels.outcomes import body_measures
from warpcontact.kernels.types import BALL, FREE, HINGE, PLANAR, SLIDER, Structs
from warpcontact.scene.elements import Contact
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.status import ContactStatus
from warpcontact.storage.model_arrays import ModelArrays

if TYPE_CHECKING:
    from warpcontact.forces.couplings.coupling_set import CouplingSet
    from warpcontact.forces.particle_contact.contact_set import ParticleContactSet
    from warpcontact.forces.shape_contact.contact_sets import ShapeContactSet

# name: (array, or struct of measures; unit; meaning)
_BODY_STATE = {
    "orientation": ("body_orientation", "-", "rotation body → world, quaternion x, y, z, w"),
    "linear_velocity": ("body_linear_velocity", "m/s", "velocity of the center of mass, world"),
    "angular_velocity": ("body_angular_velocity", "rad/s", "angular velocity, world axes"),
}
_BODY_WRENCH = {
    "force": ("force", "N", "sum of all forces except gravity, world"),
    "torque": ("torque", "N·m", "sum of their moments about the center of mass, world axes"),
}
# Always in float64, because of sums and of positions far from the origin.
_BODY_MEASURE = {
    "kinetic_energy": ("energies", "J", "kinetic energy"),
    "potential_energy": ("energies", "J", "potential energy of gravity, 0 at the world's origin"),
    "linear_momentum": ("momenta", "kg·m/s", "linear momentum, world"),
    "angular_momentum": ("momenta", "kg·m²/s", "angular momentum about the world's origin"),
}
_HINGE = {
    "angle": ("coordinates", "angle", "rad", "angle from the initial pose about the axis, −π to π"),
    "angle_rate": ("coordinates", "angle_rate", "rad/s", "angular velocity about the axis"),
}
_SLIDER = {
    "displacement": ("coordinates", "displacement", "m", "displacement from the initial position along the axis"),
    "displacement_rate": ("coordinates", "displacement_rate", "m/s", "velocity along the axis"),
}
# Sensors that are defined also without contact, which requires a search.
_OF_FAR = ("gap", "normal", "status")
_SWEPT = {
    "crossings": ("crossings", "-", "number of steps within which the point crossed the surface, since reset"),
    "crossing_time": ("crossing_time", "s", "time of the first crossing since reset; NaN: none"),
}
_COUPLING = {
    "force": ("contact_couplings", "force", "N", "force on the body of the first surface, world"),
    "torque": ("contact_couplings", "torque", "N·m", "moment of the force about its center of mass, world axes"),
    "effective_area": (
        "coupling_extremes",
        "effective_area",
        "m²",
        "largest area in range since reset, as of the last step",
    ),
    "minimum_distance": (
        "coupling_extremes",
        "minimum_distance",
        "m",
        "smallest distance of a face in range since reset, as of the last step; NaN: none",
    ),
}


def sensors_of(
    scene: SceneData,
    types: Structs,
    start_of: Mapping[Contact, int],
    groups: Sequence[ContactGroup],
    contact_couplings: ContactCouplings,
    couplings: "Sequence[CouplingSet]",
    shape_contact_sets: "Sequence[ShapeContactSet]",
    particle_contact_sets: "Sequence[ParticleContactSet]",
) -> dict[str, Sensor]:
    """Returns all sensors of a scene by name.

    Args:
        scene: The scene.
        types: Warp structs of the precision.
        start_of: Index of the first item of each contact.
        groups: Contact groups.
        contact_couplings: Contact couplings.
        couplings: Other couplings.
        shape_contact_sets: Shape contacts.
        particle_contact_sets: Particle contacts.
    """
    table: dict[str, Sensor] = {}

    def add(name: str, unit: str, meaning: str, array: Callable[..., wp.array], **options: Any) -> None:
        table[name] = Sensor(name, unit, meaning, array, **options)

    structs = {
        "state": types.State,
        "wrenches": types.Wrenches,
        "contacts": types.Contacts,
        "history": types.History,
        "coupling_extremes": types.CouplingExtremes,
        **{name: struct for name, (struct, _) in body_measures.BODY_MEASURES.items()},
        "points": body_measures.Points,
        "reactions": Reactions,
        "coordinates": Coordinates,
        "contact_couplings": contact_coupling.ContactCouplings,
    }

    def add_column(
        name: str, unit: str, meaning: str, part: str, attribute: str, own: int | slice, **options: Any
    ) -> None:
        def array(arrays: ModelArrays) -> wp.array:
            return getattr(getattr(arrays, part), attribute)[:, own]

        add(name, unit, meaning, array, shape=shape_in(structs[part], attribute), **options)

    for body in scene.bodies:
        own, several = (body.index, 0) if body.single else (body.items, body.count)
        options: dict[str, Any] = {"needs": ("positions",), "items": several}
        add_column(f"{body.name}.position", "m", "center of mass, world", "positions", "position", own, **options)
        for key, (attribute, unit, meaning) in _BODY_STATE.items():
            add_column(f"{body.name}.{key}", unit, meaning, "state", attribute, own, items=several)
        for key, (attribute, unit, meaning) in _BODY_WRENCH.items():
            options = {"needs": ("wrenches",), "items": several}
            add_column(f"{body.name}.{key}", unit, meaning, "wrenches", attribute, own, **options)
        for key, (need, unit, meaning) in _BODY_MEASURE.items():
            options = {"needs": (need,), "items": several}
            add_column(f"{body.name}.{key}", unit, meaning, need, key, own, **options)
        for key, (need, attribute, unit, meaning) in joint_sensors(body.motion).items():
            before = ("wrenches",) if need == "reactions" else ()
            options = {"needs": (*before, need), "items": several}
            add_column(f"{body.name}.{key}", unit, meaning, need, attribute, own, **options)
    for contact in scene.contacts:
        single = contact.points.single
        start = start_of[contact]
        items = start if single else slice(start, start + contact.count)
        count = 0 if single else contact.count
        meaning = "point K where the force acts, world"
        options = {"needs": ("points",), "items": count}
        add_column(f"{contact.name}.point", "m", meaning, "points", "position", items, **options)
        for key, (attribute, unit, meaning) in CONTACT_SENSORS.items():
            codes = ContactStatus if key == "status" else None
            needs = ("contacts", "distances") if key in _OF_FAR else ("contacts",)
            options = {"needs": needs, "items": count, "codes": codes}
            add_column(f"{contact.name}.{key}", unit, meaning, "contacts", attribute, items, **options)
        group = next(group for group in groups if group.first <= start < group.first + group.count)
        for part, formula in contact.material.formulas.items():
            for key, memory in formula.memories.items():
                offset = start - group.first
                own = offset if single else slice(offset, offset + contact.count)
                frame = ", axes of the surface" if memory.tangent else ""
                meaning = f"{memory.meaning}, as of the last step{frame}"
                name = f"{contact.name}.{part}.{key}"
                add(
                    name,
                    memory.unit,
                    meaning,
                    lambda arrays, of=group.history_of, part=part, key=key, own=own: of(part, key)[:, own],
                    items=count,
                    shape=(3,) if memory.tangent else (),
                )
        for key, (attribute, unit, meaning) in _SWEPT.items() if contact.swept else ():
            add_column(f"{contact.name}.{key}", unit, meaning, "history", attribute, items, items=count)
    for number, coupling in enumerate(contact_couplings.all):
        for key, (part, attribute, unit, meaning) in _COUPLING.items():
            options = {"needs": (part,)} if part == "contact_couplings" else {}
            add_column(f"{coupling.name}.{key}", unit, meaning, part, attribute, number, **options)
    for couplings_of_code in couplings:
        table.update((sensor.name, sensor) for sensor in couplings_of_code.sensors())
    for contacts_of_code in shape_contact_sets:
        table.update((sensor.name, sensor) for sensor in contacts_of_code.sensors())
    for particle_set in particle_contact_sets:
        table.update((sensor.name, sensor) for sensor in particle_set.sensors())
    for key, (need, unit, meaning) in _BODY_MEASURE.items():
        everything = slice(0, scene.bodies[-1].items.stop)
        options = {"needs": (need,), "total": True}
        add_column(f"scene.{key}", unit, f"{meaning}, all bodies", need, key, everything, **options)
    return table


def joint_sensors(motion: Motion) -> dict[str, tuple[str, str, str, str]]:
    """Returns the sensors of a body with this motion: (need, array, unit, meaning) by name."""
    if motion.kind == FREE:
        return {}
    place = "anchor" if motion.kind in (HINGE, BALL) else "center of mass"
    table = {
        "reaction_force": ("reactions", "force", "N", f"force of the joint on the body at its {place}, world"),
        "reaction_torque": ("reactions", "torque", "N·m", f"moment of the joint about the {place}, world axes"),
    }
    if motion.kind in (HINGE, PLANAR):
        table |= _HINGE
    return table | _SLIDER if motion.kind == SLIDER else table
