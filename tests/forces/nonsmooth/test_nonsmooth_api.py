"""API of nonsmooth contact: schedules, resets, mixed scenes, sensors, errors and warnings."""

import warnings
from typing import Any

import numpy as np
import pytest
import warp as wp
from nonsmooth_scenes import HARD, G, add_box, ball, rigid
from scenes import square

import warpcontact as wc


class Own(wc.Friction):
    """A friction model without a coefficient."""

    @wp.func
    def force(p: Any, s: Any):
        return -s.velocity


def thrown(envs=9, device="cpu", precision="float32"):
    """Boxes thrown onto a plane and an inclined block, with different velocities in each environment."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(20.0), name="ground")
    body = add_box(scene, (0.3, 0.4, 0.2), ground, rigid(0.5, 0.4), name="one", position=(0.0, 0.0, 0.4))
    top = scene.add_surface(wc.meshes.box((0.3, 0.4, 0.2)), body, name="top")
    other = scene.add_body(1.0, (0.01,) * 3, position=(0.0, 0.0, 0.8), name="two")
    centre = scene.add_point(other, (0.0, 0.0, 0.0))
    scene.add_contact(centre, top, rigid(0.2, 0.3), radius=0.1, name="above")
    scene.add_contact(centre, ground, rigid(0.2, 0.3), radius=0.1, name="below")
    model = scene.build(envs=envs, device=device, precision=precision)
    rng = np.random.default_rng(5)
    model["one.angular_velocity"] = rng.normal(size=(envs, 3))
    model["two.linear_velocity"] = 0.3 * rng.normal(size=(envs, 3))
    return model


def state_after(model, steps=400, **options):
    simulation = wc.Simulation(model, 1e-3, HARD, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        simulation.step(steps)
    names = (
        "one.position",
        "one.orientation",
        "two.position",
        "two.linear_velocity",
        "above.impulse",
        "one_feet.mode",
    )
    return {name: model.sensor(name) for name in names}


@pytest.fixture(scope="module")
def reference(device):
    return state_after(thrown(device=device), capture_graphs=False)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"threads": 1},
        {"threads": 2},
        {"distance_cache": False, "capture_graphs": False},
        {"deterministic": True},
    ],
    ids=str,
)
def test_nonsmooth_results_are_bitwise_identical_for_any_schedule(device, reference, options):
    result = state_after(thrown(device=device), **options)
    for name, values in reference.items():
        assert np.array_equal(result[name], values), name


def test_nonsmooth_environment_alone_equals_same_environment_among_others(device, reference):
    model = thrown(device=device)
    alone = thrown(envs=1, device=device)
    for name in ("one.angular_velocity", "two.linear_velocity"):
        alone[name] = model[name][4:5]
    result = state_after(alone)
    for name, values in reference.items():
        assert np.array_equal(result[name][0], values[4]), name


def test_nonsmooth_results_on_two_devices_equal_one_device(device, reference):
    result = state_after(thrown(device=[device, device]))
    for name, values in reference.items():
        assert np.array_equal(result[name], values), name


def test_reset_clears_impulses_dissipation_and_failures_of_its_environments(device):
    model = ball(0.5, 0.3, height=0.1, velocity=(1.0, 0.0, 0.0), envs=2, device=device)
    simulation = wc.Simulation(model, 1e-3, HARD)
    simulation.step(500)
    first = model.sensor("ball.position").copy()
    losses = model.sensor("scene.friction_dissipation")
    assert (losses > 0.0).all()
    assert (model.sensor("touch.impulse")[:, 2] > 0.0).all()
    simulation.reset([True, False])
    assert model.sensor("scene.friction_dissipation")[0] == 0.0
    assert model.sensor("scene.friction_dissipation")[1] == losses[1]
    assert model.sensor("touch.impulse")[0].tolist() == [0.0, 0.0, 0.0]
    assert model.sensor("touch.mode")[0] == wc.ContactMode.OPEN
    simulation.step(500)
    assert np.array_equal(model.sensor("ball.position")[0], first[0])
    simulation.reset()
    simulation.step(500)
    assert np.array_equal(model.sensor("ball.position"), first)


def test_nonsmooth_forces_are_the_mean_over_the_last_step(device):
    model = ball(mu=0.3, height=0.0, velocity=(1.0, 0.0, 0.0), device=device)
    simulation = wc.Simulation(model, 2e-3, HARD)
    simulation.step(20)
    impulse = model.sensor("touch.impulse")[0]
    assert model.sensor("touch.normal_force")[0] == pytest.approx(impulse[2] / 2e-3, rel=1e-14)
    assert model.sensor("touch.friction_force")[0] == pytest.approx([impulse[0] / 2e-3, 0.0, 0.0], abs=1e-12)
    assert model.sensor("ball.force")[0] == pytest.approx(impulse / 2e-3, rel=1e-14, abs=1e-12)
    assert model.sensor("touch.slip_speed")[0] > 0.1
    assert model.sensor("touch.mode")[0] == wc.ContactMode.SLIP
    assert model.sensor("scene.closed_contacts")[0] == 1
    assert model.sensor("scene.solve_converged")[0] == 1


def test_separated_nonsmooth_contact_is_open_without_impulse(device):
    model = ball(0.9, height=0.05, device=device)
    data = wc.Simulation(model, 1e-3, HARD).run(0.3, ["touch.impulse", "touch.mode", "touch.normal_force"])
    impulse, mode = data["touch.impulse"].values[:, 0, 2], data["touch.mode"].values[:, 0]
    assert 1 <= np.count_nonzero(impulse) <= 4
    assert ((mode == wc.ContactMode.OPEN) == (impulse == 0.0)).all()
    assert ((data["touch.normal_force"].values[:, 0] == 0.0) == (impulse == 0.0)).all()


def test_compliant_and_nonsmooth_contacts_can_share_a_scene(device):
    """A block on compliant points, a block on nonsmooth ones, and a compliant ball on top of the second."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(20.0), name="ground")
    soft = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e4, damping=200.0))
    feet = [(x, y, -0.1) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    add_box(scene, (0.5, 0.5, 0.2), ground, soft, name="soft", mass=4.0, feet=feet, position=(2.0, 0.0, 0.1))
    base = add_box(
        scene, (0.5, 0.5, 0.2), ground, rigid(mu=0.5), name="hard", mass=4.0, feet=feet, position=(0.0, 0.0, 0.1)
    )
    top = scene.add_surface(wc.meshes.box((0.5, 0.5, 0.2)), base, name="top")
    one = scene.add_body(1.0, (0.01,) * 3, position=(0.0, 0.0, 0.3), name="ball")
    scene.add_contact(scene.add_point(one, (0.0, 0.0, 0.0)), top, soft, radius=0.1, name="on_top")
    model = scene.build(device=device, precision="float64")
    integrator = wc.integrators.MoreauJean(compliant=["soft_feet", "on_top"])
    simulation = wc.Simulation(model, 1e-3, integrator)
    simulation.step(4000)
    assert -model.sensor("soft_feet.gap")[0] == pytest.approx(4.0 * G / 4e4, rel=1e-6)
    assert -model.sensor("on_top.gap")[0] == pytest.approx(G / 1e4, rel=1e-6)
    assert model.sensor("hard_feet.normal_force")[0].sum() == pytest.approx(5.0 * G, rel=1e-6)
    assert np.abs(model.sensor("hard_feet.gap")).max() < 2.0 * G * 1e-3**2
    assert "on_top.impulse" not in model.sensor_names
    assert model.sensor("scene.closed_contacts")[0] == 4


def test_one_model_can_be_stepped_compliant_or_nonsmooth(device):
    material = wc.ContactMaterial(
        law=wc.laws.Hooke(stiffness=1e4), friction=wc.friction.Tanh(mu=0.3, velocity_scale=0.01)
    )
    model = ball(material=material, height=0.01, device=device)
    expected = wc.Simulation(model, 1e-4).run(0.2, ["ball.position"])["ball.position"].values
    simulation = wc.Simulation(model, 1e-3, HARD)
    simulation.reset()
    simulation.step(200)
    assert "touch.impulse" in model.sensor_names
    assert abs(model.sensor("touch.gap")[0]) < 1e-3
    soft = wc.Simulation(model, 1e-4)
    soft.reset()
    assert "touch.impulse" not in model.sensor_names
    assert np.array_equal(soft.run(0.2, ["ball.position"])["ball.position"].values, expected)


def test_incomplete_nonsmooth_solve_is_counted_and_warns(device):
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    below = scene.add_surface(square(10.0), name="ground")
    feet = [(x, y, -0.25) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    for number in range(4):
        place = (0.0, 0.0, 0.25 + 0.5 * number)
        motion = {"position": place, "linear_velocity": (0.001 * number, 0.0, 0.0)}
        body = add_box(scene, (0.5,) * 3, below, rigid(mu=0.5), name=f"box{number}", feet=feet, **motion)
        below = scene.add_surface(wc.meshes.box((0.5,) * 3), body, name=f"top{number}")
    model = scene.build(envs=2, device=device, precision="float64")
    simulation = wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(solver="gauss_seidel", iterations=1))
    sensors = ["scene.solve_residual", "scene.solve_converged"]
    worst = []
    # Each run reports its own residuals, not larger ones of an earlier run.
    for duration in (0.05, 1e-3):
        with pytest.warns(
            wc.RunWarning, match="did not converge to the tolerance in 2 of 2 environments"
        ) as caught:
            steps = simulation.run(duration, sensors, every=1e-3).isel(time=slice(1, None))
        assert (model.sensor("scene.solve_failures") > 0).all()
        assert (model.sensor("scene.solve_iterations") <= 1).all()
        missed = np.where(steps["scene.solve_converged"] == 0, steps["scene.solve_residual"], 0.0).max(axis=0)
        np.testing.assert_array_equal(model.largest_residuals(), missed)
        assert f"The largest residual is {missed.max():.1e}, " in str(caught[0].message)
        worst.append(missed.max())
    assert worst[1] < worst[0]
    simulation.reset()
    assert not model.largest_residuals().any()


def test_nonsmooth_contact_raises_for_unsupported_features(device):
    cases = [
        (lambda: wc.integrators.MoreauJean(theta=0.4), "theta must be at least 0.5"),
        (lambda: wc.integrators.MoreauJean(solver="magic"), "solver must be one of 'auto', 'gauss_seidel'"),
        (
            lambda: wc.integrators.MoreauJean(iterations=0),
            "iterations must be a whole number of at least 1, got 0",
        ),
        (lambda: wc.integrators.MoreauJean(tolerance=0.0), "tolerance must be greater than 0"),
    ]
    for make, message in cases:
        with pytest.raises(ValueError, match=message):
            make()
    with pytest.raises(TypeError, match="compliant must be a list of names"):
        wc.integrators.MoreauJean(compliant="touch")
    model = ball(0.5, 0.2, device=device)
    with pytest.raises(
        ValueError, match=r"touch\.law is Rigid, which has no force; use the integrator MoreauJean"
    ):
        wc.Simulation(model, 1e-3)
    with pytest.raises(ValueError, match="compliant: there is no contact 'tuoch'; contacts: 'touch'"):
        wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(compliant=["tuoch"]))
    with pytest.raises(ValueError, match=r"compliant: touch\.law is Rigid"):
        wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(compliant=["touch"]))
    viscous = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4), friction=wc.friction.Viscous(drag=1.0))
    for own in (viscous, wc.ContactMaterial(law=wc.laws.Rigid(), friction=Own())):
        with pytest.raises(ValueError, match=r"touch\.friction is \w+, which has no coefficient of friction"):
            wc.Simulation(ball(material=own, device=device), 1e-3, HARD)
    with pytest.raises(ValueError, match=r"Rigid is for nonsmooth contact and has no force to compare"):
        wc.compare.plot_laws(wc.laws.Rigid)
    scene = wc.Scene()
    body = scene.add_body(1.0, (0.1,) * 3, position=(0, 0, 1))
    plate = scene.add_surface(square())
    scene.add_contact(scene.add_point(body, (0, 0, 0)), plate, rigid(), swept=True, name="thin")
    with pytest.raises(ValueError, match=r"thin\.swept must be False with MoreauJean"):
        wc.Simulation(scene.build(device=device), 1e-3, HARD)


def test_nonsmooth_initial_overlap_warns(device):
    model = ball(0.5, height=-0.02, envs=2, device=device)
    model["ball.position"] = [(0.0, 0.0, 0.1999), (0.0, 0.0, 0.18 - 0.1)]
    simulation = wc.Simulation(model, 1e-3, HARD)
    with pytest.warns(
        wc.ContactWarning, match=r"touch: initial penetration is 0\.02 m in environment 1\. It will remain"
    ):
        simulation.step(200)
    assert model.sensor("touch.gap")[1] == pytest.approx(-0.02, abs=1e-4)


def test_memory_estimate_includes_nonsmooth_contacts(device):
    model = ball(0.5, 0.2, envs=100, device=device, precision="float32")
    simulation = wc.Simulation(model, 1e-3, HARD)
    needs = [need for need in simulation.memory().items if need.purpose == "nonsmooth contacts"]
    assert needs
    shared = sum(need.size for need in needs)
    model["touch.friction.mu"] = np.linspace(0.1, 0.2, 100)
    own = sum(need.size for need in simulation.memory().items if need.purpose == "nonsmooth contacts")
    # Six numbers for the only contact, in each environment.
    assert own - shared == 99 * 24
    assert "nonsmooth contacts" not in [
        need.purpose
        for need in wc.Simulation(
            ball(material=wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)), device=device), 1e-3
        )
        .memory()
        .items
    ]


def test_simulations_of_one_model_follow_its_parameters_and_leave_no_uploads(device):
    model = ball(0.5, height=0.01, velocity=(0.0, 0.0, -1.0), gravity=0.0, device=device)
    parameter = model.find_parameter("touch.law.restitution")
    before = len(parameter.device_fields)
    simulations = [wc.Simulation(model, 1e-3, HARD) for _ in range(3)]
    assert len(parameter.device_fields) == before + 1
    for simulation, restitution in zip(simulations, (0.2, 0.4, 0.6), strict=True):
        model["touch.law.restitution"] = restitution
        simulation.reset()
        simulation.step(20)
        assert model.sensor("ball.linear_velocity")[0, 2] == pytest.approx(restitution, rel=1e-12)
    wc.Simulation(ball(material=wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)), device=device), 1e-3)
    assert len(parameter.device_fields) == before + 1


def test_recording_uses_the_running_simulation(device):
    model = ball(0.5, height=0.01, velocity=(0.0, 0.0, -1.0), device=device)
    own = wc.Simulation(model, 1e-3, HARD)
    own.step(30)
    lost = model.sensor("scene.impact_dissipation")[0]
    assert lost > 0.1
    wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(solver="accelerated"))
    data = own.run(0.5, ["touch.impulse", "scene.closed_contacts", "scene.impact_dissipation"])
    assert data["touch.impulse"].values[..., 2].max() > 0.1
    assert data["scene.closed_contacts"].max() == 1
    # Earlier dissipation remains in the sum.
    assert data["scene.impact_dissipation"].values[-1, 0] > lost


def test_contact_couplings_remain_forces_with_nonsmooth_integrator(device):
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    plate = scene.add_surface(wc.meshes.grid((4.0, 4.0)), name="plate")
    body = scene.add_body(1.0, (0.1,) * 3, position=(0, 0, 0.1), name="box")
    hull = scene.add_surface(wc.meshes.box((0.2, 0.2, 0.16)), body, name="hull")
    # Its lower face is 2 cm above the plate, within the coupling range.
    kept = wc.ContactRange(k1=2e4, k2=0.0, effective_range=0.03)
    scene.add_contact_coupling(hull, plate, kept, name="fender")
    model = scene.build(device=device, precision="float64")
    places = []
    for integrator in (wc.integrators.SemiImplicitEuler(), HARD):
        model.reset()
        wc.Simulation(model, 1e-4, integrator).step(2000)
        places.append(model.sensor("box.position")[0, 2])
    assert places[0] > 0.15
    # The schemes differ by half a step at a few meters per second.
    assert places[1] == pytest.approx(places[0], abs=5e-4)
    with pytest.raises(ValueError, match="there is no contact 'fender_first'; contacts: none"):
        wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(compliant=["fender_first"]))


def test_contact_history_is_reset_after_nonsmooth_steps(device):
    material = wc.ContactMaterial(law=wc.laws.HuntCrossley(stiffness=1e6, exponent=1.5, restitution=0.5))
    model = ball(material=material, height=1e-3, velocity=(0.0, 0.0, -2.0), device=device)
    wc.Simulation(model, 1e-4).step(15)
    assert model.arrays.history.entry_speed.numpy()[0, 0] > 1.5
    wc.Simulation(model, 1e-4, HARD).step(5000)
    assert model.arrays.history.entry_speed.numpy()[0, 0] < 0.1
    soft = wc.Simulation(model, 1e-4)
    soft.step(1)
    assert model.arrays.history.entry_speed.numpy()[0, 0] < 0.1
