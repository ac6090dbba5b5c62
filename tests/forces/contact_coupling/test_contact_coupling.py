"""Impacts on contact couplings match closed forms of stopping distance and time; cost of steps."""

import json
import math
import warnings

import numpy as np
import pytest
from contact_coupling_scenes import AREA, CLOSEST, MASS, OTHER_MASS, RANGE, SPEED, expected, impact_scene

import warpcontact as wc

STOPPING_PENETRATION = RANGE - CLOSEST
TAU = 0.5 * math.pi * STOPPING_PENETRATION / SPEED
RATIOS = (0.0, 0.05, 0.2, 0.7)


def stop_of(ratio):
    """Returns stopping distance, stopping time, and rebound speed over impact speed, with the force cut at zero."""
    frequency, root = SPEED / STOPPING_PENETRATION, math.sqrt(1.0 - ratio**2)
    angle = math.acos(ratio)
    depth = STOPPING_PENETRATION * math.exp(-ratio / root * angle)
    leaves = math.pi - math.atan2(2.0 * ratio * root, 1.0 - 2.0 * ratio**2)
    return RANGE - depth, angle / (frequency * root), math.exp(-ratio / root * leaves)


def settled(model, steps_per_tau, duration):
    """Runs the model; returns its recording."""
    sim = wc.Simulation(model, dt=TAU / steps_per_tau)
    names = [f"{body.name}.{key}" for body in model.scene.bodies for key in ("position", "linear_velocity")]
    return sim.run(duration * TAU, record=names)


@pytest.mark.parametrize(("other", "k1"), [(None, 2.5e7), (OTHER_MASS, 7.142857142857144e6)])
def test_contact_range_coefficients_match_impact_formulas(other, k1):
    made = expected(other)
    assert made.k1 == pytest.approx(k1, rel=1e-14)
    assert made.time_scale(MASS, AREA, other) == pytest.approx(0.015707963267948967, rel=1e-14)
    # With an area other than the estimated one, τ scales with the inverse of its root.
    assert made.time_scale(MASS, 4.0 * AREA, other) == pytest.approx(0.5 * 0.015707963267948967, rel=1e-14)
    reduced = MASS if other is None else MASS * OTHER_MASS / (MASS + OTHER_MASS)
    for ratio, k2 in ((0.05, 2.5e4), (0.2, 1e5), (0.7, 3.5e5)):
        assert expected(other, ratio).k2 == pytest.approx(k2 * reduced / MASS, rel=1e-14)
    assert wc.ContactCoupling.from_impact(
        mass=MASS, other_mass=other, area=AREA, speed=SPEED, effective_range=RANGE, closest=CLOSEST
    ) == expected(other)


@pytest.fixture(scope="module")
def models(device):
    """Impacts on a fixed plate and on a free body, with a damping ratio per environment."""
    found = {}
    for other in (None, OTHER_MASS):
        scene, coupling = impact_scene(other)
        model = scene.build(envs=len(RATIOS), device=device, precision="float64")
        model["keep.k2"] = [expected(other, ratio).k2 for ratio in RATIOS]
        found[other] = model, coupling
    return found


@pytest.mark.parametrize(("other", "sort"), [(None, "free"), (OTHER_MASS, "free"), (OTHER_MASS, "reduced")])
def test_coupled_impact_matches_closed_form(models, other, sort):
    """Yields body and environment for two free bodies and for one body with their reduced mass."""
    model, coupling = models[None if sort == "reduced" else other]
    k1 = expected(other).k1
    model["block.mass"] = MASS if sort == "free" else MASS * OTHER_MASS / (MASS + OTHER_MASS)
    model["keep.k1"] = k1
    model["keep.k2"] = [expected(other, ratio).k2 for ratio in RATIOS]
    model.reset()
    steps = 1000
    recording = settled(model, steps, 3.2)
    height = recording["block.position"].sel(axis="z").values
    speed = recording["block.linear_velocity"].sel(axis="z").values
    if sort == "free" and other is not None:
        height = height - recording["anvil.position"].sel(axis="z").values
        speed = speed - recording["anvil.linear_velocity"].sel(axis="z").values
    report = coupling.report(model)
    for env, ratio in enumerate(RATIOS):
        distance, time, rebound = stop_of(ratio)
        turn = int(np.argmax(speed[:, env] > 0.0))
        # The velocity belongs to half a step earlier.
        before, after = speed[turn - 1, env], speed[turn, env]
        stopped = (turn - 1 - before / (after - before) - 0.5) * TAU / steps
        # With damping, the scheme is of first order in dt: a step of τ/1000 is 1.6e-3 of 1/ω.
        assert height[:, env].min() == pytest.approx(
            distance, abs=2e-3 * ratio * STOPPING_PENETRATION + 1e-5 * STOPPING_PENETRATION
        )
        assert stopped == pytest.approx(time, rel=2e-3 * ratio + 1e-4)
        assert speed[-1, env] == pytest.approx(rebound * SPEED, rel=3e-3 * ratio + 1e-5)
        assert report.minimum_distance[env] == pytest.approx(height[:, env].min(), abs=1e-15)
    np.testing.assert_allclose(report.effective_area, AREA, rtol=1e-12)
    model["block.mass"], model["keep.k1"] = MASS, expected(None if sort == "reduced" else other).k1
    model.reset()


def test_contact_range_formulas_match_reference(shared):
    oracle = json.loads((shared / "spec" / "oracle_contact_coupling.json").read_text())["impact"]
    for pairing, other in (("body_env", None), ("body_body", OTHER_MASS)):
        reference = oracle[pairing]
        assert expected(other).k1 == pytest.approx(reference["k1"], rel=1e-14)
        assert pytest.approx(reference["tau"], rel=1e-14) == TAU
        for ratio in RATIOS[1:]:
            given = reference[f"zeta{ratio:g}"]
            assert expected(other, ratio).k2 == pytest.approx(given["k2"], rel=1e-14)
            distance, time, rebound = stop_of(ratio)
            assert distance == pytest.approx(given["d_stop_formula"], rel=1e-12)
            assert time == pytest.approx(given["t_stop_formula"], rel=1e-12)
            # The oracle's value comes from a numerical integration.
            assert rebound == pytest.approx(given["e_out_clamped"], rel=1e-9)


def test_steps_of_one_twentieth_stop_within_one_percent(models):
    for other, (model, coupling) in models.items():
        model.reset()
        model["keep.k2"] = 0.0
        recording = settled(model, 20, 1.5)
        height = recording["block.position"].sel(axis="z").values
        if other is not None:
            height = height - recording["anvil.position"].sel(axis="z").values
            speeds = [recording[f"{name}.linear_velocity"].sel(axis="z").values for name in ("block", "anvil")]
            total = MASS * speeds[0] + OTHER_MASS * speeds[1]
            # The velocity of the common center of mass is constant, because the reaction is exact.
            np.testing.assert_allclose(total / (MASS + OTHER_MASS), -1.5 * 50.0 / 70.0, rtol=1e-13)
        np.testing.assert_allclose(height.min(axis=0), CLOSEST, atol=0.01 * STOPPING_PENETRATION)
        np.testing.assert_allclose(np.argmin(height, axis=0) / 20.0, 1.0, atol=0.05)
        assert coupling.report(model).touched.sum() == 0
        model.reset()


def test_time_step_error_matches_reference_table(device, shared):
    """SPEC 5, Time step: the error depends on the phase of the step at which the range is entered."""
    table = json.loads((shared / "spec" / "oracle_contact_coupling.json").read_text())["impact"]
    scene, coupling = impact_scene()
    phases = np.linspace(0.02, 0.98, 25)
    model = scene.build(envs=len(phases), device=device, precision="float64")
    rule = {5: 1.26e-2, 10: 0.31e-2, 20: 0.078e-2, 50: 0.0124e-2}
    for steps in (2, 5, 10, 20, 50, 100):
        dt = TAU / steps
        place = np.zeros((len(phases), 3))
        place[:, 2] = RANGE + phases * SPEED * dt
        model["block.position"] = place
        model.reset()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            wc.Simulation(model, dt=dt).step(4 * steps)
        assert len(caught) == (steps < 20)
        closest = coupling.report(model).minimum_distance
        reference = table["timestep_tau_over_n"][str(steps)]
        # At the start of contact, a millionth of the force differs from the table.
        assert closest.min() == pytest.approx(reference["d_stop_min"], abs=1e-6 * STOPPING_PENETRATION)
        assert closest.max() == pytest.approx(reference["d_stop_max"], abs=1e-6 * STOPPING_PENETRATION)
        speeds = model.sensor("block.linear_velocity")[:, 2] / SPEED
        assert [speeds.min(), speeds.max()] == pytest.approx(reference["v_exit_over_v"], abs=1e-6)
        assert np.abs(closest - CLOSEST).max() < rule.get(steps, 1.0) * STOPPING_PENETRATION


def test_gravity_reduces_stopping_distance_and_body_hovers(device):
    scene, coupling = impact_scene()
    model = scene.build(envs=2, device=device, precision="float64")
    model["scene.gravity"] = (0.0, 0.0, -9.81)
    with pytest.warns(wc.ContactWarning, match=r"keep: gravity presses .* stops at 0.00399 m instead of 0.005 m"):
        wc.Simulation(model, dt=TAU / 1000.0).step(1500)
    # Velocities are half a step early: g dt/2 too much at the start, which is 5.1e-5 of the stopping distance.
    np.testing.assert_allclose(
        coupling.report(model).minimum_distance, 0.003986955528272279, atol=6e-5 * STOPPING_PENETRATION
    )
    assert coupling.report(model).passed.all()
    model["block.position"] = (0.0, 0.0, 0.019019)
    model.reset()
    assert model.sensor("keep.force")[0] == pytest.approx([0.0, 0.0, MASS * 9.81], rel=1e-10)


def test_coupling_damping_increases_over_its_ramp(device):
    k2, ramp = 2.0e5, 0.004
    made = wc.ContactRange(k1=2.5e7, k2=k2, effective_range=RANGE)
    scene, _ = impact_scene(contact_range=made, damping_ramp=ramp)
    depths = np.array([0.0, 1e-9, 0.001, 0.002, 0.004, 0.01])
    model = scene.build(envs=len(depths), device=device, precision="float64")
    place = np.zeros((len(depths), 3))
    place[:, 2] = RANGE - depths
    model["block.position"] = place
    force = model.sensor("keep.force")[:, 2]
    share = np.minimum(depths / ramp, 1.0)
    np.testing.assert_allclose(force, AREA * (2.5e7 * depths + k2 * SPEED * share), rtol=1e-9, atol=1e-9)
    model["keep.damping_ramp"] = 0.0
    jumps = AREA * (2.5e7 * depths + k2 * SPEED) * (depths > 0.0)
    np.testing.assert_allclose(model.sensor("keep.force")[:, 2], jumps, rtol=1e-9)
