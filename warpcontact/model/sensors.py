"""Sensors of a model: names, units, shapes and device arrays.

``sensors_of`` returns all sensors of a model; ``sensor_evaluation.py`` computes their values.
"""

from collections.abc import Iterable
from typing import Any

import warp as wp

from warpcontact.forces.force_element import ForceElement
from warpcontact.forces.sensor import Sensor, shape_in
from warpcontact.kernels.outcomes import body_measures
from warpcontact.kernels.types import Structs
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.model_arrays import ModelArrays

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


def sensors_of(scene: SceneData, types: Structs, force_elements: Iterable[ForceElement]) -> dict[str, Sensor]:
    """Returns all sensors of a model by name.

    Args:
        scene: The scene.
        types: Warp structs of the precision.
        force_elements: The force elements.
    """
    table: dict[str, Sensor] = {}
    structs = {
        "state": types.State,
        "wrenches": types.Wrenches,
        **{name: struct for name, (struct, _) in body_measures.BODY_MEASURES.items()},
    }

    def add_column(
        name: str, unit: str, meaning: str, part: str, attribute: str, own: int | slice, **options: Any
    ) -> None:
        def array(arrays: ModelArrays) -> wp.array:
            return getattr(getattr(arrays, part), attribute)[:, own]

        shape = shape_in(structs[part], attribute)
        table[name] = Sensor(name, unit, meaning, array, shape=shape, **options)

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
    for element in force_elements:
        table |= {sensor.name: sensor for sensor in element.sensors()}
    for key, (need, unit, meaning) in _BODY_MEASURE.items():
        everything = slice(0, scene.bodies[-1].items.stop)
        options = {"needs": (need,), "total": True}
        add_column(f"scene.{key}", unit, f"{meaning}, all bodies", need, key, everything, **options)
    return table
