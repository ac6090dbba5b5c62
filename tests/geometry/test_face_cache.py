"""Face caches, built by a mesh query (GPU) and by the BVH (CPU), contain the nearest face of all points nearby."""

import numpy as np
import pytest
import warp as wp
from gpu_schedule_on_cpu import build_all_face_grids
from scipy.spatial.transform import Rotation
from warpcontact.kernels.lowlevel.simd import WIDTH
from warpcontact.kernels.narrowphase import bvh_search, face_cache, face_grid, search
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.types import structs

import warpcontact as wc

POINTS = 2000


def cache_builder(real, capacity):
    """Returns a kernel that builds the face cache at given positions and returns the row of the nearest face.

    Uses the BVH on a CPU if ``capacity`` is ``None``, else a mesh query with ``capacity`` faces in registers.
    """
    t = structs(real)
    model_type, cache_type, vec3 = t.Model, t.Cache, t.vec3
    closest_on_face = closest_points.functions(real).closest_on_face
    if capacity is None:
        nearest, cache_faces_near = (
            bvh_search.functions(real).closest_in_bvh,
            bvh_search.functions(real).cache_faces_near,
        )

        @wp.kernel(module="unique", enable_backward=False)
        def build_with_bvh(
            model: model_type, cache: cache_type, places: wp.array(dtype=vec3), best: wp.array(dtype=wp.int32)
        ):
            contact = wp.tid()
            p = places[contact]
            closest = nearest(model, 0, p, contact % model.face_corner.shape[0])
            cache_faces_near(model, 0, p, closest, cache, 0, contact)
            best[contact] = closest.row

        return build_with_bvh

    to_list = search.closest_and_cache(real, capacity)

    @wp.kernel(module="unique", enable_backward=False)
    def build_with_query(
        model: model_type, cache: cache_type, places: wp.array(dtype=vec3), best: wp.array(dtype=wp.int32)
    ):
        contact = wp.tid()
        p = places[contact]
        place = wp.vec3f(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
        query = wp.mesh_query_point_no_sign(model.query_mesh_id[0], place, wp.float32(10.0))
        first = closest_on_face(model, model.query_mesh_face_start[0] + query.face, p)
        closest = to_list(model, 0, p, first, real(1e-6), cache, 0, contact)
        best[contact] = closest.row

    return build_with_query


def over_terrain(real, points, device):
    """Returns a model of points over a terrain."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.sinusoidal_terrain((4, 4), (40, 40), 0.2, 2.5))
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    law = wc.laws.Hooke(stiffness=1e4)
    # A GPU caches faces of swept points as well.
    scene.add_contact(scene.add_points(body, points), ground, wc.ContactMaterial(law=law), radius=0.1, swept=True)
    precision = "float32" if real is wp.float32 else "float64"
    return scene.build(device=device, precision=precision)


def cache_capacity(model):
    """Returns the capacity of the face cache per contact."""
    cache = model.parts[0].arrays.cache
    return cache.face.shape[1] // cache.face_count.shape[1]


def build_caches(real, capacity, model, points, device):
    """Builds the caches of all points; returns the rows of their nearest faces."""
    arrays = model.parts[0].arrays
    places = wp.array(points, dtype=structs(real).vec3, device=device)
    best = wp.zeros(len(points), dtype=wp.int32, device=device)
    inputs = [arrays.model, arrays.cache, places, best]
    wp.launch(cache_builder(real, capacity), len(points), inputs, device=device)
    return best.numpy()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_face_cache_in_registers_contains_the_nearest_faces(real, device):
    points = np.random.default_rng(5).uniform([-1.9, -1.9, -0.1], [1.9, 1.9, 0.6], (POINTS, 3))
    model = over_terrain(real, points, device)
    capacity = cache_capacity(model)
    best = build_caches(real, capacity, model, points, device)
    cache, apart = model.parts[0].arrays.cache, distances(real, model, points, device)
    skin = float(model.parts[0].arrays.model.query_mesh_skin.numpy()[0])
    count, reach = cache.face_count.numpy()[0], cache.uncached_bound.numpy()[0]
    # Some caches are not full, and others had to drop the farthest face.
    assert ((count > 0) & (count < capacity)).sum() > 50
    assert (count == capacity).sum() > 50
    # Rounding of coordinates of 2 m.
    off = 1e-6 if real is wp.float32 else 1e-14
    nearest = apart.min(axis=1)
    assert (apart[np.arange(POINTS), best] <= nearest + off).all()
    assert (reach[count < capacity] >= nearest[count < capacity] + skin - off).all()
    for contact, number in enumerate(count):
        own = slice(contact * capacity, contact * capacity + number)
        faces = cache.face.numpy()[0][own]
        assert len(set(faces)) == number
        assert apart[contact, faces].max() <= reach[contact] + off
        assert np.delete(apart[contact], faces).min() >= reach[contact] - off


def distances(real, model, points, device):
    """Returns the distances (point, face) of all faces from all points."""
    t = structs(real)
    model_type, vec3, closest_on_face = t.Model, t.vec3, closest_points.functions(real).closest_on_face

    @wp.kernel(module="unique", enable_backward=False)
    def measure(model: model_type, places: wp.array(dtype=vec3), found: wp.array2d(dtype=real)):
        point, face = wp.tid()
        found[point, face] = closest_on_face(model, face, places[point]).distance

    own = model.parts[0].arrays.model
    found = wp.zeros((len(points), own.face_corner.shape[0]), dtype=real, device=device)
    places = wp.array(points, dtype=vec3, device=device)
    wp.launch(measure, found.shape, [own, places, found], device=device)
    return found.numpy()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_face_cache_built_ahead_contains_faces_around_the_predicted_point(real):
    rng = np.random.default_rng(6)
    points = rng.uniform([-1.8, -1.8, -0.1], [1.8, 1.8, 0.4], (400, 3))
    model = over_terrain(real, points, "cpu")
    cache = model.parts[0].arrays.cache
    build_caches(real, None, model, points, "cpu")
    np.testing.assert_array_equal(
        cache.list_center.numpy()[0], points.astype(cache.list_center.numpy().dtype)
    )  # not yet moved
    reached = cache.uncached_bound.numpy()[0] - distances(real, model, points, "cpu").min(axis=1)
    displacement = rng.normal(size=points.shape)
    # All points leave the valid region of their caches. Every eighth jumps, and point 5 has no valid cache center.
    length = 1.01 * reached
    length[::8] = 3.0 * model.parts[0].arrays.model.query_mesh_skin.numpy()[0]
    displacement *= (length / np.linalg.norm(displacement, axis=1))[:, None]
    here = points + displacement
    last = cache.list_center.numpy()
    last[0, 5] = np.nan
    cache.list_center.assign(last)
    nearest = build_caches(real, None, model, here, "cpu")

    place, bound, count = (
        cache.list_center.numpy()[0],
        cache.uncached_bound.numpy()[0],
        cache.face_count.numpy()[0],
    )
    ahead = np.linalg.norm(place - here, axis=1)
    stay = np.zeros(len(points), dtype=bool)
    stay[::8] = stay[5] = True
    assert np.isfinite(place).all()
    assert ahead[stay].max() < 1e-6
    # The new center is ahead by the reach of the last cache, unless the surface came much nearer or fell away.
    forward = np.einsum("pk,pk->p", place - here, displacement) / np.linalg.norm(displacement, axis=1)
    assert (forward[~stay] > 0.4 * reached[~stay]).mean() > 0.7
    assert forward[~stay].min() > -1e-6
    # Points within the skin of the cache centers, most of them close to its limit.
    about = rng.normal(size=points.shape)
    skin = float(model.parts[0].arrays.model.query_mesh_skin.numpy()[0])
    moved = 0.99 * skin * rng.random(len(points)) ** 0.2
    about = place + about * (moved / np.linalg.norm(about, axis=1))[:, None]
    from_here, from_there, from_about = (distances(real, model, where, "cpu") for where in (here, place, about))
    # Rounding of coordinates of 2 m.
    tolerance, checked = 1e-6 if real is wp.float32 else 1e-14, 0
    assert (from_here[np.arange(len(here)), nearest] <= from_here.min(axis=1) + tolerance).all()
    for point, number in enumerate(count):
        own = slice(point * cache_capacity(model), point * cache_capacity(model) + number)
        faces, least = cache.face.numpy()[0][own], cache.distance.numpy()[0][own]
        assert len(set(faces)) == number > 0
        assert (least <= from_there[point, faces] + tolerance).all()
        # Within the validity bound of the cache, every face that is not cached is farther than the nearest cached
        # one.
        others = np.delete(from_about[point], faces).min()
        own = from_about[point, faces].min()
        if own < bound[point] - moved[point]:
            checked += 1
            assert others > own - tolerance
    assert checked > len(points) // 2


@pytest.mark.parametrize(
    ("radius", "scale", "least", "most"),
    [(0.0, 1.0, 16, 16), (0.09, 1.0, 24, 32), (0.9, 10.0, 24, 32), (0.9, 1.0, 48, 48)],
)
def test_face_cache_is_larger_for_larger_spheres(radius, scale, least, most):
    """Size relative to the edge lengths in units of the mesh. The mesh and the sphere that need most determine it."""
    scene = wc.Scene()
    coarse, fine = (wc.meshes.sinusoidal_terrain((3, 3), (n, n), 0.1, 1.0) for n in (10, 100))
    ground = scene.add_surface([coarse, fine], scale=scale)
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    points = scene.add_points(body, np.zeros((3, 3)))
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(points, ground, material, radius=[0.0, radius, 0.0])
    capacity = cache_capacity(scene.build(device="cpu"))
    assert least <= capacity <= most
    assert capacity % WIDTH == 0


# With axis-aligned sheets, products would not be rounded.
ASKEW = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()


def two_sheets(apart):
    """A triangle with an edge along x at y = z = 0, and a larger one ``apart`` below; both rotated."""
    upper = [(0.0, 0.0, 0.0), (0.5, -1.0, 0.0), (1.0, 0.0, 0.0)]
    lower = [(-0.1, -0.5, -apart), (1.1, -0.5, -apart), (0.5, 0.6, -apart)]
    return wc.Mesh(np.array(upper + lower) @ ASKEW.T, np.array([[0, 2, 1], [3, 4, 5]]))


@pytest.mark.slow
@pytest.mark.parametrize("query_name", ["nearest_candidate", "nearest_candidate_simd"])
@pytest.mark.parametrize(("real", "epsilon"), [(wp.float32, 2.0**-23), (wp.float64, 2.0**-52)])
def test_face_cache_gradients_behind_its_center_hide_no_face(real, epsilon, query_name):
    """Near an edge, rounding turns the gradient, and that error times the displacement exceeds a tie of two faces.

    The cache is built with its center displaced along the edge of one sheet, and queried at its center. There both
    sheets are equally near but for rounding: the sheet with the edge is nearer by 12 epsilon or more, and the
    other one was the previous nearest face.
    """
    t = structs(real)
    model_type, cache_type, vec3 = t.Model, t.Cache, t.vec3
    cache_faces_near, point_functions = bvh_search.functions(real).cache_faces_near, closest_points.functions(real)
    closest_on_face, nearer = point_functions.closest_on_face, point_functions.closer
    query_cache = getattr(face_cache.functions(real), query_name)

    @wp.kernel(module="unique", enable_backward=False)
    def build_and_query(
        model: model_type,
        cache: cache_type,
        places: wp.array(dtype=vec3),
        edge: int,
        found: wp.array(dtype=wp.int32),
        right: wp.array(dtype=wp.int32),
    ):
        contact = wp.tid()
        p = places[contact]
        cache_faces_near(model, 0, p, closest_on_face(model, edge, p), cache, 0, contact)
        q = cache.list_center[0, contact]
        cache.nearest[0, contact] = 1 - edge
        answer = query_cache(model, 0, cache, 0, contact, q, real(0.0))
        found[contact] = answer.closest.row
        if not answer.valid:
            found[contact] = -1
        right[contact] = nearer(model, closest_on_face(model, edge, q), closest_on_face(model, 1 - edge, q)).row

    rng = np.random.default_rng(8)
    count, apart = 20000, 0.0036
    from_lower = rng.uniform(0.0019, 0.0024, count)
    from_edge = from_lower - epsilon * rng.uniform(12.0, 20.0, count)
    z = from_lower - apart
    points = np.stack([rng.uniform(0.2, 0.5, count), np.sqrt(from_edge**2 - z**2), z], axis=1) @ ASKEW.T
    scene = wc.Scene()
    ground = scene.add_surface(two_sheets(apart))
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    scene.add_contact(scene.add_points(body, points), ground, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)))
    model = scene.build(device="cpu", precision="float32" if real is wp.float32 else "float64")
    own = model.parts[0].arrays
    cache = own.cache
    # Points move along the edge and have a previous cache with a large reach.
    cache.list_center.assign((points - 0.1 * ASKEW[:, 0])[None].astype(cache.list_center.numpy().dtype))
    cache.uncached_bound.fill_(10.0)
    places = wp.array(points, dtype=vec3, device="cpu")
    found, right = (wp.zeros(count, dtype=wp.int32, device="cpu") for _ in range(2))
    wp.launch(build_and_query, count, [own.model, cache, places, 0, found, right], device="cpu")
    ahead = cache.list_center.numpy()[0] - points
    np.testing.assert_allclose(
        ahead, [0.8 * own.model.query_mesh_skin.numpy()[0] * ASKEW[:, 0]] * count, atol=1e-6
    )
    right = right.numpy()
    assert (right == 0).mean() > 0.5
    np.testing.assert_array_equal(found.numpy(), right)


def pit(sides):
    """A pit with equal flat sides around the z axis, rotated."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    boundary_points = np.stack([np.cos(angle), np.sin(angle), np.full(sides, 0.5)], axis=1)
    vertices = np.concatenate([[(0.0, 0.0, 0.0)], boundary_points]) @ ASKEW.T
    first = 1 + np.arange(sides)
    return wc.Mesh(vertices, np.stack([np.zeros(sides, dtype=int), first, np.roll(first, -1)], axis=1))


@pytest.mark.parametrize(("real", "epsilon"), [(wp.float32, 2.0**-23), (wp.float64, 2.0**-52)])
def test_tie_between_faces_does_not_depend_on_the_search_order(real, epsilon, device, monkeypatch):
    """Two faces are tied with a third between them but not with each other: ties are not transitive.

    The axis of a pit is equally far from all of its sides. Points near the axis differ by rounding.
    """
    t, sides, count = structs(real), 7, 20000
    model_type, vec3 = t.Model, t.vec3
    refine_closest, closest_on_face = (
        search.functions(real).refine_closest,
        closest_points.functions(real).closest_on_face,
    )
    of_cells = face_grid.functions(real)
    cell_at, closest_in_cell = of_cells.cell_at, of_cells.closest_in_cell

    @wp.kernel(module="unique", enable_backward=False)
    def query_grid(model: model_type, places: wp.array(dtype=vec3), margin: real, row: wp.array(dtype=wp.int32)):
        point = wp.tid()
        p = places[point]
        row[point] = closest_in_cell(model, cell_at(model, 0, p).faces, p, margin).row

    @wp.kernel(module="unique", enable_backward=False)
    def begin_with(
        model: model_type, places: wp.array(dtype=vec3), margin: real, found: wp.array2d(dtype=wp.int32)
    ):
        point, first = wp.tid()
        p = places[point]
        found[point, first] = refine_closest(model, 0, p, closest_on_face(model, first, p), margin).row

    rng = np.random.default_rng(4)
    points = np.stack([*rng.normal(size=(2, count)) * 6.0 * epsilon, rng.uniform(0.2, 0.3, count)], axis=1)
    scene = wc.Scene()
    ground = scene.add_surface(pit(sides))
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    law = wc.laws.Hooke(stiffness=1e4)
    scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, wc.ContactMaterial(law=law), radius=0.3)
    build_all_face_grids(monkeypatch)
    model = scene.build(device=device, precision="float32" if real is wp.float32 else "float64")
    places = wp.array(points @ ASKEW.T, dtype=vec3, device=device)
    found = wp.zeros((count, sides), dtype=wp.int32, device=device)
    wp.launch(begin_with, found.shape, [model.parts[0].arrays.model, places, 1e-4, found], device=device)
    found = found.numpy()
    assert len(np.unique(found)) == sides
    np.testing.assert_array_equal(found, found[:, :1].repeat(sides, axis=1))
    # The face grid gives the same result; some of its searches had to restart.
    row = wp.zeros(count, dtype=wp.int32, device=device)
    wp.launch(query_grid, count, [model.parts[0].arrays.model, places, 1e-4, row], device=device)
    np.testing.assert_array_equal(row.numpy(), found[:, 0])


@pytest.mark.parametrize(
    "query_names",
    [
        pytest.param(("nearest_candidate", "cached_nearest"), id="threads"),
        pytest.param(("nearest_candidate_simd", "nearest_candidate_simd"), id="core", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("real", [wp.float32, pytest.param(wp.float64, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("mesh", "axes", "low", "high", "displacement", "rivals"),
    [
        (
            wc.meshes.sinusoidal_terrain((2, 2), (20, 20), 0.1, 1.0),
            np.eye(3),
            (-0.9, -0.9, 0.0),
            (0.9, 0.9, 0.25),
            0.004,
            3,
        ),
        # The cache of one sheet never contains the other.
        (two_sheets(0.9), ASKEW, (0.3, -0.5, -0.85), (0.7, -0.2, -0.05), 0.2, 1),
    ],
    ids=["terrain", "sheets"],
)
def test_certified_face_of_the_cache_is_the_nearest(
    mesh, axes, low, high, displacement, rivals, real, query_names
):
    """Points move twice: to where the whole cache is tested, then farther, to where one or few faces are
    certified.

    The SIMD variant tests all bounds against the distance of one face, both times.
    """
    t, count = structs(real), 30000
    model_type, cache_type, vec3 = t.Model, t.Cache, t.vec3
    of_search, point_functions = search.functions(real), closest_points.functions(real)
    closest_on_face, refine_closest = point_functions.closest_on_face, of_search.refine_closest
    cache_faces_near = bvh_search.functions(real).cache_faces_near
    uses_bvh, to_list = "nearest_candidate_simd" in query_names, search.closest_and_cache(real, 16)
    query_first, query_again = (getattr(face_cache.functions(real), name) for name in query_names)

    @wp.kernel(module="unique", enable_backward=False)
    def query_three_times(
        model: model_type,
        cache: cache_type,
        begin: wp.array(dtype=vec3),
        through: wp.array(dtype=vec3),
        end: wp.array(dtype=vec3),
        step: real,
        found: wp.array(dtype=wp.int32),
        right: wp.array(dtype=wp.int32),
    ):
        contact = wp.tid()
        margin = real(1e-4)
        first = refine_closest(model, 0, begin[contact], closest_on_face(model, 0, begin[contact]), margin)
        if wp.static(uses_bvh):
            cache_faces_near(model, 0, begin[contact], first, cache, 0, contact)
        else:
            to_list(model, 0, begin[contact], first, margin, cache, 0, contact)
        cache.nearest[0, contact] = first.row
        answer = query_first(model, 0, cache, 0, contact, through[contact], step)
        found[contact] = -1
        if answer.valid:
            cache.nearest[0, contact] = answer.closest.row
            answer = query_again(model, 0, cache, 0, contact, end[contact], step)
            if answer.valid:
                found[contact] = answer.closest.row
        right[contact] = refine_closest(
            model, 0, end[contact], closest_on_face(model, 0, end[contact]), margin
        ).row

    rng = np.random.default_rng(11)
    begin = rng.uniform(low, high, (count, 3)) @ axes.T
    through = begin + displacement * rng.normal(size=(count, 3))
    end = through + displacement * rng.exponential(2.0, (count, 1)) * rng.normal(size=(count, 3))
    scene = wc.Scene()
    ground = scene.add_surface(mesh)
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    scene.add_contact(
        scene.add_points(body, np.zeros((count, 3))), ground, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    )
    model = scene.build(device="cpu", precision="float32" if real is wp.float32 else "float64")
    own = model.parts[0].arrays
    places = [wp.array(points, dtype=vec3, device="cpu") for points in (begin, through, end)]
    found, right = (wp.zeros(count, dtype=wp.int32, device="cpu") for _ in range(2))
    wp.launch(query_three_times, count, [own.model, own.cache, *places, displacement, found, right], device="cpu")
    found, right = found.numpy(), right.numpy()
    known = found >= 0
    np.testing.assert_array_equal(found[known], right[known])
    assert 0.1 < known.mean() < 0.95
    if "cached_nearest" in query_names:
        assert own.cache.tied_count.numpy()[0][known].max() == rivals
