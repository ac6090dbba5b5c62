"""Warnings about the time step of body contact."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import warpcontact as wc
from warpcontact.forces.body_contact.body_sums import sum_warnings
from warpcontact.forces.body_contact.step_warnings import pair_estimates

MASS, SIDE, MODULUS = 2.0, 0.1, 1e7
TURN = (0.5, -0.4, 0.3)


def box_on_box(device, friction=None, **law):
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.RoundedBox((1.0, 1.0, 0.1)), position=(0, 0, -0.1), name="floor")
    body = scene.add_body(mass=MASS, inertia=[MASS * SIDE**2 / 6] * 3, position=(0, 0, SIDE / 2), name="body")
    box = scene.add_shape(body, wc.shapes.RoundedBox((SIDE / 2,) * 3), name="box")
    material = wc.ContactMaterial(
        law=wc.laws.ElasticFoundation(stiffness=MODULUS, **law), friction=friction or wc.friction.Frictionless()
    )
    scene.add_body_contact(box, floor, material, name="press")
    return scene.build(envs=2, device=device, precision="float64")


def test_time_step_longer_than_a_twentieth_of_the_contact_is_reported(device):
    duration = np.pi * np.sqrt(MASS / (MODULUS * SIDE**2))
    model = box_on_box(device)
    assert wc.Simulation(model, dt=duration / 20.1).check() == []
    (sentence,) = wc.Simulation(model, dt=duration / 19.9).check()
    assert sentence.startswith(f"press: dt = {duration / 19.9:g} s is too long: a contact lasts {duration:.2g} s")
    # The smaller box of an environment has a longer contact.
    model["box.half_extents"] = [[SIDE / 2] * 3, [SIDE / 4] * 3]
    (sentence,) = wc.Simulation(model, dt=duration / 15).check()
    assert "in environment 0" in sentence


def test_damping_that_makes_steps_unstable_is_reported(device):
    rate = np.sqrt(MODULUS * SIDE**2 * (1 + 3000.0) / MASS)
    model = box_on_box(device, damping=3000.0)
    assert wc.Simulation(model, dt=1.99 / rate).check() == []
    (sentence,) = wc.Simulation(model, dt=2.01 / rate).check()
    assert "too long" in sentence


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_friction_that_makes_steps_unstable_is_reported(factor, device):
    stiffness = 1e7
    friction = wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=stiffness)
    # A cube that a force at its base pushes also turns: 2/5 of its mass.
    limit = 2 * np.sqrt(0.4 * MASS / stiffness)
    found = wc.Simulation(box_on_box(device, friction), dt=factor * limit).check()
    assert [one for one in found if "friction, CundallStrack" in one] == (found[-1:] if factor > 1 else [])
    assert (factor > 1) == any("unstable" in one for one in found)


@pytest.mark.parametrize(
    ("form", "side"),
    [
        (wc.shapes.Cylinder(0.1, 0.3), 0.2 * 0.6),
        (wc.shapes.Capsule(0.1, 0.2), 0.2 * 0.6),
        (wc.shapes.Cone(0.3, 0.2), 0.6 * 0.6),
        (wc.shapes.Ellipsoid((0.1, 0.2, 0.3)), 0.4 * 0.6),
        (wc.shapes.Sphere(0.1), 0.2 * 0.2),
    ],
    ids=["cylinder", "capsule", "cone", "ellipsoid", "sphere"],
)
def test_time_step_is_compared_with_the_largest_side_around_a_curved_shape(form, side, device):
    scene = wc.Scene()
    body = scene.add_body(mass=MASS, inertia=[0.1] * 3, position=(0, 0, 1.0), name="body")
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=MODULUS))
    plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
    scene.add_body_contact(scene.add_shape(body, form), plane, material, name="press")
    model = scene.build(device=device, precision="float64")
    duration = np.pi * np.sqrt(MASS / (MODULUS * side))
    assert wc.Simulation(model, dt=duration / 20.1).check() == []
    (sentence,) = wc.Simulation(model, dt=duration / 19.9).check()
    assert f"a contact lasts {duration:.2g} s" in sentence


def plate_on_posts(device, *, mesh=False, one_contact=False, law=None, turn=(0.0, 0.0, 0.0)):
    """A plate of 1 m on nine posts; apart from them in the second environment. ``turn`` is the rotation vector of all of them [rad]."""
    scene = wc.Scene()
    turn = Rotation.from_rotvec(turn)
    pose = {"orientation": turn.as_quat()}
    body = scene.add_body(
        mass=MASS,
        inertia=np.array([1, 1, 2]) * MASS / 12,
        position=turn.apply((0, 0, SIDE / 2)),
        name="plate",
        **pose,
    )
    if mesh:
        plate = scene.add_surface(wc.meshes.box((1.0, 1.0, SIDE)), body)
    else:
        plate = scene.add_shape(body, wc.shapes.RoundedBox((0.5, 0.5, SIDE / 2)))
    material = wc.ContactMaterial(law=law or wc.laws.ElasticFoundation(stiffness=MODULUS))
    posts = [
        scene.add_shape(
            None, wc.shapes.RoundedBox((SIDE / 2,) * 3), position=turn.apply((x, y, -SIDE / 2)), **pose
        )
        for x in (-0.4, 0.0, 0.4)
        for y in (-0.4, 0.0, 0.4)
    ]
    if one_contact:
        scene.add_body_contact(plate, posts, material, name="all")
    else:
        for i, post in enumerate(posts):
            scene.add_body_contact(plate, post, material, name=f"on_{i}")
    model = scene.build(envs=2, device=device, precision="float64")
    model["plate.position"] = turn.apply([[0, 0, SIDE / 2], [0, 0, 1.0]])
    return model


@pytest.mark.parametrize(
    "options", [{}, {"mesh": True}, {"one_contact": True}, {"turn": TURN}, {"turn": TURN, "mesh": True}]
)
def test_stiffness_of_the_contacts_of_a_body_adds_up(options, device):
    """A plate on nine springs rocks with λ = 6 k a²/I = 72 (0.4)² k/m, and heaves with 9 k/m."""
    limit = np.pi / np.sqrt(72 * 0.4**2 * MODULUS * SIDE**2 / MASS) / 10
    assert wc.Simulation(plate_on_posts(device, **options), dt=0.99 * limit).check() == []
    model = plate_on_posts(device, **options)
    (sentence,) = wc.Simulation(model, dt=1.01 * limit).check()
    assert sentence.startswith(f"plate: dt = {1.01 * limit:g} s is too long for its 9 contacts together (")
    assert "in environment 0" in sentence
    assert f"Use dt ≤ {limit:.2g} s" in sentence
    # Apart from the posts, it has no contact, also where boxes along the axes of the world overlap.
    for gap in (0.01 * SIDE, 1.0):
        model["plate.position"] = Rotation.from_rotvec(options.get("turn", (0, 0, 0))).apply(
            [0, 0, SIDE / 2 + gap]
        )
        assert wc.Simulation(model, dt=1.01 * limit).check() == []


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_damping_of_the_contacts_of_a_body_adds_up(factor, device):
    """A plate on nine dashpots rocks with the rate λ = 72 (0.4)² c'/m, and steps are unstable for λ dt > 2."""
    damping = 1e3
    rate = 72 * 0.4**2 * damping / MASS
    # In a step, each contact has c' = c (√(1 + y²) − y), y = c dt/(4 m).
    y = brentq(lambda y: rate * (np.sqrt(1 + y**2) - y) * 4 * MASS * y / damping - 2, 0.0, 1.0)
    dt = factor * 4 * MASS * y / damping
    model = plate_on_posts(device, law=wc.laws.KelvinVoigt(stiffness=1.0, damping=damping))
    found = wc.Simulation(model, dt=dt).check()
    assert len(found) == (factor > 1)
    if found:
        assert "its 9 contacts together" in found[0]
        assert f"damping is unstable. Use dt ≤ {2 / rate:.2g} s" in found[0]


@pytest.mark.parametrize("steps", [8.0, 20.0])
def test_recommended_time_step_satisfies_all_limits(steps, device):
    """Damping is stable up to 1/``steps`` of half a period, of which ten steps are recommended."""
    square = 72 * 0.4**2 / MASS  # of the frequency per stiffness of a contact, and rate per damping
    stiffness = 1e5
    half_period = np.pi / np.sqrt(square * stiffness)
    damping = 2 / square / (half_period / steps)
    model = plate_on_posts(device, law=wc.laws.KelvinVoigt(stiffness=stiffness, damping=damping))
    # Long enough for each contact alone: it has 20 steps in π √(m/k).
    (sentence,) = wc.Simulation(model, dt=0.16 * half_period).check()
    limit = half_period / max(steps, 10.0)
    assert ("damping is unstable" in sentence) == (steps > 10)
    assert f"Use dt ≤ {limit:.2g} s" in sentence
    assert wc.Simulation(model, dt=0.99 * limit).check() == []


def test_stack_has_no_warning_at_the_time_step_of_a_pair(device):
    """Three cubes on a floor have λ = 2 (1 − cos 5π/7) k/m, which ten steps in half a period allow."""
    scene = wc.Scene()
    solids = [scene.add_shape(None, wc.shapes.Plane(), name="floor")]
    for i in range(3):
        body = scene.add_body(mass=MASS, inertia=[MASS * SIDE**2 / 6] * 3, position=(0, 0, (i + 0.5) * SIDE))
        solids.append(scene.add_shape(body, wc.shapes.RoundedBox((SIDE / 2,) * 3)))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=MODULUS))
    contact = scene.add_body_contact(solids, material)
    model = scene.build(device=device, precision="float64")
    limit = np.pi / np.sqrt(2 * MODULUS * SIDE**2 / MASS) / 20
    assert wc.Simulation(model, dt=0.99 * limit).check() == []
    (group,) = model.parts[0].of_family("body contact")
    estimates = [pair_estimates(model, contact, group)]
    square = 2 * (1 - np.cos(5 * np.pi / 7)) * MODULUS * SIDE**2 / MASS
    (sentence,) = sum_warnings(model, group.tables, estimates, 1.01 * np.pi / np.sqrt(square) / 10)
    assert "contacts together" in sentence
    assert sum_warnings(model, group.tables, estimates, 0.99 * np.pi / np.sqrt(square) / 10) == []


def test_friction_of_the_pads_of_a_gripper_adds_up(device):
    """A cube between two pads turns with the damping c r² of both: λ = 2 c r²/I = 3 c/m; a pair alone has 5/2 c/m."""
    damping = 1e3
    friction = wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1.0, damping=damping)
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e4), friction=friction)
    scene = wc.Scene()
    cube = scene.add_body(mass=MASS, inertia=[MASS * SIDE**2 / 6] * 3, name="cube")
    solid = scene.add_shape(cube, wc.shapes.RoundedBox((SIDE / 2,) * 3))
    for side in (-1, 1):
        pad = scene.add_shape(None, wc.shapes.RoundedBox((SIDE / 2,) * 3), position=(side * SIDE, 0, 0))
        scene.add_body_contact(solid, pad, material)
    model = scene.build(device=device, precision="float64")
    limit = 2 * MASS / (3 * damping)
    assert wc.Simulation(model, dt=0.99 * limit).check() == []
    (sentence,) = wc.Simulation(model, dt=1.01 * limit).check()
    assert "cube: " in sentence
    assert "2 contacts together" in sentence
    assert "friction is unstable" in sentence


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_steps_are_unstable_beyond_the_reported_limit(factor, device):
    """The spin of a cube between two pads decays, or grows."""
    damping = 1e3
    friction = wc.friction.CundallStrack(mu_static=1e3, mu_dynamic=1e3, stiffness=1.0, damping=damping)
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e4), friction=friction)
    # The estimate of friction is under the weight.
    scene = wc.Scene(gravity=(0, 0, -0.1))
    cube = scene.add_body(mass=MASS, inertia=[MASS * SIDE**2 / 6] * 3, angular_velocity=(0, 0, 1e-4), name="cube")
    solid = scene.add_shape(cube, wc.shapes.RoundedBox((SIDE / 2,) * 3))
    for side in (-1, 1):
        place = (side * (SIDE - 1e-3), 0, 0)
        pad = scene.add_shape(None, wc.shapes.RoundedBox((SIDE / 2,) * 3), position=place)
        scene.add_body_contact(solid, pad, material)
    model = scene.build(device=device, precision="float64")
    sim = wc.Simulation(model, dt=factor * 2 * MASS / (3 * damping))
    assert len(sim.check()) == (factor > 1)
    sim.step(200)
    assert (np.abs(model.sensor("cube.angular_velocity")).max() > 1e-4) == (factor > 1)
