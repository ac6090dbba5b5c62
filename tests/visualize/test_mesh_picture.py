"""Pictures of meshes: visibility, markers, and output of the command."""

import re

import numpy as np
import pytest

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.meshes import examine_file, load_mesh, plot_file
from warpcontact.meshes.picture import _split_by_visibility, find_defects, length_unit
from warpcontact.meshes.picture_view import View, best_direction, paint

PNG = b"\x89PNG"


def brute_force(corners, size):
    """Reference for ``paint``, triangle by triangle: barycentric coordinates of all pixels."""
    rows, columns = size
    y, x = np.mgrid[:rows, :columns] + 0.5
    depth, seen = np.full(size, np.inf), np.full(size, -1)
    for number, (a, b, c) in enumerate(corners):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
        nearer = (u >= 0) & (v >= 0) & (u + v <= 1) & (z <= depth)
        depth[nearer], seen[nearer] = z[nearer], number
    return seen, depth


@pytest.mark.parametrize("seed", range(4))
def test_rendered_triangles_hide_each_other_as_brute_force(seed):
    rng = np.random.default_rng(seed)
    # Some of them extend beyond the picture on all sides.
    corners = rng.uniform((-20, -20, 0), (90, 70, 50), (60, 3, 3))
    seen, depth = paint(corners, (50, 70))
    expected, distance = brute_force(corners, (50, 70))
    np.testing.assert_array_equal(seen, expected)
    np.testing.assert_allclose(depth, distance, rtol=1e-9)
    assert (seen >= 0).any()


def test_adjacent_faces_cover_each_pixel_once():
    mesh = wc.meshes.grid((1, 1), (37, 23))
    angle = 0.4
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    flat = mesh.vertices[:, :2] @ turn * 200 + 150
    corners = np.dstack([flat[mesh.faces], np.zeros(mesh.faces.shape)])
    seen, _ = paint(corners, (300, 300))
    # Pixels inside of the square are covered, pixels outside are not.
    y, x = np.mgrid[:300, :300] + 0.5
    inside = np.abs(np.stack([x - 150, y - 150], axis=-1) @ turn.T).max(axis=-1)
    assert (seen[inside < 100 - 1e-9] >= 0).all()
    assert (seen[inside > 100 + 1e-9] < 0).all()


def test_last_of_coincident_faces_is_visible():
    corners = np.repeat([[[1.0, 1.0, 5.0], [9.0, 1.0, 5.0], [1.0, 9.0, 7.0]]], 3, axis=0)
    assert set(np.unique(paint(corners, (10, 10))[0])) == {-1, 2}


def test_lines_are_split_where_the_surface_hides_them():
    wall = np.array([[[-1, 0, -1], [1, 0, -1], [1, 0, 1]], [[-1, 0, -1], [1, 0, 1], [-1, 0, 1]]], dtype=float)
    line = np.array([[-2.0, 1.0, 0.1], [2.0, 1.0, 0.1]])  # behind the wall, and beyond it on both sides
    points = np.concatenate([wall.reshape(-1, 3), line])
    view = View.towards(np.array([0.0, -1.0, 0.0]), points, (400, 400))
    _, depth = paint(view.project(wall), view.size)
    seen, hidden = _split_by_visibility(view.project(line)[None], view, depth)
    assert len(seen) == 2
    assert len(hidden) == 1
    # The wall is half as long as the line.
    ends = view.project(np.array([[-1.0, 0, 0], [1.0, 0, 0]]))[:, 0]
    np.testing.assert_allclose(np.sort(hidden[0][:, 0]), ends, atol=5.0)


@pytest.mark.parametrize(
    "name",
    ["bunny.ply", "busted.STL", "cycloidal.ply", "not_convex.obj", "soup.stl", "multibody.stl", "featuretype.STL"],
)
def test_drawn_defects_match_report_counts(name, shared):
    path = shared / "data" / "meshes" / name
    report = examine_file(path)
    from warpcontact.meshes.load import Options, examined

    options = Options(1.0, None, None, False, 1e-6, True, None)
    vertices, faces, _, _ = examined(path, None, options)
    check_counts(find_defects(vertices, faces), report)


def edges(ends):
    return len(np.unique(np.sort(ends, axis=1), axis=0))


def check_counts(defects, report):
    assert edges(defects.boundary) == report.boundary_edge_count
    assert edges(defects.non_manifold) == report.non_manifold_edge_count
    assert edges(defects.inconsistent) == report.inconsistent_edge_count
    assert defects.degenerate.sum() == report.degenerate_face_count
    # For duplicates the picture shows the copies and the original.
    assert (defects.duplicate.sum() > 0) == (report.duplicate_face_count > 0)
    assert defects.inward.any() == (report.inward_component_count > 0)
    assert len(defects.pinched) == report.non_manifold_vertex_count
    assert len(defects.cracks) == report.crack_vertex_count
    if report.self_intersection_count is not None:
        assert defects.cutting.any() == (report.self_intersection_count > 0)


def broken():
    """A box with a hole and a duplicated face, next to an inverted ball; a sliver, and invalid faces."""
    ball, box = wc.meshes.icosphere(0.5, 2).flipped(), wc.meshes.box((1, 1, 1))
    start = len(box.vertices) + len(ball.vertices)
    loose = [[0, 0, 0.9], [0.2, 0, 0.9], [0.1, 0, 0.9 + 1e-9], [np.nan, 0, 0]]
    vertices = np.concatenate([box.vertices, ball.vertices + np.array([1.6, 0, 0]), loose])
    bad = [[start, start + 1, start + 2], box.faces[3], [0, 1, start + 3], [0, 1, 99999]]
    return vertices, np.concatenate([box.faces[:-1], ball.faces + len(box.vertices), bad])


def write_obj(path, vertices, faces):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces.tolist()]
    path.write_text("\n".join(lines))


def test_all_defect_kinds_are_marked_and_in_the_legend(tmp_path):
    vertices, faces = broken()
    defects = find_defects(vertices, faces)
    box = len(wc.meshes.box().faces) - 1
    assert np.flatnonzero(~defects.drawable).tolist() == [len(faces) - 2, len(faces) - 1]
    assert np.flatnonzero(defects.degenerate).tolist() == [len(faces) - 4]
    assert np.flatnonzero(defects.duplicate).tolist() == [3, len(faces) - 3]
    assert np.flatnonzero(defects.inward).tolist() == list(range(box, len(faces) - 4))
    assert edges(defects.boundary) == 6  # of the hole and of the sliver

    write_obj(tmp_path / "broken.obj", vertices, faces)
    report = plot_file(tmp_path / "broken.obj", tmp_path / "broken.svg")
    assert not report.usable
    text = (tmp_path / "broken.svg").read_text()
    legend = "\n".join(re.findall(r"<!-- (.*?) -->", text))
    for words in (
        "broken:  2.6 × 1 × 1.4 m (x, y, z),  335 faces",
        "outer side",
        "inner side",
        "closed parts oriented inward: 320 faces",
        "duplicate: 2 faces",
        "open boundary: 6 edges",
        "degenerate: 1 face",
        "2 faces without finite vertices not shown",
        "500 mm",
    ):
        assert words in legend


def test_intersections_pinched_vertices_and_cracks_are_marked(tmp_path):
    """Two intersecting boxes, two more that share a vertex, and a seam that is almost closed."""
    boxes = [(0.0, 0.0, 0.0), (0.5, 0.4, 0.3), (4.0, 0.0, 0.0), (5.0, 1.0, 1.0)]
    box = wc.meshes.box((1, 1, 1))
    vertices = np.concatenate([box.vertices + place for place in boxes])
    seam = [(8, 0, 0), (9, 0, 0), (8.5, 1, 0), (8, 1e-7, 0), (9, 1e-7, 0), (8.5, -1, 0)]
    faces = np.concatenate([box.faces + 8 * i for i in range(4)] + [np.array([[32, 33, 34], [36, 35, 37]])])
    write_obj(tmp_path / "parts.obj", np.concatenate([vertices, seam]), faces)
    report = plot_file(tmp_path / "parts.obj", tmp_path / "parts.svg")
    assert (report.non_manifold_vertex_count, report.crack_vertex_count) == (1, 4)
    assert report.self_intersection_count > 0
    defects = find_defects(np.concatenate([vertices, seam]), faces)
    assert set(np.flatnonzero(defects.cutting)) < set(range(24))
    legend = "\n".join(re.findall(r"<!-- (.*?) -->", (tmp_path / "parts.svg").read_text()))
    cut = int(defects.cutting.sum())
    for words in (
        f"intersecting or overlapping: {cut} faces",
        "touching in a point only: 1 vertex",
        "cracks: 4 vertices",
    ):
        assert words in legend


def test_mesh_picture_shows_outer_inner_and_inactive_faces(tmp_path):
    from matplotlib.image import imread

    grid = wc.meshes.grid((1, 1), (10, 10))
    active = grid.vertices[grid.faces].mean(axis=1)[:, 0] > 0
    grid.plot(tmp_path / "grid.png", active_faces=active, direction=(0, 0, 1))
    image = imread(tmp_path / "grid.png")[..., :3]
    middle = image.shape[0] // 2

    def colour(part):
        return image[middle, int(part * image.shape[1])]

    # Left view, from above: blue on the active side, +x, and gray on the other.
    grey, blue = colour(0.17), colour(0.33)
    assert np.ptp(grey) < 0.02
    assert blue[2] > blue[0] + 0.15
    # Right view, from below: orange where active. Its x axis points to the left.
    sides = colour(0.67), colour(0.83)
    assert max(side[0] - side[2] for side in sides) > 0.3


def test_mesh_picture_view_shows_the_outer_side():
    for mesh, axis in ((wc.meshes.grid(), 2), (wc.meshes.grid().flipped(), 2)):
        corners = mesh.vertices[mesh.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert best_direction(cross) @ cross[0] > 0
        assert abs(best_direction(cross)[axis]) > 0.4


def test_mesh_picture_lengths_are_to_scale():
    points = np.array([[0, 0, 0], [3.0, 1, 2], [-1, 4, 0.5]])
    view = View.towards(np.array([0.3, -0.5, 0.8]), points, (400, 600))
    places = view.project(points) / view.scale
    np.testing.assert_allclose(
        np.linalg.norm(places[1] - places[2]), np.linalg.norm(points[1] - points[2]), rtol=1e-12
    )
    assert (view.project(points)[:, :2] > 0).all()
    assert (view.project(points)[:, :2] < (600, 400)).all()


@pytest.mark.parametrize(("length", "unit"), [(2e3, "km"), (1.0, "m"), (0.02, "mm"), (5e-6, "µm"), (2e-8, "nm")])
def test_scale_bar_unit_suits_the_size(length, unit):
    assert length_unit(length)[0] == unit


def test_mesh_picture_is_bitwise_reproducible(tmp_path):
    mesh = wc.meshes.icosphere(0.1, 2)
    for suffix in ("svg", "png"):
        first, second = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
        mesh.plot(first)
        mesh.plot(second)
        assert first.read_bytes() == second.read_bytes()


def test_degenerate_faces_and_names_with_formula_characters_are_drawn(tmp_path):
    write_obj(tmp_path / "a$_b$.obj", np.ones((3, 3)), np.array([[0, 1, 2]]))
    report = plot_file(tmp_path / "a$_b$.obj", tmp_path / "point.svg")
    assert report.degenerate_face_count == 1
    text = (tmp_path / "point.svg").read_text()
    assert "<!-- a$_b$:" in text
    assert "degenerate: 1 face" in text


def test_inspect_command_draws_a_file(tmp_path, capsys, shared):
    picture = tmp_path / "soup.png"
    assert main(["inspect", str(shared / "data" / "meshes" / "soup.stl"), "--plot", str(picture)]) == 0
    out, _ = capsys.readouterr()
    assert "mesh 'soup'" in out
    assert f"picture: {picture}" in out
    assert picture.read_bytes().startswith(PNG)


def test_inspect_command_draws_an_unusable_file_and_exits_with_1(tmp_path, capsys):
    vertices, faces = broken()
    write_obj(tmp_path / "broken.obj", vertices, faces)
    assert main(["inspect", str(tmp_path / "broken.obj"), "--plot", str(tmp_path / "broken.png")]) == 1
    assert (tmp_path / "broken.png").read_bytes().startswith(PNG)


def test_inspect_command_reports_a_file_that_cannot_be_drawn(tmp_path, capsys):
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    assert main(["inspect", str(tmp_path / "empty.obj"), "--plot", str(tmp_path / "x.png")]) == 1
    assert "'empty' has no face that can be drawn" in capsys.readouterr().err
    (tmp_path / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert main(["inspect", str(tmp_path / "one.obj"), "--plot", str(tmp_path / "x.gif")]) == 2
    assert "must end in .svg or .png, got .gif" in capsys.readouterr().err
    mesh = load_mesh(tmp_path / "one.obj")
    with pytest.raises(ValueError, match=r"active_faces must be face numbers from 0 to 0, got 1"):
        mesh.plot(tmp_path / "x.png", active_faces=[0, 1])
    with pytest.raises(ValueError, match=r"active_faces as a mask must have shape \(1,\), got \(2,\)"):
        mesh.plot(tmp_path / "x.png", active_faces=[True, False])
    with pytest.raises(ValueError, match="direction must be 3 numbers that are not all 0, got"):
        mesh.plot(tmp_path / "x.png", direction=(0, 0, 0))


# A wedge of two equal triangles and a square, in mm; faces 2 and 3 are one group, which overlaps another.
WEDGE = (
    "v 0 0 0\nv 1000 0 0\nv 0 1000 0\nv 0 0 1000\nv 1000 0 1000\n"
    "g front\nf 1 3 2\ng side\nf 1 4 3\ng back top\nf 1 2 5\nf 1 5 4\n"
)


@pytest.mark.slow
def test_inspect_command_reports_and_draws_active_faces(tmp_path, capsys):
    path, picture = tmp_path / "wedge.obj", tmp_path / "wedge.svg"
    path.write_text(WEDGE)
    words = ["inspect", str(path), "--unit", "mm"]
    assert main(words) == 0
    assert "active" not in capsys.readouterr().out
    for choice, legend in (
        (["--active", "back"], "2 of 4, 1 of 2 m²"),
        (["--active", "back", "top", "front"], "3 of 4, 1.5 of 2 m²"),
        (["--active-faces", "1"], "1 of 4, 0.5 of 2 m²"),
        (["--active-faces", "0", "1", "2", "3", "3"], "4 of 4, 2 of 2 m²"),
    ):
        assert main([*words, *choice, "--plot", str(picture)]) == 0
        out = capsys.readouterr().out
        assert f"  active faces           {legend}\n" in out
        assert f"picture: {picture}" in out
        drawn = "\n".join(re.findall(r"<!-- (.*?) -->", picture.read_text()))
        idle = 4 - int(legend[0])
        assert f"not active: {idle} face{'' if idle == 1 else 's'}" in drawn
        assert "outer side, active" in drawn
    # Same result in Python, and with any other selection of faces.
    for choice in ("back", [2, 3], [False, False, True, True], lambda c: c[:, 1] == 0.0):
        report = plot_file(path, picture, unit="mm", active_faces=choice)
        assert report == examine_file(path, unit="mm", active_faces=choice)
        assert (report.active_face_count, report.active_area) == (2, pytest.approx(1.0))
        load_mesh(path, unit="mm").plot(tmp_path / "mesh.svg", active_faces=choice)
        assert (tmp_path / "mesh.svg").read_bytes() == picture.read_bytes()
    assert examine_file(path).active_face_count is None


def test_active_faces_refer_to_the_repaired_mesh(tmp_path, capsys):
    (tmp_path / "wedge.obj").write_text(WEDGE + "f 1 5 4\n")
    words = ["inspect", str(tmp_path / "wedge.obj"), "--unit", "mm", "--active", "top"]
    assert main([*words, "--repair", "duplicate"]) == 0
    assert "active faces           2 of 4, 1 of 2 m²" in capsys.readouterr().out
    assert main(words) == 1
    assert "active faces           3 of 5" in capsys.readouterr().out


def test_invalid_active_faces_are_reported_with_the_option(tmp_path, capsys):
    path, picture = tmp_path / "wedge.obj", tmp_path / "wedge.png"
    path.write_text(WEDGE)
    for choice, message in (
        (["--active", "bakc"], "--active must be groups of the mesh (back, front, side, top), got 'bakc'"),
        (["--active-faces", "4"], "--active-faces must be face numbers from 0 to 3, got 4"),
        (["--active-faces", "-1"], "--active-faces must be face numbers from 0 to 3, got -1"),
        (["--active", "top", "--unit", "inch"], "unit must be one of m, dm"),
    ):
        assert main(["inspect", str(path), *choice, "--plot", str(picture)]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith(f"warpcontact: {message}")
        assert not picture.exists()
    for choice in (["--active-faces", "top"], ["--active"], ["--active", "top", "--active-faces", "1"]):
        with pytest.raises(SystemExit) as caught:
            main(["inspect", str(path), *choice])
        assert caught.value.code == 2
    capsys.readouterr()
    # For an unreadable file, only that error is reported.
    (tmp_path / "empty.stl").write_bytes(b"solid nothing")
    assert main(["inspect", str(tmp_path / "empty.stl"), "--active", "top"]) == 1
    assert "--active" not in capsys.readouterr().err


def test_active_faces_of_an_unusable_mesh_are_drawn_if_possible(tmp_path):
    (tmp_path / "broken.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n")
    for choice, count in (([0, 1], 2), (lambda c: c[:, 0] > 0, 1)):
        report = plot_file(tmp_path / "broken.obj", tmp_path / "broken.png", active_faces=choice)
        assert not report.usable
        assert (report.active_face_count, report.active_area) == (count, 0.5)
