"""The contract of a motion: how a body may move relative to the world."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.types import TIME_FUNCTION


@wp.func
def still(p: Any, t: Any):
    """No displacement and no rotation."""
    return wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0))


class Motion(Formula):
    """How a body may move relative to the world; one that is derived from this is a function of time.

    A subclass declares its parameters and one or two device functions::

        class Heave(wc.Motion):
            \"\"\"z = a sin(ω t).\"\"\"

            amplitude: float = wc.parameter("m", "amplitude a")
            rate: float = wc.parameter("rad/s", "angular frequency ω")

            @wp.func
            def displacement(p: Any, t: Any):
                return wp.vec3d(wp.float64(0.0), wp.float64(0.0), p.amplitude * wp.sin(p.rate * t))

    ``displacement`` [m] and ``rotation``, a rotation vector [rad], are relative to the initial pose, in world
    axes; one that is left out is zero. ``t`` is the time of the environment [s]. Both are computed in float64:
    ``p`` holds float64 parameters, constants are written ``wp.float64(0.5)`` and the result is a ``wp.vec3d``.
    The body turns about its centre of mass, or about ``anchor`` if there is a parameter of that name with the
    shape (3,) and a value: a point of the world at which the body is pinned before the displacement moves it.

    After every step the pose is that of the functions at its time, and the velocities are their mean over the
    step, so that the body and what rides on it have the same. Before the first step they are the derivative.
    """

    whole: ClassVar[str] = "body"
    part: ClassVar[str] = "motion"
    may_have_vectors: ClassVar[bool] = True
    may_have_rows: ClassVar[bool] = True
    functions: ClassVar = {"displacement": "a wp.vec3d [m]", "rotation": "a rotation vector, wp.vec3d [rad]"}
    displacement: ClassVar[wp.Function] = still
    rotation: ClassVar[wp.Function] = still

    #: What it is, of the constants of ``types``.
    kind: ClassVar[int] = TIME_FUNCTION
    #: Whether its functions take rows of numbers as a third argument: see ``samples``.
    sampled: ClassVar[bool] = False

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if cls.memories:
            raise TypeError(f"{cls.__name__}.{next(iter(cls.memories))}: a motion has no memory")

    @classmethod
    def arguments(cls) -> tuple[str, ...]:
        """Returns what its device functions take, in words."""
        return ("coefficients", "time", "samples") if cls.sampled else ("coefficients", "time")

    @classmethod
    def missing_function(cls) -> str:
        """Returns the name of a device function that it lacks; one of the two is enough."""
        lacks_both = cls.kind == TIME_FUNCTION and cls.displacement is still and cls.rotation is still
        return "displacement" if lacks_both else super().missing_function()

    def samples(self) -> np.ndarray:
        """Returns the rows of numbers that the functions of a ``sampled`` motion take."""
        return np.zeros((0, 1))
