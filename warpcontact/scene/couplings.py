"""Couplings of a scene, and the methods of ``Scene`` that add couplings and contact couplings; they check all input."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.algebra.vectors import transform_points
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.couplings import springs
from warpcontact.kernels.couplings.springs import Damper, Spring
from warpcontact.scene.elements import Body, Points, Surface, check_owned
from warpcontact.scene.scene_element import check_ends
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

if TYPE_CHECKING:
    from warpcontact.kernels.friction import Friction
    from warpcontact.scene.contact_coupling import ContactCoupling, ContactRange
    from warpcontact.scene.scene_data import SceneData

LENGTH = limits("m", at_least=0.0)
LINE_LENGTH = limits("m", above=0.0)
MASS_PER_LENGTH = limits("kg/m", at_least=0.0)
AXIAL_STIFFNESS = limits("N", above=0.0)
FLOOR = limits("m")
BREAK_FORCE = limits("N", above=0.0, may_be_infinite=True)
STIFFNESS = limits("N/m", at_least=0.0)
DAMPING = limits("N·s/m", at_least=0.0)
TURN_STIFFNESS = limits("N·m/rad", at_least=0.0)
TURN_DAMPING = limits("N·m·s/rad", at_least=0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Coupling:
    """A force element between two points."""

    name: str
    point_a: Points
    point_b: Points
    enabled: Array
    color: Array | None
    visible: bool

    @property
    def bodies(self) -> tuple[Body | None, Body | None]:
        """Bodies of its ends; ``None``: the world."""
        return self.point_a.body, self.point_b.body

    @property
    def formulas(self) -> dict[str, Formula]:
        """Formulas by name of the part."""
        return {}


@dataclass(frozen=True, eq=False, kw_only=True)
class SpringDamper(Coupling):
    """A spring and a damper in parallel, along the line between two points."""

    spring: Spring
    damper: Damper
    rest_length: Array
    tension_only: Array
    break_force: Array
    # Whether stiffness and damping were given as numbers, and are parameters of these names.
    plain_spring: bool
    plain_damper: bool

    @property
    def formulas(self) -> dict[str, Formula]:
        """Spring and damper."""
        return {"spring": self.spring, "damper": self.damper}


@dataclass(frozen=True, eq=False, kw_only=True)
class Catenary(Coupling):
    """An elastic cable under its own weight."""

    length: Array  # unstretched [m]
    mass_per_length: Array  # [kg/m]
    axial_stiffness: Array  # EA [N]
    floor: Array | None  # height of the floor along the vertical [m]


@dataclass(frozen=True, eq=False, kw_only=True)
class Bushing(Coupling):
    """Springs and dampers along three axes and about them."""

    orientation: Array  # of its axes in the frame of the first body, quaternion
    stiffness: Array  # (3,) along the axes [N/m]
    damping: Array  # (3,) [N·s/m]
    turn_stiffness: Array  # (3,) about the axes [N·m/rad]
    turn_damping: Array  # (3,) [N·m·s/rad]


@explain_keywords_of
class Couplings:
    """The couplings of a ``Scene``."""

    couplings: list[Coupling]
    _elements: dict[str, Any]

    def add_spring_damper(
        self,
        point_a: Points,
        point_b: Points,
        *,
        stiffness: float | None = None,
        damping: float | None = None,
        spring: Spring | None = None,
        damper: Damper | None = None,
        rest_length: float | None = None,
        tension_only: bool = False,
        break_force: float = math.inf,
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> SpringDamper:
        """Adds a spring and a damper in parallel, along the line between two points.

        The tension is f = f_e(x) + k_d ẋ with the distance x of the points; if negative, the coupling pushes. If the
        points coincide, the last direction is used.

        Args:
            point_a: From ``add_point``.
            point_b: From ``add_point``, on another body. One of the points may be fixed to the world.
            stiffness: Stiffness of a linear spring, f_e = k (x − x₀) [N/m].
            damping: Damping coefficient k_d [N·s/m].
            spring: Instead of ``stiffness``, a spring of ``wc.springs`` or a custom ``wc.Spring``.
            damper: Instead of ``damping``, a damper of ``wc.springs`` or a custom ``wc.Damper``.
            rest_length: Length x₀ at which the force of a linear spring is zero [m]. Default: the distance of the
                points in the scene.
            tension_only: Whether it behaves as a rope: no force and no damping unless it is stretched.
            break_force: Magnitude of the force at which it breaks permanently [N].
            enabled: Whether the coupling is enabled.
            name: Name in parameters and sensors. Default: generated.
            color: Display color, RGB in 0…1.
            visible: Whether it is drawn.

        Raises:
            ValueError: If a value is out of range, or both ends are fixed to the same body.
        """
        name = checks.new_name("spring_damper", name, self._elements)
        self._check_ends(name, point_a, point_b)
        if (stiffness is None) == (spring is None):
            got = "none" if spring is None else "both"
            raise ValueError(f"{name}: exactly one of stiffness and spring must be given, got {got}")
        if damping is not None and damper is not None:
            raise ValueError(f"{name}: damping and damper must not both be given")
        for key, value, kind in (("spring", spring, Spring), ("damper", damper, Damper)):
            if value is not None and not isinstance(value, kind):
                raise TypeError(f"{name}.{key} must be an instance of wc.{kind.__name__}, got {value!r}")
        if stiffness is not None:
            spring = springs.Linear(stiffness=float(checks.numbers(f"{name}.stiffness", stiffness, (), STIFFNESS)))
        if damping is not None:
            damper = springs.Viscous(damping=float(checks.numbers(f"{name}.damping", damping, (), DAMPING)))
        if rest_length is None:
            rest_length = float(np.linalg.norm(place_of(point_b) - place_of(point_a)))
        coupling = SpringDamper(
            name=name,
            point_a=point_a,
            point_b=point_b,
            spring=cast(Spring, spring),
            damper=springs.Undamped() if damper is None else damper,
            rest_length=checks.numbers(f"{name}.rest_length", rest_length, (), LENGTH),
            tension_only=np.array(float(checks.switch(f"{name}.tension_only", tension_only))),
            break_force=checks.numbers(f"{name}.break_force", break_force, (), BREAK_FORCE),
            plain_spring=stiffness is not None,
            plain_damper=damping is not None,
            enabled=np.array(float(checks.switch(f"{name}.enabled", enabled))),
            color=checks.color(f"{name}.color", color),
            visible=checks.switch(f"{name}.visible", visible),
        )
        return self._add_coupling(coupling)

    def add_bushing(
        self,
        point_a: Points,
        point_b: Points,
        *,
        stiffness: ArrayLike = (0.0, 0.0, 0.0),
        damping: ArrayLike = (0.0, 0.0, 0.0),
        turn_stiffness: ArrayLike = (0.0, 0.0, 0.0),
        turn_damping: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> Bushing:
        """Adds translational and rotational springs and dampers along three axes, between two points and their bodies.

        The axes are fixed to the first body. The force is zero if both points coincide and the bodies have the
        relative orientation of the scene. Rotations are measured by the rotation vector from that orientation,
        which is exact for equal stiffnesses and for small rotations.

        Args:
            point_a: From ``add_point``.
            point_b: From ``add_point``, on another body. One of the points may be fixed to the world.
            stiffness: Stiffness along the axes, 3 numbers [N/m].
            damping: Damping along the axes, 3 numbers [N·s/m].
            turn_stiffness: Rotational stiffness about the axes, 3 numbers [N·m/rad].
            turn_damping: Rotational damping about the axes, 3 numbers [N·m·s/rad].
            orientation: Rotation from the axes of the bushing to the first body, quaternion (x, y, z, w).
            enabled: Whether the coupling is enabled.
            name: Name in parameters and sensors. Default: generated.
            color: Display color, RGB in 0…1.
            visible: Whether it is drawn.

        Raises:
            ValueError: If a value is out of range, or both ends are fixed to the same body.
        """
        name = checks.new_name("bushing", name, self._elements)
        self._check_ends(name, point_a, point_b)
        coupling = Bushing(
            name=name,
            point_a=point_a,
            point_b=point_b,
            stiffness=checks.numbers(f"{name}.stiffness", stiffness, (3,), STIFFNESS),
            damping=checks.numbers(f"{name}.damping", damping, (3,), DAMPING),
            turn_stiffness=checks.numbers(f"{name}.turn_stiffness", turn_stiffness, (3,), TURN_STIFFNESS),
            turn_damping=checks.numbers(f"{name}.turn_damping", turn_damping, (3,), TURN_DAMPING),
            orientation=checks.unit_quaternions(
                f"{name}.orientation", checks.numbers(f"{name}.orientation", orientation, (4,))
            ),
            enabled=np.array(float(checks.switch(f"{name}.enabled", enabled))),
            color=checks.color(f"{name}.color", color),
            visible=checks.switch(f"{name}.visible", visible),
        )
        return self._add_coupling(coupling)

    def add_catenary(
        self,
        point_a: Points,
        point_b: Points,
        *,
        length: float,
        mass_per_length: float,
        axial_stiffness: float,
        floor: float | None = None,
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> Catenary:
        """Adds an elastic cable between two points under its own weight, such as a mooring line.

        The cable is quasi-static: it is always in equilibrium and has no inertia, damping or bending stiffness. It
        exerts its end tensions on the bodies, slack or taut.

        Args:
            point_a: From ``add_point``.
            point_b: From ``add_point``, on another body. One of the points may be fixed to the world.
            length: Unstretched length [m].
            mass_per_length: Mass per unstretched length; in a fluid, minus that of the displaced fluid [kg/m].
            axial_stiffness: EA, tension divided by strain [N]; EA/L is the stiffness of the whole cable.
            floor: Height above the origin, against gravity, of a horizontal frictionless floor on which the cable
                can rest [m]. Default: no floor. An end below the floor is treated as on the floor.
            enabled: Whether the coupling is enabled.
            name: Name in parameters and sensors. Default: generated.
            color: Display color, RGB in 0…1.
            visible: Whether it is drawn.

        Raises:
            ValueError: If a value is out of range, or both ends are fixed to the same body.
        """
        name = checks.new_name("catenary", name, self._elements)
        self._check_ends(name, point_a, point_b)
        coupling = Catenary(
            name=name,
            point_a=point_a,
            point_b=point_b,
            length=checks.numbers(f"{name}.length", length, (), LINE_LENGTH),
            mass_per_length=checks.numbers(f"{name}.mass_per_length", mass_per_length, (), MASS_PER_LENGTH),
            axial_stiffness=checks.numbers(f"{name}.axial_stiffness", axial_stiffness, (), AXIAL_STIFFNESS),
            floor=None if floor is None else checks.numbers(f"{name}.floor", floor, (), FLOOR),
            enabled=np.array(float(checks.switch(f"{name}.enabled", enabled))),
            color=checks.color(f"{name}.color", color),
            visible=checks.switch(f"{name}.visible", visible),
        )
        return self._add_coupling(coupling)

    def add_contact_coupling(
        self,
        surface_a: Surface,
        surface_b: Surface,
        range: "ContactRange",
        friction: "Friction | None" = None,
        *,
        facing: str = "projected",
        sides: str = "first",
        quadrature: int = 1,
        damping_ramp: float = 0.0,
        search: str = "whole",
        boundary: str = "off",
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> "ContactCoupling":
        """Adds a repulsive pressure between two surfaces within a range, before they touch.

        At quadrature points r_f of the active faces, with area weight a, the force is
        f = a max(0, k₁ (d₀ − d) − k₂ ḋ) n, with the signed distance d to the other surface and its normal n, plus
        friction. Equal and opposite forces act on both bodies at r_f.

        Args:
            surface_a: From ``add_surface``, on a body.
            surface_b: From ``add_surface``, on another body or on the world.
            range: Coefficients k₁, k₂ and the range d₀.
            friction: Friction model. Default: none.
            facing: ``"projected"``: the area of a face is projected onto the normal n, if the face faces the other
                surface. ``"all"``: the full area is used for any orientation.
            sides: ``"first"``: the faces of ``surface_a`` have quadrature points. ``"average"``: the faces of both
                surfaces, with half the force each.
            quadrature: Number of points per face: 1, 3, 6 or 7, exact for polynomials of degree 1, 2, 4 or 5.
            damping_ramp: Depth in the range over which the damping increases to its full value [m]. Default: 0, full
                damping in the whole range.
            search: ``"whole"`` or ``"active"``, as in ``add_contact``.
            boundary: ``"off"``: no force on points beyond the boundary of an open surface. ``"outer"``: also the
                boundary repels.
            enabled: Whether the coupling is enabled.
            name: Name in parameters and sensors. Default: generated. Its contacts are ``<name>_first`` and,
                for ``"average"``, ``<name>_second``.
            color: Color of the force arrows, RGB in 0…1.
            visible: Whether the force arrows are drawn.

        Raises:
            ValueError: If a value is out of range; the message names it. The scene is unchanged then.
        """
        from warpcontact.scene.contact_coupling import add_contact_coupling

        return add_contact_coupling(
            cast("SceneData", self),
            surface_a,
            surface_b,
            range,
            friction,
            facing=facing,
            sides=sides,
            quadrature=quadrature,
            damping_ramp=damping_ramp,
            search=search,
            boundary=boundary,
            enabled=enabled,
            name=name,
            color=color,
            visible=visible,
        )

    def _add_coupling(self, coupling: Any) -> Any:
        self.couplings.append(coupling)
        self._elements[coupling.name] = coupling
        return coupling

    def _check_ends(self, name: str, point_a: Points, point_b: Points) -> None:
        """Raises ``ValueError`` unless both are single points of this scene, on different bodies."""
        for key, point in (("point_a", point_a), ("point_b", point_b)):
            check_owned(f"{name}.{key}", point, Points, self._elements, "add_point")
        check_ends(name, point_a, point_b)


def place_of(point: Points) -> Array:
    """Returns the initial position of a point, world (3,) [m]."""
    place = point.places
    if point.body is not None:
        place = transform_points(place, point.body.position, point.body.orientation)
    return place[0]
