"""Joints: motions with zero to six degrees of freedom, in which the body moves under forces and torques."""

from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.joints.base import Motion
from warpcontact.kernels.types import BALL, FIXED, FREE, HINGE, PLANAR, SLIDER, TRANSLATION

Vector = tuple[float, float, float]


class Free(Motion):
    """Free body with six degrees of freedom."""

    formula = "m a = F, dL/dt = T"
    kind = FREE


class Fixed(Motion):
    """No degree of freedom."""

    formula = "v = 0, ω = 0"
    kind = FIXED


class Translation(Motion):
    """Three translations, no rotation."""

    formula = "m a = F, ω = 0"
    kind = TRANSLATION


class Planar(Motion):
    """Translation in the plane through the initial center of mass, and rotation about its normal."""

    formula = "m a = F − n (n·F), (n·I n) α = n·T"
    kind = PLANAR

    normal: Vector = parameter("-", "normal of the plane, world axes", shape=(3,), direction=True)


class Hinge(Motion):
    """Rotation about an axis fixed in the body and in the world."""

    formula = "(a·I a + m r²) α = a·(T + (x − x_A) × F), r: distance of the center of mass from the axis"
    kind = HINGE

    axis: Vector = parameter("-", "axis, world axes", shape=(3,), direction=True)
    anchor: Vector = parameter("m", "point of the axis, world", shape=(3,))


class Slider(Motion):
    """Translation along an axis, no rotation."""

    formula = "m a = a·F"
    kind = SLIDER

    axis: Vector = parameter("-", "direction, world axes", shape=(3,), direction=True)


class Ball(Motion):
    """Rotation about a point fixed in the body and in the world."""

    formula = "dL_A/dt = T + (x − x_A) × F"
    kind = BALL

    anchor: Vector = parameter("m", "fixed point, world", shape=(3,))
