"""Catenaries in USD hang as in the simulation."""

import numpy as np
from pxr import Usd, UsdGeom

import warpcontact as wc


def test_a_line_is_drawn_as_it_hangs(device, tmp_path):
    scene = wc.Scene()
    body = scene.add_body(100.0, (10.0, 10.0, 10.0), (6.0, 0.0, 1.0), name="body")
    anchor = scene.add_point(None, (0.0, 0.0, 0.0), name="anchor")
    eye = scene.add_point(body, (0.0, 0.1, 0.2), name="eye")
    scene.add_catenary(
        anchor, eye, length=8.0, mass_per_length=3.0, axial_stiffness=1e5, floor=-1.0, name="line", color=(1, 0, 0)
    )
    model = scene.build(3, device, "float64")
    model["line.length"] = [8.0, 9.0, 10.0]
    model["line.floor"] = [-1.0, -1.5, -9.0]
    model["anchor.position"] = [(0, 0, 0), (0, 0, 0), (6.0, 0.1, 4.0)]
    sim = wc.Simulation(model, 1e-3)
    recording = sim.run(0.2, ["line.status", "line.tension_a"], every=0.1)
    stage = Usd.Stage.Open(str(wc.export_usd(recording, tmp_path / "lines.usda")))
    # The last of them hangs straight down: it is folded, and not broken.
    assert recording["line.status"].values[0, 2] == wc.LineStatus.FOLDED
    for env in range(3):
        curve = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/World/env_{env}/couplings/line/shape"))
        points = np.array(curve.GetPointsAttr().Get(2))
        # USD keeps points in float32.
        np.testing.assert_allclose(points, model.line_shape("line", len(points))[env], atol=1e-5)
        assert curve.GetVisibilityAttr().Get(0) != "invisible"
