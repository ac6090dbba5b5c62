"""Normal laws in complete steps: a sphere on a mesh, one environment per case."""

import dataclasses
import json

import numpy as np
import pytest
from case_marks import slow_except
from closed_forms import contact_time, greatest_penetration
from scenes import dropped_sphere
from warpcontact.kernels.laws import hunt_crossley
from warpcontact.kernels.laws.linear_dashpot import damping_ratio_of_restitution, restitution_of_damping_ratio

import warpcontact as wc

RESTITUTION = np.linspace(0.1, 1.0, 10)
PHASES = 5  # phases of the step at which contact begins


def bounce(law, restitution=None, *, mass=1.0, speed=1.0, exponent=1.0, steps_per_contact=50, device="cpu"):
    """Returns the effective restitution of a free impact: (restitution, phase)."""
    cases = 1 if restitution is None else len(restitution)
    dt = contact_time(law.stiffness, exponent, mass, speed) / steps_per_contact
    model = dropped_sphere(law, mass=mass, velocity=(0, 0, -speed), envs=cases * PHASES, device=device)
    if restitution is not None:
        model["touch.law.restitution"] = np.repeat(restitution, PHASES)
    start = model["ball.position"].copy()
    start[:, 2] += np.tile(1.0 + np.arange(PHASES) / PHASES, cases) * speed * dt
    model["ball.position"] = start
    sim = wc.Simulation(model, dt=dt)
    # A weak rebound takes much longer than an elastic contact; the duration covers e = 0.1.
    sim.step(12 * steps_per_contact)
    assert (model.sensor("touch.normal_force") == 0).all()
    return model.sensor("ball.linear_velocity")[:, 2].reshape(cases, PHASES) / speed


# At 50 steps per contact. The phase of the step at which an elastic contact ends costs (π/50)²/8 = 5e-4. The
# corrections for a dashpot (docs/contact.md) leave a second-order error of about that size.
TOLERANCE = 1e-3


@pytest.mark.parametrize("mass", [1.0, 0.05])
def test_hunt_crossley_has_prescribed_restitution(mass, device):
    law = wc.laws.HuntCrossley(stiffness=1e6, exponent=1.5, restitution=0.5)
    measured = bounce(law, RESTITUTION, mass=mass, speed=2.0, exponent=1.5, device=device)
    np.testing.assert_allclose(measured, np.broadcast_to(RESTITUTION[:, None], measured.shape), atol=TOLERANCE)


def test_kelvin_voigt_has_prescribed_restitution(device):
    law = wc.laws.KelvinVoigt(stiffness=1e5, restitution=0.5)
    measured = bounce(law, RESTITUTION, device=device)
    np.testing.assert_allclose(measured, np.broadcast_to(RESTITUTION[:, None], measured.shape), atol=TOLERANCE)


@pytest.mark.parametrize(
    ("law", "exponent"),
    [(wc.laws.Hooke(stiffness=1e5), 1.0), (wc.laws.Hertz(stiffness=1e6), 1.5)],
    ids=["Hooke", "Hertz"],
)
def test_elastic_laws_have_restitution_one(law, exponent, device):
    np.testing.assert_allclose(bounce(law, exponent=exponent, device=device), 1.0, atol=TOLERANCE)


def test_constant_damping_matches_closed_form_restitution(device):
    # Hunt–Crossley with constant χ: d = χ v₀ in the boxed equation of FORCE_LAWS B2.
    law = wc.laws.HuntCrossley(stiffness=1e6, damping=0.4)
    expected = hunt_crossley.restitution_of_damping_factor(0.4)
    np.testing.assert_allclose(bounce(law, exponent=1.5, device=device), expected, atol=TOLERANCE)
    # Kelvin–Voigt with constant c: ξ = c/(2 √(K m)).
    law = wc.laws.KelvinVoigt(stiffness=1e5, damping=126.4911064)
    np.testing.assert_allclose(bounce(law, device=device), 0.5717400276, atol=TOLERANCE)


def test_effective_mass_includes_both_bodies_at_the_contact_point(device):
    """Kelvin–Voigt has its restitution also if the effective mass differs from the masses of both bodies."""
    scene = wc.Scene(gravity=(0, 0, 0))
    inertia = (0.02, 0.03, 0.04)
    plate = scene.add_body(3.0, (0.5, 0.5, 1.0), name="plate")
    rod = scene.add_body(2.0, inertia, position=(0.1, 0, 0.01), linear_velocity=(0, 0, -1.0), name="rod")
    surface = scene.add_surface(wc.meshes.grid((4, 4)), plate)
    law = wc.laws.KelvinVoigt(stiffness=1e5, restitution=0.5)
    scene.add_contact(scene.add_point(rod, (0.1, 0, -0.005)), surface, wc.ContactMaterial(law=law), name="touch")
    model = scene.build(envs=len(RESTITUTION), device=device)
    model["touch.law.restitution"] = RESTITUTION
    # 1/m = 1/2 + 0.1²/0.03 + 1/3 + 0.2²/0.5
    mass = 1.0 / (1 / 2 + 0.1**2 / 0.03 + 1 / 3 + 0.2**2 / 0.5)
    dt = contact_time(1e5, 1.0, mass, 1.0) / 200
    sim = wc.Simulation(model, dt=dt)

    def approach():
        lever = np.array([0.1, 0.0, -0.005])
        v_rod = model.sensor("rod.linear_velocity") + np.cross(model.sensor("rod.angular_velocity"), lever)
        v_plate = model.sensor("plate.linear_velocity") + np.cross(
            model.sensor("plate.angular_velocity"), np.array([0.2, 0.0, 0.0])
        )
        return (v_plate - v_rod)[:, 2]

    before = approach()
    sim.step(int(0.005 / dt) + 1200)
    assert (model.sensor("touch.normal_force") == 0).all()
    # The lever arm rotates by some milliradians during the contact.
    np.testing.assert_allclose(-approach() / before, RESTITUTION, atol=0.01)


def test_peak_penetration_and_force_match_hertz_impact(shared, device):
    oracle = json.loads((shared / "spec" / "oracle_contactps2.json").read_text())["laws"]["hertz"]
    model = dropped_sphere(wc.laws.Hertz(stiffness=1e6), height=1e-4, device=device)
    sim = wc.Simulation(model, dt=1e-5)
    recording = sim.run(0.02, ["touch.penetration", "touch.normal_force"], every=1e-5)
    # 1280 steps per contact: the error of the first-order scheme is about half of 1/1280.
    depth = float(recording["touch.penetration"].max())
    np.testing.assert_allclose(depth, oracle["delta_max_closed"], rtol=1e-3)
    np.testing.assert_allclose(depth, greatest_penetration(1e6, 1.5, 1.0, 1.0), rtol=1e-3)
    np.testing.assert_allclose(float(recording["touch.normal_force"].max()), oracle["Fmax_closed"], rtol=1e-3)


def test_published_damping_factors_match_measured_restitution(shared, device):
    """All impacts of the oracle in one batch. With v₀ = 1 m/s, a published factor d is a constant χ = d/v₀."""
    oracle = json.loads((shared / "spec" / "oracle_contactps2.json").read_text())["laws"]
    published = {
        "hunt_crossley": lambda e: 1.5 * (1 - e),
        "lankarani_nikravesh": lambda e: 0.75 * (1 - e**2),
        "flores": lambda e: 1.6 * (1 - e) / e,
    }
    cases = [(name, *name.split("_e0.")) for name in oracle if name != "hertz"]
    damping = [published[law](float(f"0.{digit}")) for _, law, digit in cases]
    law = wc.laws.HuntCrossley(stiffness=1e6, damping=1.0)
    model = dropped_sphere(law, height=1e-4, envs=len(cases), device=device)
    model["touch.law.damping"] = damping
    recording = wc.Simulation(model, dt=5e-6).run(0.02, ["touch.penetration", "touch.normal_force"])
    expected = {key: [oracle[name][key] for name, _, _ in cases] for key in ("delta_max", "Fmax", "e_out")}
    # About 2600 steps per contact. The velocity in a step is half a step old.
    np.testing.assert_allclose(recording["touch.penetration"].max("time"), expected["delta_max"], rtol=1e-3)
    np.testing.assert_allclose(recording["touch.normal_force"].max("time"), expected["Fmax"], rtol=1e-3)
    np.testing.assert_allclose(model.sensor("ball.linear_velocity")[:, 2], expected["e_out"], rtol=1e-3)


def test_hertz_from_materials_matches_reference():
    # FORCE_LAWS G2: a steel ball of 10 mm on a steel half-space.
    law = wc.laws.Hertz.from_materials(E=210e9, nu=0.3, R=0.01, E2=210e9, nu2=0.3)
    np.testing.assert_allclose(law.stiffness, 1.538461538e10, rtol=1e-9)
    rigid = wc.laws.Hertz.from_materials(E=210e9, nu=0.3, R=0.01)
    np.testing.assert_allclose(rigid.stiffness, 2 * law.stiffness, rtol=1e-12)
    with pytest.raises(ValueError, match=r"R2 must be positive, infinite or less than -R = -0\.01 m"):
        wc.laws.Hertz.from_materials(E=1e9, nu=0.3, R=0.01, R2=-0.005)
    with pytest.raises(ValueError, match=r"nu must be greater than -1 and at most 0\.5, got 0\.6"):
        wc.laws.Hertz.from_materials(E=1e9, nu=0.6, R=0.01)


def test_damping_conversions_match_the_tables(shared):
    table = np.genfromtxt(shared / "laws" / "conversion_table.csv", delimiter=",", skip_header=1)
    e = table[:, 0]
    np.testing.assert_allclose(hunt_crossley.damping_factor_of_restitution(e), table[:, 1], rtol=1e-8)
    # The table has eight digits.
    np.testing.assert_allclose(damping_ratio_of_restitution(e), table[:, 3], rtol=1e-7)


def test_damping_conversions_are_inverses():
    e = np.concatenate([np.linspace(0.01, 1.0, 500), 1.0 - np.logspace(-8, -2, 50)])
    factor = hunt_crossley.damping_factor_of_restitution(e)
    # Lambert's W has a branch point at e = 1, so half of the digits are lost there.
    np.testing.assert_allclose(hunt_crossley.restitution_of_damping_factor(factor), e, atol=3e-8)
    ratio = damping_ratio_of_restitution(e)
    np.testing.assert_allclose(restitution_of_damping_ratio(ratio), e, atol=1e-14)


def test_restitution_matches_published_hunt_crossley_values():
    # FORCE_LAWS G5.
    np.testing.assert_allclose(hunt_crossley.damping_factor_of_restitution(0.5), 1.432750533, rtol=1e-9)
    np.testing.assert_allclose(hunt_crossley.restitution_of_damping_factor(1.6), 0.4704447793, rtol=1e-8)


@pytest.mark.parametrize("law", wc.laws.CATALOGUE, ids=lambda law: law.__name__)
def test_every_law_is_documented(law):
    assert law.__doc__
    assert law.formula
    assert law.reference
    assert law.validity
    for field in dataclasses.fields(law):
        assert law.limits(field.name)["unit"]
        assert law.limits(field.name)["meaning"]
    assert law.__name__ in wc.laws.__all__


def sample_laws():
    laws = wc.laws
    family = (
        laws.HuntCrossley1975,
        laws.HerbertMcWhannell,
        laws.LeeWang,
        laws.LankaraniNikravesh,
        laws.Gonthier,
        laws.ZhiyingQishao,
        laws.Flores,
        laws.HuGuo,
        laws.CarvalhoMartins,
    )
    return [
        laws.Hooke(stiffness=1e4),
        laws.Hertz(stiffness=1e5),
        laws.PowerLaw(stiffness=1e6, exponent=2.0),
        laws.JohnsonCylinder(modulus=1e7, length=0.1, clearance=0.05),
        laws.PereiraCylinder(modulus=1e7, length=0.1, clearance=1e-2),
        laws.PereiraCylinderExternal(modulus=1e7, length=0.1, clearance=0.05),
        laws.ElasticFoundation(stiffness=1e8, area=1e-4, damping=2.0),
        laws.PressureField(modulus=1e8, other_modulus=3e8, area=1e-4, damping=2.0),
        laws.ContactRange(k1=1e8, k2=1e5, area=1e-4),
        laws.HertzElastic(modulus=1e6, restitution=0.3),
        laws.HuntCrossley(stiffness=1e5, restitution=0.3),
        laws.HuntCrossley(stiffness=1e5, damping=2.0),
        laws.KelvinVoigt(stiffness=1e4, restitution=0.3),
        laws.KelvinVoigt(stiffness=1e4, damping=30.0),
        laws.Tsuji(stiffness=1e5, restitution=0.3),
        laws.Tsuji(stiffness=1e5, ratio=0.2),
        laws.TwoStiffness(stiffness=1e4, restitution=0.3),
        laws.Anagnostopoulos(stiffness=1e4, restitution=0.3),
        laws.Jankowski(stiffness=1e5, restitution=0.3),
        laws.PantWijeyewickrema(stiffness=1e4, restitution=0.3),
        laws.KuwabaraKono(stiffness=1e5, viscosity=1e-3),
        laws.HertzDashpot(stiffness=1e5, damping=30.0),
        laws.Impact(stiffness=1e5, damping=100.0, depth=1e-3),
        *(law(stiffness=1e5, restitution=0.3) for law in family),
    ]


def test_samples_cover_the_catalogue():
    assert {type(law) for law in sample_laws()} == set(wc.laws.CATALOGUE)


@pytest.mark.parametrize("law", sample_laws(), ids=repr)
def test_laws_without_adhesion_never_pull(law, device):
    envs = 64
    rng = np.random.default_rng(4)
    model = dropped_sphere(law, envs=envs, device=device)
    depth = rng.uniform(1e-5, 5e-3, envs)
    position = model["ball.position"].copy()
    position[:, 2] = 0.1 - depth
    model["ball.position"] = position
    model["ball.linear_velocity"] = rng.uniform(-5, 5, (envs, 3))
    force = model.sensor("touch.normal_force")
    if law.pulls:
        assert (force < 0).any()
        return
    assert (force >= 0).all()
    assert (force[model.sensor("touch.approach_speed") >= 0] > 0).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: wc.laws.Hooke(stiffness=-1.0), r"Hooke.stiffness must be greater than 0, got -1 N/m"),
        (lambda: wc.laws.Hooke(stiffness=np.nan), r"Hooke.stiffness must be greater than 0, got nan"),
        (lambda: wc.laws.Hooke(stiffness="stiff"), r"Hooke.stiffness must be a number, got 'stiff'"),
        (lambda: wc.laws.Hooke(stiffness=[1, 2]), r"shape \(2,\); .* model\['<contact>.law.stiffness'\] = values"),
        (
            lambda: wc.friction.Tanh(mu=[0.3, 0.4]),
            r"shape \(2,\); .* model\['<contact>.friction.mu'\] = values",
        ),
        (lambda: wc.friction.Tanh(mu=[[0.3], [0.4, 0.5]]), r"Tanh.mu must be a number, got \[\[0.3\]"),
        (lambda: wc.friction.Tanh(mu="0.3"), r"Tanh.mu must be a number, got '0.3'"),
        (lambda: wc.friction.Tanh(mu=True), r"Tanh.mu must be a number, got True"),
        (
            lambda: wc.laws.HuntCrossley(stiffness=1.0, restitution=1.2),
            r"HuntCrossley.restitution must be at least 0.01 and at most 1, got 1.2",
        ),
        (
            lambda: wc.laws.HuntCrossley(stiffness=1.0),
            r"takes exactly one of restitution and damping, got none",
        ),
        (
            lambda: wc.laws.HuntCrossley(stiffness=-1.0),
            r"exactly one of restitution and damping, got none; HuntCrossley.stiffness must be greater than 0, got -1",
        ),
        (
            lambda: wc.laws.KelvinVoigt(stiffness=1.0, restitution=0.5, damping=1.0),
            r"takes exactly one of restitution and damping, got restitution and damping",
        ),
        (lambda: wc.friction.Tanh(mu=-0.1), r"Tanh.mu must be at least 0, got -0.1"),
        (
            lambda: wc.friction.Tanh(mu=0.1, velocity_scale=0),
            r"velocity_scale must be greater than 0, got 0 m/s",
        ),
        (
            lambda: wc.ContactMaterial(law=wc.friction.Tanh(mu=0.1)),
            r"ContactMaterial.law must be an instance of wc.Law",
        ),
    ],
)
def test_invalid_laws_are_refused(make, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make()


# One law of each kind of damping; all laws with --thorough.
@pytest.mark.parametrize(
    "law",
    slow_except(
        sample_laws(),
        lambda law: type(law) in (wc.laws.Hertz, wc.laws.HuntCrossley, wc.laws.KelvinVoigt, wc.laws.TwoStiffness),
    ),
    ids=repr,
)
def test_no_law_adds_energy_along_a_closed_path(law, device):
    """Random smooth paths δ(t) with reloading, δ = 0 at both ends: the work on the contact is never negative.

    Elastic laws return all of it. History advances by steps too short to move anything.
    """
    paths, frames, duration, depth = 32, 400, 0.05, 2e-3
    rng = np.random.default_rng(10)
    time = (np.arange(frames) + 0.5) / frames * duration
    phase = 2 * np.pi * time[:, None] / duration
    wave = sum(rng.uniform(-0.3, 0.3, paths) * np.sin(order * phase) for order in (1, 2, 3))
    slope = np.gradient(wave, duration / frames, axis=0)
    hump, hump_slope = np.sin(phase / 2) ** 2, np.pi / duration * np.sin(phase)
    delta = depth * hump * (1 + wave)
    delta_dot = depth * (hump_slope * (1 + wave) + hump * slope)
    model = dropped_sphere(law, envs=paths, device=device, precision="float64")
    sim = wc.Simulation(model, dt=1e-12)
    place, velocity = np.zeros((paths, 1, 3)), np.zeros((paths, 1, 3))
    work, stored = np.zeros(paths), np.zeros(paths)
    for k in range(frames):
        place[:, 0, 2], velocity[:, 0, 2] = 0.1 - delta[k], -delta_dot[k]
        sim.state.body_position.assign(place)
        sim.state.body_linear_velocity.assign(velocity)
        power = model.sensor("touch.normal_force") * delta_dot[k]
        work += power * duration / frames
        stored += np.abs(power) * duration / frames
        sim.step()
    # The sum over 400 frames of a path with three waves is accurate to 1e-3 of the exchanged energy.
    assert (work >= -1e-3 * stored).all()
    elastic = ("Hooke", "Hertz", "PowerLaw", "JohnsonCylinder", "PereiraCylinder", "PereiraCylinderExternal")
    if type(law).__name__ in elastic:
        np.testing.assert_allclose(work, 0.0, atol=1e-3 * stored.max())
    else:
        assert (work > 1e-3 * stored).all()
