"""Base class of analytic shapes, the half-space, and the structs that pair algorithms share.

All computations are in float64, independent of the precision of the model. A pair is described in the frame of its
second shape, b: ``x`` [m] is the origin of the frame of the first shape, a, and ``q`` the rotation a → b.

The support function of a convex body is h(n) = max n·y over its points y. The signed gap of two bodies is the
maximum over all unit vectors n of

    g(n) = n·x − h_b(n) − h_a(−n),

the distance between two supporting planes with normal n, negative in overlap. Separate bodies have one maximum.
Overlapping bodies can have several; the largest gives the shortest displacement that separates them.
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
# Cosine below which a unit vector counts as normal to an axis, and sine for parallel: rounding of a rotation.
AXIS_TOLERANCE = wp.constant(wp.float64(1.0e-14))
# The same for ill-conditioned shapes, whose support point depends on a small power of a component of n.
LOOSE_AXIS_TOLERANCE = wp.constant(wp.float64(1.0e-11))


@wp.struct
class WarmStart:
    """Initial guess for a pair, from the last step; a zero struct is no guess."""

    normal: vec3d  # unit vector out of b, frame of b
    u: wp.vec4d  # parameters of both surfaces (parametric surfaces only)
    valid: wp.int32  # 1: the fields above are set


@wp.struct
class ShapeContactPoint:
    """Contact points of two surfaces, or their closest points."""

    gap: wp.float64  # negative in overlap [m]
    normal: vec3d  # unit vector out of b, towards a; frame of b
    point_a: vec3d  # on a, frame of b [m]
    point_b: vec3d  # on b, frame of b [m]
    warm_start: WarmStart  # for the next step
    iterations: wp.int32
    residual: wp.float64  # tangential distance of the two points divided by the size of the pair
    status: wp.int32  # MET, NOT_CONVERGED or OUTSIDE


@wp.struct
class Curvature:
    """Principal curvatures of a surface, positive where it is convex."""

    k_1: wp.float64  # the smaller [1/m]
    k_2: wp.float64  # the larger [1/m]
    direction: vec3d  # of the smaller, unit vector


@wp.struct
class SignedDistance:
    """Closest point of a surface to a given point."""

    gap: wp.float64  # of the given point, negative inside [m]
    normal: vec3d  # unit vector out of the surface
    point: vec3d  # on the surface [m]


@wp.struct
class SupportExpansion:
    """Expansion of a support function about a direction n, changed by τ: n·point + ½ τ·hessian τ + Σ |n·kink|.

    A kink is a term |k·n|: at n·k = 0 the support point jumps from one end of an edge to the other.
    """

    point: vec3d  # gradient of the smooth part: the middle of all edges [m]
    hessian: mat33d  # of the smooth part [m]
    kinks: mat33d  # rows k [m]; 0: unused
    kink_curvature: wp.float64  # the Hessian of the first kink is this times ``hessian``; 0: straight edge
    disc_radius: wp.float64  # radius of the flat disc whose normal is n; 0: none [m]


@dataclass_transform(frozen_default=True, field_specifiers=(parameter,))
class Shape(Formula):
    """A body with an analytic surface. Parameters may be given by position and may vary per environment.

    Convex shapes have these device functions, all in the frame of the shape, of the coefficients ``p``:

    - ``support(p, n)``: the point farthest along the unit vector n; on a face or edge, its midpoint,
    - ``expand(p, n)``: the ``SupportExpansion`` of the support function of the body shrunk by ``margin``,
    - ``margin(p)``: radius of the sphere that rounds all its edges,
    - ``rolling_ball_radius(p)``: radius of a sphere that fits inside at every point of the surface,
    - ``extents(p)``: half the sides of a bounding box,
    - ``inscribed_center(p)`` and ``inscribed_radius(p)``: center and radius of an inscribed sphere.

    Shapes with ``signed_distance(p, x)`` return the ``SignedDistance`` of a point in closed form.
    """

    whole: ClassVar[str] = "shape"
    part: ClassVar[str] = ""
    positional: ClassVar[bool] = True
    may_have_vectors: ClassVar[bool] = True
    vector_shapes: ClassVar = ((2,), (3,))
    functions: ClassVar = {}
    #: Whether it is convex and has the functions above.
    convex: ClassVar[bool] = True
    #: Number of kinks of its support function.
    kinks: ClassVar[int] = 0
    #: Whether, shrunk by its margin, it is a point or has only straight edges along the axes.
    polyhedral: ClassVar[bool] = False
    #: Flat discs with the normals −z and +z: none, the first, or both.
    discs: ClassVar[int] = 0
    #: Whether the support point can move far for a small rotation of n. Such a shape has kinks there and defines
    #: ``support_powers(p)``, ``gauss_map(p, y)`` and ``gauge(p, y)``.
    ill_conditioned: ClassVar[bool] = False
    #: Whether the first kink is a curved edge.
    curved_kink: ClassVar[bool] = False

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if cls.memories:
            raise TypeError(f"{cls.__name__}.{next(iter(cls.memories))}: a shape must not have history variables")


class Plane(Shape):
    """The half-space z ≤ 0; its normal is +z. It has no support function except along z."""

    formula = "z = 0"

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        found.normal = wp.vec3d(zero, zero, one)
        found.gap = x[2]
        found.point = wp.vec3d(x[0], x[1], zero)
        return found
