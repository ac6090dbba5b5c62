"""BVH of the faces of a surface: it contains all faces, its bounds hold, and searches find the nearest face."""

import functools

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels.broadphase import contact_detection
from warpcontact.kernels.narrowphase import bvh_search as trees
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.narrowphase.closest_point import DETECT_ALL
from warpcontact.kernels.types import structs

import warpcontact as wc
from warpcontact.geometry.bvh import BRANCHES, build_bvh, face_capacity, node_count


def faces_of(mesh):
    """Returns vertices (F, 3, 3) and unit normals (F, 3) of the faces."""
    corner = np.asarray(mesh.vertices)[mesh.faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return corner, across / np.linalg.norm(across, axis=1, keepdims=True)


def below(tree, node):
    """Returns the indices of the faces in the subtree of a node."""
    nodes = [node]
    while nodes[0] < len(tree.bounds):
        nodes = [child for node in nodes for child in children(tree, node)]
    return np.array(nodes) - len(tree.bounds)


def children(tree, node):
    first = 1 if node == 0 else BRANCHES * node + tree.width - 7
    return range(first, first + (tree.width if node == 0 else BRANCHES))


def sheets():
    """Two coincident sheets with opposite normals. In a node that contains both, the normals sum to zero."""
    side = wc.meshes.grid((1.0, 1.0), (7, 7))
    vertices = np.concatenate([side.vertices, side.vertices - [0.0, 0.0, 0.01]])
    return wc.Mesh(vertices, np.concatenate([side.faces, side.faces[:, ::-1] + len(side.vertices)]))


MESHES = {
    "one face": wc.Mesh(np.eye(3), np.array([[0, 1, 2]])),
    "eight faces": wc.meshes.grid((1.0, 2.0), (2, 2)),
    "eighteen faces": wc.meshes.grid((1.0, 2.0), (3, 3)),
    "box": wc.meshes.box((1.0, 2.0, 0.5)),
    "ball": wc.meshes.icosphere(0.5, 4),
    "sheets": sheets(),
    "terrain": wc.meshes.sinusoidal_terrain((4, 4), (41, 43), 0.2, 2.5),
}


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_bvh_has_every_face_once_and_valid_bounds(mesh):
    corner, normal = faces_of(mesh)
    count = len(corner)
    # Away from the origin, where float32 rounds the vertices of the mesh tables.
    corner = corner + np.array([3.0, -200.0, 17.0])
    tree = build_bvh(corner, normal)
    assert tree.bounds.shape == (node_count(count), 8, BRANCHES)
    assert tree.faces.shape == (face_capacity(count),)
    found = tree.faces[below(tree, 0)]
    np.testing.assert_array_equal(np.sort(found[found < count]), np.arange(count))
    rounded_corner = corner.astype(np.float32).astype(np.float64)
    for node, node_bounds in enumerate(tree.bounds.astype(np.float64)):
        lanes = list(children(tree, node))
        assert np.isnan(node_bounds[:, len(lanes) :]).all()
        for lane, child in enumerate(lanes):
            faces = tree.faces[below(tree, child)]
            faces = faces[faces < count]
            centre, radius, across, half = np.split(node_bounds[:, lane], [3, 4, 7])
            if not len(faces):
                assert np.isnan(node_bounds[:, lane]).all()
                continue
            assert np.linalg.norm(across) == pytest.approx(1.0, abs=1e-6)
            for points in (corner[faces], rounded_corner[faces]):
                away = points.reshape(-1, 3) - centre
                height = away @ across
                lateral = np.sqrt(np.maximum((away**2).sum(axis=1) - height**2, 0.0))
                assert (np.abs(height) <= half).all()
                assert (lateral <= radius).all()


def test_bvh_disks_of_a_smooth_surface_thin_quadratically():
    """Per level the radius halves and the thickness shrinks to a quarter, so a search tests few faces."""
    thick = []
    for cells in (32, 64):
        corner, normal = faces_of(wc.meshes.sinusoidal_terrain((4, 4), (cells, cells), 0.2, 2.5))
        tree, last = build_bvh(corner, normal), face_capacity(len(corner)) // BRANCHES
        of_faces, of_eight = tree.bounds[-last:, 7], tree.bounds[-last - last // BRANCHES : -last, 7]
        # A face is flat, up to the margin that is added to every disk.
        assert of_faces.max() < 1e-5
        thick.append(np.median(of_eight))
    assert 3.0 < thick[0] / thick[1] < 5.0


def model_above(mesh, real, points=((0.0, 0.0, 0.0),)):
    """Returns a model of points above a mesh."""
    scene = wc.Scene()
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), position=(0.0, 0.0, 3.0))
    law = wc.laws.Hooke(stiffness=1e4)
    ground = scene.add_surface(mesh)
    scene.add_contact(scene.add_points(body, points), ground, wc.ContactMaterial(law=law))
    return scene.build(device="cpu", precision="float32" if real is wp.float32 else "float64")


@functools.cache
def searcher(real):
    """Returns a kernel that searches the BVH from given start faces, and by brute force."""
    t = structs(real)
    model_type, vec3, closest_on_face = t.Model, t.vec3, closest_points.functions(real).closest_on_face
    nearest = trees.functions(real).closest_in_bvh

    @wp.kernel(module="unique", enable_backward=False)
    def search(
        model: model_type,
        places: wp.array(dtype=vec3),
        hints: wp.array(dtype=wp.int32),
        found: wp.array(dtype=real),
        span: wp.array(dtype=real),
        least: wp.array(dtype=real),
    ):
        point = wp.tid()
        p = places[point]
        closest = nearest(model, 0, p, hints[point])
        found[point] = closest.distance
        span[point] = closest.span
        best = real(wp.inf)
        for face in range(model.face_corner.shape[0]):
            best = wp.min(best, closest_on_face(model, face, p).distance)
        least[point] = best

    return search


def searched(model, real, points, hints):
    """Returns distance and span of the face found for each point, and the smallest distance to any face."""
    count = len(points)
    places = wp.array(points, dtype=structs(real).vec3, device="cpu")
    out = [wp.zeros(count, dtype=real, device="cpu") for _ in range(3)]
    inputs = [model.parts[0].arrays.model, places, wp.array(hints, dtype=wp.int32, device="cpu"), *out]
    wp.launch(searcher(real), count, inputs, device="cpu")
    return [one.numpy() for one in out]


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_bvh_nearest_face_matches_brute_force(mesh, real):
    """Points near the surface and far away, from any start face. A non-finite point has a NaN distance."""
    rng = np.random.default_rng(3)
    count = 2000
    own = np.asarray(mesh.vertices)
    points = own[rng.integers(0, len(own), count)] - own.mean(axis=0)
    points = points + rng.exponential(0.1, (count, 1)) * rng.normal(size=(count, 3))
    points[::10] *= 30.0
    points[5] = np.nan
    # Any face, or an index out of range.
    hints = rng.integers(-1, len(mesh.faces) + 1, count)
    found, span, least = searched(model_above(mesh, real), real, points, hints)
    assert np.isnan(found[5])
    is_finite = np.arange(count) != 5
    # The face found may be tied with the nearest.
    tie = closest_points.TIE * np.finfo(found.dtype).eps * span
    assert (found[is_finite] >= least[is_finite]).all()
    assert (found[is_finite] <= (least + tie)[is_finite]).all()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
@pytest.mark.parametrize("height", [np.nan, np.inf, 1e20, 1e200])
def test_cluster_with_non_finite_pose_has_no_clearance(height, real):
    """Clearance is −1 if the height or its square is not finite."""
    t, detection_functions = structs(real), contact_detection.functions(real, False, DETECT_ALL)
    model_type, state_type, cache_type = t.Model, t.State, t.Cache
    probe, frames_of_set = detection_functions.cluster_clearance, detection_functions.frames_of_set

    @wp.kernel(module="unique", enable_backward=False)
    def probe_first(model: model_type, state: state_type, cache: cache_type, free: wp.array(dtype=real)):
        free[0] = probe(model, frames_of_set(model, state, 0, 0), cache, 0, 0)

    # A box is closed, so the clearance is the distance.
    model = model_above(wc.meshes.box((1.0, 1.0, 1.0)), real, np.eye(3) * 0.1)
    arrays = model.parts[0].arrays
    free = wp.zeros(1, dtype=real, device="cpu")

    def probed(z):
        position = model.state.body_position.numpy()
        with np.errstate(over="ignore"):
            position[..., 2] = z
        model.state.body_position.assign(position)
        wp.launch(probe_first, 1, [arrays.model, arrays.state, arrays.cache, free], device="cpu")
        return free.numpy()[0]

    # The top is at 0.5. The clearance is at most the distance, and smaller only by rounding of coordinates.
    above = 3.0 + arrays.model.cluster_center.numpy()[0, 0, 2] - 0.5
    assert above * (1.0 - 100 * np.finfo(free.numpy().dtype).eps) < probed(3.0) <= above
    with np.errstate(over="ignore"):
        squared = np.array(height, dtype=wp.dtype_to_numpy(real)) ** 2
    if np.isfinite(squared):
        assert probed(height) == pytest.approx(height, rel=1e-12)
    else:
        assert probed(height) == -1.0
