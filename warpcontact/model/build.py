"""Plans models of scenes: ``SceneData`` → ``DeviceModelPlan``, one per device.

``plan_on_devices`` declares the arrays and parameters of bodies, surfaces, points and force elements without
allocating them. ``DeviceModel`` allocates them.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra.vectors import transform_points
from warpcontact.forces.contact_table import SceneContacts, declare_contacts
from warpcontact.forces.ends import Ends
from warpcontact.forces.force_element import BuildContext
from warpcontact.forces.registry import declare_force_elements
from warpcontact.forces.shape_sets import make_shape_sets
from warpcontact.geometry.face_grid import make_grids
from warpcontact.geometry.query_mesh import QueryMeshCache
from warpcontact.kernels import types
from warpcontact.model.core_arrays import declare_arrays
from warpcontact.model.plan import DeviceModelPlan
from warpcontact.model.quarantine import add_guard
from warpcontact.model.sensors import sensors_of
from warpcontact.scene import elements as limits_of
from warpcontact.scene.elements import Body
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import DeviceField, Field, Parameter, Parameters, split
from warpcontact.system.devices import find_devices
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

PRECISIONS = {"float32": wp.float32, "float64": wp.float64}


def plan_on_devices(
    scene: SceneData,
    device: str | Sequence[str] = "auto",
    precision: str = "float32",
    mesh_cache: QueryMeshCache | None = None,
) -> tuple[DeviceModelPlan, ...]:
    """Plans the models of ``scene`` on each device; arguments and errors as for ``Scene.build``.

    Args:
        scene: The scene.
        device: Device or devices.
        precision: ``"float32"`` or ``"float64"``.
        mesh_cache: Query meshes of earlier plans, see ``make_query_meshes``.
    """
    checks.choice("precision", precision, tuple(PRECISIONS))
    if not scene.bodies:
        raise ValueError("the scene has no body; add_body adds one")
    devices = find_devices(device)
    # Tables that are the same on all devices.
    contacts = SceneContacts.of(scene, mesh_cache)
    common = scene.snapshot()
    return tuple(_plan_on_device(target, common, precision, contacts) for target in devices)


def _plan_on_device(
    target: wp.Device, scene: SceneData, precision: str, contacts: SceneContacts
) -> DeviceModelPlan:
    """Plans the model of one device: bodies, surfaces and points, contacts and shapes, and then force elements."""
    t = types.structs(PRECISIONS[precision])
    layout = AllocationPlan(target)
    parameters = Parameters(target, t.real)
    ends = Ends()
    grids = make_grids(contacts.query_meshes, target, t)
    arrays = declare_arrays(
        scene, t, layout, contacts.clusters, contacts.query_meshes, ends, uses_face_grid=grids is not None
    )
    arrays.guard = add_guard(scene, layout, parameters, t.real)
    gravity = Field(scene.gravity[None])
    device_field = parameters.device_field(arrays.model, "gravity", t.vec3, lambda: gravity.values)
    parameters.add("scene.gravity", gravity, slice(0, 1), limits("m/s²"), [device_field], tail=(3,))
    _add_bodies(scene, arrays, parameters, t)
    _add_surfaces(scene, arrays, layout, parameters, t)
    point_positions, position_parameters = _add_points(scene, arrays, layout, parameters, t)
    table = declare_contacts(
        scene, contacts, grids, arrays, layout, parameters, t, point_positions, position_parameters
    )
    context = BuildContext(
        scene=scene,
        types=t,
        layout=layout,
        parameters=parameters,
        arrays=arrays,
        contacts=table,
        shapes=make_shape_sets(scene.shapes, parameters),
        ends=ends,
        has_joints=any(body.motion.kind != types.FREE for body in scene.bodies),
    )
    force_elements = declare_force_elements(context)
    ends.declare(sum(body.count for body in scene.bodies), arrays.model, layout)
    return DeviceModelPlan(
        scene=scene,
        device=target,
        precision=precision,
        types=t,
        layout=layout,
        arrays=arrays,
        parameters=parameters,
        force_elements=force_elements,
        groups=table.groups,
        clusters=table.clusters,
        sensors=sensors_of(scene, t, force_elements),
        side_regions=contacts.query_meshes.side_regions(),
        meshes=table.meshes,
    )


def _add_bodies(scene: SceneData, arrays: ModelArrays, parameters: Parameters, t: types.Structs) -> None:
    bodies, model = scene.bodies, arrays.model
    mass = Field(np.concatenate([body.rows("mass") for body in bodies]))
    device_mass = parameters.device_field(model, "body_mass", t.real, lambda: mass.values)
    inertia = Field(np.concatenate([body.rows("inertia") for body in bodies]))
    device_inertia = [
        parameters.device_field(model, "body_inertia", t.mat33, lambda: inertia.values),
        parameters.device_field(model, "body_inverse_inertia", t.mat33, lambda: np.linalg.inv(inertia.values)),
        parameters.device_field(model, "body_isotropic_inertia", wp.bool, lambda: _is_isotropic(inertia.values)),
    ]
    for body in bodies:
        parameters.add(f"{body.name}.mass", mass, body.items, limits_of.MASS, [device_mass], single=body.single)
        parameters.add(
            f"{body.name}.inertia",
            inertia,
            body.items,
            limits("kg·m²"),
            device_inertia,
            tail=(3, 3),
            single=body.single,
            convert=_inertia,
            given=((3, 3), (3,)),
        )
    for key, unit in (("position", "m"), ("linear_velocity", "m/s"), ("angular_velocity", "rad/s")):
        field, device_fields = _add_vector(parameters, bodies, key, unit, arrays.initial, f"body_{key}", t)
        if key == "position":
            _add_remainder(parameters, field, device_fields, arrays.initial, t)
    _add_orientation(parameters, bodies, arrays.initial, "body_orientation", t)
    for key, unit in (("external_force", "N"), ("external_torque", "N·m")):
        _add_vector(parameters, bodies, key, unit, model, f"body_{key}", t)


def _add_points(
    scene: SceneData, arrays: ModelArrays, layout: AllocationPlan, parameters: Parameters, t: types.Structs
) -> tuple[Callable[[], Array], list[Parameter]]:
    """Adds the points; returns a function of their positions (1 or envs, points, 3), and the parameters they depend on.

    Positions are in the frame of the body, or in the world relative to an anchor at the center of the set.
    """
    sets = scene.points
    empty = np.zeros(0, dtype=np.int32)
    bodies = np.concatenate([empty, *(points.body_numbers for points in sets)])
    layout.constant("contacts", arrays.model, "point_body", bodies, wp.int32)
    position = Field(np.concatenate([np.zeros((0, 3)), *(points.positions for points in sets)]))
    pose_of = {
        points: [
            parameters.by_name[f"{points.surface.name}.{key}"] for key in ("position", "orientation", "scale")
        ]
        for points in sets
        if points.surface is not None
    }

    def attached_positions() -> Array:
        values = position.values
        for points, pose in pose_of.items():
            items = slice(points.start, points.start + len(points.positions))
            origin, turn, scale = (part.field.values[:, part.items.start] for part in pose)
            moved = transform_points(scale[:, None, None] * position.values[:, items], origin, turn)
            values = np.repeat(values, len(moved) if len(values) == 1 else 1, axis=0)
            values[:, items] = moved
        return values

    def anchors() -> Array:
        values = attached_positions()
        result = np.zeros_like(values)
        for points in sets:
            if points.body is None:
                own = values[:, points.start : points.start + len(points.positions)]
                middle = 0.5 * (own.min(axis=1, keepdims=True) + own.max(axis=1, keepdims=True))
                items = slice(points.start, points.start + len(points.positions))
                result[:, items] = split("point_position", middle, parameters.real)[0]
        return result

    def point_positions() -> Array:
        return attached_positions() - anchors()

    device_fields = [
        parameters.device_field(arrays.model, "point_anchor", t.vec3, anchors),
        parameters.device_field(arrays.model, "point_position", t.vec3, point_positions),
    ]
    position_parameters = list({id(part): part for pose in pose_of.values() for part in pose}.values())
    for part in position_parameters:
        part.device_fields.extend(device_fields)
    for points in sets:
        items = slice(points.start, points.start + len(points.positions))
        parameters.add(
            f"{points.name}.position",
            position,
            items,
            limits("m"),
            list(device_fields),
            tail=(3,),
            single=points.single,
        )
        position_parameters.append(parameters.by_name[f"{points.name}.position"])
    return point_positions, position_parameters


def _add_surfaces(
    scene: SceneData, arrays: ModelArrays, layout: AllocationPlan, parameters: Parameters, t: types.Structs
) -> None:
    surfaces, model = scene.surfaces, arrays.model
    bodies = [types.WORLD if surface.body is None else surface.body.index for surface in surfaces]
    layout.constant("surfaces", model, "surface_body", bodies, wp.int32)
    position = Field(np.array([surface.position for surface in surfaces]).reshape(-1, 3))
    orientation = Field(np.array([surface.orientation for surface in surfaces]).reshape(-1, 4))
    scale = Field(np.array([surface.scale for surface in surfaces]))
    mesh_index = Field(np.zeros(len(surfaces)))
    centre = np.array([surface.centre for surface in surfaces]).reshape(-1, 3)

    on_world = np.array([surface.body is None for surface in surfaces], dtype=bool)[:, None]

    def centre_in_body() -> Array:
        # Kernels use mesh coordinates relative to the center of the mesh, for precision; its position is float64.
        offset = scale.values[..., None] * centre
        return transform_points(offset[..., None, :], position.values, orientation.values)[..., 0, :]

    def anchor() -> Array:
        return np.where(on_world, split("surface_position", centre_in_body(), parameters.real)[0], 0.0)

    def from_anchor() -> Array:
        centres = centre_in_body()
        return np.where(on_world, split("surface_position", centres, parameters.real)[1], centres)

    device_position = [
        parameters.device_field(model, "surface_anchor", t.vec3, anchor),
        parameters.device_field(model, "surface_position", t.vec3, from_anchor),
    ]
    device_orientation = parameters.device_field(model, "surface_orientation", t.quat, lambda: orientation.values)
    device_scale = parameters.device_field(model, "surface_scale", t.real, lambda: scale.values)
    device_mesh_index = parameters.device_field(
        model, "surface_mesh", wp.int32, lambda: mesh_index.values.astype(np.int32)
    )
    for surface in surfaces:
        items = slice(surface.index, surface.index + 1)
        parameters.add(f"{surface.name}.position", position, items, limits("m"), list(device_position), tail=(3,))
        parameters.add(
            f"{surface.name}.orientation",
            orientation,
            items,
            checks.FINITE,
            [device_orientation, *device_position],
            tail=(4,),
            convert=checks.unit_quaternions,
        )
        scale_fields = [device_scale, *device_position]
        parameters.add(f"{surface.name}.scale", scale, items, limits_of.SCALE, scale_fields)
        if len(surface.meshes) > 1:
            allowed = limits("-", at_least=0.0, at_most=len(surface.meshes) - 1.0)
            name = f"{surface.name}.mesh"
            parameters.add(name, mesh_index, items, allowed, [device_mesh_index], whole=True)


def _add_vector(
    parameters: Parameters,
    bodies: list[Body],
    key: str,
    unit: str,
    struct: Any,
    attribute: str,
    t: types.Structs,
) -> tuple[Field, list[DeviceField]]:
    """Adds a vector parameter of all bodies."""
    field = Field(np.concatenate([body.rows(key) for body in bodies]))
    device_fields = [parameters.device_field(struct, attribute, t.vec3, lambda: field.values)]
    for body in bodies:
        name = f"{body.name}.{key}"
        parameters.add(name, field, body.items, limits(unit), device_fields, tail=(3,), single=body.single)
    return field, device_fields


def _add_remainder(
    parameters: Parameters, position: Field, device_fields: list[DeviceField], initial: Any, t: types.Structs
) -> None:
    """Adds the rounding remainder of the position of all bodies, which depends on the position."""

    def remainder() -> Array:
        return split("body_position", position.values, parameters.real)[1]

    device_fields.append(parameters.device_field(initial, "body_position_remainder", t.vec3, remainder))


def _add_orientation(
    parameters: Parameters, bodies: list[Body], struct: Any, attribute: str, t: types.Structs
) -> None:
    """Adds the orientation of all bodies."""
    field = Field(np.concatenate([body.rows("orientation") for body in bodies]))
    device_field = parameters.device_field(struct, attribute, t.quat, lambda: field.values)
    for body in bodies:
        parameters.add(
            f"{body.name}.orientation",
            field,
            body.items,
            checks.FINITE,
            [device_field],
            tail=(4,),
            single=body.single,
            convert=checks.unit_quaternions,
        )


def _is_isotropic(tensors: Array) -> NDArray[np.bool]:
    return (tensors == tensors[..., :1, :1] * np.eye(3)).all(axis=(-2, -1))


def _inertia(name: str, values: Array) -> Array:
    """Converts principal moments (…, 3) or tensors (…, 3, 3) to checked tensors (envs, items, 3, 3)."""
    if values.ndim == 3:
        values = values[..., None] * np.eye(3)
    return checks.inertia_tensors(name, values)
