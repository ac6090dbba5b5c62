"""Meshes derived from others: entries of their reports that are copied or recomputed."""

from dataclasses import replace

import numpy as np
import pytest
from test_meshes import joined, moved

from warpcontact.meshes import Mesh, MeshError, box, grid, icosphere, load_mesh
from warpcontact.meshes import mesh as mesh_module
from warpcontact.meshes.examine import examine

SHAPES = {
    "box": box(),
    "open": grid(),
    "cavity": Mesh(*joined(box((3, 3, 3)), box().flipped())),
    "onion": Mesh(*joined(box((3, 3, 3)), box((2, 2, 2)), moved(box(), 5.0), moved(box().flipped(), 8.0))),
    "sheet": Mesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]),
    "many": Mesh(*joined(*(moved(box().flipped() if i % 3 else box(), 2.0 * i) for i in range(150)))),
}


@pytest.mark.parametrize("name", SHAPES)
def test_report_of_flipped_mesh_equals_report_of_flipped_faces(name):
    mesh = SHAPES[name]
    turned = mesh.flipped()
    np.testing.assert_array_equal(turned.faces, mesh.faces[:, [0, 2, 1]])
    assert turned.report == Mesh(turned.vertices, turned.faces, name=mesh.name).report
    assert turned.flipped().report == mesh.report


@pytest.fixture
def loaded(tmp_path):
    """A mesh of a file with a warning, groups, intersections and a repair."""
    both = joined(box(), moved(box(), 0.3))
    rows = [*("v {} {} {}".format(*v) for v in both[0]), "g all", *("f {} {} {}".format(*f) for f in both[1] + 1)]
    rows += [rows[-1], "g quad", "v 5 5 5", "v 5 6 5", "v 5 6 6", "v 5 5 6", "f -4 -3 -2 -1"]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    return load_mesh(tmp_path / "a.obj", repair="duplicate")


@pytest.mark.parametrize("change", [lambda mesh: mesh.flipped(), lambda mesh: mesh.scaled(0.25)])
def test_changed_mesh_keeps_file_warnings_and_repairs(loaded, change):
    changed = change(loaded)
    old, new = loaded.report, changed.report
    assert old.repairs[0].count == 1
    assert new.repairs == old.repairs
    assert old.self_intersection_count > 0
    assert (new.self_intersection_count, new.first_intersection) == (
        old.self_intersection_count, old.first_intersection,
    )  # fmt: skip
    assert old.warnings[0] == new.warnings[0]
    assert new.warnings[0].startswith("26 faces of the file")
    assert new.notes == old.notes
    assert new.groups == old.groups
    # Entries that do not describe the file equal those of a new examination.
    fresh = examine(changed.vertices, changed.faces, "a", overlaps=True)
    of_file = {"repairs": old.repairs, "groups": old.groups, "notes": old.notes}
    assert new == replace(fresh, **of_file, warnings=(old.warnings[0], *fresh.warnings))


def test_flipped_mesh_is_not_examined_again(monkeypatch):
    ball = icosphere(1.0, 3)
    monkeypatch.setattr(mesh_module, "examine", None)
    assert ball.flipped().report.orientation == "inward"


def test_scaled_mesh_recomputes_size_warnings():
    small = box().scaled(1e-5)
    assert any("largest dimension is 1e-05 m" in text for text in small.report.warnings)
    assert not small.scaled(1e5).report.warnings
    for factor in (1e7, 1e308):
        with pytest.raises(MeshError, match=r"too far away|not finite"):
            box((9.0, 1.0, 1.0)).scaled(factor).scaled(factor)
