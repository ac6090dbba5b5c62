"""Catenaries between bodies: cases of the specification, equilibrium, stiffness, seabed and motion."""

import json
import warnings

import numpy as np
import pytest
from catenary_cases import random_lines
from warpcontact.kernels.couplings import catenary, elastic_line

import warpcontact as wc

UNIT = (1.0, 1.0, 1.0)
# Forces are rounded to the precision of the model. All intermediate results are in float64.
TOLERANCE = {"float32": 2.0e-6, "float64": 1.0e-10}
LINE = {"length": 100.0, "mass_per_length": 20.0, "axial_stiffness": 1e6}


def cable_to(place_b, envs=1, device="cpu", precision="float64", gravity=(0.0, 0.0, -9.81), **options):
    """A cable from the origin of the world to a body at ``place_b``, (3,) or (envs, 3)."""
    scene = wc.Scene(gravity=gravity)
    body = scene.add_body(1.0, UNIT, name="body")
    ends = scene.add_point(None, (0, 0, 0), name="anchor"), scene.add_point(body, (0, 0, 0))
    scene.add_catenary(*ends, **{**LINE, **options}, name="line")
    model = scene.build(envs, device, precision)
    model["body.position"] = place_b
    return model


@pytest.fixture(scope="module")
def oracle(shared):
    return json.loads((shared / "spec" / "oracle_catenary.json").read_text())["cases"]


def up_and_along(gravity):
    up = -np.array(gravity) / np.linalg.norm(gravity)
    along = np.cross(up, (0.3, -0.5, 0.7))
    return up, along / np.linalg.norm(along)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("direction", [(0.0, 0.0, -1.0), (0.48, -0.6, 0.64)])
def test_catenary_matches_specification_cases(oracle, precision, direction, device):
    """Also with gravity along other axes, and with exchanged ends."""
    cases = list(oracle.values())
    gravity = 9.81 * np.array(direction)
    up, along = up_and_along(gravity) if direction[0] else (np.array([0, 0, 1.0]), np.array([1.0, 0, 0]))
    sign = np.repeat([1.0, -1.0], len(cases))[:, None]
    cases = cases * 2
    places = np.array([case["dx"] * along + case["dy"] * up for case in cases])
    model = cable_to(sign * places, len(cases), device, precision, gravity)
    for key, of_case in (("length", "L"), ("mass_per_length", "lam0"), ("axial_stiffness", "EA")):
        model[f"line.{key}"] = [case[of_case] for case in cases]
    first = np.array([case.get("H_mp", case["H"]) * along + case.get("V1_mp", case["V1"]) * up for case in cases])
    second = np.array([-case["H"] * along - case["V2"] * up for case in cases])
    swapped = sign < 0.0
    force_a, force_b = model.sensor("line.force_a"), model.sensor("line.force_b")
    largest = np.maximum(np.abs(first), np.abs(second)).max(axis=1)[:, None]
    # Coordinates in tilted axes are rounded: 1e-7 of the chord, relative to strains of a twentieth.
    close = {"rtol": 0.0, "atol": TOLERANCE[precision] * (1.0 if not direction[0] else 30.0)}
    np.testing.assert_allclose(force_a / largest, np.where(swapped, second, first) / largest, **close)
    np.testing.assert_allclose(force_b / largest, np.where(swapped, first, second) / largest, **close)
    if direction[0]:
        return
    close["rtol"] = close.pop("atol")
    unswapped = slice(0, len(cases) // 2)
    for sensor, of_case in (("horizontal_tension", "H"), ("tension_a", "T1"), ("tension_b", "T2")):
        expected = np.array([case[of_case] for case in cases[unswapped]])
        np.testing.assert_allclose(model.sensor(f"line.{sensor}")[unswapped], expected, **close)
    for env, case in enumerate(cases[unswapped]):
        if "min_y_below_end1" in case:
            # The value of the specification is the lowest of about a thousand points.
            np.testing.assert_allclose(model.sensor("line.dip")[env], case["min_y_below_end1"], rtol=1e-6)
            stretched = model.sensor("line.stretched_length")[env]
            np.testing.assert_allclose(stretched, case["stretched_length_formula"], **close)
    status = model.sensor("line.status")[unswapped]
    assert [wc.CatenaryStatus(code).name for code in status] == ["HANGING", "TAUT", "HANGING", "FOLDED", "TAUT"]


def test_catenary_forces_in_float32_match_float64_for_random_cables(device):
    """In float32, positions have a rounding remainder, so the tension of a nearly taut cable is accurate."""
    lines = random_lines(100_000)
    x, y, weight, give = lines.T
    models = [cable_to((1.0, 0, 0), len(lines), device, precision) for precision in ("float64", "float32")]
    for model in models:
        model["body.position"] = 100.0 * np.stack([x, np.zeros_like(x), y], axis=1)
        model["line.axial_stiffness"] = 9.81 * 2000.0 / (weight * give)
    exact, rounded = (model.sensor("line.force_b") for model in models)
    largest = np.abs(exact).max(axis=1, keepdims=True)
    assert (models[0].sensor("line.status") != wc.CatenaryStatus.FAILED).all()
    assert (models[1].sensor("line.status") != wc.CatenaryStatus.FAILED).all()
    for model, rounding in zip(models, (1e-12, 2e-7), strict=True):
        assert model.sensor("line.iterations").max() <= 20
        # The end forces balance the weight, to rounding of the larger force.
        total = model.sensor("line.force_a") + model.sensor("line.force_b")
        off = (total + np.array([0.0, 0.0, 9.81 * 2000.0])) / largest
        np.testing.assert_allclose(off, 0.0, atol=rounding)
    # The remaining error comes from gravity, which has no remainder: 3e-8 of the weight and of the tension.
    np.testing.assert_allclose(rounded / largest, exact / largest, atol=2e-6)


@pytest.fixture(scope="module")
def scattered(device):
    """A model of cables to many positions, and these positions."""
    places = np.random.default_rng(0).normal(size=(200, 3)) * (60.0, 60.0, 30.0)
    return cable_to(places, len(places), device), places


def test_catenary_end_forces_sum_to_its_weight(scattered):
    model, _ = scattered
    total = model.sensor("line.force_a") + model.sensor("line.force_b")
    np.testing.assert_allclose(total, [[0.0, 0.0, -20.0 * 9.81 * 100.0]] * model.envs, atol=1e-7)
    np.testing.assert_array_equal(model.sensor("body.force"), model.sensor("line.force_b"))


def test_catenary_shape_ends_at_its_end_points_and_has_its_length(scattered):
    model, places = scattered
    shape = model.catenary_shape("line", 4001)
    np.testing.assert_allclose(shape[:, 0], 0.0, atol=1e-7)
    np.testing.assert_allclose(shape[:, -1], places, atol=1e-7)
    polyline = np.linalg.norm(np.diff(shape, axis=1), axis=2).sum(axis=1)
    # A polyline of 4000 chords on arcs with radii of some meters.
    np.testing.assert_allclose(model.sensor("line.stretched_length"), polyline, rtol=1e-6)
    np.testing.assert_allclose(model.sensor("line.dip"), -shape[..., 2].min(axis=1), atol=0.01)


def _forces(model, places):
    model["body.position"] = places
    return model.sensor("line.force_b")


def _differences(model, places, step):
    columns = []
    for axis in np.eye(3):
        ahead, behind = (_forces(model, places + side * step * axis) for side in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * step))
    model["body.position"] = places
    return np.stack(columns, axis=-1)


def test_catenary_stiffness_is_the_derivative_of_force(scattered):
    model, places = scattered
    expected = _differences(model, places, 1e-4)
    stiffness = model.catenary_stiffness("line")
    size = np.abs(stiffness).max(axis=(1, 2), keepdims=True)
    # Central differences over 0.1 mm, of cables that bend within decimeters, plus a residual of 1e-8 m times
    # stiffness.
    np.testing.assert_allclose(stiffness / size, expected / size, atol=1e-4)
    np.testing.assert_array_equal(stiffness, np.swapaxes(stiffness, 1, 2))
    assert (np.linalg.eigvalsh(stiffness) < 0.0).all()


def test_catenary_stiffness_of_vertical_cable_is_the_limit(device):
    places = np.array([[0, 0, z] for z in (-120.0, -103.0, 50.0, 103.0, 120.0)], dtype=float)
    model = cable_to(places, len(places), device)
    upright = model.catenary_stiffness("line")
    expected = _differences(model, places, 1e-3)
    np.testing.assert_allclose(upright[:, 2, 2], expected[:, 2, 2], rtol=1e-6)
    taut = [0, 1, 3, 4]
    np.testing.assert_allclose(upright[taut], expected[taut], rtol=1e-5, atol=1e-3)
    # A folded vertical cable has no lateral force, because the tension at the fold is zero.
    np.testing.assert_array_equal(upright[2, :2], 0.0)


def test_catenary_gravity_can_vary_by_environment_and_vanish(device):
    model = cable_to((50.0, 0.0, 0.0), 4, device)
    model["body.position"] = [(60.0, 0, 80.0 * 1.05), (30.0, 40.0, 0), (0, 0, 0), (0.0, 0.0, -110.0)]
    model["scene.gravity"] = (0.0, 0.0, 0.0)
    chord = np.hypot(60.0, 84.0)
    tension = 1e6 * (chord / 100.0 - 1.0)
    # The force of a straight spring, or zero.
    expected = [(tension * 60.0 / chord, 0.0, tension * 84.0 / chord), (0, 0, 0), (0, 0, 0), (0, 0, -1e5)]
    np.testing.assert_allclose(model.sensor("line.force_a"), expected, rtol=1e-12)
    names = [wc.CatenaryStatus(code).name for code in model.sensor("line.status")]
    assert names == ["TAUT", "LOOSE", "LOOSE", "TAUT"]
    np.testing.assert_allclose(model.catenary_shape("line", 3)[1], [(0, 0, 0), (15.0, 20.0, 0), (30.0, 40.0, 0)])
    # Without gravity the cable is straight: stiffness EA/L along it and T/chord across.
    stiffness = model.catenary_stiffness("line")[3]
    np.testing.assert_allclose(stiffness, -np.diag([1e5 / 110.0, 1e5 / 110.0, 1e4]), rtol=1e-12)
    model["scene.gravity"] = [(0, 0, 0), (0, 0, 0), (0, -2.0, 0), (0, 0, 0)]
    # Both ends at the same position: the cable folds in its middle.
    np.testing.assert_allclose(model.sensor("line.force_a")[2], (0, -2000.0, 0), rtol=1e-12)


def test_catenary_is_invariant_far_from_the_origin(device):
    """float32 resolves about 1 mm there, but differences of body positions keep their precision."""
    scene = wc.Scene()
    for k, far in enumerate((0.0, 1e5)):
        body = scene.add_body(1.0, UNIT, (far + 80.0, far, 30.0 + far), name=f"body_{k}")
        anchor = scene.add_point(None, (far, far, far))
        scene.add_catenary(anchor, scene.add_point(body, (0, 0, 0)), **LINE, floor=far - 2.0, name=f"line_{k}")
    model = scene.build(device=device, precision="float32")
    for sensor in ("force_b", "grounded_length"):
        near, far = (model.sensor(f"line_{k}.{sensor}") for k in range(2))
        np.testing.assert_allclose(far, near, rtol=1e-6)
    assert model.sensor("line_1.status") == wc.CatenaryStatus.GROUNDED
    near, far = (model.catenary_shape(f"line_{k}", 9) for k in range(2))
    np.testing.assert_allclose(far - 1e5, near, atol=1e-6)
    near, far = (model.catenary_stiffness(f"line_{k}") for k in range(2))
    np.testing.assert_allclose(far, near, rtol=1e-6, atol=1e-4)


def test_catenary_force_is_continuous_at_liftoff_from_seabed(device):
    """As the upper end rises, forces and shape are continuous from the grounded to the suspended cable."""
    x = np.linspace(0.0, 100.0, 401)
    places = np.stack([x, np.zeros_like(x), np.full_like(x, 30.0)], axis=1)
    model = cable_to(places, len(x), device, floor=0.0)
    status = model.sensor("line.status")
    lies = model.sensor("line.grounded_length")
    grounded = status == wc.CatenaryStatus.GROUNDED
    assert grounded[0]
    assert not grounded[-1]
    # After liftoff, the cable remains off the seabed.
    assert (np.diff(grounded.astype(int)) <= 0).all()
    assert (np.diff(lies) <= 1e-9).all()
    shape = model.catenary_shape("line", 201)
    assert (shape[..., 2] > -1e-6).all()
    np.testing.assert_allclose(shape[:, -1], places, atol=1e-7)
    tension = model.sensor("line.horizontal_tension")
    loose = x <= 100.0 - model.sensor("line.tension_b")[0] / (20.0 * 9.81)
    np.testing.assert_array_equal(tension[loose], 0.0)
    assert (np.diff(tension[~loose]) > 0.0).all()
    # A suspended part from the lowest point: T²/(2 EA) + T = H + H²/(2 EA) + w h.
    upper = model.sensor("line.tension_b")[grounded]
    held = tension[grounded] + tension[grounded] ** 2 / 2e6 + 20.0 * 9.81 * 30.0
    np.testing.assert_allclose(upper + upper**2 / 2e6, held, rtol=1e-12)
    # The anchor is on the seabed: it has no vertical force until the cable lifts off.
    np.testing.assert_array_equal(model.sensor("line.force_a")[grounded][:, 2], 0.0)
    assert (model.sensor("line.force_a")[~grounded][:, 2] > 0.0).all()
    weight = -(model.sensor("line.force_a") + model.sensor("line.force_b"))[:, 2]
    np.testing.assert_allclose(weight, 20.0 * 9.81 * (100.0 - lies), rtol=1e-9)


def test_grounded_catenary_stiffness_is_the_derivative_of_force(device):
    rng = np.random.default_rng(1)
    places = np.stack([*rng.uniform(-60.0, 60.0, (2, 100)), rng.uniform(-1.0, 30.0, 100)], axis=1)
    model = cable_to(places, 100, device, floor=-2.0)
    grounded = model.sensor("line.status") == wc.CatenaryStatus.GROUNDED
    assert grounded.sum() > 50
    assert (places[grounded][:, 2] < 0.0).any()
    expected = _differences(model, places, 1e-4)[grounded]
    stiffness = model.catenary_stiffness("line")[grounded]
    size = np.abs(stiffness).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(stiffness / size, expected / size, atol=1e-4)


def test_catenary_end_below_seabed_is_flagged_and_computed_at_seabed(device):
    model = cable_to([(90.0, 0, 0.0), (90.0, 0, -0.5), (101.0, 0, -0.5)], 3, device, floor=0.0)
    names = [wc.CatenaryStatus(code).name for code in model.sensor("line.status")]
    assert names == ["GROUNDED", "SUNK", "SUNK"]
    np.testing.assert_allclose(model.sensor("line.force_a"), [(0, 0, 0), (0, 0, 0), (1e4, 0, 0)], atol=1e-8)


def test_catenary_end_far_below_seabed_warns(device):
    """A depth given as a height puts both ends below the seabed. An anchor may be buried by 1 % of the length."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wc.Simulation(cable_to((90.0, 0, 49.0), 2, device, floor=0.5), dt=1e-3).step()
    model = cable_to((90.0, 0, 49.0), 2, device, floor=0.5)
    model["line.floor"] = [0.5, 52.0]
    with pytest.warns(wc.ContactWarning) as caught:
        wc.Simulation(model, dt=1e-3).step()
    assert [str(one.message).partition(" in environment 1 and is")[0] for one in caught] == [
        "line: its point_a 'anchor' is 52 m below the floor",
        "line: its point_b 'point' is 3 m below the floor",
    ]


def pendulum(device, precision="float64"):
    """A heavy body that swings on a cable."""
    scene = wc.Scene()
    body = scene.add_body(500.0, UNIT, (8.0, 1.0, -4.0), linear_velocity=(0, 3.0, 0), name="body")
    ends = scene.add_point(None, (0, 0, 0)), scene.add_point(body, (0, 0, 0))
    scene.add_catenary(*ends, length=10.0, mass_per_length=1.0, axial_stiffness=1e5, name="line")
    return scene.build(3, device, precision)


def _line_energy(shape, line):
    """Potential and strain energy of a cable from its shape (frames, points, 3)."""
    piece = line["length"] / (shape.shape[1] - 1)
    middle = 0.5 * (shape[:, 1:, 2] + shape[:, :-1, 2])
    strain = np.linalg.norm(np.diff(shape, axis=1), axis=2) / piece - 1.0
    return piece * (9.81 * line["mass_per_length"] * middle + 0.5 * line["axial_stiffness"] * strain**2).sum(
        axis=1
    )


def test_body_swinging_on_catenary_conserves_energy(device):
    line = {"length": 10.0, "mass_per_length": 1.0, "axial_stiffness": 1e5}
    spread = []
    for dt in (1e-3, 5e-4):
        model = pendulum(device)
        sim = wc.Simulation(model, dt=dt)
        energy = []
        for _ in range(100):
            sim.step(round(0.1 / dt))
            total = model.sensor("body.kinetic_energy")[0] + model.sensor("body.potential_energy")[0]
            energy.append(total + _line_energy(model.catenary_shape("line", 401)[:1], line)[0])
        spread.append(np.ptp(energy))
        # The energy of a symplectic step is off by half a step of power, force times speed, also after 10 s.
        assert spread[-1] < 7e3 * 9.0 * dt
    assert spread[1] < 0.55 * spread[0]


def test_catenary_warm_start_converges_to_cold_start_solution(device):
    model = pendulum(device)
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(700)
    warm = model.sensor("line.force_b")
    assert model.sensor("line.iterations").max() <= 3
    state = {key: getattr(model.state, key).numpy().copy() for key in ("body_position", "body_position_remainder")}
    sim.reset(np.array([False, True, True]))
    for key, values in state.items():
        getattr(model.state, key).assign(values)
    cold = model.sensor("line.force_b")
    np.testing.assert_allclose(cold, warm, rtol=1e-7)
    np.testing.assert_array_equal(cold[0], warm[0])
    np.testing.assert_array_equal(cold[1], cold[2])


def test_catenary_run_is_repeated_after_reset(device):
    model = pendulum(device, "float32")
    sim = wc.Simulation(model, dt=1e-3)
    runs = []
    for _ in range(2):
        sim.reset()
        runs.append(sim.run(0.2, ["line.tension_b", "line.status", "line.iterations"], every=0.02))
    for name in runs[0]:
        np.testing.assert_array_equal(runs[0][name], runs[1][name])
    assert runs[0]["line.status"].attrs["flag_meanings"].startswith("HANGING TAUT")
    # A single environment gives the same trajectory.
    assert (runs[0]["line.tension_b"].values == runs[0]["line.tension_b"].values[:, :1]).all()


def test_disabled_catenary_has_no_force(device):
    model = cable_to((50.0, 0, 0), 2, device)
    model["line.enabled"] = [0, 1]
    assert (model.sensor("line.force_a")[0] == 0.0).all()
    assert (model.catenary_stiffness("line")[0] == 0.0).all()
    assert model.sensor("line.status").tolist() == [wc.CatenaryStatus.DISABLED, wc.CatenaryStatus.HANGING]


@pytest.fixture
def _no_iterations(monkeypatch):
    """Disables the iterations of the solver."""
    monkeypatch.setattr(elastic_line, "EVALUATIONS", 0)
    monkeypatch.setattr(elastic_line, "WARM_EVALUATIONS", 0)
    catenary.kernel.cache_clear()
    yield
    catenary.kernel.cache_clear()


@pytest.mark.usefixtures("_no_iterations")
def test_failed_catenary_solution_warns_and_is_counted(device):
    model = cable_to([(50.0, 0, 0), (0, 0, 50.0)], 2, device)
    assert model.sensor("line.status").tolist() == [wc.CatenaryStatus.FAILED, wc.CatenaryStatus.FOLDED]
    sim = wc.Simulation(model, dt=1e-4)
    with pytest.warns(RuntimeWarning, match="catenary 'line' did not converge in 1 of 2"):
        sim.run(3e-4)
    assert model.sensor("line.failures")[0] == 3
    sim.reset()
    assert model.sensor("line.failures")[0] == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"length": 0.0}, r"line.length must be greater than 0, got 0 m"),
        ({"mass_per_length": -1.0}, r"line.mass_per_length must be at least 0, got -1 kg/m"),
        ({"axial_stiffness": np.inf}, r"line.axial_stiffness"),
        ({"floor": np.nan}, r"line.floor"),
    ],
)
def test_catenary_raises_for_invalid_values(options, message):
    with pytest.raises(ValueError, match=message):
        cable_to((1.0, 0, 0), **options)


def test_catenary_shape_raises_for_unknown_name_and_count(scattered):
    model, _ = scattered
    with pytest.raises(KeyError, match="no catenary 'lime'; did you mean 'line'"):
        model.catenary_shape("lime")
    with pytest.raises(ValueError, match="count must be a whole number of at least 2, got 1"):
        model.catenary_shape("line", 1)


def test_experiment_file_errors_name_the_catenary_key(tmp_path):
    file = tmp_path / "moored.toml"
    file.write_text("""
        duration = 1.0
        dt = 1e-3
        [[body]]
        name = "buoy"
        mass = 1.0
        inertia = [1, 1, 1]
        [[point]]
        name = "top"
        body = "buoy"
        position = [0, 0, 0]
        [[catenary]]
        name = "line"
        point_a = "anchor"
        point_b = "top"
        length = -1
        axial_stiffness = 1e6
        flor = 0
    """)
    with pytest.raises(wc.ExperimentError) as error:
        wc.Experiment.from_toml(file)
    for part in (".length must be greater than 0, got -1", ".mass_per_length is missing", ".flor is not known"):
        assert f"catenary[0] ('line'){part}" in str(error.value)


def test_too_long_step_for_taut_catenary_warns(device):
    """1 kg on EA/L = 10 kN/m: period 63 ms, stable up to 20 ms."""
    sim = wc.Simulation(cable_to((50.0, 0, 0), device=device), dt=0.0199)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.step()
    sim = wc.Simulation(cable_to((50.0, 0, 0), device=device), dt=0.0201)
    with pytest.warns(wc.ContactWarning, match="line: dt = 0.0201 s is too long for the taut cable: .* 0.063 s"):
        sim.step()


def test_frozen_environment_does_not_change_catenaries_of_others(device):
    runs = []
    for broken in (False, True):
        model = pendulum(device)
        sim = wc.Simulation(model, dt=1e-3)
        sim.step(20)
        if broken:
            velocity = model.state.body_linear_velocity.numpy()
            velocity[1] = np.nan
            model.state.body_linear_velocity.assign(velocity)
        sim.step(50)
        runs.append((model.health().frozen.tolist(), model.sensor("line.force_b")))
    assert [frozen for frozen, _ in runs] == [[], [1]]
    np.testing.assert_array_equal(runs[0][1][[0, 2]], runs[1][1][[0, 2]])


def test_catenary_results_of_several_devices_are_gathered_in_order():
    places = np.random.default_rng(2).normal(size=(5, 3)) * 50.0
    whole, split = cable_to(places, 5, "cpu"), cable_to(places, 5, ["cpu", "cpu"])
    np.testing.assert_array_equal(split.catenary_shape("line", 5), whole.catenary_shape("line", 5))
    np.testing.assert_array_equal(split.catenary_stiffness("line"), whole.catenary_stiffness("line"))
    np.testing.assert_array_equal(split.sensor("line.tension_a"), whole.sensor("line.tension_a"))
