"""Scenes that would give nonsense are warned about before the first step."""

import re
import warnings

import numpy as np
import pytest
from scenes import dropped_sphere, square

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


LONG_STEPS = [
    ({"friction": wc.frictions.Tanh(mu=0.3, velocity_scale=1e-6)}, 2 * (2 / 7) * 1e-6 / (0.3 * 9.81)),
    (
        {"friction": wc.frictions.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1e9)},
        2 * np.sqrt(2 / 7 / 1e9),
    ),
    (
        {"friction": wc.frictions.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1.0, damping=1e6)},
        2 * (2 / 7) / 1e6,
    ),
    ({"friction": wc.frictions.Viscous(drag=1e6)}, 2 * (2 / 7) / (1e6 * 9.81)),
    ({"rolling": wc.frictions.Viscous(drag=1e6)}, 2 * 0.4 / (1e6 * 9.81)),
    ({"torsion": wc.frictions.Viscous(drag=1e7)}, 2 * 0.4 * (0.1 / 0.01) ** 2 / (1e7 * 9.81)),
]


@pytest.mark.parametrize(("parts", "limit"), LONG_STEPS)
def test_a_step_in_which_a_friction_overshoots_is_told(parts, limit, device):
    """Limits of a solid sphere of 1 kg and 0.1 m under its weight: m_t = 2/7 m in slip, 2/5 m in rolling."""
    part, friction = next(iter(parts.items()))
    scene = wc.Scene()
    ground = scene.add_surface(square(), name="ground")
    ball = scene.add_body(1.0, [0.4 * 0.01] * 3, position=(0, 0, 0.1), name="ball")
    template = wc.Template(law=wc.laws.Hooke(stiffness=1e3), **parts)
    options = {"torsion_radius": 0.01} if part == "torsion" else {}
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, template, radius=0.1, name="touch", **options)
    model = scene.build(envs=3, device=device, precision="float64")
    with pytest.warns(wc.ContactWarning, match=f"too long for its {part}, {type(friction).__name__}") as caught:
        wc.Simulation(model, dt=1.1 * limit).step()
    told = float(re.search(r"more than (\S+) s", str(caught[0].message)).group(1))
    np.testing.assert_allclose(told, limit, rtol=0.05)
    model.reset()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wc.Simulation(model, dt=0.9 * limit).step()
