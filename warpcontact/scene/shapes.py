"""Shapes and shape contacts of a scene, the methods of ``Scene`` that add them, and triangulation of shapes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.shapes import tessellation
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.kernels.types import WORLD
from warpcontact.meshes import icosphere
from warpcontact.scene.elements import (
    ALL_GROUPS,
    Body,
    ContactMaterial,
    check_owned,
    group_bits,
    options_of,
    physics_material_name,
)
from warpcontact.storage.parameters import pack
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.devices import find_device
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

if TYPE_CHECKING:
    from warpcontact.scene.scene_data import SceneData


@dataclass(frozen=True, eq=False)
class Shape:
    """An analytic shape fixed to a body or to the world, or one shape on each body of a set.

    Positions, orientations and sizes have one entry per shape, (n, …).
    """

    name: str
    body: Body | None
    kind: type[Form]
    sizes: dict[str, Array]  # parameters of its form by name
    positions: Array  # (n, 3) origin of its frame in the frame of the body [m]
    orientations: Array  # (n, 4) rotation of its frame to that of the body, quaternion
    group: int  # bits
    mask: int  # bits
    physics_material: str | None
    color: Array | None
    visible: bool

    @property
    def count(self) -> int:
        """Number of shapes."""
        return len(self.positions)

    @property
    def single(self) -> bool:
        """Whether it is a single shape, without an item axis."""
        return self.body is None or self.body.single

    @property
    def body_numbers(self) -> NDArray[np.int32]:
        """Body index of each shape on the device (n,), or ``WORLD``."""
        if self.body is None:
            return np.full(1, WORLD, dtype=np.int32)
        return np.arange(self.body.items.start, self.body.items.stop, dtype=np.int32)

    def may_touch(self, other: "Shape") -> bool:
        """Returns whether groups and masks allow contact: each shape is in a group of the mask of the other."""
        return bool(self.group & other.mask) and bool(other.group & self.mask)

    def form(self, item: int = 0) -> Form:
        """Returns the form of one item."""
        return self.kind(**{key: _plain(values[item]) for key, values in self.sizes.items()})


def _plain(value: Array) -> Any:
    return tuple(value.tolist()) if np.ndim(value) else float(value)


@dataclass(frozen=True, eq=False)
class ShapeContact:
    """Contact of two shapes, or of the shapes of a set with one shape or with those of another set."""

    name: str
    shape: Shape
    other_shape: Shape
    material: ContactMaterial
    kappa: Array
    max_depth: Array
    torsion_radius: Array | None
    force_scale: Array
    enabled: Array
    color: Array | None
    visible: bool

    @property
    def kinds(self) -> tuple[type[Form], type[Form]]:
        """Classes of its forms, for which the narrow phase is compiled."""
        return self.shape.kind, self.other_shape.kind

    @property
    def parts(self) -> ContactModel:
        """The contact model: classes of law and friction models, for which a kernel is compiled."""
        return self.material.parts

    @property
    def count(self) -> int:
        """Number of contacts."""
        return max(self.shape.count, self.other_shape.count)

    @property
    def single(self) -> bool:
        """Whether it is a single contact, without an item axis."""
        return self.shape.single and self.other_shape.single

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """Its shapes."""
        return self.shape, self.other_shape

    @property
    def bodies(self) -> tuple[Body | None, Body | None]:
        """Bodies of its shapes; ``None``: the world."""
        return self.shape.body, self.other_shape.body

    @property
    def formulas(self) -> dict[str, Formula]:
        """Its law and friction models, by name of the part."""
        return self.material.formulas

    def parameters(self, part: str) -> dict[str, Any]:
        """Returns the parameters of one part of its material."""
        return self.formulas[part].parameters()

    def is_computed(self, part: str, name: str) -> bool:
        """Returns whether a parameter of one part of its material is computed: none."""
        return False


# Parameters of a shape in addition to those of its form.
_OWN = ("position", "orientation")


@explain_keywords_of
class ShapeContacts:
    """The shapes and shape contacts of a ``Scene``."""

    shapes: list[Shape]
    shape_contacts: list[ShapeContact]
    _elements: dict[str, Any]

    def add_shape(
        self,
        body: Body | None,
        form: Form | Sequence[Form],
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        *,
        name: str | None = None,
        group: int = 1,
        mask: int = ALL_GROUPS,
        physics_material: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> Shape:
        """Adds an analytic shape. Contacts are added separately.

        Args:
            body: Body to which it is fixed; ``None``: the world. A set of bodies gets one shape per body.
            form: Geometry, of ``wc.shapes`` or a custom ``wc.ParametricSurface``. For a set of bodies one for all, or
                a list with one per body, all of the same class.
            position: Origin of its frame in the frame of the body [m]; for a set one for all, or (n, 3).
            orientation: Rotation shape → body, quaternion (x, y, z, w); for a set one for all, or (n, 4).
            name: Name in parameters and sensors. Default: generated.
            group: Bits of the groups of the shape, for particle and body contacts.
            mask: Bits of the groups with which it can be in contact. Two shapes can be in contact if each is in a
                group of the mask of the other.
            physics_material: Name of its material, for tables of contact materials of ``add_body_contact``.
            color: Display color, RGB in 0…1.
            visible: Whether it is drawn.

        Raises:
            TypeError: If ``form`` is not a shape of ``wc.shapes``.
            ValueError: If a value is out of range; the message names it.
        """
        name = checks.new_name("shape", name, self._elements)
        carrier = cast("SceneData", self).owned_body(f"{name}.body", body)
        count = 1 if carrier is None else carrier.count
        single = carrier is None or carrier.single
        kind, sizes = _sizes_of(name, form, count, single)
        shape = Shape(
            name=name,
            body=carrier,
            kind=kind,
            sizes=sizes,
            positions=_each(f"{name}.position", position, count, single, 3),
            orientations=checks.unit_quaternions(
                f"{name}.orientation", _each(f"{name}.orientation", orientation, count, single, 4)
            ),
            group=group_bits(f"{name}.group", group),
            mask=group_bits(f"{name}.mask", mask),
            physics_material=physics_material_name(f"{name}.physics_material", physics_material),
            color=checks.color(f"{name}.color", color),
            visible=checks.switch(f"{name}.visible", visible),
        )
        self.shapes.append(shape)
        self._elements[name] = shape
        return shape

    def add_shape_contact(
        self,
        shape: Shape,
        other_shape: Shape,
        material: ContactMaterial,
        *,
        kappa: float = 0.5,
        max_depth: float | None = None,
        torsion_radius: float | None = None,
        force_scale: float = 1.0,
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> ShapeContact:
        """Adds contact of two shapes, with the exact gap, normal and curvatures of their surfaces.

        A set of shapes with one other shape, or with a set of the same size, gives one contact per shape, and sensors
        have an additional axis, ``item``.

        Args:
            shape: From ``add_shape``.
            other_shape: From ``add_shape``, on another body. The normal points out of it.
            material: Contact material. R of rolling and of the contact patch is 1/k, with the largest curvature k of
                the gap at the contact: the radius of a sphere or cylinder on a plane.
            kappa: κ of the contact point K = P_b + κ (P_a − P_b), with the closest points P_a of ``shape`` and P_b
                of ``other_shape``.
            max_depth: Maximum penetration of a contact [m]. Default: unlimited.
            torsion_radius: Lever arm of torsional friction [m]. Default: (3π/16) √(R δ), for a sphere of radius R
                with Hertzian pressure.
            force_scale: Factor on forces and torques of this contact.
            enabled: Whether the contact is enabled.
            name: Name in parameters and sensors. Default: generated.
            color: Color of the force arrows, RGB in 0…1.
            visible: Whether the force arrows are drawn.

        Raises:
            ValueError: If a value is out of range, both shapes are fixed to the same body, or contact of these
                classes of shapes is not supported.
        """
        name = checks.new_name("shape_contact", name, self._elements)
        for key, one in (("shape", shape), ("other_shape", other_shape)):
            check_owned(f"{key} of {name!r}", one, Shape, self._elements, "add_shape")
        if shape.body is other_shape.body:
            where = f"body {shape.body.name!r}" if shape.body else "the world"
            raise ValueError(f"{name}: both shapes are fixed to {where}; one must move")
        if not shape.single and not other_shape.single and shape.count != other_shape.count:
            raise ValueError(
                f"{name}: two sets of shapes must have the same size, got {shape.count} of {shape.name!r} and "
                f"{other_shape.count} of {other_shape.name!r}"
            )
        check_material(name, material, torsion_radius)
        _check_pair(name, shape.kind, other_shape.kind, material)
        contact = ShapeContact(
            name=name,
            shape=shape,
            other_shape=other_shape,
            material=material,
            **options_of(name, kappa, max_depth, torsion_radius, force_scale, enabled, color, visible),
        )
        self.shape_contacts.append(contact)
        self._elements[name] = contact
        return contact


def check_material(name: str, material: ContactMaterial, torsion_radius: float | None) -> None:
    """Checks ``material`` and torsion radius of a contact of shapes.

    Raises:
        TypeError: If ``material`` is not a contact material.
        ValueError: If a torsion radius is given for a material without torsion, or the material needs an area.
    """
    if not isinstance(material, ContactMaterial):
        raise TypeError(f"material of {name!r} must be a wc.ContactMaterial, got {material!r}")
    if torsion_radius is not None and isinstance(material.torsion, Frictionless):
        raise ValueError(f"{name}.torsion_radius is given, but its material has no torsion")
    for part, formula in material.formulas.items():
        if formula.takes_area:
            raise ValueError(
                f"{name}: the {part} of its material, {type(formula).__name__}, was given no area [m²], and "
                f"shapes have none; give the {part} an area"
            )


def _check_pair(name: str, kind: type[Form], other: type[Form], material: ContactMaterial) -> None:
    """Raises ``ValueError`` if contact of two classes of shapes, or their curvature if needed, is not supported."""
    # Imported on demand, because only shape contacts need the solvers.
    from warpcontact.kernels.shapes.curvature import pair_curvature
    from warpcontact.kernels.shapes.force import uses_curvature
    from warpcontact.kernels.shapes.pair_dispatch import pair_function

    try:
        pair_function(kind, other)
        if uses_curvature(material.parts):
            pair_curvature(kind, other)
    except TypeError as error:
        raise ValueError(f"{name}: {kind.__name__} and {other.__name__}: {error}") from None


def _sizes_of(
    name: str, form: Form | Sequence[Form], count: int, single: bool
) -> tuple[type[Form], dict[str, Array]]:
    """Returns the class of a form, and its parameters (count, …) by name."""
    several = isinstance(form, list | tuple)
    forms: list[Any] = list(form) if isinstance(form, list | tuple) else [form]
    if several and (single or len(forms) != count):
        wanted = "one form for one shape" if single else f"one form or {count}, one for each body"
        raise ValueError(f"form of {name!r} must be {wanted}, got a list of {len(forms)}")
    for one in forms:
        if not isinstance(one, Form):
            raise TypeError(f"form of {name!r} must be an instance of a class of wc.shapes, got {one!r}")
        if type(one) is not type(forms[0]):
            raise ValueError(
                f"form of {name!r} must be of one class for all bodies, got {type(forms[0]).__name__} and "
                f"{type(one).__name__}"
            )
    kind = type(forms[0])
    if taken := [key for key in kind.varying() if key in _OWN]:
        raise ValueError(f"{kind.__name__} has a parameter {taken[0]!r}, a reserved name of all shapes; rename it")
    values = [one.parameters() for one in forms]
    sizes = {key: np.array([one[key] for one in values], dtype=np.float64) for key in values[0]}
    return kind, {key: rows if several else np.repeat(rows, count, axis=0) for key, rows in sizes.items()}


def _each(name: str, value: ArrayLike, count: int, single: bool, width: int) -> Array:
    """Returns ``value``, one for all or one per item, with shape (count, width)."""
    shape = checks.shape_of(name, value)
    full = (width,) if single or shape != (count, width) else (count, width)
    values = checks.numbers(name, value, full, limits("m") if width == 3 else checks.FINITE)
    return np.array(np.broadcast_to(values, (count, width)))


# Subdivisions of an icosahedron for convex shapes; steps per parameter for parametric surfaces and tori.
LEVEL = 4
STEPS = 48

Faces = NDArray[np.signedinteger[Any]]


def tessellate(kind: type[Form], sizes: Mapping[str, Array], reach: float = 1.0) -> tuple[Array, Faces]:
    """Returns the surface of a shape as points (n, 3) [m], in its frame, and triangles (m, 3), oriented outwards.

    Args:
        kind: Class of the shape.
        sizes: Parameters of the shape.
        reach: Half the side of the square that represents a half-space [m].
    """
    if issubclass(kind, Plane):
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return reach * corners, np.array([[0, 1, 2], [0, 2, 3]])
    if issubclass(kind, Torus):
        around, faces = _grid((0.0, 2 * np.pi), (0.0, 2 * np.pi), (True, True))
        distance = sizes["major_radius"] + sizes["minor_radius"] * np.cos(around[:, 1])
        height = sizes["minor_radius"] * np.sin(around[:, 1])
        return np.stack([distance * np.cos(around[:, 0]), distance * np.sin(around[:, 0]), height], axis=1), faces
    if issubclass(kind, ParametricSurface):
        parameters, faces = _grid(kind.u_range, kind.v_range, (kind.u_periodic, kind.v_periodic))
        return _computed(kind, sizes, tessellation.patch_points(kind), parameters, wp.vec2d), faces
    ball = icosphere(1.0, LEVEL)
    return _computed(kind, sizes, tessellation.support_points(kind), ball.vertices, wp.vec3d), ball.faces


@shared_capture_lock()
def _computed(
    kind: type[Form], sizes: Mapping[str, Array], kernel: wp.Kernel, given: Array, dtype: Any
) -> NDArray[np.float64]:
    struct = coefficient_struct(kind, wp.float64)
    columns = {key: np.asarray(value)[None, None] for key, value in sizes.items()}
    names = kind.device_names()
    computed = kind.coefficients(columns) if names else {"unused": np.zeros((1, 1))}
    packed = pack(struct, {name: computed[name] for name in names or ("unused",)})
    device = find_device("cpu")
    points = wp.zeros(len(given), dtype=wp.vec3d, device=device)
    inputs = [wp.array(packed, dtype=struct, device=device), wp.array(given, dtype=dtype, device=device)]
    wp.launch(kernel, dim=len(given), inputs=inputs, outputs=[points], device=device)
    return points.numpy()


def _grid(u: tuple[float, float], v: tuple[float, float], closed: tuple[bool, bool]) -> tuple[Array, Faces]:
    """Returns a grid of parameters (n, 2) over two ranges, and its triangles (m, 3)."""
    lines = [
        np.linspace(*ends, STEPS + 1)[: STEPS + (not periodic)]
        for ends, periodic in zip((u, v), closed, strict=True)
    ]
    parameters = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = np.meshgrid(np.arange(STEPS), np.arange(STEPS), indexing="ij")
    rows, columns = (len(line) for line in lines)

    def number(i: Faces, j: Faces) -> Faces:
        return (i % rows) * columns + j % columns

    corners = [number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)]
    faces = np.stack([np.stack(corners[:3], axis=-1), np.stack([corners[0], corners[2], corners[3]], axis=-1)])
    return parameters, faces.reshape(-1, 3)
