"""Loads that equilibrium does not determine: pads of a gripper with several contacts each."""

import numpy as np
import pytest
from nonsmooth_scenes import G, rigid

import warpcontact as wc

MU = 0.5
#: Force on each pad [N]. Holding the box of 1 kg needs m g/(2 μ) = 9.81 N.
FORCES = np.array([20.0, 10.1, 8.0])


def gripper(forces, one_by_one=False):
    """A box of 1 kg between two pads that slide along x, each with four points; one environment per force."""
    scene = wc.Scene()
    box = scene.add_body(1.0, (2e-3,) * 3, name="box")
    faces = scene.add_surface(wc.meshes.box((0.1, 0.1, 0.1)), box, name="faces")
    pads = [
        scene.add_body(
            0.2, (1e-4,) * 3, position=(0.06 * s, 0, 0), name=f"pad{i}", motion=wc.motions.Slider(axis=(1, 0, 0))
        )
        for i, s in enumerate((-1, 1))
    ]
    corners = [(y, z) for y in (-0.02, 0.02) for z in (-0.02, 0.02)]
    if one_by_one:
        # Contacts of the two pads in turn.
        for number, corner in enumerate(corners):
            for pad, x in zip(pads, (0.01, -0.01), strict=True):
                point = scene.add_point(pad, (x, *corner))
                scene.add_contact(point, faces, rigid(mu=MU), name=f"{pad.name}_{number}")
    else:
        for pad, x in zip(pads, (0.01, -0.01), strict=True):
            points = scene.add_points(pad, [(x, *corner) for corner in corners], name=f"{pad.name}_points")
            scene.add_contact(points, faces, rigid(mu=MU), name=f"{pad.name}_touch")
    model = scene.build(envs=len(forces), device="cpu", precision="float64")
    for i, s in enumerate((-1, 1)):
        model[f"pad{i}.external_force"] = np.outer(forces, (-s, 0, 0))
    return model


@pytest.mark.parametrize("solver", ["auto", "gauss_seidel", "accelerated"])
def test_gripper_holds_a_box_and_shares_its_load(solver):
    model = gripper(FORCES)
    sim = wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean(solver=solver))
    sim.step(1)
    # The fourfold symmetry of each pad.
    loads = model.sensor("pad0_touch.normal_force")
    assert loads == pytest.approx(np.repeat(FORCES[:, None] / 4, 4, axis=1), rel=1e-2)
    sim.step(24)
    held, falling = slice(0, 2), 2
    # Friction 2 μ F holds a part of the weight only.
    acceleration = model.sensor("box.linear_velocity")[falling, 2] / (25 * 2e-3)
    assert acceleration == pytest.approx(2 * MU * FORCES[falling] - G, rel=1e-6)
    sim.step(1975)
    assert np.abs(model.sensor("box.position")[held]).max() < 1e-6
    assert np.abs(model.sensor("box.angular_velocity")[held]).max() < 1e-6
    friction = -model.sensor("pad0_touch.friction_force")[held, :, 2].sum(axis=1)
    assert friction == pytest.approx([G / 2, G / 2], rel=1e-5)
    assert not model.sensor("scene.solve_failures").any()


def test_gripper_holds_a_box_with_contacts_in_any_order():
    model = gripper(FORCES[:2], one_by_one=True)
    sim = wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean(solver="gauss_seidel"))
    sim.step(500)
    assert np.abs(model.sensor("box.position")).max() < 1e-6
    assert np.abs(model.sensor("box.angular_velocity")).max() < 1e-6


@pytest.mark.parametrize("solver", ["auto", "accelerated"])
def test_compliance_is_a_spring_at_each_contact(solver):
    """A block off its center on four points sinks by c times the load of each, which decreases linearly across it."""
    compliance = np.array([1e-9, 1e-8, 1e-7])
    scene = wc.Scene()
    floor = scene.add_surface(wc.meshes.grid((2.0, 2.0), (3, 3)), name="floor")
    body = scene.add_body(8.0, (0.05,) * 3, position=(0, 0, 0.1), name="block")
    feet = [(x, y, -0.1) for x in (-0.1, 0.2) for y in (-0.1, 0.1)]
    material = wc.ContactMaterial(law=wc.laws.Rigid(compliance=0.0), friction=wc.friction.Coulomb(mu=MU))
    scene.add_contact(scene.add_points(body, feet, name="feet"), floor, material, name="touch")
    model = scene.build(envs=len(compliance), device="cpu", precision="float64")
    wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean(solver=solver)).step(5)
    assert np.abs(model.sensor("touch.gap")).max() < 1e-9
    # The value changes between steps, and needs other kernels.
    model["touch.law.compliance"] = compliance
    sim = wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean(solver=solver))
    sim.step(300)
    loads = 8.0 * G * np.array([1 / 3, 1 / 3, 1 / 6, 1 / 6])
    np.testing.assert_allclose(model.sensor("touch.normal_force"), [loads] * 3, rtol=1e-5)
    np.testing.assert_allclose(model.sensor("touch.penetration"), np.outer(compliance, loads), rtol=1e-4)
    assert np.abs(model.sensor("block.linear_velocity")).max() < 1e-8
    assert not model.sensor("scene.solve_failures").any()


def test_compliant_pads_share_loads_from_any_start():
    """With a compliance the loads are unique: equal on the points of a pad."""
    model = gripper(FORCES[:2])
    for i in range(2):
        model[f"pad{i}_touch.law.compliance"] = 1e-8
    sim = wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean(solver="gauss_seidel"))
    sim.step(500)
    loads = model.sensor("pad0_touch.normal_force")
    np.testing.assert_allclose(loads, np.repeat(FORCES[:2, None] / 4, 4, axis=1), rtol=1e-3)
    assert np.abs(model.sensor("box.position")).max() < 1e-6
    assert np.abs(model.sensor("box.angular_velocity")).max() < 1e-6


def test_event_driven_simulation_refuses_compliance():
    model = gripper(FORCES[:1])
    model["pad0_touch.law.compliance"] = 1e-8
    with pytest.raises(
        ValueError, match=r"pad0_touch\.law\.compliance must be 0 m/N for this method, got 1e-08 m/N"
    ):
        wc.unilateral.EventDriven(model)


@pytest.mark.parametrize("mu", [MU, 0.0])
@pytest.mark.parametrize("solver", ["auto", "gauss_seidel", "accelerated"])
def test_boxes_that_fell_on_each_other_load_their_corners_equally(solver, mu):
    """The last box is next to the middle of the one below: its load, and so all below it, is affine in the position."""
    count, gap, offset = 5, 1e-3, 0.01
    # Not in the world axes, so that impulses along the normal have rounding errors across it.
    half = 0.2
    turn = (0.0, np.sin(half), 0.0, np.cos(half))
    x_axis, up = (
        np.array([np.cos(2 * half), 0, -np.sin(2 * half)]),
        np.array([np.sin(2 * half), 0, np.cos(2 * half)]),
    )
    scene = wc.Scene(gravity=-G * up)
    below = scene.add_shape(None, wc.shapes.Plane(), orientation=turn, name="floor")
    for i in range(count):
        place = offset * (i == count - 1) * x_axis + (0.05 + (0.1 + gap) * i) * up
        box = scene.add_body(1.0, (1e-2 / 6,) * 3, position=place, orientation=turn, name=f"box_{i}")
        shape = scene.add_shape(box, wc.shapes.RoundedBox((0.05,) * 3))
        scene.add_body_contact(shape, below, rigid(mu=mu), name=f"touch_{i}")
        below = shape
    model = scene.build(envs=1, device="cpu", precision="float64")
    wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean(solver=solver)).step(300)
    for i in range(count - 1):
        point, force = (model.sensor(f"touch_{i}.{key}")[0] for key in ("point", "point_force"))
        load = (count - i) * G
        # The center of the load is at offset/(count − i), in a square of corners at ±50 mm.
        expected = load / 4 * (1 + offset / (count - i) * point @ x_axis / 0.05**2)
        # Differences below 1e-6 of the mean, and of the tolerance of the solver, are left.
        assert force @ up == pytest.approx(expected, rel=1e-5)
