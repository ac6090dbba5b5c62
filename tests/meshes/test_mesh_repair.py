"""Mesh repair: each step does only what it documents, and reports it."""

import re

import numpy as np
import pytest
import trimesh
from test_meshes import OUTWARD, TETRAHEDRON, joined, moved, soup

from warpcontact.meshes import REPAIRS, Mesh, MeshError, box, grid, icosphere, load_mesh, repaired
from warpcontact.meshes.repair import repair_arrays


class Broken:
    """Arrays that ``Mesh`` would reject."""

    def __init__(self, vertices, faces):
        self.vertices, self.faces = np.asarray(vertices, dtype=float), np.asarray(faces)


def steps(mesh):
    return {step.step: step.count for step in mesh.report.repairs}


@pytest.mark.parametrize("name", ["angle_block.STL", "featuretype.STL", "idler_riser.STL"])
def test_cracked_real_mesh_is_closed_by_merging(shared_data, name):
    path = shared_data / "meshes" / name
    assert not load_mesh(path).report.closed
    mesh = load_mesh(path, repair="merge")
    report = mesh.report
    assert (report.closed, report.orientation, report.crack_vertex_count) == (True, "outward", 0)
    (step,) = report.repairs
    assert step.step == "merge"
    assert 0.0 < step.distance < 1e-12 * max(report.size) * 1e3
    assert step.count == len(load_mesh(path).vertices) - len(mesh.vertices)
    assert step.text in report.to_text()


@pytest.mark.parametrize("name", ["bunny.ply", "multibody.stl"])
def test_defective_real_mesh_is_usable_after_repair(shared_data, name):
    path = shared_data / "meshes" / name
    with pytest.raises(MeshError):
        load_mesh(path)
    report = load_mesh(path, repair=True).report
    assert [step.step for step in report.repairs] == list(REPAIRS)
    found = {step.step: step for step in report.repairs}
    assert (report.duplicate_face_count, report.inconsistent_edge_count) == (0, 0)
    if name == "bunny.ply":
        assert found["duplicate"].count == 87
        assert found["unused"].count == 25
        # Repairs do not change the holes of the scan, nor edges of more than two faces.
        assert {"open", "non-manifold edges"} <= set(report.kinds)
    else:
        assert (report.closed, report.orientation, report.component_count) == (True, "outward", 2)
        assert min(part.volume for part in report.components) > 0.0
        assert found["orient"].count > 0


def test_repair_of_a_valid_mesh_changes_nothing():
    for mesh in (box(), icosphere(1.0, 2), grid((1, 2), (3, 4))):
        again = repaired(mesh)
        np.testing.assert_array_equal(again.vertices, mesh.vertices)
        np.testing.assert_array_equal(again.faces, mesh.faces)
        assert steps(again) == dict.fromkeys(REPAIRS, 0)
        assert again.name == mesh.name


def test_requested_repair_steps_are_applied_in_order():
    v, f = joined(box(), moved(box().flipped(), 5.0))
    broken = Broken([*v, (9, 9, 9)], [*f, f[0]])
    with pytest.raises(MeshError, match=r'duplicate, .*; repair="duplicate"'):
        repaired(broken, ())
    mesh = repaired(broken, ["duplicate"], name="crates")
    assert (mesh.name, steps(mesh), mesh.report.inward_component_count) == ("crates", {"duplicate": 1}, 1)
    assert list(steps(repaired(broken, {"unused", "duplicate", "orient"}))) == ["duplicate", "orient", "unused"]
    assert list(steps(repaired(broken, "all"))) == list(REPAIRS)
    assert repaired(broken).report.unreferenced_vertex_count == 0
    for wrong in ("glue", ["merge", "glue"], 3, [3]):
        with pytest.raises(ValueError, match=r"repair must be True, False, or names out of merge, .*; got"):
            repaired(broken, wrong)


def test_merge_moves_no_vertex_farther_than_the_tolerance():
    rng = np.random.default_rng(5)
    ball = icosphere(0.5, 3)
    v, f = soup(ball)
    mesh = repaired(Broken(v + rng.uniform(-1e-7, 1e-7, v.shape), f), "merge")
    assert (mesh.report.closed, len(mesh.vertices)) == (True, len(ball.vertices))
    (step,) = mesh.report.repairs
    assert step.count == len(v) - len(ball.vertices)
    assert 1e-8 < step.distance <= 1e-6
    # A chain of points, each near the next one, is not merged into one.
    line = np.array([(0.6e-6 * i, 0, 0) for i in range(10)] + [(0, 1, 0), (1, 0, 0)])
    chain = repaired(Broken(line, [(0, 11, 10), (4, 11, 10), (9, 11, 10)]), "merge")
    assert len(chain.vertices) == 7
    assert chain.report.repairs[0].distance <= 1e-6


def test_merge_tolerance_larger_than_faces_is_refused():
    fine = grid((1, 1), (100, 100))
    dust = 0.003 * np.random.default_rng(1).random((300, 3))
    cloud = Broken([(1, 0, 0), *dust], np.arange(300).reshape(-1, 3))
    with pytest.raises(MeshError, match="tolerance must be smaller than the faces"):
        repaired(cloud, "merge", tolerance=0.01)
    assert steps(repaired(fine, "merge", tolerance=1e-3)) == {"merge": 0}
    for wrong in (0.0, -1.0, np.nan, "1", 0.02):
        with pytest.raises(ValueError, match="tolerance must be"):
            repaired(fine, tolerance=wrong)


def test_face_without_area_is_removed_without_opening_the_surface():
    # A vertex on the edge between two faces of a box, with a sliver in the gap.
    v, f = box().vertices, box().faces
    a, b, c = f[0]
    middle = len(v)
    longest = max(((a, b, c), (b, c, a), (c, a, b)), key=lambda t: np.linalg.norm(v[t[0]] - v[t[1]]))
    a, b, c = longest
    split = [(a, middle, c), (middle, b, c)]  # the vertex belongs to one side only
    sliver = (a, b, middle)
    broken = Broken([*v, 0.5 * (v[a] + v[b])], [*split, *f[1:], sliver])
    with pytest.raises(MeshError, match="degenerate"):
        repaired(broken, ())
    mesh = repaired(broken)
    assert (mesh.report.closed, mesh.report.orientation) == (True, "outward")
    assert mesh.report.volume == pytest.approx(1.0)
    assert mesh.report.area == pytest.approx(6.0)
    assert steps(mesh)["degenerate"] == 1
    assert "merged with the neighbor at the longest edge, at most 0 m away" in mesh.report.repairs[1].text


def test_many_slivers_in_a_row_are_removed():
    # A fan of slivers along the edge between two large faces.
    t = np.linspace(0, 1, 6)
    v = [*np.column_stack((t, 0 * t, 0 * t)), (0.5, 1, 0), (0.5, -1, 0)]
    upper = [(i, i + 1, 6) for i in range(5)]
    slivers = [(0, i + 1, i) for i in range(1, 5)]
    mesh = repaired(Broken(v, [*upper, *slivers, (0, 7, 5)]))
    assert (mesh.report.boundary_edge_count, mesh.report.boundary_loop_count) == (4, 1)
    assert mesh.report.area == pytest.approx(1.0)
    assert mesh.report.degenerate_face_count == 0


def test_faces_with_coincident_vertices_are_removed():
    v, f = box().vertices, box().faces
    mesh = repaired(Broken(v, [*f, (0, 0, 1), (3, 3, 3)]), "degenerate")
    np.testing.assert_array_equal(mesh.faces, f)
    assert steps(mesh) == {"degenerate": 2}


@pytest.mark.parametrize("seed", range(5))
def test_random_winding_is_repaired(seed):
    rng = np.random.default_rng(seed)
    v, f = joined(icosphere(1.0, 2), moved(box(), 3.0))
    scrambled = np.where(rng.random(len(f))[:, None] < 0.5, f[:, ::-1], f)
    mesh = repaired(Broken(v, scrambled), "orient")
    assert mesh.report.orientation == "outward"
    assert all(part.volume > 0 for part in mesh.report.components)
    turned = (np.sort(mesh.faces, axis=1) == np.sort(f, axis=1)).all()
    assert turned
    assert steps(mesh)["orient"] == int((_turn(mesh.faces) != _turn(scrambled)).sum())


def _turn(faces):
    """Parity of the vertex order of each face."""
    first = faces.argmin(axis=1)
    rows = np.arange(len(faces))
    return faces[rows, (first + 1) % 3] < faces[rows, (first + 2) % 3]


def test_repair_keeps_cavities_inward():
    outer, inner, core = box((3, 3, 3)), box((2, 2, 2)).flipped(), box((1, 1, 1))
    onion = Mesh(*joined(outer, inner, core))
    assert [part.inside for part in onion.report.components] == [None, 0, 1]
    assert onion.report.nested_components == (1, 2)
    assert "component 1 (12 faces from face 12, inward, a cavity) in component 0" in onion.report.to_text()
    assert steps(repaired(onion))["orient"] == 0
    # If all components are inverted, all are flipped. A component with mixed orientation becomes a cavity.
    np.testing.assert_array_equal(_turn(repaired(onion.flipped()).faces), _turn(onion.faces))
    scrambled = onion.faces.copy()
    scrambled[12:15] = scrambled[12:15, ::-1]
    volumes = [part.volume for part in repaired(Broken(onion.vertices, scrambled)).report.components]
    assert np.sign(volumes).tolist() == [1, -1, 1]
    # Nested solids are unchanged.
    solids = Mesh(*joined(outer, box((2, 2, 2))))
    assert steps(repaired(solids))["orient"] == 0
    assert "outward, one solid within another" in solids.report.to_text()


def test_repair_orients_an_open_sheet_as_its_majority():
    sheet = grid((1, 1), (4, 4))
    faces = sheet.faces.copy()
    faces[:5] = faces[:5, ::-1]
    mesh = repaired(Broken(sheet.vertices, faces))
    assert steps(mesh)["orient"] == 5
    np.testing.assert_array_equal(_turn(mesh.faces), _turn(sheet.faces))


def test_repair_of_a_moebius_strip_is_refused():
    t = np.linspace(0, np.pi, 12, endpoint=False)
    circle = np.column_stack((np.cos(2 * t), np.sin(2 * t), np.zeros(12)))
    across = 0.3 * (np.cos(t)[:, None] * circle + np.sin(t)[:, None] * (0, 0, 1))
    quads = [(i, i + 12, i + 13, i + 1) for i in range(11)] + [(11, 23, 0, 12)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    with pytest.raises(MeshError, match="wound inconsistently"):
        repaired(Broken(np.concatenate((circle - across, circle + across)), faces))


def test_repair_keeps_groups_with_their_faces():
    ball = icosphere(1.0, 1)
    v, f = soup(ball)
    mesh = Mesh(np.concatenate((v, [(7, 7, 7)])), f, groups={"north": f[:, 0] % 2 == 0, "first": [0, 1]})
    broken = repaired(mesh)
    np.testing.assert_array_equal(broken.groups["north"], mesh.groups["north"])
    vertices, faces, groups, _ = repair_arrays(
        np.array([(0.0, 0, 0), (1, 0, 0), (0.5, 1, 0), (0.5, -1, 0), (0.5, 0, 0)]),
        np.array([(0, 4, 2), (0, 4, 2), (4, 1, 2), (0, 1, 4), (1, 0, 3)]),
        {"upper": np.array([0, 1, 2]), "copy": np.array([1]), "sliver": np.array([3]), "lower": np.array([4])},
        REPAIRS,
    )
    # The sliver is now a part of the lower face and has its group.
    members = {name: vertices[faces[found]].mean(axis=(0, 1))[1] for name, found in groups.items() if len(found)}
    assert {name: len(found) for name, found in groups.items()} == {"upper": 2, "copy": 0, "sliver": 0, "lower": 2}
    assert members["upper"] > 0 > members["lower"]


def test_irreparable_mesh_is_refused():
    for vertices, faces, message in (
        (np.full((3, 3), np.nan), [(0, 1, 2)], "not finite"),
        (TETRAHEDRON, [(0, 1, 9)], "out of index range"),
        (TETRAHEDRON, np.empty((0, 3), dtype=int), "it has no faces"),
        (TETRAHEDRON[:, :2], OUTWARD, "vertices must have shape"),
    ):
        with pytest.raises(MeshError, match=message):
            repaired(Broken(vertices, faces))
    with pytest.raises(TypeError, match="mesh must have vertices and faces"):
        repaired(trimesh.Scene())


def test_trimesh_object_can_be_repaired():
    original = trimesh.creation.icosphere(subdivisions=2)
    original.faces[::3] = original.faces[::3, ::-1]
    report = repaired(original).report
    assert (report.closed, report.orientation) == (True, "outward")


def test_repair_that_an_error_of_a_mesh_recommends_repairs_it(tmp_path):
    """Arrays have another call than files."""
    mesh = box()
    faces = np.array(mesh.faces)
    faces[0] = faces[0][::-1]
    with pytest.raises(MeshError, match=r"wound inconsistently") as caught:
        Mesh(mesh.vertices, faces)
    (step,) = re.findall(r'wc\.meshes\.repaired\(mesh, "(\w+)"\)', str(caught.value))
    assert "repair=" not in str(caught.value)
    found = repaired(Broken(mesh.vertices, faces), step)
    assert (found.report.orientation, found.report.volume) == ("outward", mesh.report.volume)
    trimesh.Trimesh(mesh.vertices, faces, process=False).export(tmp_path / "box.off")
    with pytest.raises(MeshError, match=r'wound inconsistently, .*; repair="orient"$'):
        load_mesh(tmp_path / "box.off")
    assert load_mesh(tmp_path / "box.off", repair=step).report.orientation == "outward"
