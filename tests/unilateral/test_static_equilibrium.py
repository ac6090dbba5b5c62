"""Equilibrium of rigid assemblies and contact forces, against closed forms."""

import math

import numpy as np
import pytest
from rigid_scenes import G, block, ladder, rigid, three_balls

import warpcontact as wc
from warpcontact.scene.status import ContactMode

# With known contact modes, the forces solve a linear system; the error is rounding of 100 N.
FORCE = 1.0e-9


@pytest.mark.parametrize(
    ("push", "height", "mu", "sums", "acceleration", "turning"),
    [
        (20.0, 1.0, 0.5, [(-0.5, 29.05), (0.5, 69.05), (None, -20.0)], (0.0, 0.0), 0.0),
        (60.0, 0.5, 0.5, [(-0.5, 30.0), (0.5, 68.1), (None, -49.05)], (1.095, 0.0), 0.0),
        (40.0, 1.8, 0.9, [(-0.5, 0.0), (0.5, 104.985), (None, -26.23)], (1.377, 0.6885), 1.377),
    ],
    ids=["rests", "slides", "tips"],
)
def test_pushed_block_equilibrium_rests_slides_or_tips(push, height, mu, sums, acceleration, turning):
    result = wc.unilateral.equilibrium(block(push, height, mu))
    assert result.holds is (acceleration == (0.0, 0.0))
    np.testing.assert_allclose(result.linear_acceleration[0, [0, 2]], acceleration, atol=FORCE)
    np.testing.assert_allclose(result.angular_acceleration[0], (0.0, turning, 0.0), atol=FORCE)
    for side, expected in sums:
        if side is None:
            assert result.force_of("feet")[0] == pytest.approx(expected, abs=FORCE)
        else:
            corners = np.sign(result.assembly.point[:, 0]) == np.sign(side)
            assert result.normal_force[corners].sum() == pytest.approx(expected, abs=FORCE)
    # Four contact points, six equations: the forces are in the cone, but not unique.
    tangential = np.linalg.norm(result.force[:, :2], axis=1)
    assert (tangential <= mu * result.normal_force * (1.0 + 1e-9) + FORCE).all()
    assert not result.determined[result.mode != ContactMode.OPEN].any()
    assert result.residual < 1e-12


def test_equilibrium_text_states_forces_and_accelerations():
    rests, slides = (wc.unilateral.equilibrium(block(push, 0.5, 0.5)) for push in (20.0, 60.0))
    assert str(rests).startswith("in equilibrium: 4 closed contacts")
    assert "feet[0]: STICK" in str(rests)
    assert "not unique" in str(rests)
    assert "not in equilibrium: box would move" in str(slides)
    assert "(1.095, 0, 0) m/s²" in str(slides)
    with pytest.raises(KeyError, match="contact 'foot' is not closed; closed contacts: feet"):
        rests.force_of("foot")


@pytest.mark.parametrize("slope", np.radians([5.0, 15.0, 20.0]))
def test_block_on_slope_is_in_equilibrium_up_to_friction_angle(slope):
    threshold = math.tan(slope)
    holds = wc.unilateral.equilibrium(block(slope=slope, mu=threshold * (1.0 + 1e-4)))
    assert holds.holds
    np.testing.assert_allclose(holds.body_force[0], (0.0, 0.0, 10.0 * G), atol=FORCE)
    mu = threshold * (1.0 - 1e-4)
    slides = wc.unilateral.equilibrium(block(slope=slope, mu=mu))
    assert not slides.holds
    down = np.linalg.norm(slides.linear_acceleration[0])
    assert down == pytest.approx(G * (math.sin(slope) - mu * math.cos(slope)), abs=FORCE)


def test_ladder_equilibrium_matches_closed_form_friction():
    angle = math.radians(60.0)
    # Moments about the lower end: N_wall = m g/(2 tan θ), which friction at the lower end balances.
    threshold = 1.0 / (2.0 * math.tan(angle))
    result = wc.unilateral.equilibrium(ladder(threshold * (1.0 + 1e-6), angle))
    assert result.holds
    assert result.determined.all()
    np.testing.assert_allclose(result.force_of("top"), (-12.0 * G * threshold, 0.0, 0.0), atol=FORCE)
    np.testing.assert_allclose(result.force_of("foot"), (12.0 * G * threshold, 0.0, 12.0 * G), atol=FORCE)
    assert not wc.unilateral.equilibrium(ladder(threshold * (1.0 - 1e-4), angle)).holds


def test_three_ball_equilibrium_requires_closed_form_friction():
    model, sine = three_balls(mu_between=0.5, mu_ground=0.5)
    threshold = math.tan(0.5 * math.asin(sine))
    model["balls.friction.mu"] = threshold * (1.0 + 1e-6)
    result = wc.unilateral.equilibrium(model)
    assert result.holds
    # N = m g/2 between balls for any angle; friction of both contacts of a lower ball is equal.
    between = result.assembly.names == "balls"
    np.testing.assert_allclose(result.normal_force[between], 0.5 * 3.0 * G, atol=FORCE)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        friction = sign * -0.5 * 3.0 * G * threshold_of(sine)
        np.testing.assert_allclose(result.force_of(f"{side}_floor"), (friction, 0.0, 4.5 * G), atol=FORCE)
    model["balls.friction.mu"] = threshold * (1.0 - 1e-4)
    assert not wc.unilateral.equilibrium(model).holds
    # The ground needs less: μ N with N = 3 m g/2.
    model["balls.friction.mu"] = 0.5
    for name in ("left_floor", "right_floor"):
        model[f"{name}.friction.mu"] = threshold / 3.0 * (1.0 - 1e-4)
    assert not wc.unilateral.equilibrium(model).holds


def threshold_of(sine):
    return math.tan(0.5 * math.asin(sine))


def bars():
    """Bars of 4 kg and 2 m with different joints, and with contact points at their free ends."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(wc.meshes.grid((40.0, 40.0), (1, 1)), name="ground")
    motions = {
        "hinged": wc.motions.Hinge(axis=(0, 1, 0), anchor=(-1.0, 0.0, 0.0)),
        "on_ball": wc.motions.Ball(anchor=(-1.0, 0.0, 0.0)),
        "on_rail": wc.motions.Slider(axis=(0, 0.6, 0.8)),
        "in_plane": wc.motions.Planar(normal=(0, 1, 0)),
        "upright": wc.motions.Translation(),
        "fixed": wc.motions.Fixed(),
    }
    for name, motion in motions.items():
        body = scene.add_body(mass=4.0, inertia=(0.01, 4.0 / 3.0, 4.0 / 3.0), motion=motion, name=name)
        ends = [(1.0, 0.0, 0.0)] if name in ("hinged", "on_ball") else [(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)]
        points = scene.add_points(body, ends, name=f"{name}_ends")
        scene.add_contact(points, ground, rigid(0.0), name=f"{name}_touch")
    return scene.build(envs=2, device="cpu", precision="float64")


@pytest.fixture(scope="module")
def jointed_bars():
    return bars()


def test_joints_carry_load_in_equilibrium(jointed_bars):
    result = wc.unilateral.equilibrium(jointed_bars, env=1)
    assert result.holds
    weight = 4.0 * G
    expected = {"hinged": 0.5, "on_ball": 0.5, "on_rail": 1.0, "in_plane": 1.0, "upright": 1.0, "fixed": 0.0}
    for name, share in expected.items():
        assert result.force_of(f"{name}_touch")[2] == pytest.approx(share * weight, abs=FORCE), name
    for name, own in (("hinged_touch", True), ("on_rail_touch", False), ("fixed_touch", False)):
        assert (result.determined[result.assembly.names == name] == own).all(), name


def test_joint_inverse_mass_matches_a_step(jointed_bars):
    # A short step under a force and a torque: velocities change by M⁻¹ F dt.
    model = bars()
    rng = np.random.default_rng(1)
    names = wc.unilateral.assemble(model).body_names
    for name, row in zip(names, rng.normal(size=(6, 6)), strict=True):
        model[f"{name}.external_force"], model[f"{name}.external_torque"] = row[:3], row[3:]
    model["scene.gravity"] = (0.0, 0.0, 0.0)
    for name in names:
        model[f"{name}_touch.enabled"] = False
    own = wc.unilateral.assemble(model)
    assert own.count == 0
    dt = 1e-7
    wc.Simulation(model, dt=dt, integrator=wc.integrators.MoreauJean(), threads=1).step()
    after = wc.unilateral.assemble(model).velocity
    np.testing.assert_allclose(after / dt, own.free_acceleration, atol=1e-6 * np.abs(own.free_acceleration).max())


def test_assembled_contact_velocities_match_the_engine():
    model = block(velocity=1.5, lift=-1e-9)
    model["box.angular_velocity"] = (0.3, -0.2, 0.7)
    own = wc.unilateral.assemble(model)
    world = (own.contact_velocity[:, None, :] @ own.axes)[:, 0]
    np.testing.assert_allclose(-own.contact_velocity[:, 0], model.sensor("feet.approach_speed")[0], atol=1e-12)
    slip = np.linalg.norm(own.contact_velocity[:, 1:], axis=1)
    np.testing.assert_allclose(slip, model.sensor("feet.slip_speed")[0], atol=1e-12)
    arms = own.point - model.sensor("box.position")[0]
    turning = np.cross((0.3, -0.2, 0.7), arms)
    np.testing.assert_allclose(world, turning + np.array([1.5, 0.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_equilibrium_leaves_the_model_bitwise_unchanged(precision):
    model = block(20.0, velocity=0.7, slope=0.3).scene.build(envs=2, device="cpu", precision=precision)
    state = model.arrays.state
    # Rounding errors of steps: a quaternion that is not of unit length, a position with a remainder.
    state.body_orientation.numpy()[:, 0, 1] *= 1.0 + 1e-6
    if precision == "float32":
        state.body_position_remainder.numpy()[:, 0, 0] = 1e-9
    names = ("position", "position_remainder", "orientation", "linear_velocity", "angular_velocity")
    arrays = [getattr(state, f"body_{name}") for name in names]
    before = [array.numpy().copy() for array in arrays]
    wc.unilateral.equilibrium(model, env=1)
    wc.unilateral.assemble(model, env=1)
    wc.unilateral.EventDriven(model, env=1, closed=1e-4).run(0.01)
    for array, was in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array.numpy(), was)
    np.testing.assert_array_equal(model.arrays.time.numpy(), 0.0)


def test_couplings_are_loads_in_equilibrium():
    def pulled(tension, mu=0.5):
        scene = wc.Scene(gravity=(0.0, 0.0, -G))
        ground = scene.add_shape(None, wc.shapes.Plane(), name="ground")
        ball = scene.add_body(
            mass=1.0, inertia=[0.4] * 3, position=(0, 0, 1), motion=wc.motions.Translation(), name="b"
        )
        sphere = scene.add_shape(ball, wc.shapes.Sphere(1.0), name="sphere")
        scene.add_shape_contact(sphere, ground, rigid(mu), name="touch")
        scene.add_spring_damper(
            scene.add_point(ball, (0, 0, 0)),
            scene.add_point(None, (3, 0, 1)),
            stiffness=tension,
            damping=0.0,
            rest_length=2.0,
        )
        return wc.unilateral.equilibrium(scene.build(device="cpu", precision="float64"))

    holds, slides = pulled(4.9), pulled(5.0)
    assert holds.holds
    np.testing.assert_allclose(holds.force_of("touch"), (-4.9, 0.0, G), atol=FORCE)
    assert slides.linear_acceleration[0, 0] == pytest.approx(5.0 - 0.5 * G, abs=FORCE)


def test_equilibrium_raises_for_unsupported_input():
    def model(material, **options):
        scene = wc.Scene()
        ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)))
        ball = scene.add_body(mass=1.0, inertia=[0.1] * 3, position=(0, 0, 1), name="ball")
        scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, radius=1.0, name="touch", **options)
        return scene.build(device="cpu", precision="float64")

    law = wc.laws.Hooke(stiffness=1e5)
    with pytest.raises(ValueError, match=r"touch.friction is Viscous, which has no coefficient of friction"):
        wc.unilateral.equilibrium(model(wc.ContactMaterial(law=law, friction=wc.friction.Viscous(drag=1.0))))
    rolls = wc.ContactMaterial(law=law, rolling=wc.friction.Tanh(mu=0.1, velocity_scale=1e-3))
    with pytest.raises(ValueError, match=r"touch.rolling must not be set.*got Tanh"):
        wc.unilateral.equilibrium(model(rolls))
    whole = model(wc.ContactMaterial(law=law))
    with pytest.raises(ValueError, match="env must be a whole number from 0 to 0, got 3"):
        wc.unilateral.equilibrium(whole, env=3)
    with pytest.raises(TypeError, match=r"model must come from Scene.build"):
        wc.unilateral.equilibrium("model")
    with pytest.raises(ValueError, match="closed must be at least 0, got -1 m"):
        wc.unilateral.equilibrium(whole, closed=-1.0)
    # Without friction and with a gap, it falls.
    assert wc.unilateral.equilibrium(whole).holds
    whole["ball.position"] = (0, 0, 1.1)
    assert not wc.unilateral.equilibrium(whole).holds
