"""All laws with a restitution match a table of independent integrations, in one batched run."""

import json

import numpy as np
import pytest
from closed_forms import contact_time
from scenes import dropped_sphere
from warpcontact.kernels.laws import elastic, nonlinear_dashpot

import warpcontact as wc
from warpcontact import laws

RADIUS = 0.05

# Law, its column of the table, stiffness.
ROWS = [
    (laws.HuntCrossley1975, "hunt_crossley_1975", 1e6),
    (laws.HerbertMcWhannell, "herbert_mcwhannell_1977", 1e6),
    (laws.LeeWang, "lee_wang_1983", 1e6),
    (laws.LankaraniNikravesh, "lankarani_nikravesh_1990", 1e6),
    (laws.Gonthier, "gonthier_2004", 1e6),
    (laws.HuntCrossley, "zhang_sharf_exact", 1e6),
    (laws.ZhiyingQishao, "zhiying_qishao_2006", 1e6),
    (laws.Flores, "ye_2009_flores_2011", 1e6),
    (laws.HuGuo, "hu_guo_2015", 1e6),
    (laws.CarvalhoMartins, "carvalho_gonthier_piecewise", 1e6),
    (laws.Anagnostopoulos, "kelvin_voigt_anagnostopoulos_tension", 1e5),
    (laws.KelvinVoigt, "kelvin_voigt_xi_cutoff_corrected", 1e5),
    (laws.TwoStiffness, "two_stiffness_r_eq_e2", 1e5),
    (laws.Jankowski, "jankowski_2006", 1e6),
    (laws.PantWijeyewickrema, "pant_wijeyewickrema_approach_only", 1e5),
    (laws.Tsuji, "tsuji_closed_form_cutoff", 1e6),
    (laws.KuwabaraKono, "kuwabara_kono_brilliantov_pade_cutoff", 1e6),
    (laws.HertzDashpot, "ristow_linear_dashpot_calibrated", 1e6),
]


def read_table(path):
    return np.genfromtxt(path, delimiter=",", names=True, deletechars="")


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 2e-3), ("float64", 1e-3)])
def test_every_law_matches_its_row_of_the_restitution_table(precision, tolerance, shared, device):
    """One body per law, one environment per restitution; impacts of 1 kg at 1 m/s, radius 50 mm.

    dt = 5 µs is 1/2000 of a contact time. The remaining error is the first-order error of laws that are
    discontinuous when the approach ends. Kuwabara–Kono and the dashpot of Ristow have no restitution parameter;
    they use the coefficients of the conversion tables.
    """
    table = read_table(shared / "laws" / "restitution_table.csv")
    e = table["e_prescribed"]
    dashpot = np.genfromtxt(shared / "laws" / "conversion_table.csv", delimiter=",", skip_header=1)
    scene = wc.Scene(gravity=(0, 0, 0))
    # The bodies move near the origin, where float32 resolves most.
    ground = scene.add_surface(wc.meshes.grid((4, 4)), position=(0, 0, -RADIUS))
    for law, _, stiffness in ROWS:
        if law is laws.KuwabaraKono:
            made = law(stiffness=stiffness, viscosity=1e-3)
        elif law is laws.HertzDashpot:
            made = law(stiffness=stiffness, damping=1.0)
        else:
            made = law(stiffness=stiffness, restitution=0.5)
        body = scene.add_body(
            1.0, [1e-3] * 3, position=(0, 0, 1e-5), linear_velocity=(0, 0, -1), name=law.__name__
        )
        material = wc.ContactMaterial(law=made)
        name = f"touch_{law.__name__}"
        scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, material, radius=RADIUS, name=name)
    model = scene.build(envs=len(e), device=device, precision=precision)
    for law, _, stiffness in ROWS:
        name = f"touch_{law.__name__}.law"
        if law is laws.KuwabaraKono:
            reduced = [reduced_viscosity(value) for value in e]
            model[f"{name}.viscosity"] = np.array(reduced) / stiffness**0.4
        elif law is laws.HertzDashpot:
            # The table has no row for e = 1, which needs no dashpot.
            constants = np.interp(e, np.append(dashpot[:, 0], 1.0), np.append(dashpot[:, 9], 0.0))
            model[f"{name}.damping"] = constants * stiffness**0.4
        else:
            model[f"{name}.restitution"] = e
    # The softest unloading, e = 0.05 with two stiffnesses, takes ten contact times.
    wc.Simulation(model, dt=5e-6).step(24000)
    failures = []
    for law, column, _ in ROWS:
        rebound = model.sensor(f"{law.__name__}.linear_velocity")[:, 2]
        expected = table[column]
        assert (model.sensor(f"touch_{law.__name__}.normal_force") == 0).all(), law
        error = np.abs(rebound - expected)
        if error.max() > tolerance:
            failures.append((law.__name__, e[error.argmax()], error.max()))
    assert not failures


def reduced_viscosity(restitution):
    """A* whose Padé approximant is ``restitution``."""
    law = nonlinear_dashpot.KuwabaraKono.from_restitution(
        stiffness=1.0, restitution=restitution, speed=1.0, mass=1.0
    )
    return law.viscosity


def test_tsuji_restitution_is_exact_for_any_exponent(device):
    e = np.array([0.2, 0.5, 0.9])
    for exponent in (1.0, 1.5, 2.0):
        model = dropped_sphere(
            laws.Tsuji(stiffness=1e6, exponent=exponent, restitution=0.5), envs=3, height=1e-5, device=device,
            precision="float64",
        )  # fmt: skip
        model["touch.law.restitution"] = e
        dt = contact_time(1e6, exponent, 1.0, 1.0) / 2000
        wc.Simulation(model, dt=dt).step(8000)
        np.testing.assert_allclose(model.sensor("ball.linear_velocity")[:, 2], e, atol=1e-3)


def force_at(law, depths, device, **velocity):
    """Normal force of ``law`` at given penetrations, without and with approach."""
    model = dropped_sphere(law, velocity=(0, 0, -velocity.get("speed", 0.0)), envs=len(depths), device=device,
                           precision="float64")  # fmt: skip
    position = model["ball.position"].copy()
    position[:, 2] = 0.1 - np.asarray(depths)
    model["ball.position"] = position
    return model.sensor("touch.normal_force")


def test_cylinder_laws_match_worked_numbers(device):
    # Steel of 207 GPa: E* = 113.7 GPa, L = 15 mm, ΔR = 0.1 mm, δ = 0.01 mm: 13073.0 N and 12352.0 N.
    steel = {"modulus": 207e9 / (2 * (1 - 0.3**2)), "length": 0.015, "clearance": 1e-4}
    np.testing.assert_allclose(force_at(laws.JohnsonCylinder(**steel), [1e-5], device), 13073.0, rtol=5e-6)
    np.testing.assert_allclose(force_at(laws.PereiraCylinder(**steel), [1e-5], device), 12352.0, rtol=5e-6)


def test_johnson_cylinder_inverts_its_formula_over_its_whole_range(device):
    modulus, length, clearance = 1e9, 0.1, 1e-3
    law = laws.JohnsonCylinder(modulus=modulus, length=length, clearance=clearance)
    limit = 4 * np.exp(-2) * clearance
    depths = np.concatenate([limit * np.geomspace(1e-6, 0.99, 40), [limit * 0.999999]])
    force = force_at(law, depths, device)
    line = np.pi * modulus * length
    back = force / line * (np.log(4 * line * clearance / force) - 1)
    # At a height of 0.1 m, the penetration is accurate to 1.4e-17 m.
    np.testing.assert_allclose(back, depths, rtol=1e-9, atol=1.4e-17)
    beyond = force_at(law, [limit * (1 - 1e-9), limit * (1 + 1e-9), 2 * limit], device)
    np.testing.assert_allclose(beyond, line * np.array([limit, limit, 2 * limit]), rtol=1e-4)


def test_pereira_in_si_units_matches_the_fit_in_millimeters():
    for kind, factor, exponent in (
        (laws.PereiraCylinderExternal, (0.39 * 20 + 0.85) / 20, 1.094),
        (laws.PereiraCylinder, (0.965 * 0.2 + 0.0965) / 0.2, 1.51 * np.log(200) ** -0.151 * 0.2**-0.005),
    ):
        radii = 20.0 if kind is laws.PereiraCylinderExternal else 0.2  # mm
        values = {"modulus": np.array([1e11]), "length": np.array([0.015]), "clearance": np.array([radii * 1e-3])}
        made = kind.coefficients(values)
        depth = 0.01  # mm
        expected = factor * 15 * 1e5 * depth**exponent
        np.testing.assert_allclose(made["stiffness"] * (depth * 1e-3) ** made["exponent"], expected, rtol=1e-12)
    assert elastic.PereiraCylinderExternal.device == ("stiffness", "exponent")


def test_elliptic_hertz_stiffness_has_expected_symmetries():
    # Equal radii give the sphere of twice the combined radius; crossed equal cylinders are such a contact.
    circular = laws.Hertz.elliptic(E=210e9, nu=0.3, Rx=0.02, Ry=0.02, E2=210e9, nu2=0.3)
    sphere = laws.Hertz.from_materials(E=210e9, nu=0.3, R=0.02, E2=210e9, nu2=0.3)
    np.testing.assert_allclose(circular.stiffness, sphere.stiffness, rtol=1e-9)
    # Scaling both radii scales K by the root; swapping them changes nothing.
    one = laws.Hertz.elliptic(E=1e9, nu=0.3, Rx=0.01, Ry=0.1)
    np.testing.assert_allclose(laws.Hertz.elliptic(E=1e9, nu=0.3, Rx=0.1, Ry=0.01).stiffness, one.stiffness)
    scaled = laws.Hertz.elliptic(E=1e9, nu=0.3, Rx=0.04, Ry=0.4)
    np.testing.assert_allclose(scaled.stiffness, 2 * one.stiffness, rtol=1e-9)


def test_contact_range_law_hovers_and_bounces_as_closed_form(shared, device):
    oracle = json.loads((shared / "laws" / "oracles.json").read_text())
    values = next(value for key, value in oracle.items() if key.startswith("G27"))
    law = laws.ContactRange(k1=1e7, k2=1e4, area=0.01)
    scene_options = {"mass": 5.0, "radius": 0.02, "device": device, "precision": "float64"}
    resting = dropped_sphere(law, gravity=(0, 0, -9.81), velocity=(0, 0, 0), **scene_options)
    wc.Simulation(resting, dt=1e-4).step(20000)
    # The contact radius is the range of adhesion, so the height of the point is its distance.
    np.testing.assert_allclose(resting.sensor("ball.position")[0, 2], 0.01950950, rtol=1e-7)
    free = dropped_sphere(law, height=1e-4, **scene_options)
    wc.Simulation(free, dt=2e-5).step(3000)
    np.testing.assert_allclose(free.sensor("ball.linear_velocity")[0, 2], 0.8084243834, rtol=1e-3)
    assert values  # the oracle file contains the same case


def test_elastic_foundation_converges_with_number_of_points(device):
    """Sphere pressed onto a plane: the limit is π k δ² (R − δ/3), springs on the plane by projected area."""
    radius, depth, modulus = 0.05, 0.004, 1e9
    expected = 2446.253480
    errors = []
    for count in (20, 40, 80):
        # Points of the lower spherical cap on a square grid, each with its projected area.
        ticks = (np.arange(count) + 0.5) / count * 0.05 - 0.025
        x, y = (axis.ravel() for axis in np.meshgrid(ticks, ticks))
        inside = x**2 + y**2 < 0.024**2
        points = np.column_stack([x, y, -np.sqrt(radius**2 - x**2 - y**2)])[inside]
        area = (0.05 / count) ** 2
        scene = wc.Scene(gravity=(0, 0, 0))
        ground = scene.add_surface(wc.meshes.grid((1, 1)))
        ball = scene.add_body(1.0, [1e-3] * 3, position=(0, 0, radius - depth), name="ball")
        law = laws.ElasticFoundation(stiffness=modulus, area=1.0)
        scene.add_contact(scene.add_points(ball, points), ground, wc.ContactMaterial(law=law), name="bed")
        model = scene.build(device=device, precision="float64")
        model["bed.law.area"] = np.full((1, len(points)), area)
        errors.append(abs(model.sensor("ball.force")[0, 2] / expected - 1))
    assert errors[-1] < 2e-3
    assert errors[-1] < errors[0]


def test_impact_on_many_points_has_prescribed_restitution(device):
    """A sphere with many contact points, each with its own impact speed: within 0.01 of e, and slightly below."""
    rng = np.random.default_rng(7)
    radius = 0.05
    place = rng.normal(size=(400, 3))
    place *= radius / np.linalg.norm(place, axis=1, keepdims=True)
    place = place[place[:, 2] < -0.8 * radius]
    e = np.array([0.9, 0.7, 0.5, 0.3])
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(wc.meshes.grid((1, 1)))
    ball = scene.add_body(1.0, [1e-3] * 3, position=(0, 0, radius + 1e-5), linear_velocity=(0, 0, -1), name="ball")
    law = laws.HuntCrossley(stiffness=2e4, exponent=1.0, restitution=0.5)
    scene.add_contact(scene.add_points(ball, place), ground, wc.ContactMaterial(law=law), name="bed")
    model = scene.build(envs=len(e), device=device, precision="float64")
    model["bed.law.restitution"] = e
    wc.Simulation(model, dt=2e-5).step(6000)
    assert (model.sensor("bed.normal_force") == 0).all()
    # Points are not evenly spaced, so some energy goes into rotation.
    energy = model.sensor("ball.kinetic_energy")
    np.testing.assert_allclose(np.sqrt(2 * energy), e, atol=0.01)
