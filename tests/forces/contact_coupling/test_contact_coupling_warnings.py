"""Contact couplings: warnings before the first step, report after the last, and error messages."""

import re
import warnings

import numpy as np
import pytest
from contact_coupling_scenes import AREA, CLOSEST, RANGE, SPEED, expected, impact_scene, sole

import warpcontact as wc

TAU = 0.015707963267948967


def warned(model, dt):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        wc.Simulation(model, dt=dt).step()
    return [str(warning.message) for warning in caught]


@pytest.fixture(scope="module")
def impact(device):
    scene, coupling = impact_scene(friction=wc.friction.Tanh(mu=0.3, velocity_scale=0.1))
    return scene.build(envs=3, device=device, precision="float64"), coupling


def test_step_above_one_twentieth_of_stopping_time_warns(impact):
    model, _ = impact
    model.reset()
    assert warned(model, TAU / 20.0) == []
    model.reset()
    # The lightest environment stops first: τ scales with the root of the mass.
    model["block.mass"] = [50.0, 12.5, 50.0]
    (message,) = warned(model, TAU / 20.0)
    assert re.match(
        r"keep: dt = 0.00078\d+ s is too long: a body stops within 0.0079 s in environment 1, 10.0 steps. "
        r"Use dt ≤ 0.00039 s$",
        message,
    )
    model["block.mass"] = 50.0
    # With strong damping, the stability limit is smaller: 2/ω (√(1 + ς²) − ς), ω = 100/s.
    ratio = 40.0
    model["keep.k2"] = 2.0 * ratio * np.sqrt(50.0 * 2.5e7 / AREA)
    model.reset()
    limit = 0.02 * (np.sqrt(1.0 + ratio**2) - ratio)
    assert warned(model, 0.99 * limit) == []
    model.reset()
    (message,) = warned(model, 1.01 * limit)
    assert f"Use dt ≤ {limit:.2g} s" in message
    model["keep.k2"] = 0.0


def test_friction_too_steep_at_peak_impact_force_warns(impact):
    model, _ = impact
    # 2m/(μ N k_t) with N = ω m v = 7500 N.
    limit = 2.0 * 50.0 / (0.3 * 7500.0 * 1.0 / 1e-3)
    model["keep.friction.velocity_scale"] = 1e-3
    model.reset()
    assert warned(model, 0.99 * limit) == []
    model.reset()
    (message,) = warned(model, 1.01 * limit)
    assert "keep: dt" in message
    assert "its friction, Tanh: it is unstable" in message
    assert "7.5e+03 N of an impact at 1.5 m/s" in message
    model["keep.friction.velocity_scale"] = 0.1


@pytest.mark.parametrize(
    ("half_y", "words"),
    [
        # (d₀ − d_min) √(A/A′): 2/3 of the area stop at 20 − 15·1.2247 mm.
        (
            0.05 * 2.0 / 3.0,
            r"0.0133 m² can be in range .* 0.02 m²: it stops at 0.00163 m instead of 0.005 m",
        ),
        # Below 0.5625 of the area, the surfaces touch.
        (0.05 * 0.56, r"the surfaces touch instead of 0.005 m"),
        (0.05 * 0.995, None),
    ],
)
def test_smaller_contact_area_than_estimated_warns_and_exceeds_closest_distance(half_y, words, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    plate = scene.add_surface(wc.meshes.grid((1.0, 1.0)), name="plate")
    block = scene.add_body(50.0, [1.0] * 3, (0, 0, RANGE), linear_velocity=(0, 0, -SPEED), name="block")
    face = scene.add_surface(sole(0.1, half_y), block, name="face")
    coupling = scene.add_contact_coupling(face, plate, expected(), name="keep")
    model = scene.build(device=device, precision="float64")
    found = warned(model, TAU / 1000.0)
    assert len(found) == (words is not None)
    if words is not None:
        assert re.search(words, found[0])
    wc.Simulation(model, dt=TAU / 1000.0).step(2000)
    report = coupling.report(model)
    stop = RANGE - 0.015 * np.sqrt(0.05 / half_y)
    np.testing.assert_allclose(report.minimum_distance, stop, atol=1e-5 * RANGE)
    assert (
        report.passed[0]
        == (stop < CLOSEST - 1e-6)
        == ("passed the closest distance of 0.005 m: in env" in str(report))
    )
    assert report.touched[0] == (stop < 0.0) == ("the surfaces met: in environment 0" in str(report))


def test_small_plate_limits_the_estimated_area(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    plate = scene.add_surface(wc.meshes.grid((0.1, 0.1)), name="plate")
    block = scene.add_body(50.0, [1.0] * 3, (0, 0, 2 * RANGE), name="block")
    face = scene.add_surface(wc.meshes.box((0.5, 0.5, 0.02)), block, name="face")
    scene.add_contact_coupling(face, plate, expected(), name="keep")
    (message,) = warned(scene.build(device=device, precision="float64"), TAU / 1000.0)
    assert "at most 0.01 m²" in message


def test_gravity_parallel_to_wall_or_between_two_bodies_does_not_warn(device):
    scene, _ = impact_scene()
    model = scene.build(envs=2, device=device, precision="float64")
    model["scene.gravity"] = [(9.81, 0, 0), (0, 0, 9.81)]
    model.reset()
    assert warned(model, TAU / 1000.0) == []
    scene, _ = impact_scene(20.0)
    model = scene.build(device=device, precision="float64")
    model["scene.gravity"] = (0, 0, -9.81)
    model.reset()
    assert warned(model, TAU / 1000.0) == []


def test_start_deep_within_range_warns(impact):
    model, _ = impact
    velocity = model["block.linear_velocity"].copy()
    model["block.linear_velocity"] = np.zeros((3, 3))
    # ½ A k₁ δ² = ½ m v², with ω = 100/s.
    model["block.position"] = [[0, 0, 0.02], [0, 0, -0.02], [0, 0, 0.01]]
    model.reset()
    messages = warned(model, TAU / 200.0)
    assert messages == [
        "keep: starts 0.04 m within its range in environment 1. The force will eject the body at about 4 m/s. "
        "Start farther away"
    ]
    model["block.position"], model["block.linear_velocity"] = (0, 0, RANGE), velocity
    model.reset()


def test_coupling_report_lists_environments_below_closest_distance(impact):
    model, coupling = impact
    place = model["block.linear_velocity"].copy()
    model["block.linear_velocity"] = [[0, 0, -0.75], [0, 0, -1.8], [0, 0, 1.0]]
    model.reset()
    assert np.isnan(coupling.report(model).minimum_distance).all()
    wc.Simulation(model, dt=TAU / 500.0).step(600)
    report = coupling.report(model)
    np.testing.assert_allclose(report.minimum_distance[:2], [0.0125, 0.002], atol=1e-5)
    assert report.in_range.tolist() == [True, True, False]
    assert report.passed.tolist() == [False, True, False]
    assert not report.touched.any()
    assert str(report).splitlines() == [
        "keep: 2 of 3 environments came into range",
        "smallest distance: 0.002 to 0.0125 m",
        "largest area in range: 0.02 m², estimated 0.02 m²",
        "passed the closest distance of 0.005 m: in environment 1",
        "the surfaces met: in no environment",
    ]
    # Only environments that are reset clear their report.
    model.reset(np.array([False, True, False]))
    after = coupling.report(model)
    assert after.minimum_distance[0] == report.minimum_distance[0]
    assert np.isnan(after.minimum_distance[1])
    assert after.effective_area[1] == 0.0
    model["block.linear_velocity"] = place
    model.reset()


def test_coupling_extremes_are_recorded_and_split_over_devices(impact, device):
    model, _ = impact
    scene = model.scene
    split = scene.build(envs=3, device=[device, device], precision="float64")
    names = ["keep.effective_area", "keep.minimum_distance", "keep.force", "keep.torque"]
    model.reset()
    whole = wc.Simulation(model, dt=TAU / 100.0).run(1.5 * TAU, record=names, every=TAU / 10.0)
    parts = wc.Simulation(split, dt=TAU / 100.0).run(1.5 * TAU, record=names, every=TAU / 10.0)
    for name in names:
        np.testing.assert_array_equal(whole[name].values, parts[name].values)
    closest = whole["keep.minimum_distance"].values[1:]
    assert (np.diff(closest, axis=0) <= 0.0).all()
    assert whole["keep.minimum_distance"].attrs["units"] == "m"
    assert "environments came into range" in str(scene.contact_couplings[0].report(split))


GOOD = {"k1": 1e6, "effective_range": 0.02}
IMPACT = {"mass": 1.0, "area": 0.1, "speed": 1.0, "effective_range": 0.02, "closest": 0.01}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"k1": 0.0}, "ContactRange.k1 must be greater than 0, got 0 N/m³"),
        ({"k2": -1.0}, "ContactRange.k2 must be at least 0, got -1 N·s/m³"),
        ({"effective_range": [1, 2]}, "ContactRange.effective_range must be a number"),
    ],
)
def test_invalid_contact_range_raises(changes, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        wc.ContactRange(**GOOD | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": 0.0}, "ContactRange.from_impact: mass must be greater than 0, got 0 kg"),
        ({"other_mass": -1.0}, "ContactRange.from_impact: other_mass must be greater than 0, got -1 kg"),
        (
            {"closest": 0.02},
            "ContactRange.from_impact: closest must be less than effective_range = 0.02 m, got 0.02 m",
        ),
        ({"damping_ratio": float("nan")}, "ContactRange.from_impact: damping_ratio must be at least 0, got nan"),
    ],
)
def test_invalid_impact_raises(changes, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        wc.ContactRange.from_impact(**IMPACT | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"facing": "some"}, "keep.facing must be one of 'projected', 'all', got 'some'"),
        ({"sides": "both"}, "keep.sides must be one of 'first', 'average', got 'both'"),
        ({"quadrature": 2}, "keep.quadrature must be a number of points per face, one of 1, 3, 6, 7, got 2"),
        ({"quadrature": True}, "keep.quadrature must be a number of points per face"),
        ({"damping_ramp": -0.1}, "keep.damping_ramp must be at least 0, got -0.1 m"),
        ({"boundary": "inner"}, "keep.boundary must be one of 'off', 'outer', got 'inner'"),
        (
            {"surface_a": "plate", "surface_b": "hull"},
            "keep.surface_a must be on a body, got 'plate' on the world",
        ),
        ({"surface_b": "deck"}, "keep: both surfaces are fixed to body 'block'; one must move"),
        ({"surface_a": "several"}, "keep: 'several' must have one mesh, got 2"),
        ({"surface_a": "idle"}, "keep: 'idle' has no active face"),
        (
            {"friction": wc.friction.Mindlin(mu_static=0.3, mu_dynamic=0.3, shear_modulus=1e9)},
            "keep.friction, Mindlin, needs a radius",
        ),
        ({"enabled": "no"}, "keep.enabled must be True or False, got 'no'"),
        ({"color": (2, 0, 0)}, "keep.color[0] must be at least 0 and at most 1, got 2"),
        ({"name": "hull"}, "name 'hull' of a coupling is taken"),
    ],
)
def test_invalid_coupling_raises_and_leaves_scene_unchanged(changes, message):
    scene = wc.Scene()
    block = scene.add_body(1.0, [1.0] * 3, name="block")
    meshes = {"plate": wc.meshes.grid(), "hull": wc.meshes.box(), "deck": wc.meshes.grid()}
    surfaces = {
        name: scene.add_surface(mesh, None if name == "plate" else block, name=name)
        for name, mesh in meshes.items()
    }
    surfaces["several"] = scene.add_surface([meshes["hull"], meshes["deck"]], block, name="several")
    surfaces["idle"] = scene.add_surface(meshes["hull"], block, active_faces=[], name="idle")
    before = scene.element_names()
    options = {"surface_a": "hull", "surface_b": "plate", "friction": None, "name": "keep"} | changes
    pair = [surfaces[options.pop(key)] for key in ("surface_a", "surface_b")]
    with pytest.raises(ValueError, match=re.escape(message)):
        scene.add_contact_coupling(*pair, wc.ContactRange(**GOOD), options.pop("friction"), **options)
    assert scene.element_names() == before
    assert scene.contacts == []
    assert scene.contact_couplings == []


def test_invalid_types_raise():
    scene = wc.Scene()
    block = scene.add_body(1.0, [1.0] * 3)
    hull, plate = scene.add_surface(wc.meshes.box(), block), scene.add_surface(wc.meshes.grid())
    with pytest.raises(TypeError, match=r"coupling\.range must be a wc\.ContactRange"):
        scene.add_contact_coupling(hull, plate, wc.laws.ContactRange(k1=1e6))
    with pytest.raises(TypeError, match=r"coupling\.friction must be an instance of wc\.Friction"):
        scene.add_contact_coupling(hull, plate, wc.ContactRange(**GOOD), wc.laws.Hooke(stiffness=1.0))
