"""NewtonMaterialAPI and NewtonSceneAPI in exports, as read by Newton and by this library."""

import importlib.util

import numpy as np
import pytest
import xarray as xr
from pxr import Sdf, Usd

import warpcontact as wc

pytestmark = [pytest.mark.installed, pytest.mark.filterwarnings("default")]  # warnings of Newton

SINGLE = 1e-6
ROLLING = wc.friction.CundallStrack(mu_static=0.02, mu_dynamic=0.01, stiffness=1e3)
TORSION = wc.friction.Tanh(mu=0.4, velocity_scale=1e-3)
LINEAR = wc.laws.KelvinVoigt(stiffness=2e4, damping=30.0)
RADIUS = 0.25


def ball_on(floor="plane", law=LINEAR, rolling=ROLLING, torsion_radius=0.05):
    """A scene with a ball in contact with a floor."""
    scene = wc.Scene()
    ball = scene.add_body(2.0, (0.05,) * 3, (0, 0, 1), name="ball")
    touch = wc.ContactMaterial(
        law=law,
        friction=wc.friction.Tanh(mu=0.3, velocity_scale=1e-2),
        rolling=rolling,
        torsion=None if torsion_radius is None else TORSION,
    )
    if floor == "mesh":
        ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)), name="floor")
        centre = scene.add_point(ball, (0, 0, 0), name="centre")
        scene.add_contact(centre, ground, touch, radius=RADIUS, torsion_radius=torsion_radius, name="touch")
        return scene
    form = {
        "plane": wc.shapes.Plane(),
        "ball": wc.shapes.Sphere(RADIUS),
        "egg": wc.shapes.Ellipsoid((1.0, 1.0, 0.5)),
    }[floor]
    ground = scene.add_shape(None, form, (0, 0, -1), name="floor")
    skin = scene.add_shape(ball, wc.shapes.Sphere(RADIUS), name="skin")
    scene.add_shape_contact(skin, ground, touch, torsion_radius=torsion_radius, name="touch")
    return scene


def recording(scene, envs=1, **attrs):
    """A recording of one record, made without a simulation."""
    shape = (1, envs)
    variables = {}
    for body in scene.bodies:
        for key, axis in (("position", "axis"), ("orientation", "quaternion")):
            value = getattr(body, key)
            variables[f"{body.name}.{key}"] = (("time", "env", axis), np.broadcast_to(value, (*shape, len(value))))
    return xr.Dataset(variables, {"time": [0.0], "env": np.arange(envs)}, attrs)


def exported(tmp_path, scene, data=None, **attrs):
    path = wc.export_usd(recording(scene, **attrs) if data is None else data, tmp_path / "a.usda", scene=scene)
    assert wc.check_usd(path) == []
    return path


def written(path, where="/World/PhysicsMaterials/touch"):
    """Authored Newton attributes of a prim."""
    stage = Usd.Stage.Open(str(path))
    values = {one.GetName(): one.Get() for one in stage.GetPrimAtPath(where).GetAuthoredAttributes()}
    return {name.removeprefix("newton:"): one for name, one in values.items() if name.startswith("newton:")}


ALL = {
    "contactStiffness": 2e4,
    "contactDamping": 30.0,
    "rollingFriction": 0.01 * RADIUS,
    "torsionalFriction": 0.02,
}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, ALL),
        ({"floor": "mesh"}, ALL),
        ({"floor": "ball"}, ALL | {"rollingFriction": 0.01 * RADIUS / 2}),
        # The rolling radius of an ellipsoid depends on the point.
        ({"floor": "egg"}, {key: value for key, value in ALL.items() if key != "rollingFriction"}),
        # A lever arm of torsion that follows from the overlap is not a single number.
        ({"torsion_radius": None, "rolling": None}, {"contactStiffness": 2e4, "contactDamping": 30.0}),
        (
            {"law": wc.laws.Hooke(stiffness=1e3), "torsion_radius": None, "rolling": None},
            {"contactStiffness": 1e3, "contactDamping": 0.0},
        ),
        (
            {"law": wc.laws.KelvinVoigt(stiffness=1e3, restitution=0.4), "torsion_radius": None, "rolling": None},
            {"contactStiffness": 1e3},
        ),
        # Its stiffness is in N/m^1.5.
        (
            {"law": wc.laws.HuntCrossley(stiffness=1e3, restitution=0.4), "torsion_radius": None, "rolling": None},
            {},
        ),
    ],
)
def test_material_has_the_values_of_law_rolling_and_torsion(tmp_path, options, expected):
    path = exported(tmp_path, ball_on(**options))
    assert written(path) == pytest.approx(expected, rel=SINGLE)
    stage = Usd.Stage.Open(str(path))
    applied = stage.GetPrimAtPath("/World/PhysicsMaterials/touch").GetPrimTypeInfo().GetAppliedAPISchemas()
    assert ("NewtonMaterialAPI" in applied) == bool(expected)


def test_material_values_that_vary_are_written_per_environment(tmp_path):
    scene = ball_on()
    data = recording(scene, envs=2)
    data["touch.law.stiffness"] = ("env", [1e4, 3e4])
    data["touch.rolling.mu_dynamic"] = ("env", [0.01, 0.03])
    path = exported(tmp_path, scene, data)
    for env, stiffness, mu in ((0, 1e4, 0.01), (1, 3e4, 0.03)):
        expected = ALL | {"contactStiffness": stiffness, "rollingFriction": mu * RADIUS}
        assert written(path, f"/World/env_{env}/PhysicsMaterials/touch") == pytest.approx(expected, rel=SINGLE)


@pytest.mark.parametrize(
    ("attrs", "expected"),
    [
        ({"dt": float(np.float32(1e-3))}, {"timeStepsPerSecond": 1000}),
        ({"dt": 2e-3, "iterations": 50}, {"timeStepsPerSecond": 500, "maxSolverIterations": 50}),
        # 3333.3 steps per second, and less than one.
        ({"dt": 3e-4}, {}),
        ({"dt": 2.0}, {}),
        ({}, {}),
    ],
)
def test_physics_scene_has_time_step_and_iterations(tmp_path, attrs, expected):
    path = exported(tmp_path, ball_on(), **attrs)
    assert written(path, "/World/PhysicsScene") == expected
    # From the stage itself, in addition to the scene description.
    again = wc.Scene.from_usd(path, trusted=True)
    rate = expected.get("timeStepsPerSecond")
    assert again.suggested_dt == (None if rate is None else 1.0 / rate)
    assert again.suggested_iterations == expected.get("maxSolverIterations")


@pytest.mark.skipif(importlib.util.find_spec("newton") is None, reason="newton not installed")
def test_newton_reads_the_values_of_the_scene(tmp_path):
    import newton

    builder = newton.ModelBuilder()
    found = builder.add_usd(str(exported(tmp_path, ball_on(), dt=2e-3, iterations=50)))
    assert found["physics_dt"] == pytest.approx(2e-3)
    assert found["max_solver_iterations"] == 50
    expected = {"ke": 2e4, "kd": 30.0, "mu_rolling": 0.01 * RADIUS, "mu_torsional": 0.02, "mu": 0.3}
    for key, value in expected.items():
        assert getattr(builder, f"shape_material_{key}") == pytest.approx(
            [value] * builder.shape_count, rel=SINGLE
        )


def test_gravity_disabled_after_export_is_reported_as_a_change(tmp_path):
    path = exported(tmp_path, ball_on())
    stage = Usd.Stage.Open(str(path))
    stage.GetPrimAtPath("/World/PhysicsScene").CreateAttribute(
        "newton:gravityEnabled", Sdf.ValueTypeNames.Bool
    ).Set(False)
    stage.Save()
    with pytest.raises(wc.UsdError, match=r"/World/PhysicsScene: a gravity of \[0.0, 0.0, 0.0\] m/s²"):
        wc.Scene.from_usd(path, trusted=True)
