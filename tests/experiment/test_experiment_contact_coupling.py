"""Contact couplings in experiment files, in recordings and in animations."""

import numpy as np
import pytest
from recorded_usd_scene import arrows
from test_experiment_errors import problems_of

import warpcontact as wc
from warpcontact.experiment.sensor_panels import make_panels

IMPACT = {"mass": 50, "area": 0.06, "speed": 1.5, "effective_range": 0.02, "closest": 0.005, "damping_ratio": 0.05}
COUPLING = {
    **{"name": "keep", "surface_a": "hull", "surface_b": "quay", "range": {"from_impact": IMPACT}},
    **{"friction": {"type": "Tanh", "mu": 0.3}, "sides": "average", "quadrature": 3, "damping_ramp": 0.001},
}
SENSORS = ["keep.force", "keep.effective_area", "keep.minimum_distance"]
LINES = ["keep_first.point", "keep_first.normal", "keep_first.normal_force", "keep_first.friction_force"]


def content(**changes):
    """A block that falls flat onto a quay of its size."""
    given = {
        "envs": 2,
        "duration": 0.02,
        "dt": 5e-4,
        "precision": "float64",
        "gravity": [0, 0, 0],
        "body": [
            {
                **{"name": "block", "mass": 50, "inertia": [1, 1, 1]},
                **{"position": [0, 0, 0.121], "linear_velocity": [0.3, 0, -1.5]},
            }
        ],
        "surface": [
            {"name": "quay", "mesh": {"shape": "grid", "size": [0.3, 0.2]}},
            {"name": "hull", "body": "block", "mesh": {"shape": "box", "size": [0.3, 0.2, 0.2]}},
        ],
        "contact_coupling": [COUPLING],
        "variation": {"keep.k1": {"values": [1e7, 2e7]}, "keep.friction.mu": {"linspace": [0.1, 0.2]}},
        "record": {"every": 0.002, "sensors": [*SENSORS, *LINES]},
    }
    return given | changes


def test_contact_coupling_in_experiment_equals_python_api(tmp_path):
    experiment = wc.Experiment(content())
    scene = wc.Scene(gravity=(0, 0, 0))
    quay = scene.add_surface(wc.meshes.grid((0.3, 0.2)), name="quay")
    block = scene.add_body(50, [1] * 3, (0, 0, 0.121), linear_velocity=(0.3, 0, -1.5), name="block")
    hull = scene.add_surface(wc.meshes.box((0.3, 0.2, 0.2)), block, name="hull")
    coupling = scene.add_contact_coupling(
        *(hull, quay, wc.ContactRange.from_impact(**IMPACT), wc.friction.Tanh(mu=0.3)),
        **{"sides": "average", "quadrature": 3, "damping_ramp": 0.001, "name": "keep"},
    )
    model = scene.build(envs=2, device="cpu", precision="float64")
    model["keep.k1"], model["keep.friction.mu"] = [1e7, 2e7], [0.1, 0.2]
    recording = wc.Simulation(model, dt=5e-4).run(0.02, record=SENSORS, every=0.002)
    run = experiment.run(tmp_path / "out", device="cpu")
    for name in SENSORS:
        np.testing.assert_array_equal(run.recording[name].values, recording[name].values)
    assert coupling.report(model).in_range.all()
    assert np.abs(recording["keep.force"].values).max() > 1000.0
    # The picture shows its force, because the coupling has no scalar sensor.
    without = run.recording.drop_vars(LINES)
    without.scene = run.recording.scene
    panel = make_panels(without, np.zeros(0, dtype=int), 2)[0]
    assert (panel.heading, panel.curves.unit) == ("magnitude of keep.force", "N")
    np.testing.assert_allclose(panel.curves.values, np.linalg.norm(recording["keep.force"], axis=-1))
    # The saved experiment is equal.
    assert wc.Experiment.from_toml(run.files["experiment"]).settings == experiment.settings


def test_animation_has_coupling_forces_at_faces(tmp_path):
    from pxr import Usd, UsdGeom
    from scipy.spatial.transform import Rotation

    run = wc.Experiment(content()).run(tmp_path / "out", device="cpu")
    stage = Usd.Stage.Open(str(run.files["animation"]))
    frame = int(np.argmax(run.recording["keep.force"].sel(axis="z", env=1).values))
    code = frame * stage.GetTimeCodesPerSecond() * 0.002
    start, force = arrows(stage, "/World/env_1/contacts/keep_first/force", code)
    # From the points of the faces, for any position of the other surface.
    now = run.recording.isel(time=frame, env=1)
    place, turn = now["block.position"].values, Rotation.from_quat(now["block.orientation"].values)
    points = next(points for points in run.recording.scene.points if points.name == "keep_first_points")
    pushed = np.isfinite(force[:, 2])
    assert pushed.sum() == 6  # lower side, three points on each face
    assert (force[pushed, 2] > 0.0).all()
    np.testing.assert_allclose(start[pushed], (turn.apply(points.positions) + place)[pushed], atol=1e-6)
    total = stage.GetPrimAtPath("/World/env_1/contacts/keep")
    (minimum,) = [
        one
        for one in total.GetAttributes()
        if one.GetCustomDataByKey("warpcontact:name") == "keep.minimum_distance"
    ]
    assert minimum.Get(code) == pytest.approx(
        run.recording["keep.minimum_distance"].isel(time=frame, env=1).item()
    )
    # The range of a face is not drawn as a sphere.
    assert not any(prim.IsA(UsdGeom.Sphere) for prim in stage.Traverse())


def test_custom_friction_of_coupling_is_used_and_copied(tmp_path):
    (tmp_path / "own.py").write_text(
        "from typing import Any\nimport warp as wp\nimport warpcontact as wc\n\n\n"
        "class Felt(wc.Friction):\n    drag: float = wc.parameter('s/m', 'drag')\n\n"
        "    @wp.func\n    def force(p: Any, s: Any):\n        return (-p.drag * s.normal_force) * s.velocity\n"
    )
    table = COUPLING | {"friction": {"type": "own.py:Felt", "drag": 2.0}}
    given = content(contact_coupling=[table], variation={})
    run = wc.Experiment(given, folder=tmp_path).run(tmp_path / "out", device="cpu")
    assert np.abs(run.recording["keep.force"].sel(axis="x").values).max() > 100.0
    assert wc.Experiment.from_toml(run.files["experiment"]).settings.contact_coupling[0].friction.drag == 2.0
    assert (tmp_path / "out" / "own.py").exists()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"range": {"k1": 1e6}}, "contact_coupling[0].range.effective_range is missing, or from_impact = { … }"),
        (
            {"range": {"k1": 0, "effective_range": 1}},
            "contact_coupling[0].range.k1 must be greater than 0, got 0 N/m³",
        ),
        (
            {"range": {"k1": 1e6, "from_impact": IMPACT}},
            "contact_coupling[0].range.k1 must be left out: from_impact determines it",
        ),
        ({"range": {"k3": 1e6}}, "contact_coupling[0].range.k3 is not known; allowed: k1, k2"),
        ({"range": 3}, "contact_coupling[0].range must be a table, got 3"),
        (
            {"range": {"from_impact": {key: IMPACT[key] for key in IMPACT if key != "area"}}},
            "contact_coupling[0].range.from_impact.area is missing: of the contact [m²]",
        ),
        (
            {"range": {"from_impact": IMPACT | {"closest": 0.03}}},
            "contact_coupling[0].range.from_impact.closest must be less than effective_range = 0.02 m, got 0.03 m",
        ),
        (
            {"range": {"from_impact": IMPACT | {"weight": 1}}},
            "contact_coupling[0].range.from_impact.weight is not known",
        ),
        ({"facing": "some"}, "contact_coupling[0].facing must be one of 'projected', 'all'"),
        (
            {"quadrature": 4},
            "contact_coupling[0].quadrature must be a number of points per face, one of 1, 3, 6, 7",
        ),
        ({"friction": {"type": "Tanhh"}}, "contact_coupling[0].friction.type must be one of"),
        (
            {"friction": {"type": "Tanh", "mu": 1, "my": 1}},
            "contact_coupling[0].friction.my is not known; allowed: type, mu, velocity_scale",
        ),
        (
            {"surface_b": "quai"},
            "contact_coupling[0].surface_b must be the name of a surface, got 'quai'; did you mean",
        ),
        (
            {"surface_a": "quay", "surface_b": "hull"},
            "contact_coupling[0].surface_a must be on a body, got 'quay' on the world",
        ),
        ({"material": "wood"}, "contact_coupling[0].material is not known"),
    ],
)
def test_invalid_contact_coupling_is_reported_with_its_key(changes, problem):
    given = content(contact_coupling=[COUPLING | changes], variation={}, record={})
    (found,) = problems_of(given)
    assert found.startswith(problem)


def test_invalid_contact_coupling_causes_no_unknown_name_problem():
    (problem,) = problems_of(content(contact_coupling=[COUPLING | {"facing": "some"}]))
    assert problem.startswith("contact_coupling[0].facing")


def test_coupling_report_does_not_depend_on_shards(tmp_path):
    changes = {
        "envs": 3,
        "variation": {"block.linear_velocity": {"values": [[0, 0, -0.5], [0, 0, 1.0], [0, 0, -2.5]]}},
    }
    runs = [
        wc.Experiment(content(**changes)).run(tmp_path / str(shard), device="cpu", shard=shard)
        for shard in (None, 2)
    ]
    for run in runs:
        run_text = str(run)
        assert "keep: 2 of 3 environments came into range" in run_text
        assert "passed the closest distance of 0.005 m: in environment 2" in run_text
        assert run.summary["contact_couplings"]["keep"][0] == "keep: 2 of 3 environments came into range"
        (report,) = run.reports
        assert report.in_range.tolist() == [True, False, True]
        assert report.passed.tolist() == [False, False, True]
    whole, in_shards = (run.reports[0] for run in runs)
    for name in ("effective_area", "minimum_distance", "effective_range"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(in_shards, name))
