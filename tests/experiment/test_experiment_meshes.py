"""Surfaces with several meshes in experiment files: mesh per environment, and files in the results."""

import json
import shutil

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from test_experiment_errors import problems_of

import warpcontact as wc

pytestmark = pytest.mark.usefixtures("no_pictures")

# Two squares of 2 m, in mm. The left half of the second is active by its group. One face is duplicated.
FLAT = "v -1000 -1000 0\nv 1000 -1000 0\nv 1000 1000 0\nv -1000 1000 0\nf 1 2 3\nf 1 3 4\n"
HALVES = (
    "v -1000 -1000 100\nv 0 -1000 100\nv 0 1000 100\nv -1000 1000 100\nv 1000 -1000 100\nv 1000 1000 100\n"
    "g left\nf 1 2 3\nf 1 3 4\ng right\nf 2 5 6\nf 2 6 3\nf 2 6 3\n"
)
MESHES = [
    {"file": "meshes/flat.obj", "unit": "mm"},
    {"file": "meshes/halves.obj", "scale": 0.002, "repair": "duplicate"},
    {"shape": "grid", "size": [3, 3]},
]
ENVS = 6


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "flat.obj").write_text(FLAT)
    (tmp_path / "meshes" / "halves.obj").write_text(HALVES)
    return tmp_path


def content(mesh=MESHES, choice=None, *, active_faces=None, **changes):
    """A small ball that falls on the right half of a surface."""
    surface = {"name": "ground", "mesh": mesh}
    if active_faces is not None:
        surface["active_faces"] = active_faces
    return {
        "envs": ENVS,
        "duration": 0.02,
        "dt": 1e-3,
        "surface": [surface],
        "body": [{"name": "ball", "mass": 1, "inertia": [4e-3] * 3, "position": [0.5, 0.3, 0.29]}],
        "point": [{"name": "centre", "body": "ball", "position": [0, 0, 0]}],
        "material": [{"name": "rubber", "law": {"type": "Hooke", "stiffness": 1e4}}],
        "contact": [
            {"name": "touch", "points": "centre", "surface": "ground", "material": "rubber", "radius": 0.1}
        ],
        "variation": {} if choice is None else {"ground.mesh": choice},
        "record": {"sensors": ["touch.gap", "touch.status"]},
    } | changes


CHOSEN = [0, 1, 2, 2, 1, 0]
ACTIVE = [True, ["left"], [0]]


def test_experiment_with_several_meshes_equals_script(device, folder, tmp_path):
    experiment = wc.Experiment(content(choice={"values": CHOSEN}, active_faces=ACTIVE), folder)
    recorded = experiment.run(tmp_path / "out", device=device).recording

    scene = wc.Scene()
    meshes = [
        wc.load_mesh(folder / "meshes" / "flat.obj", unit="mm"),
        wc.load_mesh(folder / "meshes" / "halves.obj", scale=0.002, repair="duplicate"),
        wc.meshes.grid((3, 3)),
    ]
    ground = scene.add_surface(meshes, active_faces=[None, "left", [0]], name="ground")
    ball = scene.add_body(1, [4e-3] * 3, (0.5, 0.3, 0.29), name="ball")
    centre = scene.add_point(ball, (0, 0, 0), name="centre")
    rubber = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(centre, ground, rubber, radius=0.1, name="touch")
    model = scene.build(envs=ENVS, device=device)
    model["ground.mesh"] = CHOSEN
    expected = wc.Simulation(model, dt=1e-3).run(0.02, record=["touch.gap", "touch.status"])
    for name in ("touch.gap", "touch.status", "ball.position"):
        np.testing.assert_array_equal(recorded[name].values, expected[name].values)
    # Hand values: the surfaces are at 0, 0.2 and 0 m, and the second is inactive at the ball: no gap.
    np.testing.assert_allclose(recorded["touch.gap"][0], [0.19, 0, 0.19, 0.19, 0, 0.19], atol=1e-6)
    status = recorded["touch.status"][0]
    assert status[CHOSEN.index(1)] == wc.ContactStatus.INACTIVE
    assert status[CHOSEN.index(0)] == wc.ContactStatus.OPEN


def test_mesh_index_can_be_a_value_a_list_or_sampled(folder):
    def chosen(choice, **changes):
        return wc.Experiment(content(choice=choice, **changes), folder).model(device="cpu")["ground.mesh"]

    assert chosen(None).tolist() == [0] * ENVS
    assert chosen({"value": 2}).tolist() == [2] * ENVS
    assert chosen({"values": CHOSEN}).tolist() == CHOSEN
    assert chosen({"linspace": [0, 2]}).tolist() == [0, 0, 1, 1, 2, 2]
    assert chosen({"linspace": [2, 1]}).tolist() == [2, 2, 2, 1, 1, 1]
    assert chosen({"linspace": [0, 2]}, envs=2).tolist() == [0, 2]
    assert chosen({"linspace": [1, 2]}, envs=1).tolist() == [1]
    counts = np.bincount(chosen({"linspace": [0, 2]}, envs=1000).astype(int))
    assert np.abs(counts - 1000 / 3).max() < 2
    many = chosen({"uniform": [0, 2]}, envs=3000)
    assert set(many) == {0.0, 1.0, 2.0}
    # 3000 samples of one in three: the standard deviation of the counts is about √(3000 · 1/3 · 2/3) = 26.
    assert np.abs(np.bincount(many.astype(int)) - 1000).max() < 4 * 26
    np.testing.assert_array_equal(chosen({"uniform": [0, 2]}, envs=100), many[:100])
    assert set(chosen({"uniform": [1, 1]})) == {1.0}


def test_results_store_meshes_and_mesh_index(folder):
    experiment = wc.Experiment(content(choice={"uniform": [0, 2]}, active_faces=ACTIVE, seed=3), folder)
    messages = []
    run = experiment.run(folder / "deep" / "out", device="cpu", on_warning=messages.append)
    assert any(text.startswith("note: mesh file 'meshes/halves.obj': duplicate: 1 face") for text in messages)
    assert json.loads(run.files["summary"].read_text())["warnings"] == messages
    stored = run.recording
    chosen = stored["ground.mesh"].values
    assert stored["ground.mesh"].dims == ("env",)
    assert len(set(chosen)) > 1

    # The saved experiment refers to its own copies of the files, and repeats the run bitwise.
    again = wc.Experiment.from_toml(run.files["experiment"])
    named = [mesh.file for mesh in again.settings.surface[0].mesh[:2]]
    assert named == ["../../meshes/flat.obj", "../../meshes/halves.obj"]
    assert again.settings.surface[0].active_faces == (True, ("left",), (0,))
    second = again.run(folder / "deep" / "again", device="cpu")
    assert second.files["experiment"].read_bytes() == run.files["experiment"].read_bytes()
    assert run.recording.identical(second.recording)
    shutil.move(folder / "deep", folder / "other")
    moved = wc.Experiment.from_toml(folder / "other" / "out" / "experiment.toml")
    assert moved.settings == again.settings

    # Each environment of the animation has its mesh, in exports by the run and later.
    later = wc.export_usd(
        wc.open_run(folder / "other" / "out").recording,
        folder / "later.usdc",
        envs=range(ENVS),
        scene=moved.scene(),
    )
    surface = experiment.scene().surfaces[0]
    for path in (folder / "other" / "out" / "animation.usdc", later):
        stage = Usd.Stage.Open(str(path))
        for env in range(ENVS):
            mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/World/env_{env}/Surfaces/ground"))
            which = int(chosen[env])
            np.testing.assert_allclose(mesh.GetPointsAttr().Get(), surface.meshes[which].vertices, atol=1e-6)


def test_constant_mesh_index_is_stored(folder):
    run = wc.Experiment(content(choice={"value": 1}), folder).run(folder / "out", device="cpu")
    assert run.recording["ground.mesh"].values.tolist() == [1] * ENVS
    stage = Usd.Stage.Open(str(run.files["animation"]))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Surfaces/ground"))
    assert len(mesh.GetFaceVertexCountsAttr().Get()) == 4


def test_repeated_mesh_is_loaded_once(folder):
    mesh = [MESHES[0], {"file": "meshes/flat.obj"}, MESHES[0]]
    experiment = wc.Experiment(content(mesh, active_faces=[[0], True, [1]]), folder)
    first, other, same = experiment.scene().surfaces[0].meshes
    assert first is same
    np.testing.assert_array_equal(other.vertices, 1000 * first.vertices)
    assert [active.tolist() for active in experiment.scene().surfaces[0].active] == [
        [True, False], [True, True], [False, True],
    ]  # fmt: skip


def test_list_of_one_mesh_is_one_mesh(folder):
    experiment = wc.Experiment(content(MESHES[:1], active_faces=[[1]]), folder)
    assert experiment.scene().surfaces[0].active_faces.tolist() == [False, True]
    run = experiment.run(folder / "out", device="cpu")
    assert wc.Experiment.from_toml(run.files["experiment"]).settings.surface[0].active_faces == ((1,),)


GRID = {"shape": "grid"}
BAD = [
    ({"mesh": []}, "surface[0].mesh must be a table or a list of tables, at least one, got []"),
    ({"mesh": 3}, "surface[0].mesh must be a table or a list of tables, got 3"),
    (
        {"mesh": [GRID, "b.stl"]},
        """surface[0].mesh[1] must be a table, got 'b.stl'; write { file = "b.stl" }""",
    ),
    ({"mesh": [GRID, "box"]}, "surface[0].mesh[1] must be a table, got 'box'; write { shape = 'box', … }"),
    ({"mesh": [GRID, [GRID]]}, "surface[0].mesh[1] must be a table, got [{'shape': 'grid'}]"),
    ({"mesh": [GRID, {"file": "no.stl"}]}, "surface[0].mesh[1].file: mesh file"),
    ({"mesh": [{"file": "meshes/halves.obj"}, GRID]}, "surface[0].mesh[0].file: mesh file"),
    ({"mesh": [GRID, GRID | {"sise": [1, 1]}]}, "surface[0].mesh[1].sise is not known; did you mean 'size'?"),
    ({"mesh": [GRID, {"shape": "gird"}]}, "surface[0].mesh[1].shape must be one of grid, "),
    ({"mesh": [GRID, GRID | {"size": [1, -1]}]}, "surface[0].mesh[1].size[1] must be a positive finite number"),
    ({"mesh": [MESHES[0], MESHES[0] | {"scale": 0}]}, "surface[0].mesh[1].scale must be greater than 0, got 0"),
    (
        {"active_faces": "left"},
        "surface[0].active_faces must be a list with one entry for each of the 3 meshes, got 'left'",
    ),
    (
        {"active_faces": [True, True]},
        "surface[0].active_faces must be a list with one entry for each of the 3 meshes, got 2",
    ),
    (
        {"active_faces": [True, "left", False]},
        "surface[0].active_faces[2] must be a list of face numbers, of names of groups, or of true and false",
    ),
    (
        {"active_faces": [[0, 9], True, True]},
        "surface[0].active_faces[0] must be face numbers from 0 to 1, got 9",
    ),
    (
        {"active_faces": [True, "middle", True]},
        "surface[0].active_faces[1] must be groups of the mesh (left, right), got 'middle'",
    ),
    ({"choice": {"value": 3}}, 'variation."ground.mesh".value must be at least 0 and at most 2, got 3'),
    ({"choice": {"value": 0.5}}, 'variation."ground.mesh".value must be a whole number, got 0.5'),
    ({"choice": {"value": True}}, 'variation."ground.mesh".value must be a number or a list of numbers, got True'),
    ({"choice": {"value": [0] * ENVS}}, 'variation."ground.mesh".value must have shape () or (1,), got (6,)'),
    ({"choice": {"values": [0, 1, 0.5, 0, 0, 0]}}, 'variation."ground.mesh"[2] must be a whole number, got 0.5'),
    ({"choice": {"values": [0, 1]}}, 'variation."ground.mesh".values must have one value for each of 6'),
    ({"choice": {"uniform": [-1, 1]}}, 'variation."ground.mesh".uniform[0] must be at least 0'),
    ({"choice": {"linspace": [0, 1.5]}}, 'variation."ground.mesh".linspace[1] must be a whole number, got 1.5'),
    (
        {"choice": {"normal": [1, 1]}},
        'variation."ground.mesh".normal gives no whole numbers; ground.mesh takes one of value, values, uniform, ',
    ),
    (
        {"mesh": GRID, "choice": {"value": 0}},
        "variation.\"ground.mesh\" is not the name of a parameter: 'ground' has one mesh; give it several as",
    ),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=[message[:60] for _, message in BAD])
def test_invalid_mesh_list_is_reported_with_its_key(changes, message, folder):
    problems = problems_of(content(**changes), folder)
    assert any(problem.startswith(message) for problem in problems), problems
    assert len(problems) == 1, problems


def test_invalid_meshes_are_all_reported(folder):
    mesh = [{"file": "a.stl"}, GRID, {"file": "meshes/halves.obj"}]
    first, second = problems_of(content(mesh), folder)
    assert first.startswith("surface[0].mesh[0].file: mesh file")
    assert second.startswith("surface[0].mesh[2].file: mesh file")
    # Active faces of an unreadable mesh are not reported as a second problem.
    (problem,) = problems_of(content([GRID, 5], active_faces=["left"]), folder)
    assert problem.startswith("surface[0].mesh[1] must be a table")
