"""Meshes from USD stages: selection of prims, transforms, units, and orientation."""

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdUtils, Vt
from test_meshes import OUTWARD, TETRAHEDRON
from usd_mesh_stages import add_mesh, new_stage, save, save_tetrahedron

from warpcontact.meshes import MeshError, examine_file, load_mesh

QUAD = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


@pytest.fixture
def tetrahedron(tmp_path):
    return save_tetrahedron(tmp_path / "part.usda")


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "USDC", "usdz"])
@pytest.mark.parametrize("trusted", [False, True])
def test_every_usd_format_gives_the_faces_of_the_stage(tetrahedron, tmp_path, suffix, trusted):
    path = tmp_path / f"copy.{suffix}"
    if suffix == "usdz":
        assert UsdUtils.CreateNewUsdzPackage(str(tetrahedron), str(path))
    else:
        content = Usd.Stage.Open(str(tetrahedron))
        save(content, tmp_path / f"copy.{suffix.lower()}").rename(path)
    mesh = load_mesh(path, trusted=trusted)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], TETRAHEDRON[OUTWARD])
    assert (mesh.name, mesh.report.closed, mesh.report.warnings) == ("copy", True, ())
    assert mesh.groups["hull"].tolist() == [0, 1, 2, 3]
    assert "the up axis is Z; the mesh is not rotated" in mesh.report.notes


def test_usd_parts_are_in_meters_and_mirrored_ones_stay_outward(tmp_path):
    stage = new_stage(unit=0.01, axis="Y")
    UsdGeom.Xform.Define(stage, "/World").AddTranslateOp().Set((100, 0, 0))
    add_mesh(stage, "/World/plain")
    add_mesh(stage, "/World/mirrored", TETRAHEDRON + np.array((0, 2, 0))).AddScaleOp().Set((1, -1, 1))
    left = add_mesh(stage, "/World/left", TETRAHEDRON + np.array((0, 2, 0)), OUTWARD[:, ::-1])
    left.CreateOrientationAttr("leftHanded")
    both = add_mesh(stage, "/World/both", polygons=OUTWARD[:, ::-1])
    both.CreateOrientationAttr("leftHanded")
    turned = both.AddTransformOp()
    turned.Set(Gf.Matrix4d(Gf.Vec4d(-3, 1, 1, 1)) * Gf.Matrix4d().SetTranslate((0, 5, 0)))
    mesh = load_mesh(save(stage, tmp_path / "a.usdc"))
    volumes = [part.volume for part in mesh.report.components]
    np.testing.assert_allclose(volumes, np.array([1, 1, 1, 3]) * 1e-6 / 6, rtol=1e-5)
    np.testing.assert_allclose(mesh.vertices[0], (1, 0, 0))
    np.testing.assert_allclose(mesh.bounds, [(0.97, -0.03, 0), (1.01, 0.06, 0.01)], atol=1e-9)
    np.testing.assert_allclose(load_mesh(tmp_path / "a.usdc", unit="m").vertices[0], (100, 0, 0))
    np.testing.assert_allclose(load_mesh(tmp_path / "a.usdc", scale=2).vertices[0], (2, 0, 0))


def test_invisible_usd_prims_are_skipped_and_unsupported_ones_reported(tmp_path):
    stage = new_stage()
    add_mesh(stage, "/World/seen")
    add_mesh(stage, "/World/render", TETRAHEDRON + 2).CreatePurposeAttr("render")
    for purpose in ("guide", "proxy"):
        add_mesh(stage, f"/World/{purpose}").CreatePurposeAttr(purpose)
    UsdGeom.Xform.Define(stage, "/World/hidden").MakeInvisible()
    add_mesh(stage, "/World/hidden/below")
    add_mesh(stage, "/World/off").GetPrim().SetActive(False)
    UsdGeom.Sphere.Define(stage, "/World/ball")
    instancer = UsdGeom.PointInstancer.Define(stage, "/World/many")
    add_mesh(stage, "/World/many/prototype")
    instancer.CreatePrototypesRel().AddTarget("/World/many/prototype")
    path = save(stage, tmp_path / "a.usda")
    mesh = load_mesh(path)
    assert {name: len(faces) for name, faces in mesh.groups.items()} == {"seen": 4, "render": 4}
    assert "shapes other than meshes were omitted: 1 PointInstancer, 1 Sphere" in mesh.report.warnings
    assert list(load_mesh(path, prim="/World/guide").groups) == ["guide"]
    with pytest.raises(MeshError, match="it has no vertices"):
        load_mesh(path, prim="/World/hidden")
    with pytest.raises(
        MeshError, match=r"the prim '/World/seem' does not exist; meshes: /World/seen, /World/render"
    ):
        load_mesh(path, prim="/World/seem")
    with pytest.raises(MeshError, match="prim must be a path such as '/World/part', got 'World seen'"):
        load_mesh(path, prim="World seen")
    (tmp_path / "a.stl").write_bytes(b"")
    with pytest.raises(ValueError, match=r"prim is for USD files .*, got '/World' for 'a.stl'"):
        load_mesh(tmp_path / "a.stl", prim="/World")


def test_usd_instances_are_read_as_often_as_they_are_visible(tmp_path):
    stage = new_stage()
    shape = add_mesh(stage, "/Shape/body", QUAD, [(0, 1, 2, 3)])
    UsdGeom.Subset.CreateGeomSubset(shape, "tread", "face", Vt.IntArray([0]))
    stage.GetPrimAtPath("/Shape").SetSpecifier(Sdf.SpecifierClass)
    for i in range(3):
        copy = UsdGeom.Xform.Define(stage, f"/World/copy_{i}")
        copy.AddTranslateOp().Set((2.0 * i, 0, 0))
        copy.GetPrim().GetReferences().AddInternalReference("/Shape")
        copy.GetPrim().SetInstanceable(True)
    mesh = load_mesh(save(stage, tmp_path / "a.usda"))
    assert (len(mesh.faces), mesh.report.component_count) == (6, 3)
    assert mesh.groups["tread"].tolist() == list(range(6))
    np.testing.assert_allclose(mesh.bounds, [(0, 0, 0), (5, 1, 0)])
    one = load_mesh(tmp_path / "a.usda", prim="/World/copy_1/body")
    np.testing.assert_allclose(one.bounds, [(2, 0, 0), (3, 1, 0)])


def test_usd_subsets_holes_and_polygons_are_read(tmp_path):
    stage = new_stage()
    vertices = [(x, y, 0) for y in range(2) for x in range(5)]
    mesh = add_mesh(stage, "/strip", vertices, [(i, i + 1, i + 6, i + 5) for i in range(4)])
    mesh.CreateHoleIndicesAttr([1])
    mesh.CreateSubdivisionSchemeAttr("catmullClark")
    UsdGeom.Subset.CreateGeomSubset(mesh, "ends", "face", Vt.IntArray([0, 3]), "any")
    UsdGeom.Subset.CreateGeomSubset(mesh, "corners", "point", Vt.IntArray([0]))
    loaded = load_mesh(save(stage, tmp_path / "a.usda"))
    assert loaded.report.area == pytest.approx(3.0)
    assert {name: faces.tolist() for name, faces in loaded.groups.items()} == {
        "strip": [0, 1, 2, 3, 4, 5],
        "ends": [0, 1, 4, 5],
    }
    assert loaded.report.warnings[0].startswith(
        "3 faces of the file, some with more than three vertices, became 6"
    )
    assert any("control meshes of 1 prims" in note for note in loaded.report.notes)


def test_animated_usd_stage_is_read_at_its_start(tmp_path):
    stage = new_stage()
    mesh = add_mesh(stage, "/a")
    move = mesh.AddTranslateOp()
    for code, x in ((10, 5.0), (20, 9.0)):
        move.Set((x, 0, 0), code)
        mesh.GetPointsAttr().Set(Vt.Vec3fArray([Gf.Vec3f(*map(float, v * (x - 4))) for v in TETRAHEDRON]), code)
    np.testing.assert_allclose(load_mesh(save(stage, tmp_path / "a.usda")).bounds, [(5, 0, 0), (6, 1, 1)])


def test_missing_usd_unit_is_reported_and_can_be_given(tmp_path):
    stage = new_stage()
    add_mesh(stage, "/a")
    layer = stage.GetRootLayer()
    layer.pseudoRoot.ClearInfo("metersPerUnit")
    path = save(stage, tmp_path / "a.usda")
    report = examine_file(path)
    assert max(report.size) == pytest.approx(0.01)
    assert "metersPerUnit is not authored: the unit is 0.01 m, the default of USD" in report.warnings
    assert not any("metersPerUnit" in text for text in examine_file(path, unit="mm").warnings)
    assert max(examine_file(path, unit="in", scale=2).size) == pytest.approx(0.0508)
    for value in (0, -1, np.nan):
        layer.pseudoRoot.SetInfo("metersPerUnit", value)
        layer.Export(str(path))
        with pytest.raises(MeshError, match="metersPerUnit must be positive and finite, got"):
            load_mesh(path)
        assert load_mesh(path, unit="m").report.closed


@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [
        ("faceVertexCounts", [3, 3, 3, 2], r"/World/hull.faceVertexCounts\[3\] must be 3 or more, got 2"),
        ("faceVertexCounts", [3, 3, 3, 4], "add up to 13 vertices, but faceVertexIndices has 12"),
        ("faceVertexCounts", [2**30, 2**30, 2**30, 2**30], "add up to 4294967296 vertices"),
        ("faceVertexIndices", [99, *OUTWARD.ravel()[1:].tolist()], "index outside its 4 vertices"),
        ("faceVertexIndices", [-1, *OUTWARD.ravel()[1:].tolist()], "index outside its 4 vertices"),
        ("points", [(np.nan, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], "1 of 4 vertices is not finite"),
        ("points", [], "index outside its 0 vertices"),
        ("holeIndices", [4], r"hull.holeIndices must be face numbers from 0 to 3, got 4"),
    ],
)
def test_invalid_usd_mesh_values_are_reported(tetrahedron, attribute, value, message):
    stage = Usd.Stage.Open(str(tetrahedron))
    target = stage.GetPrimAtPath("/World/hull").GetAttribute(attribute)
    target.Set(Vt.Vec3fArray([Gf.Vec3f(*map(float, v)) for v in value]) if attribute == "points" else value)
    with pytest.raises(MeshError, match=message):
        load_mesh(save(stage, tetrahedron.with_name("bad.usdc")))


def test_exported_usd_mesh_round_trips(tmp_path, device):
    import warpcontact as wc

    scene = wc.Scene()
    tread = wc.meshes.icosphere(0.5, 1)
    wheel = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 2), name="wheel")
    scene.add_surface(tread, wheel, name="tyre", active_faces=lambda centroids: centroids[:, 2] < 0)
    recording = wc.Simulation(scene.build(device=device), dt=1e-3).run(1e-3, ["wheel.position"], every=1e-3)
    path = wc.export_usd(recording, tmp_path / "wheel.usdc")
    mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.vertices - (0, 0, 2), tread.vertices, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, tread.faces)
    below = tread.vertices[tread.faces].mean(axis=1)[:, 2] < 0
    np.testing.assert_array_equal(mesh.groups["active"], np.flatnonzero(below))
