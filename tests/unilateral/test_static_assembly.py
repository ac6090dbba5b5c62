"""Rigid assemblies: contacts of all kinds, coefficients of each environment, and loads."""

import numpy as np
import pytest
from rigid_scenes import G, ball, rigid

import warpcontact as wc
from warpcontact.unilateral import EventDriven
from warpcontact.unilateral.reference.contacts import closest_on_segments


def test_closest_points_of_segments_match_brute_force():
    rng = np.random.default_rng(3)
    d, g, h = rng.normal(size=(3, 200, 3))
    g[:20], h[10:30] = 0.0, 0.0
    g[30:50] = h[30:50] * rng.uniform(-2.0, 2.0, (20, 1))
    s, t = closest_on_segments(d, g, h)
    assert (np.abs(s) <= 1.0).all()
    assert (np.abs(t) <= 1.0).all()
    found = np.linalg.norm(d + s[:, None] * g - t[:, None] * h, axis=1)
    # No pair of grid points is nearer, and the contact point is one of theirs.
    grid = np.linspace(-1.0, 1.0, 41)
    x, y = (values.reshape(-1, 1, 1) for values in np.meshgrid(grid, grid))
    assert (found <= np.linalg.norm(d + x * g - y * h, axis=2).min(axis=0) + 1e-12).all()


def capsules(gap):
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    shapes = []
    for number, (x, z) in enumerate(((0.0, 0.0), (0.1, 0.4 + gap), (2.0, 0.0))):
        body = scene.add_body(mass=1.0, inertia=[0.1] * 3, position=(x, 0.05 * number, z), name=f"rod_{number}")
        form = wc.shapes.Capsule(radius=0.2, half_length=0.5)
        shapes.append(scene.add_shape(body, form, name=f"capsule_{number}"))
    scene.bodies[1].orientation[:] = [np.sin(0.3), 0.0, 0.0, np.cos(0.3)]
    scene.add_particle_contact(shapes, rigid(0.3), name="rods")
    return scene.build(device="cpu", precision="float64")


def test_assembled_particle_pairs_match_the_engine():
    model = capsules(gap=-0.01)
    seen = model.contact_pairs("rods")
    own = wc.unilateral.assemble(model)
    assert own.labels == ["rods: capsule_0 on capsule_1"]
    np.testing.assert_allclose(own.gap, seen["gap"].values, atol=1e-15)
    np.testing.assert_allclose(own.axes[:, 0], seen["normal"].values, atol=1e-14)
    np.testing.assert_allclose(own.point, seen["point"].values, atol=1e-15)
    # Without contact if they are apart.
    apart = capsules(gap=1.0)
    assert len(apart.contact_pairs("rods")["gap"]) == 0
    assert wc.unilateral.assemble(apart).count == 0
    assert wc.unilateral.assemble(apart, closed=1.0).gap.min() > 0.0


def test_assembled_coefficients_are_those_of_the_environment():
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0), (1, 1)), name="ground")
    body = scene.add_body(mass=1.0, inertia=[0.1] * 3, name="body")
    points = scene.add_points(body, [(0, 0, 0), (1, 0, 0)], name="points")
    hollars = wc.friction.Hollars(mu_static=0.6, mu_dynamic=0.4)
    law = wc.laws.HuntCrossley(stiffness=1e6, restitution=0.3)
    scene.add_contact(points, ground, wc.ContactMaterial(law=law, friction=hollars), name="touch")
    model = scene.build(envs=3, device="cpu", precision="float64")
    model["touch.law.restitution"] = [0.1, 0.2, 0.3]
    model["touch.friction.mu_static"] = [0.7, 0.8, 0.9]
    own = wc.unilateral.assemble(model, env=1)
    assert own.names.tolist() == ["touch", "touch"]
    assert own.labels == ["touch[0]", "touch[1]"]
    np.testing.assert_array_equal(own.items, [0, 1])
    np.testing.assert_array_equal(own.restitution, [0.2, 0.2])
    np.testing.assert_array_equal(own.mu_static, [0.8, 0.8])
    np.testing.assert_array_equal(own.mu, [0.4, 0.4])
    W = own.delassus
    np.testing.assert_allclose(W, W.T, atol=1e-15)
    np.testing.assert_allclose(W[:3, :3], np.eye(3), atol=1e-15)
    # K of the second contact is 1 m from the center: 1/m + 1/I across.
    np.testing.assert_allclose(np.diag(W[3:, 3:]), [11.0, 1.0, 11.0], atol=1e-14)


def test_assembled_float32_environment_is_accurate_to_its_precision():
    model = ball(height=1e-7)
    wide = wc.unilateral.assemble(model)
    narrow = wc.unilateral.assemble(model.scene.build(device="cpu", precision="float32"))
    np.testing.assert_allclose(narrow.gap, wide.gap, atol=1e-8)  # the radius is rounded as well
    np.testing.assert_allclose(narrow.H, wide.H, atol=1e-7)


def test_contact_couplings_are_assembled_as_loads():
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0), (1, 1)), name="ground")
    brick = scene.add_body(mass=3.0, inertia=[0.1] * 3, position=(0.1, 0, 0.11), name="brick")
    skin = scene.add_surface(wc.meshes.box((0.4, 0.2, 0.2)), brick, name="skin")
    held = wc.ContactRange(k1=2e4, k2=0.0, effective_range=0.05)
    scene.add_contact_coupling(skin, ground, held, facing="projected", sides="first", name="cushion")
    model = scene.build(device="cpu", precision="float64")
    own = wc.unilateral.assemble(model)
    assert own.count == 0
    weight = np.array([0.0, 0.0, -3.0 * G])
    np.testing.assert_allclose(own.force[:3] - weight, model.sensor("cushion.force")[0], rtol=1e-14)
    np.testing.assert_allclose(own.force[3:], model.sensor("cushion.torque")[0], atol=1e-12)
    assert own.force[2] != weight[2]


def test_event_driven_mass_on_spring_hits_a_stop_at_closed_form_times():
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    wall = scene.add_shape(None, wc.shapes.Plane(), name="wall")
    mass = scene.add_body(
        mass=2.0, inertia=[0.1] * 3, position=(0, 0, 1.5), motion=wc.motions.Slider(axis=(0, 0, 1)), name="mass"
    )
    tip = scene.add_shape(mass, wc.shapes.Sphere(0.5), name="tip")
    scene.add_shape_contact(tip, wall, rigid(0.0, 0.5), name="stop")
    ends = scene.add_point(mass, (0, 0, 0)), scene.add_point(None, (0, 0, 3.0))
    scene.add_spring_damper(*ends, stiffness=50.0, damping=0.0, rest_length=2.5)
    run = EventDriven(scene.build(device="cpu", precision="float64")).run(1.2)
    # The rest length of the spring ends where the ball is in contact; it returns after half a period with half the
    # speed.
    rate = 5.0
    first, second = run.events_of("IMPACT")[:2]
    assert first.time == pytest.approx(0.5 * np.pi / rate, abs=1e-10)
    assert first.approach_speed == pytest.approx(1.0 * rate, abs=1e-10)
    assert second.time == pytest.approx(1.5 * np.pi / rate, abs=1e-10)
    assert second.approach_speed == pytest.approx(0.5 * rate, abs=1e-10)


def test_event_driven_point_sliding_off_a_table_lifts_off():
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    table = scene.add_surface(wc.meshes.grid((1.0, 1.0), (1, 1)), name="table")
    puck = scene.add_body(
        mass=1.0,
        inertia=[0.1] * 3,
        position=(0.0, 0.0, 0.1),
        linear_velocity=(2.0, 0.0, 0.0),
        motion=wc.motions.Translation(),
        name="puck",
    )
    scene.add_contact(scene.add_point(puck, (0, 0, -0.1)), table, rigid(0.2), name="touch")
    run = EventDriven(scene.build(device="cpu", precision="float64")).run(0.4)
    speed = np.sqrt(4.0 - 2.0 * 0.2 * G * 0.5)
    leaves = (2.0 - speed) / (0.2 * G)
    (event,) = run.events
    # The engine accepts a point up to a small fraction of an edge outside the boundary.
    assert event.kind == "LIFT_OFF"
    assert event.time == pytest.approx(leaves, abs=2e-4)
    falls = 0.1 - 0.5 * G * (0.4 - event.time) ** 2
    assert run["puck.position"].values[-1, 2] == pytest.approx(falls, abs=1e-10)


def test_event_driven_stick_slip_uses_static_and_dynamic_friction():
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_shape(None, wc.shapes.Plane(), name="ground")
    block = scene.add_body(
        mass=1.0, inertia=[0.1] * 3, position=(0, 0, 0.5), motion=wc.motions.Translation(), name="block"
    )
    foot = scene.add_shape(block, wc.shapes.Sphere(0.5), name="foot")
    friction = wc.friction.Hollars(mu_static=0.6, mu_dynamic=0.4)
    hard = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e6), friction=friction)
    scene.add_shape_contact(foot, ground, hard, name="touch")
    # A sled pulls a block by a spring; the block slips when the force is μ_s m g.
    sled = scene.add_body(
        mass=1.0,
        inertia=[0.1] * 3,
        position=(2, 0, 0.5),
        linear_velocity=(0.5, 0, 0),
        motion=wc.motions.Prescribed(),
        name="sled",
    )
    ends = scene.add_point(block, (0, 0, 0)), scene.add_point(sled, (0, 0, 0))
    scene.add_spring_damper(*ends, stiffness=40.0, damping=0.0, rest_length=2.0)
    run = EventDriven(scene.build(device="cpu", precision="float64")).run(1.3)
    slips, sticks = run.events
    assert (slips.kind, sticks.kind) == ("SLIP", "STICK")
    start = 0.6 * G / (40.0 * 0.5)
    assert slips.time == pytest.approx(start, abs=1e-10)
    # From there m ẍ = k (v t + …) − μ_d m g: x = v t − (v/ω) sin ωt + (Δμ g/ω²)(1 − cos ωt), until it is at rest
    # again.
    rate, jump = np.sqrt(40.0), 0.2 * G / 40.0
    time = sticks.time - start
    speed = 0.5 - 0.5 * np.cos(rate * time) + jump * rate * np.sin(rate * time)
    assert speed == pytest.approx(0.0, abs=1e-9)
    expected_displacement = 0.5 * time - 0.5 / rate * np.sin(rate * time) + jump * (1.0 - np.cos(rate * time))
    assert run["block.position"].values[-1, 0] == pytest.approx(expected_displacement, abs=1e-10)
