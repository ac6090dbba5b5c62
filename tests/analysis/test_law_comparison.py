"""Comparison of laws and friction models: data sets against tables and closed forms, and figures."""

from typing import Any

import numpy as np
import pytest
import warp as wp

import warpcontact as wc
from warpcontact.analysis import compare

L, F = wc.laws, wc.friction

# Law, its column of the table.
ROWS = [
    (L.HuntCrossley, "zhang_sharf_exact"),
    (L.LankaraniNikravesh, "lankarani_nikravesh_1990"),
    (L.Flores, "ye_2009_flores_2011"),
    (L.TwoStiffness, "two_stiffness_r_eq_e2"),
]
ELASTIC = (L.Hooke, L.Hertz, L.PowerLaw, L.JohnsonCylinder, L.PereiraCylinder, L.PereiraCylinderExternal)


class Pad(wc.Law):
    """N = k δ² (1 + χ δ̇), a custom law whose names do not exist in the library."""

    pressure: float = wc.parameter("N/m²", "k", above=0.0)
    hysteresis: float = wc.parameter("s/m", "χ", default=0.0, at_least=0.0)

    @wp.func
    def force(p: Any, c: Any):
        one = type(c.delta)(1.0)
        return p.pressure * c.delta * c.delta * (one + p.hysteresis * c.delta_dot)


class Lubricated(wc.Friction):
    """F = −β N s v."""

    drag: float = wc.parameter("s²/m²", "drag β", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return (-p.drag * s.normal_force * s.speed) * s.velocity


@pytest.fixture(scope="module")
def table_impacts(device):
    """Impacts with the laws of ``ROWS``, at the restitutions of the table."""
    return compare.impacts([law for law, _ in ROWS], device=device)


@pytest.fixture(scope="module")
def catalogue_impacts(device):
    """Impacts with every law of the catalogue."""
    return compare.impacts(L.CATALOGUE, [0.3, 0.7, 1.0], device=device)


def test_effective_restitution_matches_reference_table(table_impacts, shared):
    table = np.genfromtxt(shared / "laws" / "restitution_table.csv", delimiter=",", names=True, deletechars="")
    rows = {round(float(e), 2): k for k, e in enumerate(table["e_prescribed"])}
    order = [rows[round(float(e), 2)] for e in table_impacts["restitution"].values]
    for law, column in ROWS:
        measured = table_impacts["effective_restitution"].sel(law=law.__name__)
        # 1000 steps per contact time: a law that is discontinuous at the end of the approach has an error of 1e-3.
        np.testing.assert_allclose(measured, table[column][order], atol=1e-3, err_msg=law.__name__)


@pytest.mark.slow
def test_hysteresis_loops_close_and_enclose_lost_energy(catalogue_impacts):
    force, depth = catalogue_impacts["normal_force"], catalogue_impacts["penetration"]
    for end in (0, -1):
        assert (force.isel(time=end) == 0).all()
    assert (depth.isel(time=0) == 0).all()
    assert (force.max("time") > 0).all()
    lost = (
        0.5
        * catalogue_impacts.attrs["mass"]
        * catalogue_impacts.attrs["speed"] ** 2
        * (1 - catalogue_impacts["effective_restitution"] ** 2)
    )
    # Records are 1/500 of a contact time apart. A dashpot on approach with e = 0.3 dissipates all energy within
    # about twelve of them.
    np.testing.assert_allclose(catalogue_impacts["energy_loss"], lost, atol=4e-3 * 0.5)


@pytest.mark.slow
def test_all_laws_are_compared_in_the_same_impact(catalogue_impacts):
    """All undamped laws have equal penetration; damped laws have the prescribed restitution, elastic ones e = 1."""
    undamped = catalogue_impacts.sel(restitution=1.0)
    np.testing.assert_allclose(undamped["greatest_penetration"], 1e-3, rtol=1e-3)
    # 2.6 to 3.14 δ/v, depending on the exponent.
    assert ((undamped["contact_time"] > 2.6e-3) & (undamped["contact_time"] < 3.2e-3)).all()
    varied = dict(zip(catalogue_impacts["law"].values, catalogue_impacts["varied"].values, strict=True))
    assert {law for law, name in varied.items() if not name} == {law.__name__ for law in ELASTIC}
    for law, name in varied.items():
        measured = catalogue_impacts["effective_restitution"].sel(law=law)
        if not name:
            np.testing.assert_allclose(measured, 1.0, atol=1e-3)
        elif name != "restitution":
            # Found by interpolation in a series with coarser steps.
            np.testing.assert_allclose(measured, catalogue_impacts["restitution"], atol=2e-3, err_msg=law)
            assert catalogue_impacts["parameter"].sel(law=law).values[-1] == 0.0


def test_peak_force_and_contact_time_match_closed_forms(device):
    data = compare.impacts([L.Hertz, L.Hooke], 1.0, mass=2.0, speed=3.0, depth=5e-4, device=device)
    for law, exponent in (("Hertz", 1.5), ("Hooke", 1.0)):
        case = data.sel(law=law).isel(restitution=0)
        stiffness = (exponent + 1) * 2.0 * 3.0**2 / (2 * 5e-4 ** (exponent + 1))
        np.testing.assert_allclose(case["greatest_force"], stiffness * 5e-4**exponent, rtol=1e-3)
        time = L.contact_time(stiffness, exponent, 2.0, 3.0)
        np.testing.assert_allclose(case["contact_time"], time, rtol=3e-3)


def test_restitution_over_speed_differs_between_laws(device):
    slow_to_fast = [0.2, 1.0, 5.0]
    data = compare.rebounds([L.HuntCrossley, L.HertzDashpot, L.KuwabaraKono], 0.6, slow_to_fast, device=device)
    over_speed = data["effective_restitution"].isel(restitution=0)
    np.testing.assert_allclose(over_speed.sel(law="HuntCrossley"), 0.6, atol=1e-3)
    np.testing.assert_allclose(over_speed.sel(speed=1.0), 0.6, atol=2e-3)
    assert (np.diff(over_speed.sel(law="HertzDashpot")) > 0.05).all()
    assert (np.diff(over_speed.sel(law="KuwabaraKono")) < -0.05).all()
    # For Kuwabara–Kono, a speed factor of 5 is equivalent to a viscosity factor of 5^(1/5).
    law = L.KuwabaraKono.from_restitution(stiffness=1.0, restitution=0.6, speed=1.0, mass=1.0)
    expected = wc.kernels.laws.nonlinear_dashpot.restitution_of_viscosity(
        law.viscosity * np.array([0.2, 5.0]) ** 0.2
    )
    np.testing.assert_allclose(over_speed.sel(law="KuwabaraKono", speed=[0.2, 5.0]), expected, atol=2e-3)


def test_custom_law_is_compared_like_library_laws(device, tmp_path):
    mine = Pad(pressure=3e9)
    data = compare.impacts({"pad": mine, "harder": Pad(pressure=6e9)}, [0.5, 1.0], device=device)
    assert data["law"].values.tolist() == ["pad", "harder"]
    assert data["varied"].values.tolist() == ["hysteresis", "hysteresis"]
    assert data["settings"].values[0] == "pressure 3e+09 N/m²"
    np.testing.assert_allclose(data["effective_restitution"], [[0.5, 1.0]] * 2, atol=2e-3)
    # d = χ v₀ is the root of d (1 + e) = ln[(1 + d)/(1 − d e)] for any elastic part.
    np.testing.assert_allclose(data["parameter"][:, 0], 1.432750533, rtol=5e-3)
    # ½ m v² = k δ³/3
    np.testing.assert_allclose(data["greatest_penetration"][:, 1], np.cbrt([0.5e-9, 0.25e-9]), rtol=1e-3)
    compare.plot_laws([mine, L.Hertz], tmp_path / "own.svg", device=device)
    assert (tmp_path / "own.svg").stat().st_size > 10_000


def test_steady_slip_matches_friction_curve(device):
    speeds = np.array([0.002, 0.01, 0.05])
    chosen = {"default": F.Tanh, "mine": F.Tanh(mu=0.7, velocity_scale=0.02), "oil": Lubricated(drag=0.5)}
    data = compare.slips(chosen, speeds, load=25.0, device=device)
    curve = data["coefficient"]
    np.testing.assert_allclose(curve.sel(friction="default"), 0.4 * np.tanh(speeds / 0.01), rtol=1e-6)
    np.testing.assert_allclose(curve.sel(friction="mine"), 0.7 * np.tanh(speeds / 0.02), rtol=1e-6)
    np.testing.assert_allclose(curve.sel(friction="oil"), 0.5 * speeds**2, rtol=1e-6)
    assert data["settings"].values[2] == "drag 0.5 s²/m²"


def test_oscillating_slip_follows_prescription_and_dissipates_energy(device):
    data = compare.swings(F.RegularizedCoulomb(mu=0.4), [1e-3, 1e-2], speed=0.5, device=device)
    assert (data["coefficient"].isel(time=0) == 0).all()
    for k, amplitude in enumerate((1e-3, 1e-2)):
        moved = data["displacement"].isel(amplitude=k)
        expected = -amplitude * np.cos(0.5 / 1e-2 * data["time"])
        np.testing.assert_allclose(moved, expected, atol=1e-9 * amplitude)
    # Over the last whole cycle 4 μ A N is dissipated, minus the part below the ramp of 0.01 m/s, 1/50 of the
    # speed.
    last = data.isel(friction=0, amplitude=1, time=slice(-1001, None))
    work = np.trapezoid(last["coefficient"], last["displacement"])
    np.testing.assert_allclose(work, 4 * 0.4 * 1e-2, rtol=2e-3)


@pytest.mark.slow
def test_friction_with_history_reaches_steady_slip(device):
    speeds = np.array([1e-4, 5e-3, 0.2])
    bristles = F.LuGre(mu_static=0.5, mu_dynamic=0.3, stribeck_speed=0.01, stiffness=1e5)
    data = compare.slips([bristles, F.CundallStrack], speeds, device=device)
    expected = 0.3 + 0.2 * np.exp(-((speeds / 0.01) ** 2))
    np.testing.assert_allclose(data["coefficient"].sel(friction="LuGre"), expected, rtol=1e-6)
    np.testing.assert_allclose(data["coefficient"].sel(friction="CundallStrack"), 0.4, rtol=1e-6)


def test_stick_spring_oscillates_along_its_stiffness(device):
    spring = F.CundallStrack(mu_static=0.5, mu_dynamic=0.3, stiffness=2e4)
    data = compare.swings(spring, [1e-4, 1e-3], load=10.0, device=device).isel(friction=0)
    # An amplitude of 0.1 mm stretches the spring to 0.2 mm and 4 N, below the limit of 5 N: no dissipation.
    small = data.isel(amplitude=0)
    np.testing.assert_allclose(small["coefficient"], 2e4 / 10.0 * (small["displacement"] + 1e-4), atol=1e-9)
    # An amplitude of 1 mm slides, with at most μ_s and mostly μ_d, and the second cycle is closed.
    last = data.isel(amplitude=1, time=slice(-1001, None))
    size = np.abs(last["coefficient"])
    assert 0.49 < float(size.max()) <= 0.5 + 1e-9
    np.testing.assert_allclose(size.median(), 0.3, rtol=1e-6)
    np.testing.assert_allclose(last["coefficient"][[0, -1]], -0.3, rtol=1e-6)


def test_slip_direction_selects_coefficient_of_anisotropic_friction(device):
    skate = F.Elliptic(mu_1=0.1, mu_2=0.4)
    for direction, expected in ((0.0, 0.1), (np.pi / 2, 0.4)):
        data = compare.slips(skate, [1.0], direction=direction, device=device)
        np.testing.assert_allclose(data["coefficient"], expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["laws", "friction"])
def test_every_catalogue_entry_can_be_plotted(kind, times, device, tmp_path):
    """Every fifth entry, because each compiles separate kernels; all entries with --thorough."""
    catalogue, draw = (
        (L.CATALOGUE, compare.plot_laws) if kind == "laws" else (F.CATALOGUE, compare.plot_friction_models)
    )
    catalogue = catalogue[:: 5 // times]
    most = compare.figures.MOST
    for first in range(0, len(catalogue), most):
        draw(catalogue[first : first + most], tmp_path / f"{first}.png", device=device)
        assert (tmp_path / f"{first}.png").read_bytes().startswith(b"\x89PNG")
    for k, one in enumerate((catalogue[0], catalogue[-1])):
        draw(one, tmp_path / f"one{k}.svg", device=device)
        assert "</svg>" in (tmp_path / f"one{k}.svg").read_text()


def test_repeated_plot_is_bitwise_identical(device, tmp_path):
    for name in ("one.svg", "two.svg"):
        compare.plot_laws(L.Hooke, tmp_path / name, device=device)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: compare.impacts([]), "got no law to compare"),
        (lambda: compare.impacts(F.Tanh), "a law must be a class or an instance of wc.Law, got <class .*Tanh'>"),
        (lambda: compare.impacts("Hooke"), "a law must be a class or an instance of wc.Law, got 'Hooke'"),
        (
            lambda: compare.slips(L.Hooke(stiffness=1.0)),
            "a friction must be a class or an instance of wc.Friction",
        ),
        (
            lambda: compare.impacts([L.Hertz, L.Hertz(stiffness=1e6)]),
            "labels must be distinct, got two laws 'Hertz': pass a",
        ),
        (
            lambda: compare.impacts(Pad),
            "Pad needs pressure: pass an instance with its values instead of the class",
        ),
        (lambda: compare.slips(Lubricated), "Lubricated needs drag: pass an instance"),
        (lambda: compare.impacts(L.Hertz, [0.5, 1.5]), r"restitution\[1\] must be at least 0.01 and at most 1"),
        (lambda: compare.impacts(L.Hertz, 1.5), r"restitution must be at least 0.01 and at most 1, got 1.5"),
        (lambda: compare.impacts(L.Hertz, mass=0), "mass must be greater than 0, got 0 kg"),
        (lambda: compare.impacts(L.Hertz, speed=-1.0), "speed must be greater than 0, got -1 m/s"),
        (lambda: compare.impacts(L.Hertz, depth=np.nan), "depth must be greater than 0, got nan m"),
        (lambda: compare.rebounds(L.Hertz, speeds=[1.0, 0.0]), r"speeds\[1\] must be greater than 0, got 0 m/s"),
        (lambda: compare.slips(F.Tanh, load=0), "load must be greater than 0, got 0 N"),
        (lambda: compare.swings(F.Tanh, amplitude=[0.0]), r"amplitude\[0\] must be greater than 0, got 0 m"),
        (lambda: compare.plot_laws(L.Hertz, "a.pdf"), r"a.pdf: must end in .svg or .png, got .pdf"),
        (lambda: compare.plot_laws(L.CATALOGUE), "a plot shows at most 8 laws, got 29: Hooke, "),
    ],
)
def test_compare_raises_for_invalid_arguments(call, message):
    with pytest.raises((ValueError, TypeError), match=message):
        call()
