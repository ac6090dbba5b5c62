"""Face grids: cell clearances and face lists are valid for points next to every face; memory and culling."""

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from brute_force import Surface, nearest_on_triangles
from gpu_schedule_on_cpu import build_all_face_grids, use_work_queues
from warpcontact.kernels.narrowphase import face_grid as device_cells
from warpcontact.kernels.types import structs

import warpcontact as wc
from warpcontact.geometry import face_grid as cells
from warpcontact.geometry.query_mesh import make_query_meshes

LAW = wc.laws.Hooke(stiffness=1e4)
POINTS = 3000


def with_slivers(sheet):
    """Moves the vertices at x = 0 to 4 mm from those at x = 0.1, which makes slivers."""
    vertices = sheet.vertices.copy()
    vertices[np.abs(vertices[:, 0]) < 1e-9, 0] = 0.096
    return wc.Mesh(vertices, sheet.faces)


# Mesh, radius of the contact, and whether the mesh is closed.
CASES = {
    "terrain": (wc.meshes.sinusoidal_terrain((4, 4), (40, 40), 0.2, 2.5), 0.1, False),
    "terrain, by points": (wc.meshes.sinusoidal_terrain((4, 4), (20, 20), 0.2, 2.5), 0.0, False),
    "sheet with boundary": (wc.meshes.grid((1.0, 0.6), (10, 7)), 0.02, False),
    "ball": (wc.meshes.icosphere(0.4, 3), 0.05, True),
    "sheet with slivers": (with_slivers(wc.meshes.grid((1.0, 0.6), (10, 7))), 0.02, False),
    "box": (wc.meshes.box((0.4, 0.5, 0.3)), 0.05, True),
}
EXPENSIVE = ("terrain", "ball")


@pytest.fixture(autouse=True)
def on_any_device(monkeypatch):
    build_all_face_grids(monkeypatch)


def scene_of(mesh, radius, *, count=1, scale=1.0):
    scene = wc.Scene()
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    point = scene.add_point(body, (0, 0, 0))
    for _ in range(count):
        scene.add_contact(point, scene.add_surface(mesh, scale=scale), wc.ContactMaterial(law=LAW), radius=radius)
    return scene


def grids_of(scene):
    """Returns the grids of a model of the scene."""
    return cells.make_grids(make_query_meshes(scene.contacts), SimpleNamespace(is_cuda=True), structs(wp.float32))


@pytest.fixture(
    scope="module",
    params=[
        *((name, "float32") for name in CASES if name not in EXPENSIVE),
        *(pytest.param((name, "float32"), marks=pytest.mark.slow) for name in EXPENSIVE),
        ("sheet with boundary", "float64"),
        *(
            pytest.param((name, "float64"), marks=pytest.mark.slow)
            for name in CASES
            if name != "sheet with boundary"
        ),
    ],
    ids="-".join,
)
def sampled_grid(request, device):
    """Face vertices, device model, points with their cell indices, host model, and whether the mesh is closed."""
    name, precision = request.param
    mesh, radius, closed = CASES[name]
    with pytest.MonkeyPatch.context() as patched:
        build_all_face_grids(patched, cells.FINEST)
        model = scene_of(mesh, radius).build(device=device, precision=precision)
    own = model.parts[0].arrays.model
    counts = own.query_mesh_grid.numpy()[0]
    origin, size = own.query_mesh_grid_origin.numpy()[0], own.query_mesh_cell_size.numpy()[0]
    assert counts[3] == 0
    assert own.cells.size == np.prod(counts[:3])
    random = np.random.default_rng(3)
    points = origin + size * random.uniform(0.0, counts[:3], (POINTS, 3))
    # Most points are near the surface, and some are near vertices of cells.
    corners = own.face_corner.numpy()[:, :3].astype(float)
    faces = random.integers(len(corners), size=POINTS)
    near = np.einsum("nk,nkx->nx", random.dirichlet(np.ones(3), POINTS), corners[faces])
    points[POINTS // 4 :] = (near + random.normal(scale=radius + size, size=(POINTS, 3)))[POINTS // 4 :]
    snapped = origin + size * (np.round((points - origin) / size) + random.choice([-1e-4, 1e-4], (POINTS, 3)))
    points = np.concatenate([points, snapped]).astype(np.float32 if precision == "float32" else float)
    at = np.floor((points - origin) / size).astype(int)
    inside = ((at >= 0) & (at < counts[:3])).all(axis=1)
    points, at = points[inside], at[inside]
    cell = at[:, 0] + counts[0] * (at[:, 1] + counts[1] * at[:, 2])
    assert len(points) > POINTS
    return corners, own, points, cell, model, closed


def distances(corners, points):
    """Distance of every point from every face (N, F)."""
    return np.stack(
        [
            np.linalg.norm(p - nearest_on_triangles(np.broadcast_to(p, (len(corners), 3)), corners), axis=1)
            for p in points.astype(float)
        ]
    )


def distance_and_side(corners, points):
    """Distance from the nearest face, and signed distance from its plane times twice its area."""
    distance, closest_point, face = Surface(corners).nearest(points)
    normal = np.cross(corners[face, 1] - corners[face, 0], corners[face, 2] - corners[face, 0])
    return distance, np.einsum("nx,nx->n", points - closest_point, normal)


def cell_face_lists(own, cell):
    """Returns the face list of each cell; ``None`` for a cell without a list."""
    faces = own.cells.numpy()["faces"][cell]
    start, count = np.divmod(faces, device_cells.LIST_STRIDE)
    start *= device_cells.LIST_ALIGNMENT
    listed = own.cell_face.numpy()
    return [listed[s : s + n] if f >= 0 else None for f, s, n in zip(faces, start, count, strict=True)]


def test_face_grid_cell_lists_contain_the_nearest_faces(sampled_grid):
    """A list contains all faces tied with the nearest, and few others."""
    corners, own, points, cell, *_ = sampled_grid
    lists = cell_face_lists(own, cell)
    listed = np.flatnonzero([faces is not None for faces in lists])
    assert len(listed) > 0.2 * len(points)
    counts = []
    for i in listed:
        assert len(set(lists[i])) == len(lists[i]) > 0
        counts.append(len(lists[i]))
    some = listed[::4]
    for i, away in zip(some, distances(corners, points[some]), strict=True):
        assert set(np.flatnonzero(away < away.min() + 1e-7)) <= set(lists[i])
    # Lists exclude most faces that merely intersect the bounding sphere of the cell.
    assert np.mean(counts) < 8.0


def test_face_grid_has_a_list_for_every_point_in_contact(sampled_grid):
    corners, own, points, cell, model, _ = sampled_grid
    distance, side = distance_and_side(corners, points)
    reach = model.scene.contacts[0].radius.max() + own.query_mesh_skin.numpy()[0]
    touching = (side > 0.0) & (distance < reach)
    assert touching.sum() > 100
    # The exception is a few points next to a boundary, if the center of the cell is on the inner side.
    assert (own.cells.numpy()["faces"][cell[touching]] >= 0).mean() > 0.995


def test_face_grid_clearance_is_a_lower_bound_on_the_outer_side(sampled_grid):
    corners, own, points, cell, _, closed = sampled_grid
    free = own.cells.numpy()["clearance"][cell]
    has_clearance = free > 0.0
    assert has_clearance.mean() > 0.1
    distance, side = distance_and_side(corners, points[has_clearance])
    assert (distance > free[has_clearance]).all()
    if closed:
        assert np.abs(Surface(corners).winding(points[has_clearance])).max() < 0.5
        # The clearance is below the distance by at most about a cell size, and rounding.
        size = own.query_mesh_cell_size.numpy()[0]
        assert (distance - free[has_clearance] < 1.75 * size + 1e-4).all()
    else:
        assert (side > 0.0).all()


@functools.cache
def query_kernel(real):
    """Returns a kernel that queries the clearance of points, and the nearest of the listed faces."""
    t = structs(real)
    of_cells, Model, vec3 = device_cells.functions(real), t.Model, t.vec3
    cell_at, closest_in_cell = of_cells.cell_at, of_cells.closest_in_cell

    @wp.kernel(module="unique", enable_backward=False)
    def query(
        model: Model,
        points: wp.array(dtype=vec3),
        free: wp.array(dtype=real),
        row: wp.array(dtype=wp.int32),
        distance: wp.array(dtype=real),
    ):
        i = wp.tid()
        cell = cell_at(model, 0, points[i])
        free[i] = cell.clearance
        row[i] = -1
        if cell.faces >= 0:
            closest_point = closest_in_cell(model, cell.faces, points[i], model.query_mesh_error[0])
            row[i] = closest_point.row
            distance[i] = closest_point.distance

    return query


def query(model, points):
    own, real = model.parts[0].arrays.model, model.parts[0].types.real
    given = wp.array(points, dtype=structs(real).vec3, device=model.devices[0])
    free, distance = (wp.zeros(len(points), dtype=real, device=model.devices[0]) for _ in range(2))
    row = wp.zeros(len(points), dtype=wp.int32, device=model.devices[0])
    wp.launch(query_kernel(real), len(points), [own, given, free, row, distance], device=model.devices[0])
    return free.numpy(), row.numpy(), distance.numpy()


def test_closest_point_from_cell_list_matches_whole_surface(sampled_grid):
    corners, _, points, _, model, _ = sampled_grid
    _, row, distance = query(model, points)
    listed = row >= 0
    assert listed.mean() > 0.2
    own = points[listed].astype(float)
    least, *_ = Surface(corners).nearest(own)
    away = np.linalg.norm(own - nearest_on_triangles(own, corners[row[listed]]), axis=1)
    error = 1e-5 if points.dtype == np.float32 else 1e-12
    np.testing.assert_allclose(distance[listed], least, atol=error)
    np.testing.assert_allclose(away, least, atol=error)


def test_points_outside_the_face_grid_have_clearance_and_side_of_its_boundary(sampled_grid):
    corners, own, _, _, model, closed = sampled_grid
    counts, origin = own.query_mesh_grid.numpy()[0][:3], own.query_mesh_grid_origin.numpy()[0]
    extent = counts * own.query_mesh_cell_size.numpy()[0]
    random = np.random.default_rng(5)
    points = random.uniform(-1.0, 2.0, (POINTS, 3))
    # Half of them are directly above.
    points[::2] = random.uniform((0.3, 0.3, 1.01), (0.7, 0.7, 3.0), (POINTS // 2, 3))
    points = origin + extent * points
    inside = ((points > origin) & (points < origin + extent)).all(axis=1)
    points = points[~inside].astype(origin.dtype)
    free, row, _ = query(model, points)
    assert (row < 0).all()
    distance, side = distance_and_side(corners, points)
    has_clearance = free > 0.0
    assert (distance[has_clearance] > free[has_clearance]).all()
    if closed:
        assert has_clearance.all()
        # The clearance differs from the distance by at most the margin at a vertex of the box.
        assert (distance - free < 2.0 * extent.max()).all()
    else:
        assert has_clearance.mean() > 0.1
        assert (side[has_clearance] > 0.0).all()


def test_face_grid_of_scaled_surface_has_scaled_reach():
    mesh, radius, _ = CASES["ball"]
    (as_it_is,) = grids_of(scene_of(mesh, radius))
    (larger,) = grids_of(scene_of(mesh, 10.0 * radius, scale=10.0))
    assert (larger.counts, larger.size) == (as_it_is.counts, as_it_is.size)
    assert larger.radius == pytest.approx(as_it_is.radius)


@pytest.mark.parametrize("radius", [5.0, 30.0])
def test_face_grid_is_not_built_for_spheres_that_reach_too_many_faces(radius):
    assert grids_of(scene_of(wc.meshes.sinusoidal_terrain((4, 4), (40, 40), 0.2, 2.5), radius)) is None


def test_face_grids_are_built_for_all_meshes_or_none(monkeypatch):
    mesh, radius, _ = CASES["ball"]
    (one,) = grids_of(scene_of(mesh, radius))
    assert len(grids_of(scene_of(mesh, radius, count=4))) == 4
    monkeypatch.setattr(cells, "MAX_BYTES", 2.5 * one.bytes)
    assert len(grids_of(scene_of(mesh, radius, count=2))) == 2
    assert grids_of(scene_of(mesh, radius, count=4)) is None
    for name in ("CELL_BYTES", "LIST_BYTES"):
        with monkeypatch.context() as here:
            here.setattr(cells, name, 1000)
            assert grids_of(scene_of(mesh, radius)) is None


def test_face_grid_is_not_built_for_swept_contacts_and_stacked_sheets():
    mesh, radius, _ = CASES["ball"]
    scene = scene_of(mesh, radius)
    scene.add_contact(scene.points[0], scene.surfaces[0], wc.ContactMaterial(law=LAW), radius=radius, swept=True)
    assert grids_of(scene) is None
    # Two sheets above each other: the nearest one does not determine the side.
    sheet = wc.meshes.grid((1.0, 0.6), (10, 7))
    above = wc.Mesh(
        np.concatenate([sheet.vertices, sheet.vertices + np.array([0, 0, 0.3])]),
        np.concatenate([sheet.faces, sheet.faces + len(sheet.vertices)]),
    )
    assert grids_of(scene_of(sheet, radius)) is not None
    assert grids_of(scene_of(above, radius)) is None


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
def test_memory_estimate_includes_face_grid(precision, device):
    mesh, radius, _ = CASES["ball"]
    model = scene_of(mesh, radius).build(device=device, precision=precision)
    own = model.parts[0].arrays.model
    taken = sum(array.capacity for array in (own.cells, own.cell_face))
    without = sum(
        array.capacity
        for name, array in ((name, getattr(own, name)) for name in own._cls.vars)
        if name.startswith(("patch_", "wall_", "face_", "surface_"))
    )
    assert taken > 100_000
    planned = model.memory_estimate().bytes_for("surfaces")
    assert taken < planned < taken + without + 1_000_000


def contact_counts(scene, steps, *, change=lambda model: None, **options):
    """Detection status and number of active contacts of a cluster every 20 steps, with ``change`` applied halfway."""
    model = scene.build(device="cpu")
    sim = wc.Simulation(model, dt=1e-3, **options)
    seen = []
    for done in range(20, steps + 1, 20):
        sim.step(20)
        arrays = model.arrays
        seen.append((arrays.contacts.status.numpy().tolist(), arrays.active_contacts.count.numpy().tolist()))
        if done == steps // 2:
            change(model)
    return seen


def falling_points(places, mesh, height, **options):
    scene = wc.Scene()
    body = scene.add_body(1.0, (1e9, 1e9, 1e9), position=(0, 0, height), linear_velocity=(0, 0, -1))
    soft = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=5.0))
    scene.add_contact(scene.add_points(body, places), scene.add_surface(mesh), soft, name="touch", **options)
    return scene


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize("clear_cache", [False, True], ids=["cached", "cache_cleared"])
def test_points_pushed_through_a_plate_are_not_culled_by_the_face_grid(clear_cache, monkeypatch):
    """The center of their cluster is far away on the outer side."""

    def change(model):
        if clear_cache:
            model["touch.law.stiffness"] = 5.0

    corners = [(x, y, 0.0) for x in (-4e-3, 4e-3) for y in (-4e-3, 4e-3)]
    scene = falling_points(corners, wc.meshes.box((1, 1, 0.02)), 0.03, entry="latched")
    in_cells = contact_counts(scene, 160, change=change)
    assert in_cells[-1] == ([[wc.ContactStatus.CONTACT] * 4], [[4]])
    monkeypatch.undo()
    assert contact_counts(scene, 160, change=change) == in_cells


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize(
    "beside", [1.5, pytest.param(2.0, marks=pytest.mark.slow), pytest.param(2.1, marks=pytest.mark.slow)]
)
def test_points_outside_the_boundary_do_not_delay_culling_of_others(beside):
    """At any distance; one is 2 m outside the boundary."""
    plane = wc.Mesh([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    scene = falling_points([(0, 0, 0), (1.0 + beside, 0, 0.5)], plane, 0.05)
    seen = contact_counts(scene, 100)
    assert seen[-1] == ([[wc.ContactStatus.CONTACT, wc.ContactStatus.OPEN]], [[1]])


def block_with_a_gap(gap, cells=10, half=0.25, height=0.0137):
    """A unit cube with a flat cavity of two sheets, and a boundary between them."""
    block = wc.meshes.box((1, 1, 1))
    side = np.linspace(-half, half, cells + 1)
    y, x = np.meshgrid(side, side)
    sheets = [np.stack([x, y, height + 0 * x + up], axis=-1).reshape(-1, 3) for up in (0.0, gap)]
    number = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    a, b, c, d = (own.ravel() for own in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    # Seen from the cavity, the lower sheet faces up and the upper one down.
    lower = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    above = number.size
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    p, q = rim, np.roll(rim, -1)
    walls = np.concatenate([np.stack([q, p, p + above], 1), np.stack([q, p + above, q + above], 1)])
    hollow = np.concatenate([lower, lower[:, ::-1] + above, walls]) + len(block.vertices)
    return wc.Mesh(np.concatenate([block.vertices, *sheets]), np.concatenate([block.faces, hollow]))


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
def test_face_grid_clearance_is_zero_around_a_narrow_gap_inside_a_body(precision, device):
    """Both faces of the gap are equally near to rounding; one has the gap on its side, the other the body."""
    near = block_with_a_gap(2e-6)
    faces = near.faces
    # A surface of two meshes far apart has large coordinates.
    far = np.array([60.0, 0.0, 60.0])
    scene = wc.Scene()
    point = scene.add_point(scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0)), (0, 0, 0))
    surface = scene.add_surface([near, wc.Mesh(near.vertices + far, faces)])
    scene.add_contact(point, surface, wc.ContactMaterial(law=LAW), radius=0.0)
    model = scene.build(device=device, precision=precision)
    own = model.parts[0].arrays.model
    for patch, middle in enumerate((0.0 * far, far)):
        *counts, first = own.query_mesh_grid.numpy()[patch]
        origin, size = own.query_mesh_grid_origin.numpy()[patch], own.query_mesh_cell_size.numpy()[patch]
        free = own.cells.numpy()["clearance"][first : first + np.prod(counts)]
        at = np.indices(counts[::-1]).reshape(3, -1)[::-1].T
        away = np.abs(origin.astype(float) + size * (at + 0.5) - surface_centre(surface, middle))
        assert (away < 0.5).all(axis=1).sum() > 100
        assert (free[(away < 0.5).all(axis=1)] <= 0.0).all()
        assert (free > 0.0).any()


def surface_centre(surface, middle):
    """Returns the center of a mesh in the frame of the mesh tables."""
    return middle - surface.centre


def test_face_grid_cells_without_list_capacity_have_no_list(device, monkeypatch):
    mesh, radius, _ = CASES["box"]
    usual = scene_of(mesh, radius).build(device=device).parts[0].arrays.model.cells.numpy()
    forced = cells.make_grid

    def with_ten(*arguments):
        grid = forced(*arguments)
        return replace(grid, places=12, bytes=grid.bytes - 4 * (grid.places - 12))

    monkeypatch.setattr(cells, "make_grid", with_ten)
    few = scene_of(mesh, radius).build(device=device).parts[0].arrays.model.cells.numpy()
    start, count = np.divmod(few["faces"][few["faces"] >= 0], device_cells.LIST_STRIDE)
    assert 0 < len(count) < 4
    assert (device_cells.LIST_ALIGNMENT * start + count <= 12).all()
    np.testing.assert_array_equal(few["clearance"], usual["clearance"])


def test_face_grid_query_of_non_finite_state_finds_no_face(monkeypatch):
    """Cached face counts are nonzero for points near the surface, but no faces are stored."""
    build_all_face_grids(monkeypatch)
    use_work_queues(monkeypatch)
    monkeypatch.setattr("warpcontact.forces.launch_shape.SMALL_LAUNCH", 0)
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.sinusoidal_terrain((4, 4), (20, 20), 0.2, 2.5))
    rng = np.random.default_rng(3)
    for name in ("touch", "other"):
        body = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.4))
        points = scene.add_points(body, rng.uniform(-0.1, 0.1, (20, 3)))
        material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
        scene.add_contact(points, ground, material, radius=0.01, name=name)
    model = scene.build(envs=4, device="cpu")
    wc.Simulation(model, dt=1e-3).step(400)
    own = model.parts[0].arrays
    assert own.uses_face_grid
    assert own.cache.face_count.numpy().max() == 1
    assert own.cache.face.size == 0
    assert np.isfinite(model.sensor("touch.gap")).any()
    own.state.body_position.fill_(np.nan)
    assert (model.sensor("touch.status") == wc.ContactStatus.FAR).all()
