"""Arguments of the scene API, and errors for invalid ones."""

import re

import numpy as np
import pytest
from scenes import dropped_sphere, square

import warpcontact as wc
from warpcontact.validation.checks import find_entry

pytestmark = pytest.mark.installed

HOOKE = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0))


def scene_with(**body):
    scene = wc.Scene()
    values = {"mass": 1.0, "inertia": (1, 1, 1), "name": "ball"} | body
    scene.add_body(**values)
    return scene


def contact_with(**options):
    scene = scene_with()
    surface = scene.add_surface(square(), name="ground")
    point = scene.add_point(scene.bodies[0], (0, 0, 0), name="tip")
    return scene.add_contact(point, surface, HOOKE, name="touch", **options)


BAD = [
    (lambda: wc.Scene(gravity=(0, 0)), "gravity must be 3 numbers, got (0, 0)"),
    (lambda: wc.Scene(gravity=(0, 0, np.nan)), "gravity[2] must be finite, got nan m/s²"),
    (lambda: scene_with(mass=-0.2), "ball.mass must be greater than 0, got -0.2 kg"),
    (lambda: scene_with(mass=0), "ball.mass must be greater than 0, got 0 kg"),
    (lambda: scene_with(mass=np.inf), "ball.mass must be greater than 0, got inf kg"),
    (lambda: scene_with(mass="heavy"), "ball.mass must be a number, got 'heavy'"),
    (lambda: scene_with(mass="3"), "ball.mass must be a number, got '3'"),
    (lambda: scene_with(mass=True), "ball.mass must be a number, got True"),
    (lambda: scene_with(mass=10**400), "ball.mass must be a number, got 1000"),
    (lambda: scene_with(mass=[1, 2]), "ball.mass must be a number, got [1, 2]"),
    (lambda: scene_with(inertia=1.0), "ball.inertia must be 3 numbers or a 3×3 tensor"),
    (lambda: scene_with(inertia=(1, 1, 0)), "ball.inertia must be positive definite"),
    (lambda: scene_with(inertia=(1, 1, 3)), "ball.inertia must be physical: no principal moment may exceed"),
    (lambda: scene_with(inertia=[[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), "ball.inertia must be symmetric"),
    (lambda: scene_with(inertia=(1, np.nan, 1)), "ball.inertia[1] must be finite"),
    (lambda: scene_with(position=(0, 0)), "ball.position must be 3 numbers, got (0, 0)"),
    (lambda: scene_with(orientation=(0, 0, 0, 2)), "ball.orientation must be a unit quaternion (x, y, z, w)"),
    (lambda: scene_with(orientation=(0, 0, 0)), "ball.orientation must be 4 numbers"),
    (lambda: scene_with(linear_velocity=(np.inf, 0, 0)), "ball.linear_velocity[0] must be finite, got inf m/s"),
    (lambda: scene_with(angular_velocity=None), "ball.angular_velocity must be 3 numbers, got None"),
    (lambda: scene_with(color=(2, 0, 0)), "ball.color[0] must be at least 0 and at most 1, got 2"),
    (lambda: scene_with(name="a.b"), "name of a body must be letters, digits, _ and -"),
    (lambda: scene_with(name="scene"), "name 'scene' of a body is taken"),
    (lambda: scene_with().add_body(1.0, (1, 1, 1), name="ball"), "name 'ball' of a body is taken"),
    (lambda: scene_with().add_point(None, (0, 0)), "point.position must be 3 numbers"),
    (lambda: scene_with().add_point("ball", (0, 0, 0)), "point.body must be a body of this scene or None"),
    (lambda: scene_with().add_points(None, np.zeros((0, 3))), "points.position must have shape (n, 3) with n ≥ 1"),
    (lambda: scene_with().add_point(scene_with().bodies[0], (0, 0, 0)), "point.body must be a body of this scene"),
    (
        lambda: scene_with().add_surface("mesh.stl"),
        "mesh of 'surface' must be a wc.Mesh or have vertices and faces",
    ),
    (
        lambda: scene_with().add_surface(square(), active_faces=[2]),
        "active_faces must be face numbers from 0",
    ),
    (lambda: scene_with().add_surface(square(), active_faces=[True]), "as a mask must have shape (2,), got (1,)"),
    (
        lambda: scene_with().add_surface(square(), active_faces=[0.5]),
        "must be a mask of 2 booleans",
    ),
    (lambda: contact_with(radius=-1), "touch.radius must be at least 0, got -1 m"),
    (lambda: contact_with(kappa=1.5), "touch.kappa must be at least 0 and at most 1, got 1.5"),
    (lambda: contact_with(max_depth=0), "touch.max_depth must be greater than 0, got 0 m"),
    (lambda: contact_with(search_radius=-1), "touch.search_radius must be greater than 0, got -1 m"),
    (lambda: contact_with(search="all"), "touch.search must be one of 'whole', 'active', got 'all'"),
    (lambda: contact_with(entry="late"), "touch.entry must be one of 'literal', 'latched', got 'late'"),
    (lambda: contact_with(boundary="inner"), "touch.boundary must be one of 'off', 'outer', got 'inner'"),
    (lambda: wc.Scene().build(), "the scene has no body"),
    (lambda: scene_with().build(envs=0), "envs must be a whole number of at least 1, got 0"),
    (lambda: scene_with().build(envs=2.5), "envs must be a whole number of at least 1, got 2.5"),
    (lambda: scene_with().build(device="gpu"), "device must be 'auto' or one of cpu"),
    (lambda: scene_with().build(precision="half"), "precision must be one of 'float32', 'float64', got 'half'"),
]


@pytest.mark.parametrize(("make", "message"), BAD, ids=[message[:40] for _, message in BAD])
def test_invalid_scene_input_is_refused_with_its_name(make, message):
    with pytest.raises((ValueError, TypeError), match=re.escape(message)):
        make()


def test_contact_of_two_fixed_sides_is_refused():
    scene = scene_with()
    surface = scene.add_surface(square())
    with pytest.raises(ValueError, match="points and surface are both fixed to the world"):
        scene.add_contact(scene.add_point(None, (0, 0, 0)), surface, HOOKE)
    carried = scene.add_surface(square(), scene.bodies[0])
    with pytest.raises(ValueError, match="both fixed to body 'ball'"):
        scene.add_contact(scene.add_point(scene.bodies[0], (0, 0, 0)), carried, HOOKE)


def test_elements_of_another_scene_are_refused():
    scene, other = scene_with(), scene_with()
    point = other.add_point(other.bodies[0], (0, 0, 0))
    with pytest.raises(ValueError, match=r"from add_point or add_points of this scene, got Points 'point'$"):
        scene.add_contact(point, scene.add_surface(square()), HOOKE)
    own = scene.add_point(scene.bodies[0], (0, 0, 0))
    with pytest.raises(ValueError, match=r"from add_surface of this scene, got 'ground'$"):
        scene.add_contact(own, "ground", HOOKE)


@pytest.mark.parametrize("key", ["enabled", "visible", "swept"])
def test_non_boolean_option_is_refused(key):
    scene = scene_with()
    point, surface = scene.add_point(scene.bodies[0], (0, 0, 0)), scene.add_surface(square())
    with pytest.raises(ValueError, match=f"touch.{key} must be True or False, got 'no'"):
        scene.add_contact(point, surface, HOOKE, name="touch", **{key: "no"})
    assert scene.add_contact(point, surface, HOOKE, name="touch", **{key: np.bool_(False)}).name == "touch"


def test_names_are_generated_if_not_given():
    scene = wc.Scene()
    names = [scene.add_body(1.0, (1, 1, 1)).name for _ in range(3)]
    assert names == ["body", "body_2", "body_3"]


PARAMETERS = [
    ("ball.mass", -1.0, "ball.mass must be greater than 0, got -1 kg"),
    ("ball.mass", [1, 2, 0, 4], "ball.mass[2] must be greater than 0, got 0 kg"),
    ("ball.mass", [1, 2, 3], "ball.mass must have shape () or (4,), got (3,)"),
    ("ball.mass", "heavy", "ball.mass must be numeric, got 'heavy'"),
    ("ball.position", np.zeros((4, 2)), "ball.position must have shape (3,) or (4, 3), got (4, 2)"),
    ("ball.position", [0, np.nan, 0], "ball.position[1] must be finite, got nan m"),
    ("ball.orientation", (0, 0, 1, 1), "ball.orientation[0, 0] must be a unit quaternion"),
    ("ball.inertia", (1, 1, 3), "ball.inertia must be physical"),
    ("touch.law.stiffness", 0, "touch.law.stiffness must be greater than 0, got 0 N/m"),
    ("touch.radius", [0.1, 0.1, -0.1, 0.1], "touch.radius[2] must be at least 0, got -0.1 m"),
    ("touch.enabled", 2, "touch.enabled must be at least 0 and at most 1, got 2"),
    ("ground.orientation", (1, 1, 1, 1), "ground.orientation[0, 0] must be a unit quaternion"),
]


@pytest.mark.parametrize(("name", "value", "message"), PARAMETERS, ids=[f"{n}={v}" for n, v, _ in PARAMETERS])
def test_invalid_parameter_values_are_refused_without_changes(name, value, message):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e3), envs=4)
    before = model[name].copy()
    with pytest.raises(ValueError, match=re.escape(message)):
        model[name] = value
    np.testing.assert_array_equal(model[name], before)


def test_ambiguous_inertia_shape_is_refused():
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e3), envs=3)
    moments = np.array([(1.0, 2.0, 2.5), (1.0, 1.0, 1.0), (2.0, 2.0, 3.0)])
    with pytest.raises(ValueError, match=r"of shape \(3, 3\) is ambiguous: one row for all environments"):
        model["ball.inertia"] = moments
    model["ball.inertia"] = moments[:, :, None] * np.eye(3)
    np.testing.assert_array_equal(model["ball.inertia"][0], np.diag(moments[0]))
    model["ball.inertia"] = (1.0, 2.0, 2.5)
    np.testing.assert_array_equal(model["ball.inertia"][2], np.diag(moments[0]))


def test_unknown_names_suggest_the_nearest():
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e3))
    with pytest.raises(KeyError, match=r"no parameter 'ball.masss'; did you mean 'ball.mass'\?"):
        model["ball.masss"] = 1.0
    with pytest.raises(KeyError, match=r"no sensor 'touch.gapp'; did you mean 'touch.gap'\?"):
        model.sensor("touch.gapp")
    with pytest.raises(
        KeyError, match=r"no parameter 'ball.zzzzzzzzzzzzzzzzzz'; there are: (ball\.\w+, )+ball\.\w+\"$"
    ):
        model["ball.zzzzzzzzzzzzzzzzzz"] = 1.0
    with pytest.raises(KeyError, match=r"no sensor 'x\.y'; there are: \w+\.\*, (\w+\.\*, )*scene\.\*\"$"):
        model.sensor("x.y")
    with pytest.raises(KeyError, match=r"no sensor 'touch\.zzzzzz'; there are: (touch\.\w+, )+touch\.\w+\"$"):
        model.sensor("touch.zzzzzz")
    with pytest.raises(KeyError, match=r"no sensor 'touch\.gap'; there are: e0\.\*, (e\d+\.\*, ){19}…\"$"):
        find_entry("sensor", "touch.gap", {f"e{i}.value": None for i in range(21)})
    with pytest.raises(KeyError, match=r"no catenary 'c'; there are: line, rope\"$"):
        find_entry("catenary", "c", {"line": None, "rope": None})
    with pytest.raises(KeyError, match=r"'touch\.gap' is a sensor, not a parameter; use model\.sensor"):
        model["touch.gap"] = 0.5
    law = wc.laws.HuntCrossley(stiffness=1e3, restitution=0.5)
    with pytest.raises(KeyError, match="the HuntCrossley of 'touch' was made without damping; it has stiffness"):
        dropped_sphere(law)["touch.law.damping"] = 0.5


def test_parameters_accept_one_value_or_one_per_environment():
    scene = scene_with()
    surface = scene.add_surface(square(), name="ground")
    points = scene.add_points(scene.bodies[0], np.eye(3), name="corners")
    material = wc.ContactMaterial(
        law=wc.laws.HuntCrossley(stiffness=1e3, restitution=0.5), friction=wc.friction.Tanh(mu=0.3)
    )
    scene.add_contact(points, surface, material, name="touch")
    envs = 5
    model = scene.build(envs=envs)
    for name in model:
        old = model[name]
        assert old.shape[0] == envs
        of_a_set = name.startswith(("corners", "touch"))
        for value in (old[:1] if of_a_set else old[0], old):
            model[name] = value
            np.testing.assert_allclose(model[name], old, rtol=1e-12)
    model["touch.radius"] = np.arange(5) * 0.1
    np.testing.assert_allclose(model["touch.radius"], np.arange(5)[:, None] * [[0.1, 0.1, 0.1]])
    model["corners.position"] = np.arange(9.0).reshape(1, 3, 3)
    np.testing.assert_allclose(model["corners.position"][4], np.arange(9.0).reshape(3, 3))


def test_initial_state_follows_its_parameters_until_the_first_step():
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e3), envs=2)
    sim = wc.Simulation(model, dt=1e-3)
    model["ball.position"] = [(0, 0, 1), (0, 0, 2)]
    np.testing.assert_allclose(model.sensor("ball.position")[:, 2], [1, 2])
    sim.step(1)
    model["ball.position"] = (0, 0, 5)
    assert model.sensor("ball.position")[0, 2] < 2
    sim.reset()
    np.testing.assert_allclose(model.sensor("ball.position")[:, 2], [5, 5])


def test_model_does_not_change_with_its_scene():
    scene = scene_with()
    model = scene.build()
    scene.add_body(1.0, (1, 1, 1), name="later")
    assert [body.name for body in model.scene.bodies] == ["ball"]
    assert model.body_count == 1


def test_one_scene_can_have_several_laws():
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square(), name="ground")
    materials = [
        wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3)),
        wc.ContactMaterial(law=wc.laws.Hertz(stiffness=1e5), friction=wc.friction.Tanh(mu=0.1)),
        wc.ContactMaterial(law=wc.laws.Hooke(stiffness=2e3)),
    ]
    for number, material in enumerate(materials):
        body = scene.add_body(1.0, (1, 1, 1), position=(0.1 * number, 0, -0.01), name=f"body{number}")
        scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, material, name=f"touch{number}")
    model = scene.build(envs=2)
    assert len(model.groups) == 2
    expected = [10.0, 1e5 * 0.01**1.5, 20.0]
    for number, force in enumerate(expected):
        np.testing.assert_allclose(model.sensor(f"touch{number}.normal_force"), force, rtol=1e-5)
        np.testing.assert_allclose(model.sensor(f"body{number}.force")[:, 2], force, rtol=1e-5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda m: wc.Simulation(m, dt=0), "dt must be greater than 0, got 0 s"),
        (lambda m: wc.Simulation(m, dt=[1, 2]), "dt must be a number"),
        (lambda m: wc.Simulation("model", dt=1), "model must come from Scene.build"),
        (lambda m: wc.Simulation(m, dt=1, integrator="euler"), "integrator must be an object of wc.integrators"),
        (lambda m: wc.Simulation(m, dt=1).step(-1), "count must be a whole number of at least 0, got -1"),
        (lambda m: wc.Simulation(m, dt=0.1).run(-1), "duration must be greater than 0, got -1 s"),
        (lambda m: wc.Simulation(m, dt=0.1).run(1, every=0.25), "every must be a multiple of dt = 0.1 s"),
        (lambda m: wc.Simulation(m, dt=0.1).run(1, "ball.position"), "record must be a list of sensors"),
        (lambda m: m.reset([1]), "env_mask must be 1 booleans"),
    ],
)  # fmt: skip
def test_invalid_simulation_input_is_refused(make, message):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e3))
    with pytest.raises((ValueError, TypeError), match=re.escape(message)):
        make(model)


def test_mesh_with_faces_without_area_in_float32_is_refused():
    scene = scene_with()
    big, far = (0, 0, 0), 5e5
    corners = [(far, 0, 0), (far + 1e-3, 0, 0), (far, 1e-3, 0), big, (1, 0, 0), (0, 1, 0)]
    mesh = wc.Mesh(corners, [(0, 1, 2), (3, 4, 5)])
    surface = scene.add_surface(mesh, name="ground")
    scene.add_contact(scene.add_point(scene.bodies[0], (0, 0, 0)), surface, HOOKE)
    with pytest.raises(ValueError, match=r"ground: face 0 is degenerate in float32"):
        scene.build()


def test_repr_of_a_scene_lists_its_elements():
    assert repr(wc.Scene()) == "<Scene of nothing yet>"
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((1, 1)), name="ground")
    ball = scene.add_body(1.0, (1, 1, 1), name="ball")
    points = scene.add_point(ball, (0, 0, 0), name="centre")
    scene.add_contact(points, ground, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)), name="touch")
    assert repr(scene) == "<Scene of bodies: ball; surfaces: ground; points: centre; contacts: touch>"


def test_refused_entry_is_named_with_its_index_if_there_are_several(device):
    scene = wc.Scene()
    scene.add_body(1.0, (1, 1, 1), name="ball")
    model = scene.build(envs=3, device=device)
    with pytest.raises(ValueError, match=r"^ball\.inertia must be physical"):
        model["ball.inertia"] = [1, 1, 3]
    with pytest.raises(ValueError, match=r"^ball\.inertia\[1\] must be physical"):
        model["ball.inertia"] = [np.eye(3), np.diag([1, 1, 3]), np.eye(3)]
    with pytest.raises(ValueError, match=r"multiple of dt = 0.1 s, got 0.05 s; the smallest multiple is dt$"):
        wc.Simulation(model, dt=0.1).run(1.0, every=0.05)
