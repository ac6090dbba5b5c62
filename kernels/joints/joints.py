"""Motions that leave a body some of its six freedoms; forces and moments decide about these."""

from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.joints.base import Motion
from warpcontact.kernels.types import BALL, FIXED, FREE, HINGE, PLANAR, SLIDER, TRANSLATION

Vector = tuple[float, float, float]


class Free(Motion):
    """Moves as forces and moments make it."""

    formula = "m a = F, dL/dt = T"
    kind = FREE


class Fixed(Motion):
    """Stays where it is."""

    formula = "v = 0, ω = 0"
    kind = FIXED


class Translation(Motion):
    """Moves as forces make it, and does not turn."""

    formula = "m a = F, ω = 0"
    kind = TRANSLATION


class Planar(Motion):
    """Moves in the plane through its initial centre of mass, and turns about the normal of that."""

    formula = "m a = F − n (n·F), (n·I n) α = n·T"
    kind = PLANAR

    normal: Vector = parameter("-", "normal of the plane, world axes", shape=(3,), direction=True)


class Hinge(Motion):
    """Turns about an axis fixed in the body and in the world."""

    formula = "(a·I a + m r²) α = a·(T + (x − x_A) × F), r: distance of the centre of mass from the axis"
    kind = HINGE

    axis: Vector = parameter("-", "axis, world axes", shape=(3,), direction=True)
    anchor: Vector = parameter("m", "a point of the axis, world", shape=(3,))


class Slider(Motion):
    """Moves along an axis, and does not turn."""

    formula = "m a = a·F"
    kind = SLIDER

    axis: Vector = parameter("-", "direction, world axes", shape=(3,), direction=True)


class Ball(Motion):
    """Turns about a point fixed in the body and in the world."""

    formula = "dL_A/dt = T + (x − x_A) × F"
    kind = BALL

    anchor: Vector = parameter("m", "the point, world", shape=(3,))
