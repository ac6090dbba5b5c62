"""Groups of faces: sources, transformations with the mesh, and selection of active faces."""

import copy
import json
import pickle

import numpy as np
import pytest
import trimesh
from test_cli import TRIANGLE
from test_meshes import OUTWARD, TETRAHEDRON

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.meshes import Mesh, box, grid, load_mesh

WHEEL = (
    "mtllib wheel.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nf 1 2 5\n"
    "o wheel\ng tread left\nusemtl soft rubber\nf 4 3 2 1\ng tread right\nf 2 3 5\n"
    "o hub\ng\nusemtl steel\nf 3 4 5\ng tread\nf 4 1 5\n"
)


def faces_of(mesh):
    return {name: members.tolist() for name, members in mesh.groups.items()}


def test_obj_objects_groups_and_materials_are_mesh_groups(tmp_path):
    (tmp_path / "wheel.obj").write_text(WHEEL)
    mesh = load_mesh(tmp_path / "wheel.obj")
    assert faces_of(mesh) == {
        "wheel": [1, 2, 3], "tread": [1, 2, 3, 5], "left": [1, 2], "right": [3], "soft rubber": [1, 2, 3],
        "hub": [4, 5], "steel": [4, 5],
    }  # fmt: skip
    assert dict(mesh.report.groups)["tread"] == 4
    assert "'tread' (4 faces)" in mesh.report.to_text()
    assert wc.meshes.examine_file(tmp_path / "wheel.obj") == mesh.report


def test_solids_of_an_ascii_stl_are_mesh_groups(tmp_path):
    def solid(name, corners):
        rows = "".join(f"  vertex {x} {y} {z}\n" for x, y, z in corners)
        return f"solid {name}\nfacet normal 0 0 0\nouter loop\n{rows}endloop\nendfacet\nendsolid {name}\n"

    parts = [
        solid(name, TETRAHEDRON[face]) for name, face in zip(("inlet", "wall", "", "wall"), OUTWARD, strict=True)
    ]
    (tmp_path / "a.stl").write_text("".join(parts))
    assert faces_of(load_mesh(tmp_path / "a.stl")) == {"inlet": [0], "wall": [1, 3]}


def test_nodes_meshes_and_materials_of_a_glb_are_mesh_groups(tmp_path):
    scene = trimesh.Scene()
    for i, name in enumerate(("tyre", "rim")):
        part = trimesh.Trimesh(TETRAHEDRON + 3 * i, OUTWARD, process=False)
        part.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(name=f"{name}_look")
        )
        scene.add_geometry(part, geom_name=name, node_name=f"{name}_node")
    scene.export(tmp_path / "a.glb")
    mesh = load_mesh(tmp_path / "a.glb")
    for name in ("tyre", "tyre_node", "tyre_look"):
        assert mesh.groups[name].tolist() == [0, 1, 2, 3]
    assert mesh.groups["rim"].tolist() == [4, 5, 6, 7]


def test_groups_are_stored_with_the_mesh():
    crate = Mesh(
        box().vertices, box().faces, groups={"lid": [3, 1, 1], "all": np.ones(12, dtype=bool), "none": []}
    )
    assert faces_of(crate) == {"lid": [1, 3], "all": list(range(12)), "none": []}
    twins = (crate.flipped(), crate.scaled(2.0), copy.deepcopy(crate), pickle.loads(pickle.dumps(crate)))
    for twin in (crate, *twins):
        assert faces_of(twin) == faces_of(crate)
        assert twin.report.groups == (("lid", 2), ("all", 12), ("none", 0))
        with pytest.raises(ValueError, match="read-only"):
            twin.groups["lid"][0] = 5
        with pytest.raises(TypeError):
            twin.groups["new"] = np.array([1])
    with pytest.raises(ValueError, match=r"groups\['lid'\] must be face numbers from 0 to 11, got 12"):
        Mesh(box().vertices, box().faces, groups={"lid": [12]})
    with pytest.raises(ValueError, match="a group must have a non-empty string for a name, got ''"):
        Mesh(box().vertices, box().faces, groups={"": [1]})


def test_active_faces_are_selected_by_group_or_predicate():
    sheet = grid((2, 2), (2, 2))
    mesh = Mesh(sheet.vertices, sheet.faces, groups={"left": [0, 1], "first": [0], "back": [6, 7]})
    scene = wc.Scene()

    def active(choice, **options):
        return np.flatnonzero(scene.add_surface(mesh, active_faces=choice, **options).active_faces).tolist()

    assert active("left") == [0, 1]
    assert active(["left", "back"]) == [0, 1, 6, 7]
    assert active(("first", "left"), flip=True) == [0, 1]
    centroids = mesh.vertices[mesh.faces].mean(axis=1)
    assert active(lambda c: c[:, 0] > 0) == np.flatnonzero(centroids[:, 0] > 0).tolist()
    with pytest.raises(
        ValueError, match=r"floor.active_faces must be groups of the mesh \(back, first, left\), got 'li"
    ):
        scene.add_surface(mesh, active_faces="lift", name="floor")
    with pytest.raises(ValueError, match=r"must be groups of the mesh \(back, first, left\), got 3"):
        scene.add_surface(mesh, active_faces=["left", 3], name="floor")
    with pytest.raises(ValueError, match=r"must be groups of the mesh \(it has none\), got 'a'"):
        scene.add_surface(sheet, active_faces="a", name="floor")
    with pytest.raises(ValueError, match=r"as a function must return a mask of shape \(8,\), got float64"):
        scene.add_surface(mesh, active_faces=lambda c: c[:, 0], name="floor")


def study(folder, **surface):
    entry = {"name": "road", "mesh": {"file": "wheel.obj"}, **surface}
    body = {"name": "ball", "mass": 1, "inertia": [1, 1, 1]}
    return wc.Experiment.from_dict({"duration": 1, "dt": 0.1, "surface": [entry], "body": [body]}, folder)


def test_experiment_accepts_groups_units_and_repairs(tmp_path):
    (tmp_path / "wheel.obj").write_text(WHEEL + "f 4 1 5\n")
    mesh = {"file": "wheel.obj", "unit": "mm", "scale": 2.0, "repair": ["duplicate"], "tolerance": 1e-5}
    experiment = study(tmp_path, mesh=mesh, active_faces=["left", "steel"])
    surface = experiment.scene().surfaces[0]
    assert np.flatnonzero(surface.active_faces).tolist() == [1, 2, 4, 5]
    assert surface.mesh.bounds[1].tolist() == [0.002, 0.002, 0.002]
    assert [step.count for step in surface.mesh.report.repairs] == [1]
    for changes, message in (
        (
            {"active_faces": "rght"},
            r"surface\[0\].* must be groups of the mesh \(hub, left, .*\), got 'rght'",
        ),
        (
            {"active_faces": ["left", 1]},
            "must be a list of face numbers, of names of groups, or of true and",
        ),
        ({"mesh": mesh | {"unit": "inch"}}, r"mesh.unit must be one of 'm', 'dm', .*, got 'inch'"),
        (
            {"mesh": mesh | {"repair": "glue"}},
            r"mesh.repair must be true, false, or names out of .* got 'glue'",
        ),
        ({"mesh": mesh | {"repair": False}}, "1 of 7 faces is duplicate"),
        ({"mesh": mesh | {"tolerance": 1.0}}, "mesh.tolerance must be greater than 0 and at most 0.01"),
        ({"mesh": mesh | {"prim": "/a"}}, r"mesh.prim is for USD files"),
    ):
        with pytest.raises(wc.ExperimentError, match=message):
            study(tmp_path, **({"mesh": mesh} | changes))


def test_repair_is_reported_and_repeated_by_the_copied_experiment(tmp_path):
    (tmp_path / "wheel.obj").write_text(WHEEL + "f 4 1 5\n")
    entry = {"name": "road", "mesh": {"file": "wheel.obj", "repair": True}, "active_faces": "tread"}
    body = {"name": "ball", "mass": 1, "inertia": [1, 1, 1]}
    content = {"duration": 0.1, "dt": 0.1, "surface": [entry], "body": [body]}
    messages = []
    run = wc.Experiment.from_dict(content, tmp_path).run(
        tmp_path / "out", device="cpu", on_warning=messages.append
    )
    assert "note: mesh file 'wheel.obj': duplicate: 1 face with the vertices of an earlier one dropped" in messages
    assert not any("are treated as one" in text or "no face flipped" in text for text in messages)
    assert json.loads((tmp_path / "out" / "run.json").read_text())["warnings"] == messages
    again = wc.Experiment.from_toml(run.files["experiment"]).scene().surfaces[0]
    assert np.flatnonzero(again.active_faces).tolist() == [1, 2, 3, 5]


def test_inspect_command_accepts_unit_prim_repair_and_trust(tmp_path, capsys):
    path = tmp_path / "a.obj"
    path.write_text(TRIANGLE)
    assert main(["inspect", str(path), "--unit", "mm", "--repair", "merge,orient", "--trusted"]) == 0
    out = capsys.readouterr().out
    assert "0.001 × 0.001 × 0 m" in out
    assert "repairs\n  - merge: no vertices to join\n  - orient: no face flipped" in out
    for words, message in (
        (["--unit", "inch"], "unit must be one of m, dm, cm, mm, um, µm, km, in, ft, got 'inch'"),
        (["--repair", "glue"], "repair must be True, False, or names out of merge"),
        (["--prim", "/a"], "prim is for USD files (.usd, .usda, .usdc, .usdz), got '/a' for 'a.obj'"),
        (["--tolerance", "1"], "tolerance must be at most 0.01"),
    ):
        assert main(["inspect", str(path), *words]) == 2
        assert message in capsys.readouterr().err
