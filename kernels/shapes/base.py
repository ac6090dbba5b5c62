"""The contract of a shape: the surface of a body of analytic form, and what two of them have in common.

Everything is computed in float64, whatever the precision of the model. A pair is seen in the frame of its second
shape, b: ``x`` [m] is the origin of the first one's frame, a, there, and ``q`` the rotation a → b.

Of a convex body, h(n) = max n·y over its points y is the support function. The signed gap of two is the largest
value over all unit vectors n of

    g(n) = n·x − h_b(n) − h_a(−n),

the width of the gap between two planes with the normal n that touch them, negative in overlap. Bodies that are
apart have one maximum; of several in overlap, the largest counts: the shortest way apart.
"""

from typing import Any, ClassVar, dataclass_transform

import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula, parameter

real = wp.float64
vec3d = wp.vec3d
mat33d = wp.mat33d
zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
half = wp.constant(real(0.5))
two = wp.constant(real(2.0))
# Where a unit vector is taken to lie on an axis or across it: rounding of a rotation there and back.
AXIS_TOLERANCE = wp.constant(wp.float64(1.0e-14))
# The same where a point goes by a small power of a component of n: what rounding leaves of the point is lost.
LOOSE_AXIS_TOLERANCE = wp.constant(wp.float64(1.0e-11))


@wp.struct
class WarmStart:
    """What is known of a pair before it is solved, from the last step; empty: nothing."""

    normal: vec3d  # unit vector out of b, frame of b
    u: wp.vec4d  # parameters of both surfaces, where they have any
    valid: wp.int32  # 1: the above means something


@wp.struct
class ShapeContactPoint:
    """Where two surfaces meet, or are nearest to each other."""

    gap: wp.float64  # negative in overlap [m]
    normal: vec3d  # unit vector out of b, towards a; frame of b
    point_a: vec3d  # on a, frame of b [m]
    point_b: vec3d  # on b, frame of b [m]
    warm_start: WarmStart  # for the next step
    iterations: wp.int32
    residual: wp.float64  # tangential distance of the two points over the size of the pair
    status: wp.int32  # MET, NOT_CONVERGED or OUTSIDE


@wp.struct
class Curvature:
    """Principal curvatures of a surface, positive where it is convex."""

    k_1: wp.float64  # the smaller [1/m]
    k_2: wp.float64  # the larger [1/m]
    direction: vec3d  # of the smaller, unit vector


@wp.struct
class SignedDistance:
    """The point of a surface that is nearest to a place."""

    gap: wp.float64  # of the place, negative inside [m]
    normal: vec3d  # unit vector out of the surface
    point: vec3d  # on the surface [m]


@wp.struct
class SupportExpansion:
    """A support function near a direction n: n·point + ½ τ·hessian τ + Σ |n·kink|, for n changed by τ.

    A kink is a term |k·n| where the support point jumps from one end of an edge to the other, n·k = 0.
    """

    point: vec3d  # gradient of the smooth part: the middle of all edges [m]
    hessian: mat33d  # of the smooth part [m]
    kinks: mat33d  # rows k [m]; 0: unused
    kink_curvature: wp.float64  # the first kink is curved, too, and its Hessian is this times ``hessian``
    disc_radius: wp.float64  # radius of the flat disc that n stands on, exactly; 0: none [m]


@dataclass_transform(frozen_default=True, field_specifiers=(parameter,))
class Shape(Formula):
    """A body of analytic form. Parameters may be given by position and differ between environments.

    Convex shapes have these device functions, all in the frame of the shape, of the coefficients ``p``:

    - ``support(p, n)``: the point farthest along the unit vector n; of many, the middle of the face or edge,
    - ``expand(p, n)``: the ``SupportExpansion`` of the support function of the body less ``margin`` all around,
    - ``margin(p)``: radius of the sphere that rounds all its edges,
    - ``rolling_ball_radius(p)``: radius of a sphere that fits inside at every point of the surface,
    - ``extents(p)``: half the sides of a box around it,
    - ``inscribed_center(p)`` and ``inscribed_radius(p)``: centre and radius of a sphere inside.

    Shapes with ``signed_distance(p, x)`` answer for the ``SignedDistance`` point of a place at once.
    """

    whole: ClassVar[str] = "shape"
    part: ClassVar[str] = ""
    positional: ClassVar[bool] = True
    may_have_vectors: ClassVar[bool] = True
    vector_shapes: ClassVar = ((2,), (3,))
    functions: ClassVar = {}
    #: Whether it is convex, and has the functions above.
    convex: ClassVar[bool] = True
    #: How many kinks its support function has.
    kinks: ClassVar[int] = 0
    #: Whether, less its margin, it is a point, or all its edges are straight and along the axes.
    polyhedral: ClassVar[bool] = False
    #: Flat discs with the normals −z and +z: none, the first, or both.
    discs: ClassVar[int] = 0
    #: Whether a point may run far for the smallest turn of n: it has kinks where it would, and
    #: ``support_powers(p)``, ``gauss_map(p, y)`` and ``gauge(p, y)``.
    ill_conditioned: ClassVar[bool] = False
    #: Whether the first kink is bent.
    curved_kink: ClassVar[bool] = False

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if cls.memories:
            raise TypeError(f"{cls.__name__}.{next(iter(cls.memories))}: a shape has no memory")
