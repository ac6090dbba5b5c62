"""Normal force of every law of the catalogue, against its published formula evaluated in NumPy with float64.

One model holds a sphere and a contact per sample law. Its 64 environments vary all parameters and the kinematic
state: approach and separation, with and without a stored impact speed. ``Model.sensor`` evaluates the force of an
instant (dt = 0), at which the correction of a dashpot for the time step vanishes.
"""

import functools
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import square
from scipy.special import lambertw

import warpcontact as wc
from warpcontact import laws

ENVIRONMENTS = 64
# Radius [m] and depths [m] are multiples of powers of two, so that float32 represents the penetration exactly.
RADIUS = 0.125
DEPTH_UNIT = 2.0**-20
# Float32 rounds by up to 6e-8 per operation. Parameters, powers, logarithms and sums add up to 2.3e-7 on a CPU.
# The margin is for a GPU, where powers and logarithms are less accurate.
TOLERANCE = 2e-5


def root(function, lower, upper):
    """Returns the root of an elementwise function, positive near ``lower`` and negative near ``upper``."""
    for _ in range(80):
        middle = 0.5 * (lower + upper)
        positive = function(middle) > 0
        lower, upper = np.where(positive, middle, lower), np.where(positive, upper, middle)
    return 0.5 * (lower + upper)


def exact_damping_factor(e):
    """Returns d of d (1 + e) = ln[(1 + d)/(1 − d e)] (Zhang & Sharf 2009)."""
    return root(lambda d: d * (1 + e) - np.log((1 + d) / (1 - d * e)), 0.75 * (1 - e), 1 / e)


def clamped_damping_ratio(e):
    """Returns ξ of e = exp[−2ξ arccos ξ/√(1 − ξ²)], a contact without tension (Schwager & Pöschel 2007)."""

    def excess(ratio):
        # Numerator and denominator are imaginary for ξ > 1.
        quotient = np.abs(np.arccos(ratio + 0j) / np.sqrt(1 - ratio**2 + 0j))
        return np.exp(-2 * ratio * quotient) - e

    return root(excess, 0.0, 1 + 1 / np.sqrt(e))


# Formulas N(p, c) before the force is cut at zero. ``p`` holds the parameters of the law. ``c`` holds penetration
# ``delta`` [m], approach speed ``delta_dot`` [m/s], impact speed ``v0`` [m/s] and effective ``mass`` [kg].


def power_law(p, c):
    return p.stiffness * c.delta**p.exponent


def johnson_cylinder(p, c):
    """Inverse of δ = F/(π E* L) [ln(4π E* L ΔR/F) − 1]; proportional to δ beyond its turning point x = 1/e."""
    x = np.e * c.delta / (4 * p.clearance)
    w = np.where(x < 1 / np.e, lambertw(-np.minimum(x, 1 / np.e), -1).real, -1.0)
    return -np.pi * p.modulus * p.length * c.delta / w


def pereira_cylinder(p, c):
    """Pin in a hole, in mm, N and MPa."""
    gap = 1e3 * p.clearance
    with np.errstate(invalid="ignore"):  # ln(1000 ΔR) < 0 in environments that use the other branch
        y = np.where(gap < 0.34954, 1.51 * np.log(1e3 * gap) ** -0.151, 0.0151 * gap + 1.151)
    factor = (0.965 * gap + 0.0965) * (1e3 * p.length) * (1e-6 * p.modulus) / gap
    return factor * (1e3 * c.delta) ** (y * gap**-0.005)


def pereira_cylinder_external(p, c):
    """Cylinders side by side, in mm, N and MPa."""
    gap = 1e3 * p.clearance
    factor = (0.39 * gap + 0.85) * (1e3 * p.length) * (1e-6 * p.modulus) / gap
    return factor * (1e3 * c.delta) ** 1.094


def elastic_foundation(p, c):
    return p.stiffness * p.area * c.delta * (1 + p.damping * c.delta_dot)


def pressure_field(p, c):
    stiffness = p.modulus * p.other_modulus / (p.modulus + p.other_modulus)
    return stiffness * p.area * c.delta * (1 + p.damping * c.delta_dot)


def contact_range(p, c):
    ramp = np.minimum(1.0, c.delta / np.maximum(p.ramp, 1e-12))
    return p.area * (p.k1 * c.delta + p.k2 * ramp * c.delta_dot)


def hertz_elastic(p, c):
    """Hertz contact of a sphere and a plane: K = (4/3) E* √R, with a lower bound on R."""
    impact_speed = np.maximum(c.v0, p.speed_floor)
    damping = exact_damping_factor(p.restitution) / impact_speed + p.damping
    radius = np.maximum(RADIUS, p.edge_radius)
    return 4 / 3 * p.modulus * np.sqrt(radius) * c.delta**1.5 * (1 + damping * c.delta_dot)


def constant_damping(p, c):
    """Hunt–Crossley damping with a constant χ."""
    return power_law(p, c) * (1 + p.damping * c.delta_dot)


def of_impact_speed(damping_factor):
    """Returns the formula N = K δⁿ (1 + d δ̇/v₀) for a relation d(e)."""

    def force(p, c):
        impact_speed = np.maximum(c.v0, p.speed_floor)
        return power_law(p, c) * (1 + damping_factor(p.restitution) * c.delta_dot / impact_speed)

    return force


def kelvin_voigt(p, c):
    damping = 2 * clamped_damping_ratio(p.restitution) * np.sqrt(p.stiffness * c.mass)
    return p.stiffness * c.delta + damping * c.delta_dot


def kelvin_voigt_dashpot(p, c):
    return p.stiffness * c.delta + p.damping * c.delta_dot


def tsuji_ratio(p, c):
    """ξ = c/√(2(n+1) m K) of N = K δⁿ + c δ^((n−1)/2) δ̇."""
    damping = p.ratio * np.sqrt(2 * (p.exponent + 1) * c.mass * p.stiffness)
    return power_law(p, c) + damping * c.delta ** ((p.exponent - 1) / 2) * c.delta_dot


def tsuji(p, c):
    return tsuji_ratio(SimpleNamespace(**vars(p), ratio=clamped_damping_ratio(p.restitution)), c)


def two_stiffness(p, c):
    return power_law(p, c) * np.where(c.delta_dot < 0, p.restitution**2, 1.0)


def anagnostopoulos(p, c):
    log = np.log(p.restitution)
    ratio = -log / np.sqrt(np.pi**2 + log**2)
    return p.stiffness * c.delta + 2 * ratio * np.sqrt(p.stiffness * c.mass) * c.delta_dot


def jankowski(p, c):
    e = p.restitution
    ratio = 9 * np.sqrt(5) / 2 * (1 - e**2) / (e * (e * (9 * np.pi - 16) + 16))
    damping = 2 * ratio * np.sqrt(c.mass * p.stiffness * np.sqrt(c.delta))
    return p.stiffness * c.delta**1.5 + damping * np.maximum(c.delta_dot, 0)


def pant_wijeyewickrema(p, c):
    factor = 3 * (1 - p.restitution**2) / (2 * p.restitution**2)
    impact_speed = np.maximum(c.v0, p.speed_floor)
    return power_law(p, c) * (1 + factor * np.maximum(c.delta_dot, 0) / impact_speed)


def kuwabara_kono(p, c):
    return p.stiffness * (c.delta**1.5 + 1.5 * p.viscosity * np.sqrt(c.delta) * c.delta_dot)


def hertz_dashpot(p, c):
    return p.stiffness * c.delta**1.5 + p.damping * c.delta_dot


def impact(p, c):
    x = np.minimum(c.delta / p.depth, 1.0)
    return power_law(p, c) + p.damping * x**2 * (3 - 2 * x) * c.delta_dot


def carvalho_martins_factor(e):
    high = 3 * (1 - e) * (11 - e) / (2 * (1 + 9 * e))
    return np.where(e > 1 / 3, high, (1 - e**2) / e)


# Sample laws with their formulas. Environments vary the values about these and choose restitution and exponent.
BY_RESTITUTION = {"stiffness": 1e5, "restitution": 0.5, "speed_floor": 0.2}
CASES = [
    (laws.Hooke(stiffness=1e4), lambda p, c: p.stiffness * c.delta),
    (laws.Hertz(stiffness=1e5), lambda p, c: p.stiffness * c.delta**1.5),
    (laws.HertzElastic(modulus=1e6, restitution=0.5, damping=0.3, speed_floor=0.2), hertz_elastic),
    (laws.HertzElastic(modulus=1e6, edge_radius=0.2), hertz_elastic),
    (laws.PowerLaw(stiffness=1e6, exponent=2.0), power_law),
    (laws.JohnsonCylinder(modulus=1e7, length=0.1, clearance=0.05), johnson_cylinder),
    (laws.JohnsonCylinder(modulus=1e7, length=0.1, clearance=8e-3), johnson_cylinder),
    (laws.JohnsonCylinder(modulus=1e7, length=0.1, clearance=1e-6), johnson_cylinder),  # beyond its turning point
    (laws.PereiraCylinder(modulus=1e7, length=0.1, clearance=1e-4), pereira_cylinder),
    (laws.PereiraCylinder(modulus=1e7, length=0.1, clearance=5e-3), pereira_cylinder),
    (laws.PereiraCylinderExternal(modulus=1e7, length=0.1, clearance=0.05), pereira_cylinder_external),
    (laws.ElasticFoundation(stiffness=1e8, area=1e-4, damping=1.0), elastic_foundation),
    (laws.PressureField(modulus=1e8, other_modulus=3e8, area=1e-4, damping=1.0), pressure_field),
    (laws.ContactRange(k1=1e8, k2=3e5, area=1e-4), contact_range),
    (laws.ContactRange(k1=1e8, k2=3e5, area=1e-4, ramp=1e-3), contact_range),
    (laws.HuntCrossley(**BY_RESTITUTION), of_impact_speed(exact_damping_factor)),
    (laws.HuntCrossley(stiffness=1e5, damping=1.0), constant_damping),
    (laws.KelvinVoigt(stiffness=1e4, restitution=0.5), kelvin_voigt),
    (laws.KelvinVoigt(stiffness=1e4, damping=30.0), kelvin_voigt_dashpot),
    (laws.Tsuji(stiffness=1e5, restitution=0.5), tsuji),
    (laws.Tsuji(stiffness=1e5, ratio=0.2), tsuji_ratio),
    (laws.TwoStiffness(stiffness=1e4, restitution=0.5), two_stiffness),
    (laws.Anagnostopoulos(stiffness=1e4, restitution=0.5), anagnostopoulos),
    (laws.Jankowski(stiffness=1e5, restitution=0.5), jankowski),
    (laws.PantWijeyewickrema(**BY_RESTITUTION), pant_wijeyewickrema),
    (laws.KuwabaraKono(stiffness=1e5, viscosity=1e-3), kuwabara_kono),
    (laws.HertzDashpot(stiffness=1e5, damping=10.0), hertz_dashpot),
    (laws.Impact(stiffness=1e5, damping=30.0, depth=1e-3), impact),
    (laws.HuntCrossley1975(**BY_RESTITUTION), of_impact_speed(lambda e: 3 * (1 - e) / 2)),
    (laws.HerbertMcWhannell(**BY_RESTITUTION), of_impact_speed(lambda e: 6 * (1 - e) / ((2 * e - 1) ** 2 + 3))),
    (laws.LeeWang(**BY_RESTITUTION), of_impact_speed(lambda e: 3 * (1 - e) / 4)),
    (laws.LankaraniNikravesh(**BY_RESTITUTION), of_impact_speed(lambda e: 3 * (1 - e**2) / 4)),
    (laws.Gonthier(**BY_RESTITUTION), of_impact_speed(lambda e: (1 - e**2) / e)),
    (
        laws.ZhiyingQishao(**BY_RESTITUTION),
        of_impact_speed(lambda e: 3 / 4 * (1 - e**2) * np.exp(2 * (1 - e))),
    ),
    (laws.Flores(**BY_RESTITUTION), of_impact_speed(lambda e: 8 * (1 - e) / (5 * e))),
    (laws.HuGuo(**BY_RESTITUTION), of_impact_speed(lambda e: 3 * (1 - e) / (2 * e))),
    (laws.CarvalhoMartins(**BY_RESTITUTION), of_impact_speed(carvalho_martins_factor)),
]


def log_uniform(rng, smallest, largest):
    """Returns one random number per environment, uniform in its logarithm."""
    return np.exp(rng.uniform(np.log(smallest), np.log(largest), ENVIRONMENTS))


@functools.cache
def states():
    """Returns kinematic states and masses, one per environment, and the impact speed in the history (−1: none)."""
    rng = np.random.default_rng(7)
    environment = np.arange(ENVIRONMENTS)
    delta_dot = np.where(environment % 2, -1.0, 1.0) * log_uniform(rng, 0.02, 3.0)
    history = np.where(environment % 4 < 2, -1.0, log_uniform(rng, 0.1, 3.0))
    # A contact begins with its approach speed, and a faster approach replaces the impact speed.
    impact_speed = np.maximum(history, np.maximum(delta_dot, 0.0))
    depth = rng.integers(16, 2000, ENVIRONMENTS) * DEPTH_UNIT
    mass = rng.uniform(0.5, 2.0, ENVIRONMENTS)
    return SimpleNamespace(delta=depth, delta_dot=delta_dot, v0=impact_speed, mass=mass), history


@functools.cache
def parameters(index):
    """Returns the parameters of a case, one value per environment."""
    rng = np.random.default_rng(index)
    values = {}
    for name, value in CASES[index][0].parameters().items():
        if name == "restitution":
            values[name] = rng.uniform(0.05, 0.95, ENVIRONMENTS)
        elif name == "exponent":
            values[name] = rng.choice([1.0, 1.5, 2.25], ENVIRONMENTS)
        else:
            values[name] = value * rng.uniform(0.7, 1.4, ENVIRONMENTS)
    return values


def expected_force(index, values):
    """Returns the force of the formula, cut at zero unless the law pulls, and the tolerance [N]."""
    law, formula = CASES[index]
    state, _ = states()
    force = formula(SimpleNamespace(**values), state)
    # In separation, the damping term can cancel the elastic force, so the error is relative to both.
    at_rest = formula(SimpleNamespace(**values), SimpleNamespace(**vars(state) | {"delta_dot": 0.0}))
    if not law.pulls:
        force = np.maximum(force, 0.0)
    return force, TOLERANCE * (np.abs(force) + np.abs(at_rest))


@pytest.fixture(scope="module")
def forces(device):
    """Normal forces of all cases [N], (environment, case)."""
    state, history = states()
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    ground = scene.add_surface(square(10.0), name="ground")
    for index, (law, _) in enumerate(CASES):
        ball = scene.add_body(mass=1.0, inertia=[0.01] * 3, name=f"ball{index}")
        center = scene.add_point(ball, (0, 0, 0))
        scene.add_contact(center, ground, wc.ContactMaterial(law=law), radius=RADIUS, name=f"contact{index}")
    model = scene.build(envs=ENVIRONMENTS, device=device)
    zero = np.zeros(ENVIRONMENTS)
    for index in range(len(CASES)):
        model[f"ball{index}.mass"] = state.mass
        model[f"ball{index}.position"] = np.stack([zero, zero, RADIUS - state.delta], axis=-1)
        model[f"ball{index}.linear_velocity"] = np.stack([zero, zero, -state.delta_dot], axis=-1)
        for name, values in parameters(index).items():
            model[f"contact{index}.law.{name}"] = values
    # Impact speeds are the same for all contacts of an environment, in any order of the contacts.
    stored = model.arrays.history.entry_speed
    stored.assign(np.broadcast_to(history[:, None], stored.shape))
    for index in range(len(CASES)):
        np.testing.assert_allclose(model.sensor(f"contact{index}.penetration"), state.delta, rtol=1e-6)
        np.testing.assert_allclose(model.sensor(f"contact{index}.approach_speed"), state.delta_dot, rtol=1e-6)
    return np.stack([model.sensor(f"contact{index}.normal_force") for index in range(len(CASES))], axis=-1)


def test_formulas_cover_the_catalogue():
    assert {type(law) for law, _ in CASES} == set(laws.CATALOGUE)


@pytest.mark.parametrize("index", range(len(CASES)), ids=[repr(law) for law, _ in CASES])
def test_normal_force_equals_the_published_formula(index, forces):
    expected, error = expected_force(index, parameters(index))
    np.testing.assert_array_less(np.abs(forces[:, index] - expected), error + 1e-30)


def test_tolerance_detects_one_percent_in_each_parameter():
    """A change of 1 % in any parameter exceeds the tolerance in some environments of some sample."""
    detected = set()
    for index, (law, _) in enumerate(CASES):
        values = parameters(index)
        expected, error = expected_force(index, values)
        for name, value in values.items():
            changed, _ = expected_force(index, {**values, name: 1.01 * value})
            if (np.abs(changed - expected) > error).sum() >= 4:
                detected.add((type(law), name))
    assert detected == {(law, name) for law in laws.CATALOGUE for name in law.varying()}


def test_cylinder_formulas_match_the_worked_example():
    # FORCE_LAWS A5: steel, L = 15 mm, ΔR = 0.1 mm, δ = 0.01 mm. E = 207 GPa and ν = 0.3 give both printed forces.
    p = SimpleNamespace(modulus=207e9 / (2 * (1 - 0.3**2)), length=0.015, clearance=1e-4)
    c = SimpleNamespace(delta=1e-5)
    np.testing.assert_allclose(johnson_cylinder(p, c), 13073.0, rtol=1e-5)
    np.testing.assert_allclose(pereira_cylinder(p, c), 12352.0, rtol=1e-5)
