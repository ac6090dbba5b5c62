"""Values of a wrong type are rejected everywhere by a message that names the entry, and are not converted."""

import copy
import pickle

import numpy as np
import pytest
from scenes import dropped_sphere

import warpcontact as wc

# Keywords that take environment numbers.
KEYS = {wc.export_usd: "envs", wc.render: "env"}
# Not numbers, although NumPy converts some of them.
NO_NUMBERS = (
    True,
    [True],
    [1.0, True],
    [1.0, np.array(True)],
    np.array(True),
    np.ones(3, dtype=bool),
    "1",
    ["1"],
    None,
    np.array([1.0, None]),
    np.array(object()),
    1.0j,
    [[1.0], [1.0, 2.0]],
    {},
)
LAW = wc.laws.Hooke(stiffness=1e4)


@pytest.fixture(scope="module")
def model(device):
    return dropped_sphere(LAW, device=device)


@pytest.fixture
def scene():
    one = wc.Scene()
    one.ball = one.add_body(1.0, [1.0] * 3, name="ball")
    one.ground = one.add_surface(wc.meshes.grid((1.0, 1.0)), name="ground")
    one.point = one.add_point(one.ball, (0, 0, 0), name="point")
    one.hook = one.add_point(None, (0, 0, 1), name="hook")
    return one


# Entries of the scene that take numbers, with a question mark if they may be ``None``.
OF_SCENE = {
    "gravity": lambda s, v: wc.Scene(gravity=v),
    "max_speed": lambda s, v: wc.Scene(max_speed=v),
    "mass": lambda s, v: s.add_body(v, [1.0] * 3),
    "inertia": lambda s, v: s.add_body(1.0, v),
    "position": lambda s, v: s.add_body(1.0, [1.0] * 3, v),
    "orientation": lambda s, v: s.add_body(1.0, [1.0] * 3, orientation=v),
    "linear_velocity": lambda s, v: s.add_body(1.0, [1.0] * 3, linear_velocity=v),
    "scale": lambda s, v: s.add_surface(wc.meshes.grid((1.0, 1.0)), scale=v),
    "point.position": lambda s, v: s.add_point(s.ball, v),
    "points.position": lambda s, v: s.add_points(s.ball, v),
    "radius": lambda s, v: s.add_contact(s.point, s.ground, wc.ContactMaterial(law=LAW), radius=v),
    "max_depth?": lambda s, v: s.add_contact(s.point, s.ground, wc.ContactMaterial(law=LAW), max_depth=v),
    "rest_length?": lambda s, v: s.add_spring_damper(s.hook, s.point, stiffness=1.0, rest_length=v),
    "stiffness": lambda s, v: s.add_spring_damper(s.hook, s.point, stiffness=v),
    "length": lambda s, v: s.add_catenary(s.hook, s.point, length=v, mass_per_length=1.0, axial_stiffness=1.0),
    "envs": lambda s, v: s.build(envs=v, device="cpu"),
    "samples": lambda s, v: s.add_surface_contact(s.ground, s.ground, wc.ContactMaterial(law=LAW), samples=v),
}
# Other entries that take numbers.
OTHERS = {
    "Hooke.stiffness": lambda v: wc.laws.Hooke(stiffness=v),
    "Tanh.mu": lambda v: wc.friction.Tanh(mu=v, velocity_scale=1.0),
    "Sphere.radius": lambda v: wc.shapes.Sphere(radius=v),
    "Hinge.axis": lambda v: wc.motions.Hinge(axis=v, anchor=(0, 0, 0)),
    "E": lambda v: wc.laws.Hertz.from_materials(E=v, nu=0.3, R=0.1),
    "Rx": lambda v: wc.laws.Hertz.elliptic(1e9, 0.3, v, 0.1),
    "thickness": lambda v: wc.laws.ElasticFoundation.from_layer(E=1e9, nu=0.3, thickness=v),
    "restitution": lambda v: wc.laws.KuwabaraKono.from_restitution(
        stiffness=1e5, restitution=v, speed=1.0, mass=1.0
    ),
    "speed": lambda v: wc.laws.recommended_dt(1e5, 1.0, 1.0, v),
    "steps": lambda v: wc.laws.recommended_dt(1e5, 1.0, 1.0, 1.0, v),
    "k1": lambda v: wc.ContactRange(k1=v, effective_range=0.1),
    "ContactRange.from_impact: mass": lambda v: wc.ContactRange.from_impact(
        mass=v, area=1.0, speed=1.0, effective_range=0.1, closest=0.05
    ),
    "K": lambda v: wc.unilateral.Problem(K=v, f=[1.0], G=[[1.0]], d=[0.0]),
    "f": lambda v: wc.unilateral.Problem(K=[[1.0]], f=v, G=[[1.0]], d=[0.0]),
    "vertices": lambda v: wc.Mesh(v, [[0, 1, 2]]),
    "faces": lambda v: wc.Mesh(np.eye(3), v),
    "radius": wc.meshes.icosphere,
    "size": wc.meshes.box,
    "count": lambda v: wc.sample_surface(wc.meshes.box(), v, method="blue_noise"),
}
# Entries of a model and a simulation.
OF_MODEL = {
    "ball.mass": lambda m, v: m.__setitem__("ball.mass", v),
    "touch.law.stiffness": lambda m, v: m.__setitem__("touch.law.stiffness", v),
    "ball.position": lambda m, v: m.__setitem__("ball.position", v),
    "dt": wc.Simulation,
    "crossing_substeps": lambda m, v: wc.Simulation(m, 1e-3, crossing_substeps=v),
    "count": lambda m, v: wc.Simulation(m, 1e-3).step(v),
    "duration": lambda m, v: wc.Simulation(m, 1e-3).run(v),
    "every?": lambda m, v: wc.Simulation(m, 1e-3).run(1e-2, ["touch.gap"], every=v),
    "recovery_time?": lambda m, v: wc.integrators.MoreauJean(recovery_time=v),
    "tolerance?": lambda m, v: wc.integrators.MoreauJean(tolerance=v),
}


def refused(call, name, *context):
    """Returns the values of ``NO_NUMBERS`` that a call does not reject with a message about ``name``."""
    wrong = []
    word = name.rstrip("?").rpartition(".")[2]
    for value in NO_NUMBERS:
        if value is None and name.endswith("?"):
            continue
        try:
            call(*context, value)
        except (TypeError, ValueError) as error:
            if word not in str(error) or " must " not in str(error):
                wrong.append((value, error))
        else:
            wrong.append((value, "accepted"))
    return wrong


@pytest.mark.parametrize("name", OF_SCENE)
def test_scene_refuses_non_numeric_values(name, scene):
    assert refused(OF_SCENE[name], name, scene) == []


@pytest.mark.parametrize("name", OTHERS)
def test_formulas_and_meshes_refuse_non_numeric_values(name):
    assert refused(OTHERS[name], name) == []


@pytest.mark.parametrize("name", OF_MODEL)
def test_model_refuses_non_numeric_values(name, model):
    assert refused(OF_MODEL[name], name, model) == []


@pytest.mark.parametrize("value", [np.array(2.0), np.float32(2.0), np.int64(2), [np.array(2)], 2])
def test_numpy_scalars_are_accepted(value, model):
    model["ball.mass"] = value
    assert model["ball.mass"] == 2.0


@pytest.mark.parametrize("value", [True, [True], np.array(True), 1, 1.0])
def test_boolean_parameters_accept_booleans_and_numbers(value, model):
    model["touch.enabled"] = value
    assert model["touch.enabled"] == 1.0


@pytest.mark.parametrize("value", [True, np.array(True), np.array(object()), 1.0j, "1", [[0]], 0.5])
def test_environment_numbers_must_be_integers(value, model, tmp_path):
    recording = wc.Simulation(model, 1e-3).run(2e-3, ["touch.gap"])
    for draw in (wc.export_usd, wc.render):
        with pytest.raises((TypeError, ValueError), match=r"^envs? must be "):
            draw(recording, tmp_path / ("x.usda" if draw is wc.export_usd else "x.png"), **{KEYS[draw]: value})


@pytest.mark.parametrize("value", [None, "1", 2, [1.0, True], [[True], [True, False]]])
def test_boolean_parameters_refuse_other_values(value, model):
    with pytest.raises(ValueError, match=r"^touch\.enabled(\[\])? must be "):
        model["touch.enabled"] = value


@pytest.mark.parametrize("name", [3, None, ["ball.mass"], ("ball", "mass"), slice(2)])
def test_names_that_are_not_strings_are_refused(name, model):
    for call in (model.__getitem__, model.sensor, lambda one: model.__setitem__(one, 1.0)):
        with pytest.raises(TypeError, match=r"^name of a (parameter|sensor) must be a string, .*got "):
            call(name)


@pytest.mark.parametrize("copied", [pickle.dumps, copy.copy, copy.deepcopy])
def test_models_and_simulations_cannot_be_pickled_or_copied(copied, model):
    with pytest.raises(TypeError, match=r"^a Model must not be pickled or copied, .*scene\.build"):
        copied(model)
    with pytest.raises(TypeError, match=r"^a Simulation must not be pickled or copied, .*simulation\.save"):
        copied(wc.Simulation(model, 1e-3))


def test_scenes_can_be_pickled(model):
    built = pickle.loads(pickle.dumps(model.scene)).build(envs=2, device=str(model.device))
    assert list(built) == list(model)
    np.testing.assert_array_equal(built["touch.law.stiffness"], 1e4)
