"""Couplings in USD: curves between their ends, sensors as attributes, invisible if broken."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from recorded_usd_scene import findings

import warpcontact as wc
from warpcontact.drawing.lines import LINE_POINTS, PER_TURN, TURNS, Coil, coil_points


@pytest.fixture(scope="module")
def recording(device):
    scene = wc.Scene()
    ball = scene.add_body(1.0, (0.1, 0.2, 0.15), (0.5, 0.0, -1.0), name="ball", linear_velocity=(1, 0, -2))
    hook = scene.add_point(None, (0.0, 0.0, 0.0), name="hook")
    eye = scene.add_point(ball, (0.0, 0.1, 0.2), name="eye")
    scene.add_spring_damper(hook, eye, stiffness=50.0, name="spring", color=(0.1, 0.8, 0.2))
    scene.add_spring_damper(
        hook, eye, stiffness=100.0, rest_length=0.5, tension_only=True, break_force=46.0, name="rope"
    )
    scene.add_bushing(hook, eye, stiffness=(1, 1, 1), name="bush-ing", visible=False)
    model = scene.build(2, device, "float64")
    model["rope.break_force"] = [46.0, np.inf]
    names = ["spring.length", "spring.force", "rope.status", "rope.force_b"]
    return wc.Simulation(model, 1.0e-3).run(0.5, names, every=0.1)


@pytest.fixture(scope="module")
def stage(recording, tmp_path_factory):
    return Usd.Stage.Open(str(wc.export_usd(recording, tmp_path_factory.mktemp("usd") / "a.usda")))


def curve(stage, env, name):
    return UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/World/env_{env}/couplings/{name}/shape"))


def test_usd_couplings_pass_all_validators(stage):
    assert [error.GetErrorAsString() for error in findings(stage)] == []


def test_usd_coupling_curves_connect_their_ends(recording, stage):
    for env in range(2):
        shape = curve(stage, env, "spring")
        for code, length in enumerate(recording["spring.length"].values[:, env]):
            points = np.array(shape.GetPointsAttr().Get(code))
            assert len(points) == TURNS * PER_TURN + 3
            np.testing.assert_allclose(points[0], 0.0, atol=1e-6)
            # Points of USD are float32.
            assert np.linalg.norm(points[-1]) == pytest.approx(length, rel=1e-6)
    rope = curve(stage, 0, "rope")
    assert list(rope.GetCurveVertexCountsAttr().Get()) == [2]
    np.testing.assert_allclose(rope.GetPointsAttr().Get(0)[1], (0.5, 0.1, -0.8), rtol=1e-6)


def test_broken_rope_is_invisible_in_usd(recording, stage):
    broken = recording["rope.status"].values == wc.CouplingStatus.BROKEN
    assert broken[:, 0].any()
    assert not broken[:, 1].any()
    for env in range(2):
        shape = curve(stage, env, "rope")
        seen = [shape.GetVisibilityAttr().Get(code) == "inherited" for code in range(len(broken))]
        assert seen == (~broken[:, env]).tolist()


def test_usd_couplings_have_sensors_color_and_visibility(recording, stage):
    prim = stage.GetPrimAtPath("/World/env_1/couplings/spring")
    values = [prim.GetAttribute("warpcontact:force").Get(code) for code in range(6)]
    np.testing.assert_array_equal(values, recording["spring.force"].values[:, 1])
    assert "3 OUTSIDE" in stage.GetPrimAtPath("/World/env_1/couplings/rope").GetAttribute(
        "warpcontact:status"
    ).GetMetadata("documentation")
    np.testing.assert_allclose(
        curve(stage, 1, "spring").GetDisplayColorAttr().Get()[0], (0.1, 0.8, 0.2), rtol=1e-6
    )
    hidden = UsdGeom.Imageable(stage.GetPrimAtPath("/World/env_0/couplings/bush_ing"))
    assert hidden.ComputeVisibility() == "invisible"


def test_coil_has_constant_radius_and_is_continuous():
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    ends = np.stack([np.cos(angle), np.sin(angle), np.full_like(angle, 0.3)], axis=-1)
    start = np.zeros_like(ends)
    points = coil_points(start, ends, Coil.of(start, ends))
    assert np.isfinite(points).all()
    along = ends / np.linalg.norm(ends, axis=-1, keepdims=True)
    inner = points[:, 1:-1]
    off = inner - (inner @ along[..., None]) * along[:, None]
    radius = np.linalg.norm(off, axis=-1)
    np.testing.assert_allclose(radius, radius[0, 0], rtol=1e-12)
    # A rotation by 2π/199 moves points by at most a few times that.
    assert np.linalg.norm(np.diff(points, axis=0), axis=-1).max() < 3.0 * 2.0 * np.pi / 199
    nowhere = np.zeros((1, 3))
    assert np.isfinite(coil_points(nowhere, nowhere, Coil.of(nowhere, nowhere))).all()


def test_usd_catenary_matches_recorded_shape(device, tmp_path):
    scene = wc.Scene()
    buoy = scene.add_body(
        500.0, (50.0, 50.0, 50.0), (30.0, 0.0, 0.0), name="buoy", linear_velocity=(2.0, 1.0, 0.0)
    )
    ends = scene.add_point(None, (0.0, 0.0, -10.0)), scene.add_point(buoy, (0.0, 0.0, -0.5))
    scene.add_catenary(*ends, length=40.0, mass_per_length=5.0, axial_stiffness=1e6, floor=-10.0, name="line")
    scene.add_catenary(*ends, length=35.0, mass_per_length=2.0, axial_stiffness=1e6, name="free")
    model = scene.build(2, device, "float64")
    model["line.length"] = [40.0, 38.0]
    model["scene.gravity"] = [(0, 0, -9.81), (0, 0, -1.62)]
    recording = wc.Simulation(model, 1.0e-3).run(0.3, ["line.dip"], every=0.1)
    stage = Usd.Stage.Open(str(wc.export_usd(recording, tmp_path / "a.usdc")))
    assert [error.GetErrorAsString() for error in findings(stage)] == []
    for name in ("line", "free"):
        expected = model.catenary_shape(name, LINE_POINTS)
        for env in range(2):
            points = np.array(curve(stage, env, name).GetPointsAttr().Get(3))
            # Points of USD are float32.
            np.testing.assert_allclose(points, expected[env], rtol=0, atol=4e-6)
    resting = np.array(curve(stage, 0, "line").GetPointsAttr().Get(0))[:, 2]
    assert (resting == -10.0).sum() > 3


def test_folded_catenary_is_visible_in_usd(device, tmp_path):
    """Status codes of cables differ from those of springs."""
    scene = wc.Scene(gravity=(0, 0, -9.81))
    load = scene.add_body(1.0, (1.0, 1.0, 1.0), (0.0, 0.0, -3.0), name="load")
    ends = scene.add_point(None, (0.0, 0.0, 0.0)), scene.add_point(load, (0.0, 0.0, 0.0))
    scene.add_catenary(*ends, length=5.0, mass_per_length=1.0, axial_stiffness=1e4, name="line")
    recording = wc.Simulation(scene.build(device=device, precision="float64"), 1.0e-3).run(2e-3, ["line.status"])
    assert (recording["line.status"] == wc.CatenaryStatus.FOLDED).all()
    stage = Usd.Stage.Open(str(wc.export_usd(recording, tmp_path / "a.usdc")))
    assert curve(stage, 0, "line").ComputeVisibility(1) == "inherited"
