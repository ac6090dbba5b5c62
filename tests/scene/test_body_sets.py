"""A body set is one element that gives bitwise the results of the same bodies added one by one."""

import warnings

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from recorded_usd_scene import findings, value
from scenes import oracle_law, square
from scipy.spatial.transform import Rotation

import warpcontact as wc

N = 21
ENVS = 3
RNG = np.random.default_rng(7)
POSITIONS = RNG.uniform(-1.5, 1.5, (N, 3)) * [1, 1, 0.1] + [0, 0, 0.45]
MASSES = RNG.uniform(0.1, 1.0, N)
INERTIA = 0.01 * MASSES[:, None] * RNG.uniform(0.9, 1.1, (N, 3))
TURNS = RNG.normal(size=(N, 4))
TURNS /= np.linalg.norm(TURNS, axis=1)[:, None]
VELOCITIES = RNG.normal(size=(N, 3))
SPINS = 5.0 * RNG.normal(size=(N, 3))
PUSHES = RNG.normal(size=(N, 3))
RADII = RNG.uniform(0.08, 0.15, N)
PLACES = RNG.uniform(-0.05, 0.05, (N, 3))
STATE = ("body_position", "body_position_remainder", "body_orientation", "body_linear_velocity")
SENSORS = ("gap", "normal_force", "friction_force", "point", "status", "friction.spring")


def sticky():
    return wc.ContactMaterial(
        law=wc.laws.HuntCrossley(stiffness=2e4, exponent=1.5, restitution=0.6),
        friction=wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.3, stiffness=5e3, damping=1.0),
    )


def rolling_scene(together, n=N):
    """Bodies on a terrain, as a set or one by one, between others with a spring and a surface."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.sinusoidal_terrain((5, 5), (20, 20)), name="ground")
    box = scene.add_body(3.0, (0.1, 0.1, 0.1), position=(0, 0, 0.4), name="box")
    lid = scene.add_surface(wc.meshes.box((0.6, 0.6, 0.2)), box, name="lid")
    hull = scene.add_points(box, [(x, y, -0.1) for x in (-0.3, 0.3) for y in (-0.3, 0.3)], name="hull")
    scene.add_contact(hull, ground, oracle_law(), name="stand")
    material = sticky()
    if together:
        grains = scene.add_bodies(
            POSITIONS[:n],
            mass=MASSES[:n],
            inertia=INERTIA[:n],
            orientations=TURNS[:n],
            linear_velocities=VELOCITIES[:n],
            angular_velocities=SPINS[:n],
            external_forces=PUSHES[:n],
            name="grains",
        )
        points = scene.add_points(grains, PLACES[:n], name="middles")
        scene.add_contact(points, ground, material, radius=RADII[:n], name="touch")
        scene.add_contact(scene.add_point(grains, (0, 0, 0.02)), lid, material, radius=0.1, name="hit")
    else:
        bodies = [
            scene.add_body(
                MASSES[i],
                INERTIA[i],
                POSITIONS[i],
                TURNS[i],
                VELOCITIES[i],
                SPINS[i],
                external_force=PUSHES[i],
                name=f"grain_{i}",
            )
            for i in range(n)
        ]
        for i, body in enumerate(bodies):
            point = scene.add_point(body, PLACES[i], name=f"middle_{i}")
            scene.add_contact(point, ground, material, radius=RADII[i], name=f"touch_{i}")
        for i, body in enumerate(bodies):
            scene.add_contact(scene.add_point(body, (0, 0, 0.02)), lid, material, radius=0.1, name=f"hit_{i}")
    last = scene.add_body(1.0, (0.1, 0.1, 0.1), position=(0, 0, 2), name="last")
    end = scene.add_point(last, (0, 0, 0))
    scene.add_spring_damper(end, scene.add_point(box, (0, 0, 0)), stiffness=50.0, name="spring")
    scene.add_contact(end, ground, material, radius=0.1, name="tip")
    return scene


def per_item(model, name, n=N):
    """Sensors of the set, or of the bodies one by one, (env, item, …)."""
    element, _, quantity = name.partition(".")
    if element in {element.name for element in (*model.scene.bodies, *model.scene.contacts)}:
        return model.sensor(name)
    singular = element.removesuffix("s")
    return np.stack([model.sensor(f"{singular}_{i}.{quantity}") for i in range(n)], axis=1)


def set_values(model, together, n=N):
    """Sets a different mass, radius and start in every environment and body."""
    factors = 1.0 + 0.1 * np.arange(ENVS)[:, None]
    height = POSITIONS[:n] + 0.05 * np.arange(ENVS)[:, None, None] * [0, 0, 1]
    values = {"mass": factors * MASSES[:n], "position": height}
    radii = factors * RADII[:n]
    if together:
        for key, of_all in values.items():
            model[f"grains.{key}"] = of_all
        model["touch.radius"] = radii
    else:
        for i in range(n):
            for key, of_all in values.items():
                model[f"grain_{i}.{key}"] = of_all[:, i]
            model[f"touch_{i}.radius"] = radii[:, i]


def both_models(device, precision, n=N):
    models = []
    for together in (True, False):
        models.append(rolling_scene(together, n).build(ENVS, device, precision))
        set_values(models[-1], together, n)
    return models


def assert_same(models, n=N):
    for name in STATE:
        np.testing.assert_array_equal(*(getattr(model.state, name).numpy() for model in models), err_msg=name)
    for name in (*(f"touch.{key}" for key in SENSORS), "hit.gap", "grains.kinetic_energy", "grains.force"):
        np.testing.assert_array_equal(*(per_item(model, name, n) for model in models), err_msg=name)
    for name in ("scene.kinetic_energy", "box.force", "last.position", "spring.force", "stand.gap"):
        np.testing.assert_array_equal(*(model.sensor(name) for model in models), err_msg=name)


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
def test_body_set_matches_individual_bodies(precision, device):
    models = both_models(device, precision)
    assert_same(models)
    simulations = [wc.Simulation(model, dt=2e-4, deterministic=True) for model in models]
    for sim in simulations:
        sim.step(1500)
    assert_same(models)
    # Contact, stick, and collision with the other body each occur.
    assert (models[0].sensor("touch.status") == wc.ContactStatus.CONTACT).any()
    assert models[0].sensor("touch.friction.spring").any()
    assert models[0].sensor("hit.gap").min() < 0.2
    for sim in simulations:
        sim.reset(np.arange(ENVS) == 1)
        sim.step(300)
    assert_same(models)


def test_body_set_of_one_body_keeps_item_axis(device):
    models = both_models(device, "float32", 1)
    for model in models:
        wc.Simulation(model, dt=2e-4, deterministic=True).step(1500)
    assert_same(models, 1)
    assert models[0].sensor("grains.position").shape == (ENVS, 1, 3)
    assert models[0]["grains.inertia"].shape == (ENVS, 1, 3, 3)


@pytest.fixture(scope="module")
def model(device):
    return rolling_scene(True).build(ENVS, device)


def test_body_set_is_one_element(model):
    grains = model.scene.bodies[1]
    assert (grains.name, grains.index, grains.count, grains.single) == ("grains", 1, N, False)
    assert [body.index for body in model.scene.bodies] == [0, 1, N + 1]
    assert model.body_count == N + 2
    assert model.contact_count == 4 + 2 * N + 1
    assert repr(model).startswith(f"<Model of {ENVS} environments: {N + 2} bodies, {2 * N + 5} contacts")


def test_body_set_parameters_have_item_axis(device):
    model = rolling_scene(True).build(ENVS, device)
    shapes = {"mass": (), "inertia": (3, 3), "position": (3,), "orientation": (4,), "external_force": (3,)}
    for key, tail in shapes.items():
        assert model[f"grains.{key}"].shape == (ENVS, N, *tail)
    np.testing.assert_array_equal(model["touch.radius"][0], RADII)
    np.testing.assert_array_equal(model["middles.position"][0], PLACES)
    model["grains.mass"] = 2.0
    assert (model["grains.mass"] == 2.0).all()
    assert (model["box.mass"] == 3.0).all()
    model["grains.mass"] = MASSES[None]
    np.testing.assert_array_equal(model["grains.mass"], np.tile(MASSES, (ENVS, 1)))
    model["grains.inertia"] = INERTIA[None]
    np.testing.assert_array_equal(model["grains.inertia"][2, 5], np.diag(INERTIA[5]))
    with pytest.raises(ValueError, match=r"grains\.mass must have shape \(\) or \(3,\) or \(1, 21\) or \(3, 21\)"):
        model["grains.mass"] = np.ones(5)
    with pytest.raises(ValueError, match=r"grains\.inertia\[0, 4\] must be physical"):
        model["grains.inertia"] = np.where(np.arange(N)[:, None] == 4, (1.0, 1.0, 3.0), (1.0, 1.0, 1.0))[None]


def test_body_set_external_force_can_change_between_steps(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    scene.add_bodies(np.zeros((4, 3)), mass=[1, 2, 3, 4], inertia=(1, 1, 1), name="grains")
    model = scene.build(2, device)
    model.external.force.assign(np.full((2, 4, 3), (0.0, 0.0, 12.0), dtype=np.float32))
    wc.Simulation(model, dt=0.5).step(1)
    np.testing.assert_allclose(model.sensor("grains.linear_velocity")[1, :, 2], [6, 3, 2, 1.5], rtol=1e-6)


def test_body_set_recording_has_named_dimensions(model):
    sim = wc.Simulation(model, dt=1e-4)
    recording = sim.run(3e-4, record=["grains.kinetic_energy", "grains.angular_velocity", "stand.gap"])
    assert recording["grains.kinetic_energy"].dims == ("time", "env", "grains.item")
    assert recording["grains.angular_velocity"].dims == ("time", "env", "grains.item", "axis")
    assert recording["grains.position"].dims == ("time", "env", "grains.item", "axis")
    assert recording["grains.orientation"].shape == (4, ENVS, N, 4)
    assert recording["grains.mass"].dims == ("env", "grains.item")
    assert recording["stand.gap"].sizes["stand.item"] == 4
    total = model.sensor("grains.kinetic_energy").sum(axis=1)
    others = sum(model.sensor(f"{name}.kinetic_energy") for name in ("box", "last"))
    np.testing.assert_allclose(model.sensor("scene.kinetic_energy"), total + others, rtol=1e-12)


MOTIONS = [
    wc.motions.Fixed(),
    wc.motions.Translation(),
    wc.motions.Slider(axis=(0, 0, 2)),
    wc.motions.Planar(normal=(1, 0, 1)),
    wc.motions.Prescribed(),
]


@pytest.mark.parametrize("motion", MOTIONS, ids=[type(motion).__name__ for motion in MOTIONS])
def test_joint_of_body_set_applies_to_all_bodies(motion, device):
    models = []
    for together in (True, False):
        scene = wc.Scene()
        scene.add_body(1.0, (1, 1, 1), name="first")
        if together:
            scene.add_bodies(POSITIONS, MASSES, INERTIA, TURNS, motion=motion, name="grains")
        else:
            for i in range(N):
                pose = {"position": POSITIONS[i], "orientation": TURNS[i]}
                scene.add_body(MASSES[i], INERTIA[i], motion=motion, name=f"grain_{i}", **pose)
        models.append(scene.build(2, device))
    for model in models:
        wc.Simulation(model, dt=1e-3).step(100)
    for name in ("grains.position", "grains.orientation", "grains.reaction_force", "grains.kinetic_energy"):
        np.testing.assert_array_equal(*(per_item(model, name) for model in models), err_msg=name)
    moved = np.abs(models[0].sensor("grains.position") - POSITIONS).max() > 1e-3
    assert moved == (type(motion) not in (wc.motions.Fixed, wc.motions.Prescribed))
    for key in motion.parameters():
        assert models[0][f"grains.motion.{key}"].shape == (2, N, 3)


def test_body_set_split_over_devices_matches_one_device(device, model):
    split = rolling_scene(True).build(ENVS, [device, device])
    whole = rolling_scene(True).build(ENVS, device)
    for one in (split, whole):
        set_values(one, True)
        wc.Simulation(one, dt=2e-4, deterministic=True).step(500)
    for name in ("grains.position", "touch.gap", "grains.kinetic_energy"):
        np.testing.assert_array_equal(split.sensor(name), whole.sensor(name))


def test_body_set_of_many_bodies_is_built_from_arrays(device):
    n = 20_000
    side = np.arange(n)
    at = np.stack([side % 200 * 0.1, side // 200 * 0.1, np.full(n, 0.5)], axis=1)
    scene = wc.Scene()
    ground = scene.add_surface(square(20.0), position=(10, 5, 0), name="ground")
    grains = scene.add_bodies(at, mass=1.0, inertia=(1e-3,) * 3, name="grains")
    radii = np.linspace(0.01, 0.05, n)
    material = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e5, damping=10.0))
    scene.add_contact(scene.add_point(grains, (0, 0, 0)), ground, material, radius=radii, name="touch")
    # The number of elements does not depend on the number of bodies.
    assert [len(part) for part in (scene.bodies, scene.points, scene.contacts)] == [1, 1, 1]
    model = scene.build(1, device)
    tables = model.arrays.model
    for name in ("point_body", "contact_set", "set_contact", "cluster_set", "cluster_contact", "contact_point"):
        np.testing.assert_array_equal(getattr(tables, name).numpy(), np.arange(n), err_msg=name)
    for name in ("set_cluster_start", "cluster_start", "body_cluster_start"):
        np.testing.assert_array_equal(getattr(tables, name).numpy(), np.arange(n + 1), err_msg=name)
    np.testing.assert_array_equal(tables.body_cluster.numpy(), 2 * np.arange(n))
    # The points are at the body origins, so the extent of the set is zero, not that of the packing.
    assert not tables.set_extent.numpy().any()
    np.testing.assert_allclose(model.sensor("touch.gap")[0], 0.5 - radii, atol=1e-6)
    wc.Simulation(model, dt=1e-3).step(3)
    np.testing.assert_allclose(model.sensor("grains.linear_velocity")[0, :, 2], -9.81 * 3e-3, rtol=1e-5)


def test_usd_export_draws_body_set_as_instances(model, tmp_path):
    recording = wc.Simulation(model, dt=1e-4).run(3e-4, record=["touch.gap", "grains.kinetic_energy"])
    stage = Usd.Stage.Open(str(wc.export_usd(recording, tmp_path / "set.usda")))
    assert [error.GetErrorAsString() for error in findings(stage)] == []
    path = "/World/env_1/grains/touch"
    balls = UsdGeom.PointInstancer(stage.GetPrimAtPath(path))
    assert [str(target) for target in balls.GetPrototypesRel().GetTargets()] == [f"{path}/ball"]
    np.testing.assert_allclose(value(stage, path, "scales")[:, 0], RADII, rtol=1e-6)
    assert len(value(stage, path, "protoIndices")) == N
    # The centers of the spheres are points of rotated bodies.
    for frame in range(recording.sizes["time"]):
        pose = recording.isel(time=frame, env=1)
        turned = Rotation.from_quat(pose["grains.orientation"].values).apply(PLACES)
        expected = pose["grains.position"].values + turned
        np.testing.assert_allclose(value(stage, path, "positions", frame), expected, atol=1e-6)
    np.testing.assert_allclose(
        value(stage, "/World/env_0/grains", "warpcontact:kineticEnergy", 0),
        recording["grains.kinetic_energy"].values[0, 0],
    )
    again = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/env_1/grains/hit"))
    assert len(again.GetPositionsAttr().Get(0)) == N


def test_usd_export_draws_body_set_without_contacts_at_its_centers(device, tmp_path):
    scene = wc.Scene()
    scene.add_bodies(POSITIONS, mass=1.0, inertia=(1, 1, 1), name="grains")
    recording = wc.Simulation(scene.build(1, device, "float64"), dt=1e-3).run(2e-3)
    stage = Usd.Stage.Open(str(wc.export_usd(recording, tmp_path / "set.usdc")))
    assert [error.GetErrorAsString() for error in findings(stage)] == []
    for frame in range(3):
        shown = value(stage, "/World/env_0/grains/centres", "points", frame)
        np.testing.assert_allclose(shown, recording["grains.position"].values[frame, 0], rtol=1e-6)


def test_too_long_step_for_one_body_of_a_set_warns(device):
    scene = wc.Scene()
    ground = scene.add_surface(square(5.0), name="ground")
    grains = scene.add_bodies(
        [(-1, 0, 0.2), (1, 0, 0.2)], mass=[1.0, 1e-4], inertia=[(1e-2,) * 3, (1e-6,) * 3], name="grains"
    )
    law = wc.laws.KelvinVoigt(stiffness=1e4, damping=1.0)
    points = scene.add_point(grains, (0, 0, 0))
    scene.add_contact(points, ground, wc.ContactMaterial(law=law), radius=0.1, name="touch")
    model = scene.build(2, device)
    # π √(m/k): 31 ms for the first body, 0.31 ms for the second.
    with pytest.warns(wc.ContactWarning, match=r"touch: dt = 0\.0001 s is too long: a contact lasts 0\.00031 s"):
        wc.Simulation(model, dt=1e-4).step(1)
    model["grains.mass"] = 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.reset()
        wc.Simulation(model, dt=1e-4).step(1)


def with_set(**options):
    scene = wc.Scene()
    given = {"positions": np.zeros((4, 3)), "mass": 1.0, "inertia": (1, 1, 1), "name": "grains"} | options
    return scene, scene.add_bodies(**given)


def with_contact(**options):
    scene, grains = with_set()
    points = scene.add_point(grains, (0, 0, 0), name="middles")
    return scene.add_contact(points, scene.add_surface(square()), oracle_law(), name="touch", **options)


def on_set(add):
    """Returns a call of ``add`` with a scene and its body set."""
    return lambda: add(*with_set())


REFUSED = [
    (lambda: with_set(positions=(0, 0, 0)), r"grains\.positions must have shape \(n, 3\) with n ≥ 1, got \(3,\)"),
    (lambda: with_set(positions=np.zeros((0, 3))), r"grains\.positions must have shape \(n, 3\) with n ≥ 1"),
    (lambda: with_set(positions=[(0, 0, np.nan)]), r"grains\.positions\[0, 2\] must be finite"),
    (lambda: with_set(mass=[1, 2]), r"grains\.mass must have shape \(\) or \(4,\), one per body, got \(2,\)"),
    (lambda: with_set(mass=[1, 2, 3, 0]), r"grains\.mass\[3\] must be greater than 0, got 0 kg"),
    (lambda: with_set(mass="heavy"), r"grains\.mass must be a number, got 'heavy'"),
    (lambda: with_set(inertia=1.0), r"grains\.inertia must be 3 numbers or a 3×3 tensor, or of shape \(4, 3\)"),
    (lambda: with_set(inertia=[(1, 1, 1)] * 3 + [(1, 1, 5)]), r"grains\.inertia\[3\] must be physical"),
    (
        lambda: with_set(positions=np.zeros((3, 3)), inertia=np.eye(3)),
        r"grains\.inertia of shape \(3, 3\) is ambiguous: one tensor, or the moments of each of 3 bodies",
    ),
    (
        lambda: with_set(orientations=[(0, 0, 0, 1)] * 3 + [(0, 0, 0, 2)]),
        r"grains\.orientations\[3\] must be a unit",
    ),
    (lambda: with_set(linear_velocities=np.zeros((3, 3))), r"grains\.linear_velocities must have shape \(3,\) or"),
    (lambda: with_set(color=(2, 0, 0)), r"grains\.color\[0\] must be at least 0 and at most 1, got 2"),
    (
        lambda: with_set(motion=wc.motions.Hinge(axis=(0, 0, 1), anchor=(0, 0, 0))),
        r"grains\.motion must be Free, Fixed, .* got Hinge, which needs an anchor or a function of time per body",
    ),
    (
        lambda: with_set(motion=wc.motions.Harmonic(direction=(0, 0, 1), amplitude=1, frequency=1)),
        r"grains\.motion must be Free, .* got Harmonic",
    ),
    (
        lambda: with_set(motion=wc.motions.Fixed(), linear_velocities=[(0, 0, 0)] * 3 + [(0, 0, 1)]),
        r"grains\.linear_velocities\[3\] must be zero with its motion Fixed, got \[0\.0, 0\.0, 1\.0\]",
    ),
    (
        lambda: wc.Scene().add_surface(square(), with_set()[1]),
        r"surface\.body must be a body of this scene or None",
    ),
    (
        on_set(lambda scene, grains: scene.add_surface(square(), grains)),
        r"surface\.body must be one body, from add_body, got the set 'grains'",
    ),
    (
        on_set(lambda scene, grains: scene.add_points(grains, np.zeros((3, 3)))),
        r"points\.position must have shape \(4, 3\), one for each body of 'grains', got \(3, 3\)",
    ),
    (
        on_set(
            lambda scene, grains: scene.add_spring_damper(
                scene.add_point(grains, (0, 0, 0)), scene.add_point(None, (0, 0, 0)), stiffness=1.0
            )
        ),
        r"point_a must be one point, from add_point, got the 4 points",
    ),
    (lambda: with_contact(radius=[0.1, 0.1]), r"touch\.radius must be 4 numbers, got"),
    (lambda: with_contact(radius=[0.1, 0.1, 0.1, -1]), r"touch\.radius\[3\] must be at least 0"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message[:40] for _, message in REFUSED])
def test_body_set_raises_for_invalid_arguments(call, message):
    with pytest.raises(ValueError, match=message):
        call()
