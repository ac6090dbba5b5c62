"""Reference for the smallest signed distance of a patch from a shape, independent of the solver.

Distances of most shapes are closed forms; those of superellipsoids are bounded by directions
(``superellipsoid_distance``). The search evaluates a grid and refines each of its minima without derivatives. The
result is a point of the patch: if it is nearer than a reported contact, that contact is wrong.
"""

import functools

import numpy as np
import warp as wp
from convex_pairs import packed
from superellipsoid_distance import distance_lower_bound
from warpcontact.kernels import shapes as S
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes.revolution import Torus

vec5d = wp.types.vector(5, wp.float64)
# Shapes with their sizes, in the order of the coefficients.
SIZES = {
    S.Sphere: ("radius",), S.Plane: (), S.Ellipsoid: ("semi_axes",), S.Cylinder: ("radius", "half_length"),
    S.Capsule: ("radius", "half_length"), S.Cone: ("radius", "height"), S.RoundedBox: ("half_extents", "radius"),
    S.Superellipsoid: ("semi_axes", "exponents"), Torus: ("major_radius", "minor_radius"),
}  # fmt: skip
SPHERE, PLANE, ELLIPSOID, CYLINDER, CAPSULE, CONE, BOX, SUPER, RING = (wp.constant(i) for i in range(len(SIZES)))

# Number of grid cells: 0.02 apart on most patches; the smallest shapes have edges of 0.15.
GRID = 96
# Steps of the differences for normals, in the parameters, and for gradients of distances [m].
STEP = wp.constant(wp.float64(1e-5))
SLOPE = wp.constant(wp.float64(1e-6))
# Distances of one point may differ by this much, because the compiler may use FMA in one of two calls [m].
ROUNDING = wp.constant(wp.float64(1e-12))
# Initial direction if no gradient is available.
NOWHERE = wp.constant(wp.vec3d(0.0, 0.0, 1.0))


@wp.func
def out_of_box(a: wp.float64, b: wp.float64, c: wp.float64):
    """Vector from the box to the point, in coordinates beyond the half sides."""
    zero = wp.float64(0.0)
    out = wp.vec3d(wp.max(a, zero), wp.max(b, zero), wp.max(c, zero))
    return wp.length(out) + wp.min(wp.max(a, wp.max(b, c)), zero)


@wp.func
def to_segment(x: wp.vec2d, a: wp.vec2d, b: wp.vec2d):
    t = wp.clamp(wp.dot(x - a, b - a) / wp.dot(b - a, b - a), wp.float64(0.0), wp.float64(1.0))
    return wp.length(x - a - t * (b - a))


@wp.func
def to_ellipsoid(axes: wp.vec3d, x: wp.vec3d):
    """Nearest point a² x/(t + a²), with t counted from −a² of the shortest axis.

    Bisection, then Newton's method. Newton does not overshoot from a side where the point is outside of the
    surface, because the function is convex and decreasing.
    """
    least = wp.min(wp.min(axes[0], axes[1]), axes[2])
    low = wp.float64(0.0)
    high = wp.length(wp.cw_mul(axes, x))
    for i in range(22):
        middle = wp.where(i < 14, wp.float64(0.5) * (low + high), low)
        total = wp.float64(0.0)
        steep = wp.float64(0.0)
        for k in range(3):
            off = middle + axes[k] * axes[k] - least * least
            if off > wp.float64(0.0):
                part = axes[k] * x[k] / off
                total += part * part
                steep += wp.float64(2.0) * part * part / off
        if i < 14:
            if total > wp.float64(1.0):
                low = middle
            else:
                high = middle
        elif total > wp.float64(1.0):
            low += (total - wp.float64(1.0)) / steep
    high = low
    rest = wp.float64(1.0)
    closest = wp.vec3d()
    short = wp.int32(0)
    for k in range(3):
        if axes[k] == least:
            short = k
    for k in range(3):
        if k != short:
            closest[k] = axes[k] * axes[k] * x[k] / (high + axes[k] * axes[k] - least * least)
            rest -= closest[k] * closest[k] / (axes[k] * axes[k])
    # Near the middle of the shortest axis t is below rounding; the missing component is along that axis.
    closest[short] = wp.sign(x[short]) * least * wp.sqrt(wp.max(rest, wp.float64(0.0)))
    scaled = wp.cw_div(x, axes)
    return wp.where(wp.dot(scaled, scaled) > wp.float64(1.0), wp.length(x - closest), -wp.length(x - closest))


@wp.func
def to_superellipsoid(s: vec5d, x: wp.vec3d, enough: wp.float64, known: wp.vec3d):
    """Signed distance or a sufficient lower bound, and its gradient; the direction ``known`` is tried first."""
    return distance_lower_bound(wp.vec3d(s[0], s[1], s[2]), wp.vec2d(s[3], s[4]), known, x, enough)


@wp.func
def distance(kind: wp.int32, s: vec5d, x: wp.vec3d, enough: wp.float64, known: wp.vec3d):
    """Signed distance of a point from a shape, in its frame, and its gradient if that is available.

    Args:
        kind: Kind of shape.
        s: Sizes of the shape.
        x: The point [m].
        enough: If the distance is larger, a lower bound of at least this value is returned [m].
        known: Gradient at a point nearby.
    """
    zero = wp.float64(0.0)
    far = wp.float64(-1e9)
    across = wp.sqrt(x[0] * x[0] + x[1] * x[1])
    if kind == SPHERE:
        return wp.length(x) - s[0], known
    if kind == PLANE:
        return x[2], known
    if kind == ELLIPSOID:
        return to_ellipsoid(wp.vec3d(s[0], s[1], s[2]), x), known
    if kind == CYLINDER:
        return out_of_box(across - s[0], wp.abs(x[2]) - s[1], far), known
    if kind == CAPSULE:
        return wp.length(wp.vec2d(across, wp.max(wp.abs(x[2]) - s[1], zero))) - s[0], known
    if kind == CONE:
        at = wp.vec2d(across, x[2])
        rim = wp.vec2d(s[0], zero)
        out = wp.min(to_segment(at, wp.vec2d(), rim), to_segment(at, rim, wp.vec2d(zero, s[1])))
        inside = x[2] > zero and across / s[0] + x[2] / s[1] < wp.float64(1.0)
        return wp.where(inside, -out, out), known
    if kind == SUPER:
        return to_superellipsoid(s, x, enough, known)
    if kind == BOX:
        r = s[3]
        return out_of_box(wp.abs(x[0]) - s[0] + r, wp.abs(x[1]) - s[1] + r, wp.abs(x[2]) - s[2] + r) - r, known
    return wp.length(wp.vec2d(across - s[0], x[2])) - s[1], known


@wp.func
def slope(kind: wp.int32, s: vec5d, x: wp.vec3d):
    """Gradient of the signed distance."""
    far = wp.float64(wp.inf)
    by = wp.vec3d()
    if kind == SUPER:
        _value, by = to_superellipsoid(s, x, far, NOWHERE)
        return by
    for k in range(3):
        step = wp.vec3d()
        step[k] = SLOPE
        ahead, _n = distance(kind, s, x + step, far, NOWHERE)
        behind, _m = distance(kind, s, x - step, far, NOWHERE)
        by[k] = (ahead - behind) / (wp.float64(2.0) * SLOPE)
    return by


# Smallest distance over a patch


@wp.struct
class LowestPoint:
    """The lowest point of a patch that was found."""

    gap: wp.float64  # its distance [m]; the bound, if there is no lower point
    u: wp.float64
    v: wp.float64
    tilt: wp.float64  # slope of the distance along the patch; 0 if normals are parallel
    along: wp.float64  # slope of the distance along the normal of the patch; −1 if normals are opposite


@functools.cache
def _kernels(P, grid):
    position = P.position
    nodes, cells = wp.constant(wp.int32(grid + 1)), wp.constant(wp.float64(grid))
    Of_b = coefficient_struct(P, wp.float64)
    closed = P.u_periodic
    u_0, u_1, v_0, v_1 = (wp.constant(wp.float64(value)) for value in (*P.u_range, *P.v_range))

    @wp.func
    def normal(p: Of_b, u: wp.float64, v: wp.float64):
        by_u = position(p, u + STEP, v) - position(p, u - STEP, v)
        by_v = position(p, u, v + STEP) - position(p, u, v - STEP)
        return wp.normalize(wp.cross(by_u, by_v))

    @wp.func
    def lowered(p: Of_b, u: wp.float64, v: wp.float64, by: wp.float64):
        place = position(p, u, v)
        if by != wp.float64(0.0):
            place -= by * normal(p, u, v)
        return place

    @wp.func
    def at(
        kind: wp.int32, s: vec5d, p: Of_b, x: wp.vec3d, q: wp.quatd, u: wp.float64, v: wp.float64, by: wp.float64,
        enough: wp.float64, known: wp.vec3d,
    ):  # fmt: skip
        return distance(kind, s, wp.quat_rotate_inv(q, lowered(p, u, v, by) - x), enough, known)

    @wp.func
    def within(u: wp.float64, v: wp.float64):
        if wp.static(not closed):
            u = wp.clamp(u, u_0, u_1)
        return u, wp.clamp(v, v_0, v_1)

    @wp.func
    def searched(
        kind: wp.int32, s: vec5d, p: Of_b, x: wp.vec3d, q: wp.quatd, u: wp.float64, v: wp.float64,
        du: wp.float64, dv: wp.float64, by: wp.float64, known: wp.vec3d,
    ):  # fmt: skip
        """Minimum found by a pattern search with decreasing steps."""
        best = LowestPoint()
        best.u = u
        best.v = v
        least, n = at(kind, s, p, x, q, u, v, by, wp.float64(wp.inf), known)
        best.gap = least
        size = wp.float64(1.0)
        for round_ in range(600):
            if size < wp.float64(1e-8):
                break
            better = wp.bool(False)
            angle = wp.float64(0.37) * wp.float64(round_)
            far = size
            for _k in range(10):
                # All around, alternately near and far.
                angle += wp.float64(0.628318530718)
                far = wp.float64(1.4) * size - far
                to_u = best.u + far * du * wp.cos(angle)
                to_v = best.v + far * dv * wp.sin(angle)
                # Repeats the move while the distance decreases.
                for _i in range(20):
                    at_u, at_v = within(to_u, to_v)
                    gap, n = at(kind, s, p, x, q, at_u, at_v, by, best.gap, n)
                    if gap >= best.gap:
                        break
                    better = wp.bool(True)
                    to_u = at_u + wp.float64(1.5) * (at_u - best.u)
                    to_v = at_v + wp.float64(1.5) * (at_v - best.v)
                    best.gap = gap
                    best.u = at_u
                    best.v = at_v
            size = wp.where(better, size, wp.float64(0.5) * size)
        return best

    @wp.kernel(module="unique", enable_backward=False)
    def search(
        kind: wp.int32,
        s: wp.array(dtype=vec5d),
        p: wp.array(dtype=Of_b),
        x: wp.array(dtype=wp.vec3d),
        q: wp.array(dtype=wp.quatd),
        outer: wp.array(dtype=wp.float64),
        by: wp.array(dtype=wp.float64),
        bound: wp.array(dtype=wp.float64),
        found: wp.array(dtype=LowestPoint),
    ):
        i = wp.tid()
        du = (u_1 - u_0) / cells
        dv = (v_1 - v_0) / cells
        best = LowestPoint()
        best.gap = bound[i]
        known = NOWHERE
        if outer[i] < wp.float64(wp.inf):
            # Starts at the grid node nearest to the center of the shape. Its distance excludes most other nodes.
            nearest = wp.float64(wp.inf)
            u_near = wp.float64(0.0)
            v_near = wp.float64(0.0)
            for j in range(nodes):
                for k in range(nodes):
                    u = u_0 + du * wp.float64(j)
                    v = v_0 + dv * wp.float64(k)
                    near = wp.length(position(p[i], u, v) - x[i])
                    if near < nearest:
                        nearest = near
                        u_near = u
                        v_near = v
            now = searched(kind, s[i], p[i], x[i], q[i], u_near, v_near, du, dv, by[i], known)
            if now.gap < best.gap:
                best = now
        for j in range(nodes):
            for k in range(nodes):
                u = u_0 + du * wp.float64(j)
                v = v_0 + dv * wp.float64(k)
                place = position(p[i], u, v)
                near = wp.length(place - x[i]) - outer[i] - by[i]
                # Half the diagonal of a cell, with a margin.
                spare = wp.float64(0.6) * (
                    wp.length(position(p[i], u + du, v) - place) + wp.length(position(p[i], u, v + dv) - place)
                )
                if near - spare < best.gap:
                    gap, known = at(kind, s[i], p[i], x[i], q[i], u, v, by[i], best.gap + spare, known)
                    if gap - spare < best.gap:
                        least = wp.bool(True)
                        side = wp.vec2d(wp.float64(1.0), wp.float64(0.0))
                        for _m in range(4):
                            side = wp.vec2d(-side[1], side[0])
                            if least:
                                at_u, at_v = within(u + side[0] * du, v + side[1] * dv)
                                beside, _n = at(kind, s[i], p[i], x[i], q[i], at_u, at_v, by[i], gap, known)
                                # If the search leads beyond an edge, the point itself is the minimum.
                                least = beside >= gap - ROUNDING
                        if least:
                            now = searched(kind, s[i], p[i], x[i], q[i], u, v, du, dv, by[i], known)
                            if now.gap < best.gap:
                                best = now
        n = normal(p[i], best.u, best.v)
        place = lowered(p[i], best.u, best.v, by[i])
        grows = wp.quat_rotate(q[i], slope(kind, s[i], wp.quat_rotate_inv(q[i], place - x[i])))
        best.along = wp.dot(grows, n)
        best.tilt = wp.length(grows - best.along * n)
        found[i] = best

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(
        kind: wp.int32,
        s: wp.array(dtype=vec5d),
        p: wp.array(dtype=Of_b),
        x: wp.array(dtype=wp.vec3d),
        q: wp.array(dtype=wp.quatd),
        u: wp.array(dtype=wp.vec2d),
        by: wp.array(dtype=wp.float64),
        place: wp.array(dtype=wp.vec3d),
        gap: wp.array(dtype=wp.float64),
    ):
        i = wp.tid()
        place[i] = lowered(p[i], u[i][0], u[i][1], by[i])
        apart, _n = distance(kind, s[i], wp.quat_rotate_inv(q[i], place[i] - x[i]), wp.float64(wp.inf), NOWHERE)
        gap[i] = apart

    return search, evaluate


class Reference:
    """Pairs of a shape and a patch, with searches for their smallest distance.

    Args:
        A: Class of the shape.
        P: Class of the patch.
        a: Parameters of the shapes, by name.
        b: Parameters of the patches.
        x: Origins of the shapes, (n, 3).
        q: Rotations of the shapes, (n, 4).
        outer: Radii of spheres around the origins that contain the shapes.
        device: Warp device.
        grid: Number of cells per parameter.
    """

    def __init__(self, A, P, a, b, x, q, outer, device="cpu", grid=GRID):
        self.count, self.device = len(x), device
        self.kernels = _kernels(P, grid)
        sizes = np.zeros((self.count, 5))
        columns = [np.reshape(a[name], (self.count, -1)) for name in SIZES[A]]
        if columns:
            joined = np.concatenate(columns, axis=1)
            sizes[:, : joined.shape[1]] = joined
        self.given = [
            list(SIZES).index(A),
            wp.array(sizes, dtype=vec5d, device=device),
            packed(P, b, self.count, device),
            wp.array(x, dtype=wp.vec3d, device=device),
            wp.array(q, dtype=wp.quatd, device=device),
        ]
        self.outer = self._array(outer)

    def _array(self, values):
        return wp.array(np.broadcast_to(values, self.count), dtype=wp.float64, device=self.device)

    def least(self, lowered, bound):
        """Returns the lowest points below ``bound``, of patches lowered along their normals."""
        found = wp.zeros(self.count, dtype=LowestPoint, device=self.device)
        inputs = [*self.given, self.outer, self._array(lowered), self._array(bound), found]
        wp.launch(self.kernels[0], self.count, inputs=inputs, device=self.device)
        return found.numpy()

    def evaluate(self, u, lowered):
        """Returns points of patches, lowered along their normals, and their distances from the shapes."""
        place = wp.zeros(self.count, dtype=wp.vec3d, device=self.device)
        gap = wp.zeros(self.count, dtype=wp.float64, device=self.device)
        inputs = [*self.given, wp.array(u, dtype=wp.vec2d, device=self.device), self._array(lowered), place, gap]
        wp.launch(self.kernels[1], self.count, inputs=inputs, device=self.device)
        return place.numpy(), gap.numpy()
