"""Warnings before the first step about scenes with inaccurate or unstable contacts."""

import re
import warnings

import custom_law
import numpy as np
import pytest
from scenes import dropped_sphere, square

import warpcontact as wc


def test_too_long_step_warns_with_contact_duration(device):
    model = dropped_sphere(wc.laws.HuntCrossley(stiffness=1e6, restitution=0.5), height=0.1, envs=3, device=device)
    model["ball.mass"] = [1.0, 0.01, 1.0]
    # The lightest ball: 3.218 (m²/(K² v))^(1/5) = 2.0 ms.
    with pytest.warns(
        wc.ContactWarning, match=r"touch: dt = 0.001 s is too long.* 0.002 s in environment 1, 2.0 steps"
    ):
        wc.Simulation(model, dt=1e-3).step()


def test_deep_initial_overlap_warns_with_ejection_speed(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), velocity=(0, 0, 0), envs=4, device=device)
    position = model["ball.position"].copy()
    position[2, 2] = -0.4
    model["ball.position"] = position
    # ½ k δ² = ½ m v² with δ = 0.5 m: 50 m/s.
    with pytest.warns(wc.ContactWarning, match=r"touch: initial penetration is 0.5 m in environment 2.* 50 m/s"):
        wc.Simulation(model, dt=1e-4).step()


def test_valid_scene_raises_no_warning_and_warnings_are_issued_once(device):
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


@pytest.mark.parametrize(
    "step",
    [
        lambda sim: sim.step(),
        lambda sim: sim.run(0.02),
        lambda sim: sim.step_with_callback(1, 2, [], lambda *_: None),
    ],
    ids=["step", "run", "step_with_callback"],
)
def test_contact_warning_location_is_the_caller_of_step(step, device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), height=-1e-3, device=device)
    with pytest.warns(wc.ContactWarning) as caught:
        step(wc.Simulation(model, dt=0.01))
    assert [warning.filename for warning in caught] == [__file__]


def warnings_of_first_step(sim, match):
    """Returns the warnings of the first step of a simulation that match."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sim.step()
    return [found for warning in caught if (found := re.search(match, str(warning.message)))]


@pytest.mark.parametrize("scale", [1.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_contact_duration_estimate_shares_mass_among_simultaneous_points(scale, device):
    """A box that lands flat on its points has the contact duration of a foundation of their areas."""
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square(5.0), name="ground")
    box = scene.add_body(2.0, [1.0] * 3, (0, 0, 0.06 * scale), linear_velocity=(0, 0, -2), name="box")
    hull = scene.add_surface(wc.meshes.box((0.4, 0.3, 0.1)), box, scale=scale, name="hull")
    bed = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e6))
    scene.add_surface_contact(hull, ground, bed, samples=400, name="touch")
    model = scene.build(device=device, precision="float64")
    exact = np.pi * np.sqrt(2.0 / (1e6 * 0.12 * scale**2))
    (found,) = warnings_of_first_step(
        wc.Simulation(model, dt=exact / 19), r"touch: dt = .* a contact lasts (\S+) s"
    )
    # Points of the lateral sides are in contact as well, within the maximum penetration of 8 mm or 4 mm.
    assert 0.8 * exact < float(found.group(1)) < 1.01 * exact
    model.reset()
    recording = wc.Simulation(model, dt=exact / 500).run(0.02 * scale, ["touch.status"])
    touching = (recording["touch.status"] == wc.ContactStatus.CONTACT).any("item").sum() * exact / 500
    assert float(found.group(1)) == pytest.approx(float(touching), rel=0.15)


def test_contact_duration_estimate_ignores_points_outside_the_contact_area(device):
    """A ball on points of a floor that is a hundred times as wide: only points within the width of the ball count."""
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(wc.meshes.grid((10.0, 10.0)), name="ground")
    ball = scene.add_body(1.0, [1.0] * 3, (0, 0, 0.06), name="ball")
    skin = scene.add_surface(wc.meshes.icosphere(0.05), ball, name="skin")
    bed = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e8))
    scene.add_contact(scene.add_points(ground, wc.sample_surface(ground.mesh, 2000)), skin, bed, name="touch")
    model = scene.build(device=device)
    (found,) = warnings_of_first_step(wc.Simulation(model, dt=1e-2), r"a contact lasts (\S+) s")
    # A point has an area weight of 500 cm², but the ball covers at most 0.1 m × 0.1 m.
    assert float(found.group(1)) > 0.9 * np.pi * np.sqrt(1.0 / (1e8 * 0.1))


def test_ejection_speed_estimate_sums_energy_of_all_points(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square(), name="ground")
    body = scene.add_body(1.0, [1.0] * 3, (0, 0, 0), name="body")
    feet = scene.add_points(body, [(0.1, 0.1, -0.5), (0.1, -0.2, -0.5), (-0.1, 0.1, -0.5), (-0.1, -0.2, -0.5)])
    scene.add_contact(feet, ground, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=2500.0)), name="touch")
    with pytest.warns(wc.ContactWarning, match=r"touch: initial penetration is 0.5 m .* 50 m/s"):
        wc.Simulation(scene.build(device=device), dt=1e-4).step()


@pytest.mark.parametrize("radius", [0.0, 0.05])
def test_swept_contact_warns_if_max_depth_is_smaller_than_distance_per_step(radius, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square(), name="ground")
    ball = scene.add_body(1.0, [1e-3] * 3, (0, 0, 0.055), name="ball")
    spring = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3))
    options = {"radius": radius, "max_depth": 0.02, "swept": True, "name": "touch"}
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, spring, **options)
    model = scene.build(envs=2, device=device)
    model["ball.linear_velocity"] = [(0, 0, -1), (0, 0, -10)]
    match = r"touch: max_depth = 0\.02 m .* distance per step \(0\.1 m at 10 m/s, environment 1\)\."
    sim = wc.Simulation(model, dt=1e-2)
    assert warnings_of_first_step(sim, match)
    sim.step(30)
    # The ball does fall through.
    assert model.sensor("ball.linear_velocity")[1, 2] < 0
    model["touch.max_depth"] = 0.5
    model.reset()
    sim = wc.Simulation(model, dt=1e-2)
    assert not warnings_of_first_step(sim, "can be lost")
    sim.step(30)
    assert model.sensor("ball.linear_velocity")[1, 2] > 0


def test_elastic_part_is_defined_for_every_law_with_closed_form():
    silent = {"HertzElastic", "JohnsonCylinder"}
    for law in wc.laws.CATALOGUE:
        values = {name: np.ones((1, 1)) * 2.0 for name in law.__dataclass_fields__}
        if "clearance" in values:
            values["clearance"] = np.full((1, 1), 1e-3)
        assert (law.elastic(values) is None) == (law.__name__ in silent), law.__name__


def test_impact_estimates_match_closed_forms():
    laws = wc.laws
    # FORCE_LAWS G2 and G3: steel ball on steel, and a linear spring.
    steel = (15384615384.615385, 1.5, 0.03288200310757317, 1.0)
    np.testing.assert_allclose(laws.greatest_penetration(*steel), 2.3480787287e-5, rtol=1e-9)
    np.testing.assert_allclose(laws.greatest_force(*steel), 1750.473839804, rtol=1e-9)
    np.testing.assert_allclose(laws.contact_time(*steel), 6.911041853e-5, rtol=1e-9)
    np.testing.assert_allclose(laws.contact_time(1e5, 1.0, 1.0, 1.0), 9.934588266e-3, rtol=1e-9)
    np.testing.assert_allclose(laws.recommended_dt(1e5, 1.0, 1.0, 1.0), 9.934588266e-3 / 20, rtol=1e-9)


LONG_STEPS = [
    ({"friction": wc.friction.Tanh(mu=0.3, velocity_scale=1e-6)}, 2 * (2 / 7) * 1e-6 / (0.3 * 9.81)),
    (
        {"friction": wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1e9)},
        2 * np.sqrt(2 / 7 / 1e9),
    ),
    (
        {"friction": wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1.0, damping=1e6)},
        2 * (2 / 7) / 1e6,
    ),
    ({"friction": wc.friction.Viscous(drag=1e6)}, 2 * (2 / 7) / (1e6 * 9.81)),
    (  # under the weight and the pull-off force of 20 N
        {
            "friction": wc.friction.Tanh(mu=0.3, velocity_scale=1e-6),
            "law": custom_law.Adhesive(stiffness=1e4, depth=2e-3),
        },
        2 * (2 / 7) * 1e-6 / (0.3 * (9.81 + 20.0)),
    ),
    ({"rolling": wc.friction.Viscous(drag=1e6)}, 2 * 0.4 / (1e6 * 9.81)),
    ({"torsion": wc.friction.Viscous(drag=1e7)}, 2 * 0.4 * (0.1 / 0.01) ** 2 / (1e7 * 9.81)),
]


@pytest.mark.parametrize(("parts", "limit"), LONG_STEPS)
def test_step_above_friction_limit_warns_with_time_step_limit(parts, limit, device):
    """Limits for a solid sphere of 1 kg and 0.1 m under its weight: m_t = 2/7 m in slip, 2/5 m in rolling."""
    part, friction = next(iter(parts.items()))
    scene = wc.Scene()
    ground = scene.add_surface(square(), name="ground")
    ball = scene.add_body(1.0, [0.4 * 0.01] * 3, position=(0, 0, 0.1), name="ball")
    material = wc.ContactMaterial(**({"law": wc.laws.Hooke(stiffness=1e3)} | parts))
    options = {"torsion_radius": 0.01} if part == "torsion" else {}
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, radius=0.1, name="touch", **options)
    model = scene.build(envs=3, device=device, precision="float64")
    with pytest.warns(wc.ContactWarning, match=f"too long for its {part}, {type(friction).__name__}") as caught:
        wc.Simulation(model, dt=1.1 * limit).step()
    warnings_of_first_step = float(re.search(r"more than (\S+) s", str(caught[0].message)).group(1))
    np.testing.assert_allclose(warnings_of_first_step, limit, rtol=0.05)
    model.reset()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wc.Simulation(model, dt=0.9 * limit).step()


def two_balls(gap, device):
    """Two particles and a heavy one, with two shapes each."""
    scene = wc.Scene(gravity=(0, 0, 0))
    shapes = []
    for number, (mass, x) in enumerate([(1.0, 0.0), (3.0, 0.2 + gap), (1000.0, 5.0)]):
        body = scene.add_body(mass, (1.0, 1.0, 1.0), (x, 0, 0), name=f"ball_{number}")
        shapes += [scene.add_shape(body, wc.shapes.Sphere(radius)) for radius in (0.1, 0.05)]
    scene.add_particle_contact(shapes, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)), name="pile")
    return scene.build(2, device)


def test_particle_contact_warns_of_too_long_step_and_deep_initial_overlap(device):
    """For the two lightest bodies of 0.75 kg: π √(m/k) = 27.2 ms; ½ k δ² = ½ m v² with δ = 0.1 m gives 11.5 m/s."""
    text = r"pile: dt = 0.003 s is too long: .* 0.027 s in environment 0, 9.1 steps. Use dt ≤ 0.0027 s for 10"
    assert len(warnings_of_first_step(wc.Simulation(two_balls(0.01, device), dt=3e-3), text)) == 1
    assert warnings_of_first_step(wc.Simulation(two_balls(0.01, device), dt=2.7e-3), ".*") == []
    messages = warnings_of_first_step(wc.Simulation(two_balls(-0.1, device), dt=1e-3), ".*")
    assert [found[0] for found in messages] == [
        "pile: initial penetration is 0.1 m in environment 0. The contact force will eject the body at about 11.5 m/s. "
        "Start outside, or set max_depth"
    ]
