"""Scenes that would give nonsense are warned about before the first step."""

import warnings

import numpy as np
import pytest
from scenes import dropped_sphere

import warpcontact as wc


def test_a_step_too_long_for_the_contact_is_named(device):
    model = dropped_sphere(wc.laws.HuntCrossley(stiffness=1e6, restitution=0.5), height=0.1, envs=3, device=device)
    model["ball.mass"] = [1.0, 0.01, 1.0]
    # The lightest ball: 3.218 (m²/(K² v))^(1/5) = 2.0 ms.
    with pytest.warns(
        wc.ContactWarning, match=r"touch: dt = 0.001 s is too long.* 0.002 s in environment 1, 2.0 steps"
    ):
        wc.Simulation(model, dt=1e-3).step()


def test_a_start_in_deep_overlap_is_named(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), velocity=(0, 0, 0), envs=4, device=device)
    position = model["ball.position"].copy()
    position[2, 2] = -0.4
    model["ball.position"] = position
    # ½ k δ² = ½ m v² with δ = 0.5 m: 50 m/s.
    with pytest.warns(
        wc.ContactWarning, match=r"touch: starts 0.5 m deep in the surface in environment 2.* 50 m/s"
    ):
        wc.Simulation(model, dt=1e-4).step()


def test_a_sound_scene_is_silent_and_warnings_come_once(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), height=-1e-3, envs=4, device=device)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wc.Simulation(model, dt=1e-4).step()
    model.reset()
    sim = wc.Simulation(model, dt=0.01)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(3):
            sim.step()
            sim.reset()
    assert [warning.category for warning in caught] == [wc.ContactWarning]


def test_every_law_with_a_known_elastic_part_tells_it():
    silent = {"JohnsonCylinder"}
    for law in wc.laws.CATALOGUE:
        values = {name: np.ones((1, 1)) * 2.0 for name in law.__dataclass_fields__}
        if "clearance" in values:
            values["clearance"] = np.full((1, 1), 1e-3)
        assert (law.elastic(values) is None) == (law.__name__ in silent), law.__name__


def test_impact_estimates_match_their_closed_forms():
    laws = wc.laws
    # FORCE_LAWS G2 and G3: steel ball on steel, and a linear spring.
    steel = (15384615384.615385, 1.5, 0.03288200310757317, 1.0)
    np.testing.assert_allclose(laws.greatest_penetration(*steel), 2.3480787287e-5, rtol=1e-9)
    np.testing.assert_allclose(laws.greatest_force(*steel), 1750.473839804, rtol=1e-9)
    np.testing.assert_allclose(laws.contact_time(*steel), 6.911041853e-5, rtol=1e-9)
    np.testing.assert_allclose(laws.contact_time(1e5, 1.0, 1.0, 1.0), 9.934588266e-3, rtol=1e-9)
    np.testing.assert_allclose(laws.recommended_dt(1e5, 1.0, 1.0, 1.0), 9.934588266e-3 / 20, rtol=1e-9)
