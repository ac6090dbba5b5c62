"""How couplings are added to a scene. All input is checked here."""

import math
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.algebra.poses import transform_points
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.couplings import springs
from warpcontact.kernels.couplings.springs import Damper, Spring
from warpcontact.scene.couplings import (
    AXIAL_STIFFNESS,
    BREAK_FORCE,
    DAMPING,
    FLOOR,
    LENGTH,
    LINE_LENGTH,
    MASS_PER_LENGTH,
    STIFFNESS,
    TURN_DAMPING,
    TURN_STIFFNESS,
    Bushing,
    Catenary,
    Coupling,
    SpringDamper,
)
from warpcontact.scene.elements import Points, Surface
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.kernels.friction import Friction
    from warpcontact.scene.contact_coupling import ContactCoupling
    from warpcontact.scene.contact_range import ContactRange
    from warpcontact.scene.scene import Scene


@explain_keywords_of
class Couplings:
    """The couplings of a ``Scene``, and how to add them."""

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
        """Adds a spring and a damper side by side, along the line between two points.

        It pulls its ends together with f = f_e(x) + k_d ẋ, where x is their distance; it pushes where that is
        negative. Where the ends are in one place the direction is the last one known.

        Args:
            point_a: From ``add_point``.
            point_b: From ``add_point``, on another body; one of both may be of the world.
            stiffness: Stiffness of a linear spring, f_e = k (x − x₀) [N/m].
            damping: Damping coefficient k_d [N·s/m].
            spring: In place of ``stiffness``, a spring of ``wc.springs`` or your own ``wc.Spring``.
            damper: In place of ``damping``, a damper of ``wc.springs`` or your own ``wc.Damper``.
            rest_length: Length x₀ at which a linear spring is without force [m]; ``None``: the distance of the
                points in the scene.
            tension_only: Whether it is a rope: it does not push, and is without force and damping while it is
                not stretched.
            break_force: Force of either sign beyond which it breaks, for good [N].
            enabled: Whether it acts.
            name: Name in parameters and sensors; made up if not given.
            color: Display colour, RGB in 0…1.
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
        """Adds springs and dampers along three axes and about them, between two points and their bodies.

        The axes are fixed to the first body. The bushing is without force where both points are in one place and
        the bodies stand to each other as in the scene. Turns enter as the rotation vector from there, which is
        exact for equal stiffnesses and for small turns.

        Args:
            point_a: From ``add_point``.
            point_b: From ``add_point``, on another body; one of both may be of the world.
            stiffness: Along the axes, 3 numbers [N/m].
            damping: Along the axes, 3 numbers [N·s/m].
            turn_stiffness: About the axes, 3 numbers [N·m/rad].
            turn_damping: About the axes, 3 numbers [N·m·s/rad].
            orientation: Rotation from the axes of the bushing to the first body, quaternion (x, y, z, w).
            enabled: Whether it acts.
            name: Name in parameters and sensors; made up if not given.
            color: Display colour, RGB in 0…1.
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
        """Adds an elastic line that hangs between two points under its own weight, such as a mooring line.

        It is in equilibrium at every instant: it has no inertia, damping or bending of its own. It pulls at its
        ends with the tension that the catenary has there, slack or taut.

        Args:
            point_a: From ``add_point``.
            point_b: From ``add_point``, on another body; one of both may be of the world.
            length: Unstretched length [m].
            mass_per_length: Mass per unstretched length; in a fluid, less that of the fluid it displaces [kg/m].
            axial_stiffness: EA, the tension over the strain [N]; EA/L is the stiffness of the whole line.
            floor: Height above the origin, against gravity, of a level floor without friction on which the line
                may rest [m]; ``None``: there is none. An end below it is taken to be on it.
            enabled: Whether it acts.
            name: Name in parameters and sensors; made up if not given.
            color: Display colour, RGB in 0…1.
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
        """Adds a force per area that keeps the faces of a body off another surface before they touch.

        On each active face, at its points r_f, f = a max(0, k₁ (d₀ − d) − k₂ ḋ) n, with the signed distance d to
        the other surface and its normal n there, and friction against the velocity at r_f; both bodies get the
        force at r_f.

        Args:
            surface_a: From ``add_surface``, on a body.
            surface_b: From ``add_surface``: on the world, or on another body.
            range: Coefficients k₁, k₂ and the range d₀.
            friction: Friction model; ``None``: none.
            facing: ``"projected"``: a face counts with the area that it turns to the other surface.
                ``"all"``: with all of it, whichever way it looks.
            sides: ``"first"``: the faces of ``surface_a`` feel ``surface_b``. ``"average"``: the faces of each
                feel the other, with half the force each.
            quadrature: Points per face: 1, 3, 6 or 7, exact for fields of order 1, 2, 4 or 5 over a face.
            damping_ramp: Depth within the range over which damping sets in [m]; 0: at once.
            search: ``"whole"`` or ``"active"``, as in ``add_contact``.
            boundary: ``"off"``: a face beyond an open boundary is not held; ``"outer"``: the boundary itself is.
            enabled: Whether it acts.
            name: Name in parameters and sensors; made up if not given. Its contacts are ``<name>_first`` and,
                with two sides, ``<name>_second``.
            color: Colour of its arrows, RGB in 0…1.
            visible: Whether its arrows are drawn.

        Raises:
            ValueError: If a value is out of range; the message names it, and the scene is as before.
        """
        from warpcontact.scene.contact_coupling import add_contact_coupling

        return add_contact_coupling(
            cast("Scene", self),
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
        """Raises ``ValueError`` if these are not two points of this scene, on different bodies."""
        for key, point in (("point_a", point_a), ("point_b", point_b)):
            if not isinstance(point, Points) or self._elements.get(point.name) is not point:
                raise ValueError(
                    f"{name}.{key} must come from add_point of this scene, got {checks.element(point)}"
                )
            if not point.single:
                raise ValueError(
                    f"{name}.{key} must be one point, from add_point, got the {len(point.positions)} points of "
                    f"{point.name!r}"
                )
        if point_a.body is point_b.body:
            where = f"body {point_a.body.name!r}" if point_a.body else "the world"
            raise ValueError(
                f"{name}: point_a and point_b are both fixed to {where}; they must be on two bodies, or on one "
                "and the world"
            )


def place_of(point: Points) -> Array:
    """Returns where a point is in the scene, world [m]."""
    place = point.places
    if point.body is not None:
        place = transform_points(place, point.body.position, point.body.orientation)
    return place[0]
