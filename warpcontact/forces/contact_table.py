"""Contacts of points with meshes: the table that mesh contact and contact couplings share.

``SceneContacts`` holds host tables that are the same on all devices. ``declare_contacts`` declares clusters, query
meshes, geometry and contact groups on one device, and adds their parameters.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpcontact.algebra.vectors import transform_points
from warpcontact.forces.contact_coupling.contact_couplings import ContactCouplings
from warpcontact.forces.contact_groups import ContactGroup, group_by_model, make_group
from warpcontact.geometry.contact_clusters import ContactClusters, make_clusters, upload_clusters
from warpcontact.geometry.face_grid import FaceGrid
from warpcontact.geometry.query_mesh import QueryMeshCache, QueryMeshes, make_query_meshes, upload_query_meshes
from warpcontact.kernels import types
from warpcontact.kernels.types import Structs
from warpcontact.scene import elements as limits_of
from warpcontact.scene.elements import Contact
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import ContactTolerance, DeviceField, Field, Parameter, Parameters, pack
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

_RANGES = {
    "radius": limits_of.RADIUS,
    "kappa": limits_of.KAPPA,
    "max_depth": limits_of.MAX_DEPTH,
    "search_radius": limits_of.SEARCH_RADIUS,
    "torsion_radius": limits_of.TORSION_RADIUS,
    "force_scale": limits_of.FORCE_SCALE,
    "enabled": limits_of.ENABLED,
}


@dataclass(frozen=True)
class SceneContacts:
    """Host tables of the contacts of a scene, the same on all devices.

    Attributes:
        groups: Contacts, grouped by contact model.
        contacts: All contacts in the order of the groups, which is their order on the device.
        clusters: Clusters of contacts.
        query_meshes: Query meshes of the contacts.
    """

    groups: list[list[Contact]]
    contacts: list[Contact]
    clusters: ContactClusters
    query_meshes: QueryMeshes

    @classmethod
    def of(cls, scene: SceneData, mesh_cache: QueryMeshCache | None) -> "SceneContacts":
        """Returns the tables of a scene; errors are those of ``make_query_meshes``."""
        groups = group_by_model(scene.contacts)
        contacts = [contact for group in groups for contact in group]
        clusters = make_clusters(contacts, sum(body.count for body in scene.bodies))
        return cls(groups, contacts, clusters, make_query_meshes(contacts, mesh_cache))


@dataclass(frozen=True)
class ContactTable:
    """Contacts of a model on one device.

    Attributes:
        contacts: All contacts in device order.
        start_of: Index of the first item of each contact.
        clusters: Clusters of contacts.
        groups: Contact groups.
        couplings: Contact couplings, in the order of their contacts.
        geometry: Fields of the geometric parameters of all contacts, by name.
        geometry_field: Device field of these parameters.
        meshes: Warp meshes of the queries; created when the model is allocated.
    """

    contacts: list[Contact]
    start_of: Mapping[Contact, int]
    clusters: ContactClusters
    groups: list[ContactGroup]
    couplings: ContactCouplings
    geometry: Mapping[str, Field]
    geometry_field: DeviceField
    meshes: list[wp.Mesh]


def declare_contacts(
    scene: SceneData,
    tables: SceneContacts,
    grids: list[FaceGrid] | None,
    arrays: ModelArrays,
    layout: AllocationPlan,
    parameters: Parameters,
    t: Structs,
    point_positions: Callable[[], Array],
    position_parameters: list[Parameter],
) -> ContactTable:
    """Declares the contacts of a model and adds their parameters.

    Args:
        scene: The scene.
        tables: Host tables of its contacts.
        grids: Face grids of the query meshes; ``None``: queries use none.
        arrays: Arrays of the model.
        layout: Allocation plan to which the arrays are added.
        parameters: Parameters to which those of contacts are added.
        t: Warp structs of the precision.
        point_positions: Returns the positions of all points.
        position_parameters: Parameters on which these positions depend.
    """
    contacts, clusters, query_meshes = tables.contacts, tables.clusters, tables.query_meshes
    starts = np.cumsum([0] + [contact.count for contact in contacts]).tolist()
    start_of = dict(zip(contacts, starts, strict=False))
    couplings = ContactCouplings.order(scene.contact_couplings, contacts)
    dependent_fields = upload_clusters(clusters, contacts, arrays.model, layout, parameters, t, point_positions)
    for parameter in position_parameters:
        parameter.device_fields.extend(dependent_fields)
    point_count = sum(points.count for points in scene.points)
    _add_point_normals(contacts, point_count, arrays.model, parameters, t)
    meshes = upload_query_meshes(query_meshes, grids, arrays.model, layout, t)
    _declare_indices(contacts, query_meshes.first_of_contact, arrays.model, layout)
    geometry, geometry_field = _add_geometry(contacts, start_of, arrays.model, parameters, t)
    arrays.contact_tolerance = ContactTolerance(geometry["contact_tolerance"], geometry_field)
    has_joints = any(body.motion.kind != types.FREE for body in scene.bodies)
    groups = [
        make_group(group, start_of[group[0]], couplings, clusters, layout, parameters, t.real, has_joints)
        for group in tables.groups
    ]
    return ContactTable(contacts, start_of, clusters, groups, couplings, geometry, geometry_field, meshes)


def _declare_indices(
    contacts: list[Contact], first_mesh_of: Mapping[Contact, int], model: Any, layout: AllocationPlan
) -> None:
    """Declares point, query mesh and options of each contact."""
    counts = np.array([contact.count for contact in contacts], dtype=np.intp)

    def add_constant(name: str, of_contact: list[int], values: Any = 0) -> None:
        each = np.repeat(np.array(of_contact, dtype=np.int32), counts)
        layout.constant("contacts", model, name, each + values, wp.int32)

    items_of = [np.arange(count) for count in counts]
    starts = [contact.points.start for contact in contacts]
    add_constant("contact_point", starts, np.concatenate([np.zeros(0, dtype=np.int32), *items_of]))
    add_constant("contact_query_mesh", [first_mesh_of[contact] for contact in contacts])
    options = [
        types.LATCHED * (contact.entry == "latched")
        # With all minima, other walls act also next to a boundary that does not.
        + types.BOUNDARY_OUTER * (contact.boundary == "outer" or contact.minima == "all")
        + types.IGNORES_BOUNDARY * (contact.boundary == "off" and contact.minima == "all")
        + types.HERTZ_TORSION * (contact.torsion_radius is None)
        + types.SWEPT * contact.swept
        + types.FORCE_AT_POINT * (contact.facing is not None)
        for contact in contacts
    ]
    add_constant("contact_options", options)


def _add_geometry(
    contacts: list[Contact],
    start_of: Mapping[Contact, int],
    model: Any,
    parameters: Parameters,
    t: Structs,
) -> tuple[dict[str, Field], DeviceField]:
    """Adds the geometric parameters of contacts; returns their fields and device field."""

    def values_of(contact: Contact, key: str) -> Array:
        value = getattr(contact, key)
        # 0 stands for a torsion radius that is computed from the penetration.
        return np.broadcast_to(0.0 if value is None else value, contact.count)

    fields = {
        key: Field(np.concatenate([np.zeros(0), *(values_of(contact, key) for contact in contacts)]))
        for key in _RANGES
    }
    fields["contact_tolerance"] = Field(np.zeros(sum(contact.count for contact in contacts)))
    struct = t.ContactGeometry
    device_field = parameters.device_field(
        model, "contact_geometry", struct, lambda: pack(struct, {key: one.values for key, one in fields.items()})
    )
    for contact in contacts:
        items = slice(start_of[contact], start_of[contact] + contact.count)
        own = dict(_RANGES)
        # The radius of a contact of a contact coupling is the effective range.
        if contact.facing is not None or limits_of.needs_radius(
            contact.material, contact.torsion_radius is not None
        ):
            own["radius"] = limits("m", above=0.0)
        for key, allowed in own.items():
            if getattr(contact, key) is None:
                continue
            parameters.add(
                f"{contact.name}.{key}",
                fields[key],
                items,
                allowed,
                [device_field],
                single=contact.points.single,
                convert=checks.switches if key == "enabled" else None,
            )
    return fields, device_field


def _add_point_normals(
    contacts: list[Contact], point_count: int, model: Any, parameters: Parameters, t: Structs
) -> None:
    """Adds the device field of point normals, in their bodies, if a contact has ``facing="projected"``."""
    weighed = [
        (points, points.normals, parameters.by_name[f"{points.surface.name}.orientation"])
        for points in (contact.points for contact in contacts if contact.facing == "projected")
        if points.surface is not None and points.normals is not None
    ]
    if not weighed:
        return

    def normals() -> Array:
        envs = max(len(turn.field.values) for _, _, turn in weighed)
        values = np.zeros((envs, point_count, 3))
        for points, own, turn in weighed:
            items = slice(points.start, points.start + len(own))
            values[:, items] = transform_points(own, np.zeros(3), turn.field.values[:, turn.items.start])
        return values

    device_field = parameters.device_field(model, "point_normal", t.vec3, normals)
    for _, _, turn in weighed:
        if device_field not in turn.device_fields:
            turn.device_fields.append(device_field)
