"""check_usd finds every defect added to a valid stage, and names the prim, the attribute and the value."""

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, Vt
from recorded_usd_scene import simulate

import warpcontact as wc

BALL, FLOOR, ENSEMBLE = "/World/env_0/ball", "/World/Surfaces/floor", "/World/Ensemble/ball"
FORCE = "/World/env_0/contacts/touch/force"


@pytest.fixture(scope="module")
def valid_stage(device, tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "stage.usdc"
    return wc.export_usd(simulate(device), path, envs=[0, 1])


def set_to(path, name, value, code=None):
    def spoil(stage):
        attribute = stage.GetPrimAtPath(path).GetAttribute(name)
        assert attribute, (path, name)
        attribute.Set(value) if code is None else attribute.Set(value, code)

    return spoil


def one_vector(path, name, row, value, code=None):
    def spoil(stage):
        attribute = stage.GetPrimAtPath(path).GetAttribute(name)
        values = np.array(attribute.Get() if code is None else attribute.Get(code))
        values[row] = value
        array = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))
        attribute.Set(array) if code is None else attribute.Set(array, code)

    return spoil


def nest(stage):
    UsdPhysics.RigidBodyAPI.Apply(UsdGeom.Xform.Define(stage, f"{BALL}/inner").GetPrim())


def shorten(stage):
    attribute = stage.GetPrimAtPath(ENSEMBLE).GetAttribute("orientationsf")
    attribute.Set(Vt.QuatfArray([Gf.Quatf(1, 0, 0, 0)]), 3)


def no_extent(stage):
    UsdGeom.Sphere.Define(stage, "/World/extra").CreateRadiusAttr(2.0)


def no_up_axis(stage):
    stage.GetRootLayer().ClearDefaultPrim()


def curve(stage):
    curves = UsdGeom.BasisCurves.Define(stage, "/World/line")
    curves.CreateTypeAttr("linear")
    curves.CreateCurveVertexCountsAttr([3])
    curves.CreatePointsAttr([(0, 0, 0), (1, 0, 0)])
    curves.CreateExtentAttr([(0, 0, 0), (1, 0, 0)])


def moving_curve(stage):
    curve(stage)
    counts = UsdGeom.BasisCurves(stage.GetPrimAtPath("/World/line")).GetCurveVertexCountsAttr()
    counts.Set([2])
    counts.Set([2], 3.0)
    counts.Set([3], 4.0)


def fewer(stage):
    attribute = stage.GetPrimAtPath(ENSEMBLE).GetAttribute("protoIndices")
    attribute.Set([0, 0, 0, 0], 0.0)
    attribute.Set([0, 0, 0], 3.0)


def primvar(stage):
    api = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(ENSEMBLE))
    api.CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "vertex").Set([1.0, 2.0])


DEFECTS = {
    "a point that is not finite": (
        one_vector(FLOOR, "points", 1, np.nan),
        FLOOR,
        "points must be finite, got nan",
    ),
    "a pose that is not finite": (
        set_to(BALL, "xformOp:translate", Gf.Vec3d(0, float("inf"), 0), 7.0),
        BALL,
        "xformOp:translate at time 7 must be finite, got inf",
    ),
    "a velocity that is not finite": (
        set_to("/World/env_1/cube", "physics:velocity", Gf.Vec3f(float("nan"), 0, 0), 2.0),
        "/World/env_1/cube",
        "physics:velocity at time 2 must be finite",
    ),
    "an extent that is not finite": (
        one_vector(FORCE, "extent", 0, np.nan, 4.0),
        FORCE,
        "extent at time 4 must be finite",
    ),
    "an extent that is too small": (
        set_to(FLOOR, "extent", [(0, 0, 0), (1, 1, 0)]),
        FLOOR,
        "extent must enclose",
    ),
    "an animated extent that is too small": (
        set_to(ENSEMBLE, "extent", [(0, 0, 0), (1, 1, 0)], 5.0),
        ENSEMBLE,
        "extent at time 5 must enclose",
    ),
    "no extent": (no_extent, "/World/extra", "extent must be authored"),
    "a face of a point that is not there": (
        set_to(FLOOR, "faceVertexIndices", [0, 1, 2, 0, 2, 4]),
        FLOOR,
        "faceVertexIndices must be from 0 to 3, the last point, got 4",
    ),
    "a face of a negative point": (
        set_to(FLOOR, "faceVertexIndices", [0, 1, -2, 0, 2, 3]),
        FLOOR,
        "faceVertexIndices must be from 0 to 3, the last point, got -2",
    ),
    "a face of a point that is not there at some time": (
        set_to(FLOOR, "faceVertexIndices", [0, 1, 2, 0, 2, 4], 3.0),
        FLOOR,
        "faceVertexIndices at time 3 must be from 0 to 3, the last point, got 4",
    ),
    "a face of two points at some time": (
        set_to(FLOOR, "faceVertexCounts", [2, 4], 3.0),
        FLOOR,
        "faceVertexCounts at time 3 must be at least 3, got 2",
    ),
    "faces that do not add up at some time": (
        set_to(FLOOR, "faceVertexCounts", [3], 3.0),
        FLOOR,
        "faceVertexCounts at time 3 must add up to the 6 indices, got 3",
    ),
    "points that are fewer at some time": (
        set_to(FLOOR, "points", [(-5, -5, 0), (5, -5, 0), (5, 5, 0)], 3.0),
        FLOOR,
        "faceVertexIndices at time 3 must be from 0 to 2, the last point, got 3",
    ),
    "a group of a face that is not there at some time": (
        set_to(f"{FLOOR}/active", "indices", [2], 3.0),
        FLOOR,
        "indices of active at time 3 must be from 0 to 1",
    ),
    "a face of two points": (set_to(FLOOR, "faceVertexCounts", [2, 4]), FLOOR, "at least 3, got 2"),
    "faces that do not add up": (set_to(FLOOR, "faceVertexCounts", [3]), FLOOR, "add up to the 6 indices, got 3"),
    "a group of a face that is not there": (
        set_to(f"{FLOOR}/active", "indices", [2]),
        FLOOR,
        "indices of active must be from 0 to 1",
    ),
    "curves that do not add up at some time": (
        moving_curve,
        "/World/line",
        "curveVertexCounts at time 4 must add up to the 2 points, got 3",
    ),
    "curves that do not add up": (curve, "/World/line", "curveVertexCounts must add up to the 2 points, got 3"),
    "a prototype that is not there": (
        set_to(ENSEMBLE, "protoIndices", [0, 0, 9, 0]),
        ENSEMBLE,
        "protoIndices must be from 0 to",
    ),
    "instances that are not as many": (
        shorten,
        ENSEMBLE,
        "orientationsf at time 3 must be as many as the 4 protoIndices, got 1",
    ),
    "ids twice": (set_to(ENSEMBLE, "ids", [0, 1, 1, 3]), ENSEMBLE, "ids must differ"),
    "ids twice at some time": (set_to(ENSEMBLE, "ids", [0, 1, 1, 3], 2.0), ENSEMBLE, "ids at time 2 must differ"),
    "prototypes that are fewer at some time": (
        fewer,
        ENSEMBLE,
        "positions at time 3 must be as many as the 3 protoIndices, got 4",
    ),
    "a primvar of too few": (primvar, ENSEMBLE, "primvar heat must have one value for each of 4 instances, got 2"),
    "a quaternion that is not of unit length": (
        set_to(BALL, "xformOp:orient", Gf.Quatd(1, 1, 0, 0), 3.0),
        BALL,
        "xformOp:orient at time 3 must be of unit length, got 1.41421",
    ),
    "a negative mass": (
        set_to(BALL, "physics:mass", -1.0),
        BALL,
        "mass must be greater than 0 and finite, or 0: not given, got -1.0",
    ),
    "a mass that is not finite": (set_to(BALL, "physics:mass", float("nan")), BALL, "mass must be greater than 0"),
    "a moment that no body has": (
        set_to(BALL, "physics:diagonalInertia", Gf.Vec3f(1, 1, 3)),
        BALL,
        "no moment may exceed the sum of the others, got [1.0, 1.0, 3.0]",
    ),
    "a negative moment": (
        set_to(BALL, "physics:diagonalInertia", Gf.Vec3f(1, -1, 1)),
        BALL,
        "diagonalInertia must be greater than 0 and finite",
    ),
    "a rigid body in a rigid body": (nest, f"{BALL}/inner", f"in the rigid body {BALL}"),
    "a negative friction": (
        set_to("/World/PhysicsMaterials/touch", "physics:dynamicFriction", -0.1),
        "/World/PhysicsMaterials/touch",
        "dynamicFriction must be from 0 on, got -0.1",
    ),
    "a restitution above 1": (
        set_to("/World/PhysicsMaterials/touch", "physics:restitution", 1.5),
        "/World/PhysicsMaterials/touch",
        "restitution must be from 0 to 1, got 1.5",
    ),
    "no default prim": (no_up_axis, "/", "defaultPrim"),
}


def test_valid_stage_has_no_findings(valid_stage):
    assert wc.check_usd(valid_stage) == []


@pytest.mark.parametrize("defect", DEFECTS)
@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_every_stage_defect_is_reported(valid_stage, tmp_path, defect, suffix):
    spoil, prim, message = DEFECTS[defect]
    stage = Usd.Stage.Open(str(valid_stage))
    copy = Sdf.Layer.CreateAnonymous(suffix)
    copy.TransferContent(stage.GetRootLayer())
    edited = Usd.Stage.Open(copy)
    spoil(edited)
    path = tmp_path / f"bad{suffix}"
    copy.Export(str(path))
    found = wc.check_usd(path)
    assert any(one.startswith(f"{prim}: ") and message in one for one in found), found


def test_consistently_time_varying_mesh_has_no_findings(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "grows.usda"))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    world = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(world)
    mesh = UsdGeom.Mesh.Define(stage, "/World/mesh")
    instancer = UsdGeom.PointInstancer.Define(stage, "/World/many")
    instancer.CreatePrototypesRel().SetTargets([mesh.GetPath()])
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    for code, count in ((1.0, 3), (2.0, 4)):
        points = corners[:count]
        mesh.CreatePointsAttr().Set(points, code)
        mesh.CreateFaceVertexIndicesAttr().Set(list(range(count)), code)
        mesh.CreateFaceVertexCountsAttr().Set([count], code)
        mesh.CreateExtentAttr().Set([(0, 0, 0), (1, 1, 0)], code)
        instancer.CreateProtoIndicesAttr().Set([0] * count, code)
        instancer.CreatePositionsAttr().Set(points, code)
        instancer.CreateIdsAttr().Set(list(range(count)), code)
        instancer.CreateExtentAttr().Set([(0, 0, 0), (2, 2, 0)], code)
    stage.Save()
    assert wc.check_usd(tmp_path / "grows.usda") == []


def test_zero_mass_and_moments_count_as_not_given(valid_stage, tmp_path):
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(Sdf.Layer.FindOrOpen(str(valid_stage)))
    stage = Usd.Stage.Open(layer)
    api = UsdPhysics.MassAPI(stage.GetPrimAtPath(BALL))
    api.CreateMassAttr(0.0)
    api.CreateDensityAttr(0.0)
    api.CreateDiagonalInertiaAttr(Gf.Vec3f(0, 0, 0))
    api.CreatePrincipalAxesAttr(Gf.Quatf(0, 0, 0, 0))
    layer.Export(str(tmp_path / "zeros.usda"))
    assert wc.check_usd(tmp_path / "zeros.usda") == []


def test_non_finite_time_sample_is_reported(valid_stage, tmp_path):
    """Layers sort time codes from any file, but the values can be any number."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(Sdf.Layer.FindOrOpen(str(valid_stage)))
    layer.SetTimeSample(f"{BALL}.physics:mass", 3.0, 1.0)
    layer.SetTimeSample(f"{BALL}.physics:mass", 1.0, 1.0)
    assert layer.ListTimeSamplesForPath(f"{BALL}.physics:mass") == [1.0, 3.0]
    layer.SetTimeSample(f"{BALL}.physics:mass", float("inf"), 1.0)
    layer.Export(str(tmp_path / "bad.usdc"))
    (found,) = wc.check_usd(tmp_path / "bad.usdc")
    assert found.startswith("/: time samples must be at finite times, got inf in bad.usdc")


def test_invalid_stage_file_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"missing\.usda is not a file"):
        wc.check_usd(tmp_path / "missing.usda")
    (tmp_path / "broken.usdc").write_bytes(b"PXR-USDC" + bytes(80))
    with pytest.raises(OSError, match=r"cannot read .*broken\.usdc"):
        wc.check_usd(tmp_path / "broken.usdc")
