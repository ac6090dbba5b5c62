"""Implements ``Scene.from_usd``: reads the file in a sandboxed process, and builds the scene from UsdPhysics data."""

import os
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np
from scipy.spatial.transform import Rotation

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.joints import Fixed, Prescribed
from warpcontact.meshes.isolation import Limits, array_of, header_of, read_sandboxed, unexpected_answer
from warpcontact.meshes.readers import USD_SUFFIXES, Unreadable
from warpcontact.scene.elements import Body, ContactMaterial
from warpcontact.scene.material_table import GivenTable, MaterialTable, check_names, checked_table
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.scene_element import SceneElement
from warpcontact.scene.surface_contact import check_amount
from warpcontact.usd.importing.contact_materials import FRICTION, PhysicsMaterial
from warpcontact.usd.importing.contacts import Collider, ContactBuilder
from warpcontact.usd.importing.findings import InvalidValue, Unsupported, UsdError, shortened
from warpcontact.usd.importing.restore import restore_scene
from warpcontact.usd.importing.shapes import ColliderShape, Weight, collider_shape
from warpcontact.usd.importing.stage import ARRAY, read_stage
from warpcontact.validation import checks
from warpcontact.validation.checks import Array
from warpcontact.validation.checks import limits as allowed

#: Default density [kg/m³].
DENSITY = 1000.0
# Largest length of element names.
_LONGEST = 60

# Types of arrays that the reader process returns.
_TYPES = ("<f8", "<i8", "|b1")


def build_scene(
    physics: dict[str, Any],
    subject: str,
    *,
    material: ContactMaterial | MaterialTable | None,
    contact_time: float,
    samples: int | str | None,
    skip_unsupported: bool,
) -> SceneData:
    """Returns the scene of a stage.

    Args:
        physics: Result of ``read_physics``.
        subject: Name of the stage in messages.
        material: Contact material of all contacts, or a table of them; ``None``: from the physics materials.
        contact_time: Duration of an impact [s].
        samples: Sampling of meshes, as for ``add_surface_contact``; ``None``: body contact.
        skip_unsupported: Whether to omit what has no counterpart instead of raising an error.

    Raises:
        UsdError: If something is invalid or has no counterpart; lists all problems.
    """
    return _Assembly(physics).scene(subject, material, contact_time, samples, skip_unsupported)


class _Assembly:
    def __init__(self, physics: dict[str, Any]) -> None:
        self.physics = physics
        findings = physics["findings"]
        self.wrong, self.unsupported, self.remarks = (
            list(findings[key]) for key in ("wrong", "unsupported", "remarks")
        )
        paths = [one["path"] for one in (*physics["bodies"], *physics["colliders"])]
        names = element_names(paths)
        self.body_names, self.collider_names = names[: len(physics["bodies"])], names[len(physics["bodies"]) :]

    def scene(
        self,
        subject: str,
        material: ContactMaterial | MaterialTable | None,
        contact_time: float,
        samples: int | str | None,
        skip: bool,
    ) -> SceneData:
        found = [
            self._collect_errors(one, partial(self._part, one, name)) for one, name in self._named_colliders()
        ]
        scene = SceneData(self.physics["gravity"])
        bodies: list[Body | None] = []
        centers = []
        carried: list[list[tuple[dict[str, Any], ColliderShape]]] = [[] for _ in self.body_names]
        for collider, part in zip(self.physics["colliders"], found, strict=True):
            if collider["body"] >= 0 and part is not None:
                carried[collider["body"]].append((collider, part))
        for record, name, geometry in zip(self.physics["bodies"], self.body_names, carried, strict=True):
            made = self._collect_errors(record, partial(self._body, scene, record, name, geometry))
            bodies.append(made)
            centers.append(np.zeros(3) if made is None else _local(record, made.position))
        self._raise_problems(subject, skip)
        colliders: list[Collider] = []
        numbers = np.full(len(found), -1)  # indices among the colliders that are not omitted
        for i, ((record, name), one) in enumerate(zip(self._named_colliders(), found, strict=True)):
            if one is None:
                continue
            carrier = bodies[record["body"]] if record["body"] >= 0 else None
            shift = centers[record["body"]] if record["body"] >= 0 else np.zeros(3)
            numbers[i] = len(colliders)
            colliders.append(self._collider(record, name, carrier, one, shift))
        for one in colliders:
            self._collect_errors({"path": one.path}, partial(one.add, scene))
        if isinstance(material, MaterialTable):
            check_names(
                "from_usd",
                material,
                (one.material_name for one in colliders),
                "collider has this physics material",
            )
        contact_builder = ContactBuilder(scene, material, contact_time, samples)
        apart = numbers[self.physics["apart"]]
        self._collect_errors(
            {"path": "/"}, partial(contact_builder.add, colliders, apart[(apart >= 0).all(axis=1)])
        )
        self._raise_problems(subject, skip)
        without_material = sum(record["material"] is None for record in self.physics["colliders"])
        if without_material and material is None:
            self.remarks.append(
                f"{without_material} colliders have no physics material: friction {FRICTION}, restitution 0"
            )
        scene.suggested_dt = self.physics["stepping"]["dt"]
        scene.suggested_iterations = self.physics["stepping"]["iterations"]
        scene.import_warnings = (
            *self.remarks,
            *contact_builder.remarks,
            *(f"omitted: {one}" for one in self.unsupported),
        )
        return scene

    def _named_colliders(self) -> list[tuple[dict[str, Any], str]]:
        return list(zip(self.physics["colliders"], self.collider_names, strict=True))

    def _collect_errors(self, record: dict[str, Any], make: Callable[[], Any]) -> Any:
        try:
            return make()
        except Unsupported as error:
            self.unsupported.append(f"{shortened(record['path'])}: {error}")
        except (ValueError, TypeError) as error:
            self.wrong.append(f"{shortened(record['path'])}: {error}")
        return None

    def _raise_problems(self, subject: str, skip: bool) -> None:
        problems = self.wrong + ([] if skip else [f"{one} (not supported)" for one in self.unsupported])
        if problems:
            raise UsdError(subject, problems)

    def _part(self, record: dict[str, Any], name: str) -> ColliderShape:
        """Returns a collider in the frame of its body, whose origin is that of its prim."""
        shape, placement = record["shape"], record["placement"]
        if record["body"] < 0:
            return collider_shape(shape, placement[:3, :3], placement[:3, 3], name, filled=False)
        carrier = self.physics["bodies"][record["body"]]
        linear, position = carrier["turn"].T @ placement[:3, :3], _local(carrier, placement[:3, 3])
        return collider_shape(shape, linear, position, name, filled=True)

    def _body(
        self,
        scene: SceneData,
        record: dict[str, Any],
        name: str,
        colliders: list[tuple[dict[str, Any], ColliderShape]],
    ) -> Body:
        rotation = record["turn"]
        weight = self._weight(record, colliders)
        still = not (record["velocity"].any() or record["angular_velocity"].any())
        motion = None if not record["kinematic"] else Fixed() if still else Prescribed()
        return scene.add_body(
            mass=weight.mass,
            inertia=weight.inertia,
            position=record["placement"][:3, 3] + rotation @ weight.centre,
            orientation=Rotation.from_matrix(rotation).as_quat(),
            linear_velocity=record["velocity"],
            angular_velocity=record["angular_velocity"],
            motion=motion,
            name=name,
        )

    def _weight(self, record: dict[str, Any], colliders: list[tuple[dict[str, Any], ColliderShape]]) -> Weight:
        """Returns mass, center of mass and inertia of a body in its frame.

        Values of MassAPI on the body take precedence over those on its colliders, and these over values computed
        from volumes and densities.
        """
        parts = [_weight_of(record, one, geometry) for one, geometry in colliders]
        weights = [part for part in parts if part is not None]
        weight = Weight.total(weights) if weights else None
        centre = None if record["centre"] is None else _local(record, record["centre"])
        mass, moments = record["mass"], record["moments"]
        if weight is None:
            complete = mass > 0.0 and moments is not None
            if not complete and not record["kinematic"]:
                missing = "physics:mass" if mass == 0.0 else "physics:diagonalInertia"
                raise InvalidValue(
                    f"{missing} must be authored, because no collider has a volume to compute it from"
                )
            origin = np.zeros(3) if centre is None else centre
            weight = Weight(mass or 1.0, origin, np.eye(3))
        if mass > 0.0:
            weight = weight.scaled(mass)
        if centre is not None:
            weight = weight.with_center(centre)
        if moments is not None:
            weight = Weight(weight.mass, weight.centre, _tensor(moments, record["axes"]))
        return weight

    def _collider(
        self, record: dict[str, Any], name: str, body: Body | None, geometry: ColliderShape, shift: Array
    ) -> Collider:
        self.remarks += [f"{shortened(record['path'])}: {remark}" for remark in geometry.remarks]
        placed = ColliderShape(
            geometry.form, geometry.mesh, geometry.position - shift, geometry.orientation, geometry.solid
        )
        moves = record["body"] >= 0 and not self.physics["bodies"][record["body"]]["kinematic"]
        material = PhysicsMaterial.of(record["material"])
        material_name = (record["material"] or {}).get("name")
        return Collider(
            record["path"], name, body, moves, placed, material, bool(record["visible"]), material_name
        )


def _local(body: dict[str, Any], position: Array) -> Array:
    """Returns a world position in the frame of a body, whose origin is that of its prim [m]."""
    local: Array = body["turn"].T @ (position - body["placement"][:3, 3])
    return local


def _weight_of(body: dict[str, Any], record: dict[str, Any], geometry: ColliderShape) -> Weight | None:
    """Returns mass properties of a collider in the frame of its body; ``None`` if it has no volume."""
    # In UsdPhysics, the density of a material has the lowest precedence.
    density = record["density"] or body["density"] or (record["material"] or {}).get("density") or DENSITY
    if geometry.solid is None or not geometry.solid.volume > 0.0:
        return None
    weight = Weight.of(geometry.solid, record["mass"] or density * geometry.solid.volume)
    if record["centre"] is not None:
        weight = weight.with_center(_local(body, record["centre"]))
    if record["moments"] is not None:
        axes = body["turn"].T @ _rotation(record["placement"][:3, :3])
        weight = Weight(weight.mass, weight.centre, axes @ _tensor(record["moments"], record["axes"]) @ axes.T)
    return weight


def _rotation(linear: Array) -> Array:
    """Returns the rotation nearest to a linear map (3, 3)."""
    left, _, right = np.linalg.svd(linear)
    rotation: Array = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return rotation


def _tensor(moments: Array, axes: Array | None) -> Array:
    """Returns the inertia tensor with given principal moments; ``axes``: quaternion from principal axes to body."""
    rotation = np.eye(3) if axes is None else Rotation.from_quat(axes).as_matrix()
    return rotation @ np.diag(moments) @ rotation.T


def element_names(paths: list[str]) -> list[str]:
    """Returns a distinct valid element name for each prim path: the prim name, with a number if it is repeated."""
    taken = {"scene"}
    last: dict[str, int] = {}  # last number appended to each repeated name
    names = []
    for path in paths:
        text = re.sub(r"[^A-Za-z0-9_-]", "_", path.rpartition("/")[2])[:_LONGEST]
        name = base = text if re.match(r"[A-Za-z_]", text) else f"_{text}"
        while name in taken:
            last[base] = last.get(base, 1) + 1
            name = f"{base}_{last[base]}"
        taken.add(name)
        names.append(name)
    return names


def _checked_entry(label: str, given: Any) -> ContactMaterial:
    if not isinstance(given, ContactMaterial):
        raise TypeError(f"{label} must be a wc.ContactMaterial or None, got {given!r}")
    return given


def scene_from_usd(
    path: str | os.PathLike[str],
    *,
    custom_types: Iterable[type[Formula] | type[SceneElement]],
    material: ContactMaterial | GivenTable | None,
    contact_time: float,
    samples: int | str | None,
    skip_unsupported: bool,
    trusted: bool,
    limits: Limits | None,
) -> SceneData:
    """Returns the scene of a USD file; arguments and errors as for ``Scene.from_usd``."""
    given = checked_table("from_usd", material, _checked_entry) if isinstance(material, Mapping) else material
    if given is not None and not isinstance(given, ContactMaterial | MaterialTable):
        raise TypeError(f"material must be a wc.ContactMaterial, a table of them, or None, got {material!r}")
    if limits is not None and not isinstance(limits, Limits):
        raise TypeError(f"limits must be a Limits or None, got {limits!r}")
    duration = float(checks.numbers("contact_time", contact_time, (), allowed("s", above=0.0)))
    amount = None if samples is None else check_amount("samples", samples)
    skip = checks.switch("skip_unsupported", skip_unsupported)
    subject = f"stage {shortened(path)!r}"
    found = _read(Path(path), subject, checks.switch("trusted", trusted), Limits() if limits is None else limits)
    if "description" in found:
        if found["additions"] and not skip:
            raise UsdError(subject, [f"{one} (not supported)" for one in found["additions"]])
        scene = restore_scene(found["description"], custom_types, subject)
        scene.suggested_dt = found["stepping"]["dt"]
        scene.suggested_iterations = found["stepping"]["iterations"]
        scene.import_warnings = tuple(f"omitted: {one}" for one in found["additions"])
        return scene
    return build_scene(
        found["physics"],
        subject,
        material=given,
        contact_time=duration,
        samples=amount,
        skip_unsupported=skip,
    )


def _read(path: Path, subject: str, trusted: bool, limits: Limits) -> Any:
    try:
        if path.suffix.lower() not in USD_SUFFIXES:
            raise Unreadable(f"the extension {path.suffix!r} is not one of {', '.join(USD_SUFFIXES)}")
        if not path.is_file():  # excludes pipes, which would block
            raise Unreadable("it is not a regular file" if path.exists() else "it does not exist")
        file = os.path.abspath(path)
        if trusted:
            return read_stage(file, limits.faces, confined=False)
        task = {"file": file, "most_faces": limits.faces}
        return read_sandboxed("warpcontact.usd.importing.stage", task, limits, partial(_unpack, limits=limits))
    except (Unreadable, OSError) as error:
        raise UsdError(subject, [str(error)]) from error


def _unpack(output: IO[bytes], limits: Limits) -> Any:
    """Returns the value written by a process; checks sizes before allocating memory.

    Raises:
        EOFError: If the output ends early.
        Unreadable: If the output is an error report, or invalid.
    """
    try:
        header = header_of(output, limits)
        shapes = [(str(kind), [int(size) for size in shape]) for kind, *shape in header["arrays"]]
        if any(kind not in _TYPES or min(shape, default=0) < 0 for kind, shape in shapes):
            raise unexpected_answer("arrays of unknown types")
        if sum(np.dtype(kind).itemsize * prod(shape) for kind, shape in shapes) > limits.memory:
            raise unexpected_answer("more than is allowed")
        arrays = [array_of(output, prod(shape), kind).reshape(shape) for kind, shape in shapes]

        def restore(value: Any) -> Any:
            if isinstance(value, dict):
                return (
                    arrays[value[ARRAY]] if ARRAY in value else {key: restore(one) for key, one in value.items()}
                )
            return [restore(one) for one in value] if isinstance(value, list) else value

        return restore(header["tree"])
    except (Unreadable, EOFError):
        raise
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise unexpected_answer(f"{type(error).__name__}: {error}") from error
