"""Point sets from meshes and surface contact in experiment files."""

import numpy as np
import pytest
from test_experiment_errors import problems_of

import warpcontact as wc


def content(**changes):
    """A meshed ball on a plate, and two pins of the ball that are part of a surface."""
    given = {
        "envs": 2,
        "duration": 0.002,
        "dt": 1e-4,
        "precision": "float64",
        "gravity": [0, 0, 0],
        "body": [{"name": "ball", "mass": 1, "inertia": [1e-3] * 3, "position": [0, 0, 0.046]}],
        "surface": [
            {"name": "ground", "mesh": {"shape": "grid", "size": [0.06, 0.06]}},
            {
                **{"name": "skin", "body": "ball", "position": [0, 0, 0.01]},
                "mesh": {"shape": "icosphere", "radius": 0.05, "subdivisions": 2},
            },
        ],
        "material": [{"name": "bed", "law": {"type": "ElasticFoundation", "stiffness": 1e8}}],
        "surface_contact": [
            {
                **{"name": "press", "surface_a": "skin", "surface_b": "ground", "material": "bed"},
                **{"samples": ["vertices", 40], "sides": "average", "seed": 5, "kappa": 0.25},
            }
        ],
        "points": [
            {"name": "dots", "surface": "skin", "samples": 30, "seed": 2},
            {"name": "middles", "surface": "skin", "samples": "centroids"},
            {"name": "pins", "surface": "skin", "positions": [[0, 0, -0.05], [0, 0, 0]], "areas": [1e-4, 1e-4]},
        ],
        "point": [{"name": "pole", "surface": "skin", "position": [0, 0, -0.05]}],
        "contact": [{"name": "prick", "points": "pins", "surface": "ground", "material": "bed"}],
        "variation": {
            "press_first.force_scale": {"values": [0.5, 1.0]},
            "skin.position": {"values": [[0, 0, 0]] * 2},
        },
        "record": {"sensors": ["press_first.normal_force", "press_second.normal_force", "prick.gap"]},
    }
    return given | changes


def test_surface_contact_in_experiment_equals_python_api(tmp_path):
    experiment = wc.Experiment(content())
    scene = wc.Scene(gravity=(0, 0, 0))
    ball = scene.add_body(1, [1e-3] * 3, (0, 0, 0.046), name="ball")
    ground = scene.add_surface(wc.meshes.grid((0.06, 0.06)), name="ground")
    skin = scene.add_surface(wc.meshes.icosphere(0.05, 2), ball, name="skin")
    bed = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e8))
    scene.add_surface_contact(
        skin, ground, bed, samples=("vertices", 40), sides="average", seed=5, kappa=0.25, name="press"
    )
    model = scene.build(envs=2, device="cpu", precision="float64")
    made = experiment.model(device="cpu")
    for name in ("press_first.normal_force", "press_second.normal_force", "press_first.point", "press_second.gap"):
        expected = model.sensor(name)
        if name == "press_first.normal_force":
            assert expected.max() > 1.0
            expected[1] *= 2.0  # its area weight varies
        np.testing.assert_allclose(made.sensor(name), expected, rtol=1e-12)
    run = experiment.run(tmp_path / "out", device="cpu")
    assert run.recording["press_second.normal_force"].sizes["press_second.item"] == 40
    # The saved experiment is equal.
    assert wc.Experiment.from_toml(run.files["experiment"]).settings == experiment.settings


def test_surface_points_in_experiment_equal_sample_surface():
    scene = wc.Experiment(content()).scene()
    found = {points.name: points for points in scene.points}
    mesh = scene.surfaces[1].mesh
    samples = wc.sample_surface(mesh, 30, seed=2)
    np.testing.assert_array_equal(found["dots"].positions, samples.positions)
    np.testing.assert_array_equal(found["dots"].areas, samples.areas)
    assert found["dots"].surface is scene.surfaces[1]
    assert len(found["middles"].positions) == len(mesh.faces)
    np.testing.assert_array_equal(found["pins"].areas, [1e-4, 1e-4])
    # In the frame of the mesh, 1 cm above that of the ball.
    np.testing.assert_allclose(found["pole"].places, [[0, 0, -0.04]], atol=1e-15)


PRESS = content()["surface_contact"][0]
BAD = [
    (
        {"points": [{"name": "p", "body": "ball"}]},
        "points[0] must have exactly one of positions and samples; got none",
    ),
    (
        {"points": [{"name": "p", "surface": "skin", "samples": 3, "positions": [[0, 0, 0]]}]},
        "points[0] must have exactly one of positions and samples; got both",
    ),
    (
        {"points": [{"name": "p", "body": "ball", "samples": 3}]},
        "points[0].surface is missing: samples are taken on a surface",
    ),
    (
        {"points": [{"name": "p", "body": "ball", "surface": "skin", "positions": [[0, 0, 0]]}]},
        "points[0] must be on a body or on a surface, got 'ball' and 'skin'",
    ),
    ({"points": [{"name": "p", "positions": [[0, 0, 0]], "seed": 3}]}, "points[0].seed requires samples"),
    (
        {"points": [{"name": "p", "surface": "skin", "samples": 3, "areas": [1, 1, 1]}]},
        "points[0].areas must be left out: samples have their own",
    ),
    (
        {"points": [{"name": "p", "positions": [[0, 0, 0]], "areas": [-1]}]},
        "points[0].areas[0] must be greater than 0",
    ),
    ({"points": [{"name": "p", "positions": [[0, 0, 0]], "areas": [1, 1]}]}, "points[0].areas must be 1 numbers"),
    (
        {"points": [{"name": "p", "surface": "skni", "samples": 3}]},
        "points[0].surface must be the name of a surface, got 'skni'; did you mean 'skin'?",
    ),
    (
        {"points": [{"name": "p", "surface": "skin", "samples": "poisson"}]},
        "points[0].samples must be a whole number of points, at least 1, or 'vertices' or 'centroids'",
    ),
    (
        {"surface_contact": [PRESS | {"samples": [5, 0]}]},
        "surface_contact[0].samples[1] must be a whole number of points, at least 1, or 'vertices' or 'centroids'",
    ),
    (
        {"surface_contact": [PRESS | {"samples": [1, 2, 3]}]},
        "surface_contact[0].samples must be one entry or two, one for each surface, got [1, 2, 3]",
    ),
    (
        {"surface_contact": [PRESS | {"sides": "first"}]},
        "surface_contact[0].samples must be one entry, or with sides='average' two",
    ),
    (
        {"surface_contact": [PRESS | {"sides": "both"}]},
        "surface_contact[0].sides must be one of 'first', 'average'",
    ),
    (
        {"surface_contact": [PRESS | {"surface_b": "skin"}]},
        "surface_contact[0]: press_first: points and surface are both fixed to body 'ball'",
    ),
    (
        {"surface_contact": [PRESS | {"surface_b": "floor"}]},
        "surface_contact[0].surface_b must be the name of a surface",
    ),
    (
        {"surface_contact": [PRESS | {"force_scale": -1}]},
        "surface_contact[0].force_scale must be at least 0, got -1",
    ),
    (
        {"points": [], "contact": [{"name": "prick", "points": "pole", "surface": "ground", "material": "bed"}]},
        "contact[0]: the law of its material, ElasticFoundation, was given no area [m²], and the points",
    ),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=[message[:50] for _, message in BAD])
def test_invalid_surface_contact_is_reported_with_its_key(changes, message):
    base = {} if "surface_contact" in changes or "contact" in changes else {"contact": [], "record": {}}
    problems = problems_of(content(**base | {"variation": {}, "record": {"sensors": []}} | changes))
    assert any(problem.startswith(message) for problem in problems), problems
    assert len(problems) == 1, problems


def test_elements_of_an_invalid_contact_cause_no_second_problem():
    problems = problems_of(content(surface_contact=[PRESS | {"sides": "both"}]))
    assert len(problems) == 1, problems
