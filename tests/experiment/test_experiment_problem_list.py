"""Problems of experiments are reported in one message, including those of files, meshes and overrides."""

import numpy as np
import pytest
from test_experiment_errors import GROUND, LAW, VALID_STUDY, invalid_study, problems_of

import warpcontact as wc


def test_experiment_problems_are_all_reported():
    content = invalid_study(
        (("dt",), "fast"),
        (("body", 0, "mass"), -1),
        (("body", 0, "positon"), [0, 0, 0]),
        ((*LAW, "type"), "HuntCrosley"),
        (("contact", 0, "radius"), -0.1),
        (("surface", 1), {"name": "wall", "mesh": {"file": "no.stl"}, "body": "nobody"}),
        (("body", 1), {"name": "other", "mass": 1, "inertia": [1, 1, 1]}),
        (("contact", 1), {"name": "second", "points": "hul", "surface": "groun", "material": "rubber"}),
        (("variation", "other.mas"), {"uniform": [1, 2]}),
        (("variation", "ball.orientation"), {"uniform": [0]}),
        (("variation", "other.mass"), {"values": [1, 2]}),
    )
    found = problems_of(content)
    begins = [
        "dt must be a number",
        "body[0].mass must be greater",
        "body[0].positon is not known",
        "material[0].law.type must be one of",
        "contact[0].radius must be at least 0",
        "surface[1].mesh.file: mesh file",
        "surface[1].body must be the name of a body",
        "contact[1].points must be the name of a point",
        "contact[1].surface must be the name of a surface",
        'variation."other.mas" is not the name',
        'variation."ball.orientation".uniform must be two numbers',
        'variation."other.mass".values must have one value for each of 3',
    ]
    missed = [begin for begin in begins if not any(problem.startswith(begin) for problem in found)]
    assert not missed, found
    # A reference to an element with problems is not a problem.
    assert len(found) == len(begins), found


def test_references_of_an_entry_with_other_problems_are_reported():
    content = invalid_study(
        (("contact", 0, "radius"), -1),
        (("contact", 0, "raduis"), 1),
        (("contact", 0, "points"), "center"),
        (("contact", 0, "material"), 3),
        (("points", 0, "seed"), "x"),
        (("points", 0, "body"), "bal"),
    )
    content["particle_contact"] = [
        {"name": "pile", "shapes": ["no"], "exclude": [["no", "none"]], "material": "r", "x": 1}
    ]
    found = problems_of(content)
    begins = [
        "contact[0].radius must be at least 0",
        "contact[0].raduis is not known",
        "contact[0].points must be the name of a point, got 'center'; did you mean 'centre'?",
        "contact[0].material must be a text",
        "points[0].seed must be a whole number",
        "points[0].body must be the name of a body, got 'bal'; did you mean 'ball'?",
        "particle_contact[0].x is not known",
        "particle_contact[0].shapes[0] must be the name of a shape, got 'no'",
        "particle_contact[0].exclude[0][1] must be the name of a shape, got 'none'",
        "particle_contact[0].material must be the name of a material, got 'r'",
    ]
    missed = [begin for begin in begins if not any(problem.startswith(begin) for problem in found)]
    assert not missed, found
    # The other one is exclude[0][0].
    assert len(found) == len(begins) + 1, found


def test_reference_to_an_unnamed_entry_is_no_additional_problem():
    content = invalid_study(
        (("body", 1), {"mass": 1, "inertia": [1, 1, 1]}), (("record", "sensors"), ["box.position"])
    )
    content["variation"]["box.mass"] = {"solid_sphere": {"mass": "box.mass", "radius": 1}}
    content["surface"][0]["body"] = "box"
    assert problems_of(content) == ("body[1].name is missing",)


def test_error_message_lists_problems_under_the_source():
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict(invalid_study((("dt",), 0), (("body", 0, "mass"), 0)))
    assert str(caught.value).splitlines() == [
        "experiment has 2 problems:",
        "  - dt must be greater than 0, got 0 s",
        "  - body[0] ('ball').mass must be greater than 0, got 0 kg",
    ]
    assert caught.value.source == "experiment"


def test_error_message_is_limited_to_40_problems():
    bodies = [{"name": f"b{i}", "mass": -1, "inertia": [1, 1, 1]} for i in range(200)]
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict(invalid_study((("body",), [*VALID_STUDY["body"], *bodies])))
    assert len(caught.value.problems) == 200
    assert str(caught.value).splitlines()[-1] == "  … and 160 more"


def test_mesh_file_defects_are_reported_with_the_key(tmp_path):
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n")
    (problem,) = problems_of(invalid_study(((*GROUND, "mesh"), {"file": "bad.obj"})), tmp_path)
    assert problem.startswith("surface[0].mesh.file: mesh file ")
    assert "degenerate" in problem
    assert "out of index range" in problem


def test_face_without_area_in_float32_is_reported_with_its_surface(tmp_path):
    corners = ((999999, 0), (999999.001, 0), (999999, 0.001), (0, 0), (1, 0), (0, 1))
    far = "".join(f"v {x} {y} 0\n" for x, y in corners)
    (tmp_path / "far.obj").write_text(far + "f 1 2 3\nf 4 5 6\n")
    (problem,) = problems_of(invalid_study(((*GROUND, "mesh"), {"file": "far.obj"})), tmp_path)
    assert problem.startswith("surface[0]: face 0 ")


def test_numpy_values_are_accepted():
    content = invalid_study((("body", 0, "mass"), np.float32(2.0)), (("body", 0, "position"), np.arange(3)))
    body = wc.Experiment.from_dict(content).scene().bodies[0]
    assert body.mass == 2.0
    assert body.position.tolist() == [0.0, 1.0, 2.0]


def test_overrides_are_checked_like_file_values(tmp_path):
    experiment = wc.Experiment.from_dict(VALID_STUDY)
    for options, message in (
        ({"envs": 0}, "envs must be at least 1, got 0"),
        ({"envs": 2.5}, "envs must be a whole number, got 2.5"),
        ({"duration": -1}, "duration must be greater than 0, got -1 s"),
        ({"duration": 1e-3}, "record.every must be at most the duration"),
        ({"device": "cuda:99"}, "device must be 'auto' or one of"),
    ):
        with pytest.raises(wc.ExperimentError, match=message):
            experiment.run(tmp_path / "out", **options)
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dt = 1\nenvs = \n", "line 2, column 8: Invalid value"),
        ("dt = 1\n[[body]\n", "line 2"),
        ("dt = 1\ndt = 2\n", "line 2"),
        ("dt == 1\n", "line 1, column 5"),
        ("dt = [1,\n", "document"),
        ("a = " + "[" * 100_000, "too deeply"),
    ],
)
def test_syntax_error_is_reported_with_its_line(tmp_path, text, message):
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_toml(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


def test_unreadable_experiment_file_is_reported(tmp_path):
    with pytest.raises(wc.ExperimentError, match=r"none\.toml: there is no such file"):
        wc.Experiment.from_toml(tmp_path / "none.toml")
    with pytest.raises(wc.ExperimentError, match="cannot be read"):
        wc.Experiment.from_toml(tmp_path)
    (tmp_path / "latin.toml").write_bytes("name = 'Kübel'".encode("latin-1"))
    with pytest.raises(wc.ExperimentError, match="byte 9 is not UTF-8"):
        wc.Experiment.from_toml(tmp_path / "latin.toml")
