"""Device data of joints and prescribed motions: parameters, and functions of time grouped by class."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.device_model import unit_vectors
from warpcontact.kernels.joints import Motion, driven
from warpcontact.kernels.types import FREE, TIME_FUNCTION, BodyMotion
from warpcontact.scene.elements import Body
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.parameters import DeviceField, Field, Parameters, pack, split
from warpcontact.system.compilation import load
from warpcontact.validation.checks import Array
from warpcontact.validation.custom_law_errors import compile_error_text, has_user_code

#: Names of axis parameters of joints.
_AXES = ("axis", "normal")


@dataclass(eq=False)
class MotionArrays:
    """Device arrays of bodies with prescribed motion of one class; ``None`` before allocation.

    Attributes:
        members: Body indices [member].
        coefficients: Coefficients of the motion [env, member].
        samples: Table rows of all members.
    """

    members: Any = None
    coefficients: Any = None
    samples: Any = None


@dataclass(frozen=True)
class PrescribedMotionSet:
    """Bodies with prescribed motion of one class.

    Attributes:
        motion: Class of the motion.
        count: Number of bodies.
        arrays: Their arrays.
    """

    motion: type[Motion]
    count: int
    arrays: MotionArrays

    @property
    def inputs(self) -> dict[str, wp.array]:
        """Its arrays as arguments of kernels."""
        return {
            "members": self.arrays.members,
            "coefficients": self.arrays.coefficients,
            "samples": self.arrays.samples,
        }

    def compile(self, device: wp.Device, real: type) -> None:
        """Compiles the step kernel of a user-defined motion, to report errors early.

        Raises:
            TypeError: If the motion does not compile.
        """
        if not has_user_code([self.motion]):
            return
        try:
            load(driven.follow(self.motion, real), device)
        except Exception as error:
            text = compile_error_text(error, [self.motion])
            names = ", ".join(self.motion.device_names() or ("nothing",))
            hint = "\nWrite constants as wp.float64(1.5). Functions return wp.vec3d."
            raise TypeError(
                f"motion {self.motion.__name__} does not compile: {text}\nIn the motion, p has {names}.{hint}"
            ) from error


def add_motions(
    scene: SceneData, model: Any, layout: AllocationPlan, parameters: Parameters
) -> list[PrescribedMotionSet]:
    """Adds joints and motions of the bodies to the struct ``model``; returns the prescribed motions."""
    bodies = scene.bodies
    counts = [body.count for body in bodies]
    kinds = np.repeat([body.motion.kind for body in bodies], counts)[None]
    axis = Field(np.zeros((sum(counts), 3)))
    anchor = Field(np.zeros((sum(counts), 3)))
    anchored = np.repeat([_has_world_anchor(body.motion) for body in bodies], counts)
    # All bodies share these fields.
    position, orientation = (
        parameters.by_name[f"{bodies[0].name}.{key}"].field for key in ("position", "orientation")
    )

    def content() -> NDArray[Any]:
        # Rounded as in the state, including the remainder, so that both are bitwise identical.
        start = np.add(*split("body_position", position.values, parameters.real))
        columns = {
            "kind": kinds,
            "axis": axis.values,
            "anchor": np.where(anchored[:, None], anchor.values, start),
            "position": start,
            "orientation": orientation.values,
        }
        return pack(BodyMotion, columns)

    device_field = parameters.device_field(model, "body_motion", BodyMotion, content)
    for body in bodies:
        for key in ("position", "orientation"):
            device_fields = parameters.by_name[f"{body.name}.{key}"].device_fields
            if device_field not in device_fields:  # bodies may share the list
                device_fields.append(device_field)
    classes = dict.fromkeys(type(body.motion) for body in bodies if body.motion.kind != FREE)
    prescribed_motions = []
    for motion in classes:
        members = [body for body in bodies if type(body.motion) is motion]
        fields = {body: _fields_of(body, axis, anchor) for body in members}
        sends = []
        if motion.kind == TIME_FUNCTION:
            motion_set, send = _add_prescribed_motions(motion, fields, layout, parameters)
            prescribed_motions.append(motion_set)
            sends.append(send)
        for body, own in fields.items():
            for name, (field, items) in own.items():
                allowed = motion.limits(name)
                parameters.add(
                    f"{body.name}.motion.{name}",
                    field,
                    items,
                    allowed,
                    [*sends, device_field] if field in (axis, anchor) else list(sends),
                    tail=allowed["shape"],
                    single=body.single,
                    convert=unit_vectors if allowed["direction"] else None,
                )
    return prescribed_motions


def _has_world_anchor(motion: Motion) -> bool:
    """Returns whether the motion has an anchor, a point in the world about which the body rotates."""
    return "anchor" in motion.parameters() and motion.limits("anchor")["shape"] == (3,)


def _fields_of(body: Body, axis: Field, anchor: Field) -> dict[str, tuple[Field, slice]]:
    """Returns field and items of each parameter of a motion; sets the values of the scene."""
    shared = {"anchor": anchor}
    if body.motion.kind != TIME_FUNCTION:
        shared |= dict.fromkeys(_AXES, axis)
    fields = {}
    for name, value in body.motion.parameters().items():
        limits = body.motion.limits(name)
        values = np.asarray(value, dtype=np.float64)
        if limits["direction"]:
            values = unit_vectors(name, values)
        if name in shared and limits["shape"] == (3,):
            field, items = shared[name], body.items
            field.values[:, items] = values
        else:
            field, items = Field(values[None]), slice(0, 1)
        fields[name] = (field, items)
    return fields


def _add_prescribed_motions(
    motion: type[Motion],
    fields: dict[Body, dict[str, tuple[Field, slice]]],
    layout: AllocationPlan,
    parameters: Parameters,
) -> tuple[PrescribedMotionSet, DeviceField]:
    """Adds the bodies with prescribed motion of one class."""
    arrays = MotionArrays()
    struct = driven.coefficients_struct(motion)
    layout.constant("state", arrays, "members", [body.index for body in fields], wp.int32)
    # Optional parameters that are omitted are zero.
    optional = {name: motion.limits(name)["shape"] for name in motion.varying()}
    tables = [body.motion.samples() for body in fields]
    starts = np.cumsum([0] + [len(table) for table in tables])
    rows = np.concatenate(tables) if motion.sampled else np.zeros((1, 1))
    layout.constant("state", arrays, "samples", rows, wp.float64)

    def columns_of(number: int, own: dict[str, tuple[Field, slice]], envs: int) -> dict[str, Array]:
        values = {name: field.values[:, items] for name, (field, items) in own.items()}
        values = {name: np.broadcast_to(array, (envs, *array.shape[1:])) for name, array in values.items()}
        if motion.sampled:
            values["first"] = np.full((envs, 1), float(starts[number]))
            values["count"] = np.full((envs, 1), float(len(tables[number])))
        return dict(motion.coefficients(values))

    def content() -> NDArray[Any]:
        names = motion.device_names()
        if not names:
            return pack(struct, {"unused": np.zeros((1, len(fields)))})
        envs = max(len(field.values) for own in fields.values() for field, _ in own.values())
        computed = [columns_of(number, own, envs) for number, own in enumerate(fields.values())]
        for own, values in zip(fields.values(), computed, strict=True):
            for name in set(optional) - set(own):
                values.setdefault(name, np.zeros((envs, 1, *optional[name])))
            if missing := set(names) - set(values):
                raise TypeError(
                    f"{motion.__name__}.coefficients must return {', '.join(names)}, got no {min(missing)}"
                )
        return pack(struct, {name: np.hstack([values[name] for values in computed]) for name in names})

    device_field = parameters.device_field(arrays, "coefficients", struct, content)
    return PrescribedMotionSet(motion, len(fields), arrays), device_field
