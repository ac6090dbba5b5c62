"""Body contacts of a scene, and the method of ``Scene`` that adds them; it checks all input."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.rounded_box import RoundedBox
from warpcontact.scene.elements import MARGIN, Body, ContactMaterial, Surface, check_owned, options_of
from warpcontact.scene.material_table import GivenTable, MaterialTable, check_pairs, checked_table
from warpcontact.scene.shapes import Shape
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

#: An element with the geometry of a solid.
Solid: TypeAlias = Surface | Shape

#: Weight of the columns on the faces of the second solid, by ``reference``; negative: it follows from the flatness of both.
REFERENCES = {"auto": -1.0, "first": 0.0, "second": 1.0, "average": 0.5}


@cache
def curved_shapes() -> tuple[type, ...]:
    """Returns the classes of shapes with curved surfaces that body contact supports."""
    # Imported on demand, because most scenes do not need them.
    from warpcontact.kernels.shapes.revolution import Cone, Cylinder
    from warpcontact.kernels.shapes.spheres import Capsule, Ellipsoid, Sphere

    return Sphere, Ellipsoid, Cylinder, Cone, Capsule


@dataclass(frozen=True, eq=False)
class BodyContact:
    """Contact of solids over an area: all pairs of a first and a second solid on different bodies.

    ``first`` and ``second`` are the same for a list of solids in contact with each other. With a table of contact materials,
    ``material`` is that of the first pair, and those of all pairs have the same contact model.
    """

    name: str
    first: tuple[Solid, ...]
    second: tuple[Solid, ...]
    material: ContactMaterial
    table: MaterialTable | None
    exclude: tuple[tuple[Solid, Solid], ...]
    reference: str
    kappa: Array
    max_depth: Array
    margin: Array
    force_scale: Array
    enabled: Array
    color: Array | None
    visible: bool

    @cached_property
    def pairs(self) -> tuple[tuple[Solid, Solid], ...]:
        """Its pairs: each first solid with each second one on another body, unless groups or ``exclude`` prevent contact.

        Pairs that the table of contact materials excepts are left out. A half-space or open surface is the second of a pair.
        """
        pairs = _pairs_of(self.first, self.second, self.exclude)
        if self.table is None:
            return pairs
        materials = self.table.find_all(pairs)
        return tuple(pair for pair, material in zip(pairs, materials, strict=True) if material is not None)

    @cached_property
    def materials(self) -> tuple[ContactMaterial, ...]:
        """Contact material of each pair."""
        if self.table is None:
            return (self.material,) * len(self.pairs)
        return tuple(one for one in self.table.find_all(self.pairs) if one is not None)

    @property
    def count(self) -> int:
        """Number of pairs."""
        return len(self.pairs)

    @property
    def single(self) -> bool:
        """Whether it is one pair, without an item axis."""
        return len(self.pairs) == 1

    @property
    def parts(self) -> ContactModel:
        """The contact model: classes of law and friction models, for which a kernel is compiled."""
        return self.material.parts

    @property
    def formulas(self) -> dict[str, Formula]:
        """Its law and friction models, by name of the part."""
        return self.material.formulas

    @property
    def per_area(self) -> bool:
        """Whether the law is a pressure; otherwise its mean over the area of contact is the normal force."""
        return self.material.law.takes_area

    @property
    def bodies(self) -> tuple[Body | None, Body | None]:
        """Bodies of the first pair; ``None``: the world."""
        first, second = self.pairs[0]
        return first.body, second.body

    def parameters(self, part: str) -> dict[str, Any]:
        """Returns the parameters of one part of the material, one value or one per pair.

        With an area of 1 m², a force is a pressure.
        """
        if self.table is None:
            return self.formulas[part].parameters(area=1.0)
        each = [material.formulas[part].parameters(area=1.0) for material in self.materials]
        return {key: np.array([values[key] for values in each]) for key in each[0]}

    def is_computed(self, part: str, name: str) -> bool:
        """Returns whether a parameter of one part of the material is computed: the area."""
        return name == "area" and self.formulas[part].takes_area


@explain_keywords_of
class BodyContacts:
    """The body contacts of a ``Scene``."""

    body_contacts: list[BodyContact]
    surfaces: list[Surface]
    shapes: list[Shape]
    _elements: dict[str, Any]

    def add_body_contact(
        self,
        first: Body | Solid | Sequence[Body | Solid],
        second: Body | Solid | Sequence[Body | Solid] | ContactMaterial | GivenTable,
        material: ContactMaterial | GivenTable | None = None,
        *,
        exclude: Sequence[
            tuple[Body | Solid | Sequence[Body | Solid], Body | Solid | Sequence[Body | Solid]]
        ] = (),
        reference: str = "auto",
        kappa: float = 0.5,
        max_depth: float | None = None,
        margin: float = 0.0,
        force_scale: float = 1.0,
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> BodyContact:
        """Adds contact of solids over an area: faces, edges and vertices of both carry load.

        Solids are closed meshes, boxes, spheres, ellipsoids, cylinders, cones, capsules, half-spaces (``wc.shapes.Plane``,
        second only) and open surfaces (second only). A column stands on each point of a face of one solid inside the other
        solid, along the normal of the face, and its length is the depth. Between two curved shapes, columns are along the
        normal of a common plane. A law with an omitted ``area`` is the pressure at the depth of each column. The mean of any
        other law over the area of contact is the normal force. Friction without history acts at each point of the area;
        friction with history has one force and one torque per patch of similar normals. A law with history has one history per
        patch, and acts at the root mean square of the depths of its columns.

        Args:
            first: A surface, a shape, a body (all of its surfaces and shapes), or a list of them. Sensors give the force
                on it.
            second: Likewise. Each first solid is paired with each second one on another body. With several pairs, sensors
                have an additional axis, ``item``. If left out, as in ``add_body_contact(bodies, material)``, each solid of the
                list is paired with each other one; a half-space or open surface is the second of its pairs.
            material: Contact material, without rolling and torsional friction; or a table of them,
                ``{("steel", "steel"): …, ("rubber", "steel"): …, None: …}``, by the ``physics_material`` of both solids. The
                order of names does not matter. ``None`` as a key stands for all other pairs, and as a value for pairs that
                are not in contact. Materials of a table have the same classes of law and friction, and parameters of the
                contact have one value per pair.
            exclude: Pairs of surfaces, shapes or bodies that are not in contact, for example the two bodies of a joint; or
                pairs of lists of them. ``group`` and ``mask`` of ``add_shape`` and ``add_surface`` also prevent contact.
            reference: Solid on whose faces the columns stand. ``"auto"``: the flatter one, with a continuous transition;
                ``"first"``, ``"second"``, or ``"average"`` of both. A half-space or open surface is always the reference.
                Two curved shapes have a common plane instead.
            kappa: The force of a column acts at κ times its length from the second solid.
            max_depth: Maximum depth of a contact [m]. Default: unlimited.
            margin: Gap up to which nonsmooth contact finds points, at least [m]. Points within the distance of two steps are
                always found.
            force_scale: Factor on forces and torques of this contact.
            enabled: Whether the contact is enabled.
            name: Name in parameters and sensors. Default: generated.
            color: Color of the force arrows, RGB in 0…1.
            visible: Whether the force arrows are drawn.

        Raises:
            TypeError: If an argument is of a wrong type.
            ValueError: If a value is out of range, a solid is not supported, or there is no pair on different bodies.
        """
        name = checks.new_name("body_contact", name, self._elements)
        if material is None and isinstance(second, ContactMaterial | Mapping):
            material = second
            second = first
        table = checked_table(name, material, _checked_material) if isinstance(material, Mapping) else None
        first_material = _checked_material(name, material) if table is None else table.materials[0]
        firsts = self._solids(f"{name}.first", first)
        seconds = self._solids(f"{name}.second", second)
        if set(firsts) != set(seconds):
            for solid in firsts:
                _check_first(name, solid)
        excluded = self._excluded(name, exclude, {*firsts, *seconds})
        pairs = _pairs_of(firsts, seconds, excluded)
        if not pairs:
            where = f"body {firsts[0].body.name!r}" if firsts[0].body else "the world"
            reason = f"all solids are fixed to {where}; one must move"
            if len({solid.body for solid in (*firsts, *seconds)}) > 1:
                reason = "exclude, groups and masks leave no pair of solids on different bodies"
            raise ValueError(f"{name}: {reason}")
        if table is not None:
            check_pairs(name, table, (*firsts, *seconds), pairs)
            first_material = next(one for one in table.find_all(pairs) if one is not None)
        options = options_of(name, kappa, max_depth, None, force_scale, enabled, color, visible)
        del options["torsion_radius"]
        contact = BodyContact(
            name=name,
            first=tuple(firsts),
            second=tuple(seconds),
            material=first_material,
            table=table,
            exclude=excluded,
            margin=checks.numbers(f"{name}.margin", margin, (), MARGIN),
            reference=checks.choice(f"{name}.reference", reference, tuple(REFERENCES)),
            **options,
        )
        for pair in contact.pairs:
            _check_pair(name, *pair)
        self.body_contacts.append(contact)
        self._elements[name] = contact
        return contact

    def _excluded(self, name: str, pairs: Any, solids: set[Solid]) -> tuple[tuple[Solid, Solid], ...]:
        """Returns the pairs of solids of the argument ``exclude``."""
        found: list[tuple[Solid, Solid]] = []
        if not isinstance(pairs, list | tuple):
            raise TypeError(f"{name}.exclude must be a list of pairs of surfaces, shapes or bodies, got {pairs!r}")
        for i, pair in enumerate(pairs):
            label = f"{name}.exclude[{i}]"
            if not isinstance(pair, list | tuple) or len(pair) != 2:
                raise TypeError(
                    f"{label} must be a pair of surfaces, shapes, bodies, or lists of them, got {pair!r}"
                )
            one, other = (self._solids(label, side) for side in pair)
            for solid in (*one, *other):
                if solid not in solids:
                    raise ValueError(f"{label}: {solid.name!r} is not among the solids of {name!r}")
            found += itertools.product(one, other)
        return tuple(dict.fromkeys(found))

    def _solids(self, label: str, given: Any) -> list[Solid]:
        """Returns the solids of an argument."""
        solids: list[Solid] = []
        for one in given if isinstance(given, list | tuple) else [given]:
            if isinstance(one, Body):
                check_owned(label, one, Body, self._elements, "add_body")
                own: list[Solid] = [each for each in self.surfaces if each.body is one]
                own += [each for each in self.shapes if each.body is one]
                if not own:
                    raise ValueError(f"{label}: body {one.name!r} has no surface or shape; add_surface adds one")
                solids += own
            elif isinstance(one, Surface | Shape):
                method = "add_surface" if isinstance(one, Surface) else "add_shape"
                check_owned(label, one, type(one), self._elements, method)
                solids.append(one)
            else:
                raise TypeError(f"{label} must be a surface, a shape, a body or a list of them, got {one!r}")
        if not solids:
            raise ValueError(f"{label} must not be an empty list")
        for solid in solids:
            _check_solid(label, solid)
        return solids


def _pairs_of(
    first: Sequence[Solid], second: Sequence[Solid], exclude: Sequence[tuple[Solid, Solid]]
) -> tuple[tuple[Solid, Solid], ...]:
    """Returns the pairs of first and second solids on different bodies, unless groups, masks or ``exclude`` prevent contact."""
    excluded = {frozenset(pair) for pair in exclude}
    found: dict[frozenset[Solid], tuple[Solid, Solid]] = {}
    for one, other in itertools.product(first, second):
        key = frozenset((one, other))
        may_touch = bool(one.group & other.mask) and bool(other.group & one.mask)
        if one.body is not other.body and may_touch and key not in excluded:
            # Each pair once, although lists may have common elements.
            found.setdefault(key, (other, one) if _must_be_second(one) else (one, other))
    return tuple(found.values())


def unsupported_reason(first: Solid, second: Solid, material: ContactMaterial | None = None) -> str | None:
    """Returns why ``add_body_contact`` does not accept a pair of solids on different bodies; ``None``: it accepts it.

    Args:
        first: One of the solids; their order does not matter.
        second: The other one.
        material: Contact material; ``None``: only the solids are checked.
    """
    name = f"{first.name} and {second.name}"
    try:
        for solid in (first, second):
            _check_solid(name, solid)
        _check_pair(name, *((second, first) if _must_be_second(first) else (first, second)))
        if material is not None:
            _checked_material(name, material)
    except ValueError as error:
        return str(error)
    return None


def _check_pair(name: str, first: Solid, second: Solid) -> None:
    """Raises ``ValueError`` if body contact does not support a pair of solids, each of which it supports."""
    if _must_be_second(first):
        raise ValueError(
            f"{name}: {first.name!r} and {second.name!r} are both half-spaces or open surfaces, which have no body "
            "contact with each other; exclude leaves out a pair"
        )


def _check_solid(label: str, solid: Solid) -> None:
    """Raises ``ValueError`` if body contact does not support ``solid``."""
    if isinstance(solid, Surface):
        for mesh in solid.meshes:
            report = mesh.report
            if not report.closed or report.orientation == "outward":
                continue
            if report.orientation == "inward":
                raise ValueError(
                    f"{label}: the faces of surface {solid.name!r} are oriented inward, with a volume of {report.volume:.3g} m³; "
                    "allowed: outward; flip of add_surface, or flipped() of the mesh, reverses them"
                )
            if report.orientation == "mixed":
                raise ValueError(
                    f"{label}: the faces of surface {solid.name!r} disagree in orientation at edges of more than two faces; "
                    "allowed: each edge in both directions equally often"
                )
            raise ValueError(
                f"{label}: the faces of surface {solid.name!r} are closed but enclose no volume; allowed: a mesh with a "
                "thickness, or an open surface as second"
            )
        if not all(active.all() for active in solid.active):
            raise ValueError(
                f"{label}: surface {solid.name!r} has faces that are not active, which body contact needs"
            )
        return
    if not solid.single:
        raise ValueError(f"{label}: shape {solid.name!r} is a set; body contact needs shapes of single bodies")
    supported = (RoundedBox, Plane, *curved_shapes())
    if solid.kind not in supported:
        names = ", ".join(kind.__name__ for kind in supported)
        raise ValueError(
            f"{label}: shape {solid.name!r} is a {solid.kind.__name__}; body contact supports meshes and the shapes "
            f"{names}. add_shape_contact supports all shapes, at one point"
        )
    if solid.kind is RoundedBox and solid.sizes["radius"].any():
        raise ValueError(
            f"{label}: box {solid.name!r} has rounded edges, of radius {solid.sizes['radius'].max():g} m; body contact "
            "needs a radius of 0, or a closed mesh; add_shape_contact supports rounded edges, at one point"
        )


def _must_be_second(solid: Solid) -> bool:
    """Returns whether a solid is a half-space or open."""
    if isinstance(solid, Shape):
        return solid.kind is Plane
    return not all(mesh.report.closed for mesh in solid.meshes)


def _check_first(name: str, solid: Solid) -> None:
    """Raises ``ValueError`` unless a solid is bounded and closed."""
    if isinstance(solid, Shape) and solid.kind is Plane:
        raise ValueError(f"{name}: {solid.name!r} is a half-space, which must be second")
    if isinstance(solid, Surface) and not all(mesh.report.closed for mesh in solid.meshes):
        raise ValueError(
            f"{name}: surface {solid.name!r} is open, and must be second; warpcontact inspect shows its boundary"
        )


def _checked_material(name: str, material: Any) -> ContactMaterial:
    """Returns the material of a body contact.

    Raises:
        TypeError: If it is not a contact material.
        ValueError: If body contact does not support one of its parts.
    """
    if not isinstance(material, ContactMaterial):
        raise TypeError(f"material of {name!r} must be a wc.ContactMaterial, or a table of them, got {material!r}")
    law, friction = material.law, material.friction
    for part in ("rolling", "torsion"):
        formula = material.formulas[part]
        if not isinstance(formula, Frictionless):
            raise ValueError(
                f"{name}: its material has {part} {type(formula).__name__}; body contact has no {part} friction, "
                "because friction over the area resists spin and pressure over the area resists rolling"
            )
    for part, formula in (("law", law), ("friction", friction)):
        has_friction = not isinstance(friction, Frictionless)
        if type(formula).memories and (friction.directional or (law.pulls and has_friction)):
            kind = (
                f"friction {type(friction).__name__} depends on the direction of slip"
                if friction.directional
                else f"law {type(law).__name__} pulls, with friction"
            )
            raise ValueError(
                f"{name}: the {part} of its material, {type(formula).__name__}, has history variables, and its {kind}; "
                "body contact does not support both"
            )
    if law.needs_curvature or friction.needs_radius:
        part, formula = ("law", law) if law.needs_curvature else ("friction", friction)
        raise ValueError(
            f"{name}: the {part} of its material, {type(formula).__name__}, needs a radius of curvature, which an area "
            "does not have"
        )
    if "area" in law.parameters(area=math.nan) and not law.takes_area:
        raise ValueError(
            f"{name}: the law of its material has an area; leave it out, because body contact computes it"
        )
    if friction.takes_area and not law.takes_area:
        raise ValueError(
            f"{name}: the friction of its material, {type(friction).__name__}, is per area, but its law "
            f"{type(law).__name__} is not"
        )
    return material


def reference_share(contact: BodyContact) -> Array:
    """Returns the weight of columns on second solids, (pairs,); negative: it follows from the flatness of both."""
    return np.full(contact.count, REFERENCES[contact.reference])
