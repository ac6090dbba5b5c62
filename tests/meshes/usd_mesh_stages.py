"""USD stages with meshes, for tests of mesh import."""

from pxr import Gf, Usd, UsdGeom, Vt
from test_meshes import OUTWARD, TETRAHEDRON


def add_mesh(stage, path, vertices=TETRAHEDRON, polygons=OUTWARD):
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, v)) for v in vertices]))
    mesh.CreateFaceVertexCountsAttr([len(polygon) for polygon in polygons])
    mesh.CreateFaceVertexIndicesAttr([int(i) for polygon in polygons for i in polygon])
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


def new_stage(unit=1.0, axis="Z"):
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    UsdGeom.SetStageUpAxis(stage, axis)
    return stage


def save(stage, path):
    stage.GetRootLayer().Export(str(path))
    return path


def save_tetrahedron(path):
    """A stage with a tetrahedron at /World/hull."""
    stage = new_stage()
    add_mesh(stage, "/World/hull")
    return save(stage, path)
