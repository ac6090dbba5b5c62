"""Experiments equal the same script, leave complete results, and repeat the same samples."""

import dataclasses
import inspect
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import warpcontact as wc
from warpcontact.experiment.catalogue import SHAPES
from warpcontact.experiment.observation import default_sensors
from warpcontact.experiment.schema import BodySettings, ContactSettings, SurfaceSettings
from warpcontact.geometry import query_mesh

pytestmark = pytest.mark.installed

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "terrain_drop.toml"


def content(**changes):
    """A small valid experiment: a sphere above a square."""
    return {
        "envs": 4,
        "duration": 0.02,
        "dt": 1.0e-3,
        "surface": [{"name": "ground", "mesh": {"shape": "grid", "size": [4.0, 4.0]}}],
        "body": [{"name": "ball", "mass": 1.0, "inertia": [4.0e-3] * 3, "position": [0.0, 0.0, 0.105]}],
        "point": [{"name": "centre", "body": "ball", "position": [0, 0, 0]}],
        "material": [{"name": "rubber", "law": {"type": "Hooke", "stiffness": 1.0e4}}],
        "contact": [
            {"name": "touch", "points": "centre", "surface": "ground", "material": "rubber", "radius": 0.1}
        ],
        "record": {"sensors": ["touch.gap"]},
    } | changes


def small_example():
    return wc.Experiment.from_toml(EXAMPLE).changed(envs=3, duration=0.06)


@pytest.mark.parametrize("flip", [False, True])
def test_experiment_check_reuses_loaded_meshes_for_the_first_model(flip, monkeypatch):
    made = []
    for name in ("make_query_mesh", "build_bvh"):
        function = getattr(query_mesh, name)

        def counted(*args, name=name, function=function, **options):
            made.append(name)
            return function(*args, **options)

        monkeypatch.setattr(query_mesh, name, counted)
    described = content()
    described["surface"][0]["flip"] = flip
    experiment = wc.Experiment.from_dict(described)
    assert sorted(made) == ["build_bvh", "make_query_mesh"]
    experiment.model(device="cpu")
    assert len(made) == 2
    # The file cache is kept for one experiment; among derived experiments, for the last one.
    experiment.model(device=["cpu", "cpu"])
    assert sorted(made) == ["build_bvh"] * 2 + ["make_query_mesh"] * 2
    for envs in (2, 3):
        experiment.changed(envs=envs)
    assert len(experiment._file_cache.query_meshes) == 1


@pytest.mark.smoke
def test_example_writes_complete_results(device, tmp_path):
    run = small_example().run(tmp_path / "out", device=device)
    assert {path.name for path in run.files.values()} == {path.name for path in run.folder.iterdir()}
    assert run.health.good
    stored = wc.open_run(run.folder).recording
    assert stored["touch.gap"].dims == ("time", "env")
    assert stored["touch.gap"].shape == (4, 3)
    np.testing.assert_array_equal(stored["ball.position"].values, run.recording["ball.position"].values)
    assert list(stored["axis"].values) == ["x", "y", "z"]
    assert stored["ball.mass"].dims == ("env",)
    assert stored["ball.mass"].attrs["units"] == "kg"
    assert stored["ball.position.initial"].dims == ("env", "axis")
    np.testing.assert_allclose(stored["ball.position.initial"], stored["ball.position"][0], rtol=1e-6)
    assert run.files["picture"].read_bytes().startswith(b"\x89PNG")
    summary = json.loads(run.files["summary"].read_text())
    assert summary["state"] == "finished"
    assert (summary["envs"], summary["steps"], summary["seed"]) == (3, 300, 1)
    assert summary["duration"] == 0.06  # as given, without the rounding of a sum of steps
    assert all(str(path) in str(run) for path in run.files.values())


def test_example_animation_has_the_requested_environments(device, tmp_path):
    from pxr import Usd

    run = wc.Experiment(content(output={"usd_envs": 2})).run(tmp_path / "out", device=device)
    stage = Usd.Stage.Open(str(run.files["animation"]))
    assert stage.GetPrimAtPath("/World/env_1/ball")
    assert not stage.GetPrimAtPath("/World/env_2")
    without = wc.Experiment(content(output={"usd_envs": 0})).run(tmp_path / "none", device=device)
    assert "animation" not in without.files


def test_written_experiment_repeats_the_run(device, tmp_path):
    first = small_example().run(tmp_path / "first", device=device)
    again = wc.Experiment.from_toml(first.files["experiment"])
    assert again.settings == small_example().settings
    second = again.run(tmp_path / "second", device=device)
    assert second.files["experiment"].read_bytes() == first.files["experiment"].read_bytes()
    assert first.recording.identical(second.recording)


def test_example_spheres_gain_no_energy_and_stay_above_the_ground(device, tmp_path):
    data = wc.Experiment.from_toml(EXAMPLE).run(tmp_path, envs=64, device=device).recording
    assert np.abs(data["ball.position"].values[..., :2]).max() < 8.0  # the terrain ends there
    assert (data["touch.gap"] > -0.6 * data["touch.radius"]).all()
    energy = (data["scene.kinetic_energy"] + data["scene.potential_energy"]).values
    flying = data["touch.status"].values == wc.ContactStatus.OPEN
    for env in range(64):
        flights = energy[flying[:, env], env]
        # float32 holds 3 J to 2e-7 J; any bounce loses more than one percent.
        assert (np.diff(flights) < 0.01 * flights[0]).all()
    assert np.median(energy[-1]) < 0.2 * np.median(energy[0])


def test_experiment_equals_equivalent_script_bitwise(device, tmp_path):
    varied = {"ball.linear_velocity": {"uniform": [[0, 0, -2], [0, 0, -1]]}}
    friction = {"type": "Tanh", "mu": 0.3}
    raw = content(variation=varied, material=[{**content()["material"][0], "friction": friction}])
    recorded = wc.Experiment(raw).run(tmp_path / "out", device=device).recording

    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid(size=(4.0, 4.0)), name="ground")
    ball = scene.add_body(mass=1.0, inertia=[4.0e-3] * 3, position=(0.0, 0.0, 0.105), name="ball")
    centre = scene.add_point(ball, (0, 0, 0), name="centre")
    rubber = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0e4), friction=wc.friction.Tanh(mu=0.3))
    scene.add_contact(centre, ground, rubber, radius=0.1, name="touch")
    model = scene.build(envs=4, device=device)
    model["ball.linear_velocity"] = recorded["ball.linear_velocity.initial"].values
    expected = wc.Simulation(model, dt=1.0e-3).run(0.02, record=["touch.gap"])
    assert (expected["touch.gap"].values < 0.0).any()
    # Bitwise identical: compiling before the run has no effect on results.
    np.testing.assert_array_equal(recorded["touch.gap"].values, expected["touch.gap"].values)


def test_repr_of_experiment_and_model_summarizes_them(device):
    experiment = wc.Experiment.from_toml(EXAMPLE).changed(envs=1, duration=0.06)
    assert repr(experiment) == "<Experiment terrain drop: 1 environment × 0.06 s, dt = 0.0002 s>"
    assert repr(experiment.model(device=device)).startswith("<Model of 1 environment: ")


def test_experiment_defaults_equal_python_api():
    for settings, function in (
        (SurfaceSettings, wc.Scene.add_surface),
        (BodySettings, wc.Scene.add_body),
        (ContactSettings, wc.Scene.add_contact),
    ):
        parameters = inspect.signature(function).parameters
        assert set(settings.model_fields) <= set(parameters) | {"material"}
        for name, field in settings.model_fields.items():
            if name != "name" and not field.is_required():
                default = parameters[name].default
                # TOML has no infinity in this schema: the key is omitted.
                assert field.default == (None if default == np.inf else default), name
    assert wc.Experiment(content()).settings.gravity == tuple(wc.Scene().gravity)


def within(limits):
    """A number within limits, the same for most."""
    low = max(limits["above"], limits["at_least"])
    if limits["above"] < 0.5 < limits["at_most"] and limits["at_least"] <= 0.5:
        return 0.5
    return 0.5 * (low + limits["at_most"]) if np.isfinite(limits["at_most"]) else low + 1.0


@pytest.mark.parametrize("kind", [*wc.laws.CATALOGUE, *wc.friction.CATALOGUE], ids=lambda kind: kind.__name__)
def test_every_law_and_friction_can_be_used_in_an_experiment(kind):
    optional = set(kind.exactly_one_of[1:])
    values = {
        field.name: within(kind.limits(field.name))
        for field in dataclasses.fields(kind)
        if field.name not in optional
    }
    part = "law" if kind in wc.laws.CATALOGUE else "friction"
    material = content()["material"][0] | {part: {"type": kind.__name__, **values}}
    scene = wc.Experiment(content(material=[material])).scene()
    assert getattr(scene.contacts[0].material, part) == kind(**values)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_generated_mesh_can_be_used_in_an_experiment(shape):
    scene = wc.Experiment(content(surface=[{"name": "ground", "mesh": {"shape": shape}}])).scene()
    np.testing.assert_array_equal(scene.surfaces[0].mesh.vertices, SHAPES[shape]().vertices)


def test_mesh_paths_are_relative_to_the_experiment_file_and_its_copy(tmp_path):
    triangle = "v 0 0 0\nv 1000 0 0\nv 0 1000 0\nf 1 2 3\n"
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "corner.obj").write_text(triangle)
    (tmp_path / "study.toml").write_text(
        'duration = 0.01\ndt = 0.001\n[[body]]\nname = "b"\nmass = 1\ninertia = [1, 1, 1]\n'
        '[[surface]]\nname = "s"\nmesh = { file = "meshes/corner.obj", scale = 0.001 }\n'
    )
    experiment = wc.Experiment.from_toml(tmp_path / "study.toml")
    assert experiment.settings.name == "study"
    np.testing.assert_array_equal(experiment.scene().surfaces[0].mesh.bounds[1], (1.0, 1.0, 0.0))
    run = experiment.run(tmp_path / "deep" / "results", device="cpu")
    written = tomllib.loads(run.files["experiment"].read_text())
    assert written["surface"][0]["mesh"]["file"] == "../../meshes/corner.obj"
    assert wc.Experiment.from_toml(run.files["experiment"]).scene().surfaces[0].mesh.report.face_count == 1


def test_every_experiment_key_round_trips(tmp_path):
    raw = content(
        name='a "quoted" \\ name with ü',
        precision="float64",
        body=[
            *content()["body"],
            {"name": "table", "mass": 2, "inertia": [[2, 0.1, 0], [0.1, 2, 0], [0, 0, 2]], "color": [0, 0.5, 1]},
        ],
        surface=[
            {"name": "ground", "mesh": {"shape": "grid"}, "body": "table", "active_faces": [1], "flip": True},
            {"name": "roof", "mesh": {"shape": "grid"}, "active_faces": [True, False], "visible": False},
        ],
        points=[{"name": "corners", "body": "ball", "positions": [[0, 0, 1], [1, 0, 0]]}],
        contact=[
            *content()["contact"],
            {
                **{"name": "edge", "points": "corners", "surface": "roof", "material": "rubber", "kappa": 1},
                **{
                    "search": "active",
                    "entry": "latched",
                    "max_depth": 0.1,
                    "boundary": "outer",
                    "search_radius": 2,
                },
                "enabled": False,
            },
        ],
        variation={
            "ball.mass": {"loguniform": [0.1, 10]},
            "ball.inertia": {"solid_sphere": {"mass": "ball.mass", "radius": 0.1}},
            "touch.law.stiffness": {"values": [1e3, 2e3, 3e3, 4e3]},
            "ball.angular_velocity": {"normal": [[0, 0, 0], [1, 1, 0]]},
            "edge.radius": {"linspace": [0, 0.1]},
            "corners.position": {"uniform": [[[0, 0, 0], [1, 1, 1]], [[0, 0, 1], [1, 1, 2]]]},
        },
        record={"every": 0.002, "sensors": ["edge.gap", "ball.linear_velocity"]},
    )
    experiment = wc.Experiment(raw)
    assert experiment.scene().contacts[1].surface.active_faces.tolist() == [True, False]
    run = experiment.run(tmp_path / "out", device="cpu")
    assert wc.Experiment.from_toml(run.files["experiment"]).settings == experiment.settings
    assert run.recording["edge.radius"].dims == ("env", "item")
    assert run.recording["corners.position"].dims == ("env", "item", "axis")
    assert run.recording["ball.inertia"].dims == ("env", "row", "column")


def test_record_sensors_and_interval_have_defaults():
    experiment = wc.Experiment(content(duration=3.0, record={}))
    assert experiment.settings.record.every == 0.03
    expected_sensors = ("touch.penetration", "touch.normal_force", "scene.kinetic_energy")
    assert experiment.settings.record.sensors == expected_sensors
    # A written experiment contains explicit defaults, and they still follow a changed duration.
    written = wc.Experiment(experiment.settings.model_dump(exclude_none=True))
    assert written.settings.record.every == 0.03
    assert written.changed(duration=0.01).settings.record.every == 0.001
    assert experiment.changed(duration=0.01).settings.record.every == 0.001
    assert default_sensors(experiment.model(device="cpu")) == list(experiment.settings.record.sensors)


def test_coupling_sensors_are_recorded_by_default():
    ends = [{"name": "hook", "position": [0, 0, 3]}, {"name": "centre", "body": "ball", "position": [0, 0, 0]}]
    between = {"point_a": "hook", "point_b": "centre"}
    experiment = wc.Experiment(
        content(
            point=ends,
            contact=[],
            spring_damper=[between | {"name": "spring", "stiffness": 10.0}],
            bushing=[between | {"name": "pad"}],
            catenary=[between | {"name": "line", "length": 4, "mass_per_length": 1, "axial_stiffness": 1e5}],
            record={},
        )
    )
    names = ("spring.length", "spring.force", "pad.displacement", "pad.force", "line.tension_a", "line.tension_b")
    assert experiment.settings.record.sensors == (*names, "scene.kinetic_energy")


def test_box_on_slope_example_slides_as_closed_form(device, tmp_path):
    experiment = wc.Experiment.from_toml(EXAMPLE.parent / "box_on_slope.toml")
    assert experiment.settings.envs == 11
    changed = experiment.settings.model_dump(exclude_none=True)
    changed["variation"] = {"feet.friction.mu": {"values": [0.0, 0.15, 0.3, 0.5]}}
    run = wc.Experiment.from_dict(changed | {"envs": 4}).run(tmp_path / "out", device=device)
    position, mu = run.recording["box.position"].values, run.recording["feet.friction.mu"].values[:, 0]
    slid = np.linalg.norm(position[-1] - position[0], axis=-1)
    slope, duration = np.radians(20.0), experiment.settings.duration
    acceleration = 9.81 * (np.sin(slope) - mu * np.cos(slope))
    # The box sinks by 0.05 mm, and friction is smaller below the velocity scale of 1 mm/s.
    np.testing.assert_allclose(slid[:3], 0.5 * acceleration[:3] * duration**2, atol=1.0e-3)
    assert slid[3] < 2.0e-3


def test_rolling_and_torsion_are_parts_of_a_contact_material(device, tmp_path):
    stick = {"type": "CundallStrack", "mu_static": 0.5, "mu_dynamic": 0.4, "stiffness": 1.0e4}
    material = {
        "name": "felt",
        "law": {"type": "Hooke", "stiffness": 1.0e4},
        "friction": stick,
        "rolling": {"type": "Tanh", "mu": 0.02},
        "torsion": {"type": "Tanh", "mu": 0.4, "velocity_scale": 1.0e-3},
    }
    ball = content()["body"][0] | {"position": [0.0, 0.0, 0.099], "angular_velocity": [0.0, 10.0, 5.0]}
    contact = content()["contact"][0] | {"material": "felt", "torsion_radius": 0.002}
    study = wc.Experiment(
        content(
            body=[ball], material=[material], contact=[contact],
            variation={"touch.rolling.mu": {"values": [0.0, 0.01, 0.02, 0.04]}},
            record={"sensors": ["touch.torque", "touch.normal_force"]},
        )
    )  # fmt: skip
    run = study.run(tmp_path / "out", device=device)
    couple, force = (run.recording[name].isel(time=0) for name in ("touch.torque", "touch.normal_force"))
    # M = −μ_r R N about y, −μ r_t N about z.
    np.testing.assert_allclose(couple.sel(axis="y"), -np.array([0, 0.01, 0.02, 0.04]) * 0.1 * force, rtol=1e-5)
    np.testing.assert_allclose(couple.sel(axis="z"), -0.4 * 0.002 * force, rtol=1e-5)
    again = wc.Experiment.from_toml(run.files["experiment"])
    assert again.settings == study.settings


def test_default_sensors_include_one_of_each_element(device):
    experiment = wc.Experiment.from_dict(
        {
            "duration": 0.1,
            "dt": 1e-3,
            "body": [
                {
                    "name": "arm",
                    "mass": 1.0,
                    "inertia": [1.0, 1.0, 1.0],
                    "position": [1.0, 0.0, 0.0],
                    "motion": {"type": "Hinge", "axis": [0, 1, 0], "anchor": [0, 0, 0]},
                }
            ],
            "point": [
                {"name": "hook", "position": [1.0, 0.0, 2.0]},
                {"name": "eye", "body": "arm", "position": [0.0, 0.0, 0.0]},
            ],
            "spring_damper": [{"name": "spring", "point_a": "hook", "point_b": "eye", "stiffness": 10.0}],
            "catenary": [
                {
                    "name": "line",
                    "point_a": "hook",
                    "point_b": "eye",
                    "length": 3.0,
                    "mass_per_length": 0.1,
                    "axial_stiffness": 1e4,
                }
            ],
        }
    )
    expected_sensors = ["spring.length", "spring.force", "line.tension_a", "line.tension_b", "arm.angle"]
    assert default_sensors(experiment.model(device=device)) == [*expected_sensors, "scene.kinetic_energy"]
