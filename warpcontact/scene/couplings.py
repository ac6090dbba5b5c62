"""Couplings of a scene, and the ranges of their values."""

from dataclasses import dataclass

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.couplings.springs import Damper, Spring
from warpcontact.scene.elements import Body, Points
from warpcontact.validation.checks import Array, limits

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
