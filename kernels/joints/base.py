"""Base class of motions, and joints: motions in which the body moves under forces and torques."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula, parameter
from warpcontact.kernels.types import BALL, FIXED, FREE, HINGE, PLANAR, SLIDER, TIME_FUNCTION, TRANSLATION


@wp.func
def still(p: Any, t: Any):
    """Returns zero displacement or rotation."""
    return wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0))


class Motion(Formula):
    """Motion of a body relative to the world; a derived class prescribes the pose as a function of time.

    A subclass declares its parameters and one or two device functions::

        class Heave(wc.Motion):
            \"\"\"z = a sin(ω t).\"\"\"

            amplitude: float = wc.parameter("m", "amplitude a")
            rate: float = wc.parameter("rad/s", "angular frequency ω")

            @wp.func
            def displacement(p: Any, t: Any):
                return wp.vec3d(wp.float64(0.0), wp.float64(0.0), p.amplitude * wp.sin(p.rate * t))

    ``displacement`` [m] and ``rotation``, a rotation vector [rad], are relative to the initial pose, in world
    axes. An omitted function is zero. ``t`` is the time of the environment [s]. Both are computed in float64:
    ``p`` holds float64 parameters, constants are written ``wp.float64(0.5)`` and the result is a ``wp.vec3d``.
    The body rotates about its center of mass, or about ``anchor`` if there is a parameter of that name with the
    shape (3,) and a value. The anchor is a world point, which the displacement moves with the body.

    After every step the pose is that of the functions at its time, and the velocities are their mean over the
    step, as for a body that rests on it. Before the first step the velocities are the derivatives.
    """

    whole: ClassVar[str] = "body"
    part: ClassVar[str] = "motion"
    may_have_vectors: ClassVar[bool] = True
    may_have_rows: ClassVar[bool] = True
    functions: ClassVar = {"displacement": "a wp.vec3d [m]", "rotation": "a rotation vector, wp.vec3d [rad]"}
    displacement: ClassVar[wp.Function] = still
    rotation: ClassVar[wp.Function] = still

    #: Joint type, a constant of ``kernels/types.py``.
    kind: ClassVar[int] = TIME_FUNCTION
    #: Whether the functions take an array of samples as third argument; see ``samples``.
    sampled: ClassVar[bool] = False

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if cls.memories:
            raise TypeError(
                f"{cls.__name__}.{next(iter(cls.memories))}: a motion must not declare history variables"
            )

    @classmethod
    def arguments(cls) -> tuple[str, ...]:
        """Returns the names of the arguments of its device functions."""
        return ("coefficients", "time", "samples") if cls.sampled else ("coefficients", "time")

    @classmethod
    def missing_function(cls) -> str:
        """Returns the name of a missing device function; one of the two is sufficient."""
        lacks_both = cls.kind == TIME_FUNCTION and cls.displacement is still and cls.rotation is still
        return "displacement" if lacks_both else super().missing_function()

    def samples(self) -> np.ndarray:
        """Returns the samples that the functions of a ``sampled`` motion read, one row per sample."""
        return np.zeros((0, 1))


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
