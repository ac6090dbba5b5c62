"""Reference cases of body contact, which are closed forms, as stages with UsdPhysics."""

import itertools
import json
from typing import Any

import numpy as np
import pytest
import warp as wp
from physics_stages import COLLIDER, CUBE, body, mesh, prim, stage
from rest_stages import cells

import warpcontact as wc

# Coordinates of unions of boxes are whole multiples of this length [m]. Points of meshes are float32 in USD.
UNIT = 0.005
MASS = (
    "float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 1, 1)\npoint3f physics:centerOfMass = (0, 0, 0)"
)


class PowerFoundation(wc.Law):
    """p = k δⁿ."""

    stiffness: float = wc.parameter("Pa/mⁿ", "stiffness k", above=0.0)
    exponent: float = wc.parameter("-", "exponent n", above=0.0)
    area: float | None = wc.parameter("m²", "area of the point", default=None, above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * p.area * wp.pow(c.delta, p.exponent)


def placed(position=(0, 0, 0), orientation=(0, 0, 0, 1), scale=(1, 1, 1)):
    """Pose and scale of a prim, in double precision."""
    x, y, z, w = map(float, orientation)
    values = [
        f"double3 xformOp:translate = {tuple(map(float, position))}",
        f"quatd xformOp:orient = {(w, x, y, z)}",
        f"double3 xformOp:scale = {tuple(map(float, scale))}",
    ]
    order = 'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient", "xformOp:scale"]'
    return "\n".join([*values, order])


def union(boxes):
    """Mesh of a union of boxes, in units of ``UNIT``."""
    centers, sizes = (np.array([one[key] for one in boxes]) for key in ("centre", "size"))
    lower, upper = (np.rint((centers + sign * sizes / 2) / UNIT) for sign in (-1, 1))
    axes = [np.unique(np.concatenate([lower[:, k], upper[:, k]])).tolist() for k in range(3)]
    missing = set()
    for cell in itertools.product(*(range(len(axis) - 1) for axis in axes)):
        middle = [0.5 * (axis[i] + axis[i + 1]) for axis, i in zip(axes, cell, strict=True)]
        if not ((lower < middle) & (middle < upper)).all(axis=1).any():
            missing.add(cell)
    return mesh(*cells(*axes, missing=missing))


def groove(half_angle, length):
    """Mesh of a prism with two walls that meet along the y axis."""
    x, z = length * np.sin(half_angle), length * np.cos(half_angle)
    outline = [(0, 0), (-x, z), (-x, -0.1), (x, -0.1), (x, z)]
    points = [(a, y, b) for y in (-0.2, 0.2) for a, b in outline]
    faces = [(0, 1, 2), (0, 2, 3), (0, 3, 4)]
    faces += [tuple(5 + i for i in face[::-1]) for face in faces]
    faces += [(i, 5 + i, 5 + (i + 1) % 5, (i + 1) % 5)[::-1] for i in range(5)]
    indices = ",".join(str(i) for face in faces for i in face)
    return mesh(
        ", ".join(str(tuple(map(float, p))) for p in points), indices, ",".join(str(len(f)) for f in faces)
    )


def collider(solid, name, as_mesh):
    """Prim of a solid of the reference cases, without the pose of its body."""
    kind = solid["shape"]
    if kind == "box" and as_mesh:
        return prim("Mesh", name, COLLIDER, mesh(CUBE) + "\n" + placed(scale=np.array(solid["size"]) / 2))
    if kind == "box":
        return prim("Cube", name, COLLIDER, "double size = 2\n" + placed(scale=np.array(solid["size"]) / 2))
    if kind == "plane":
        return prim("Plane", name, COLLIDER, 'uniform token axis = "Z"')
    if kind == "union of boxes":
        return prim("Mesh", name, COLLIDER, union(solid["boxes"]) + "\n" + placed(scale=(UNIT,) * 3))
    if kind == "groove":
        return prim("Mesh", name, COLLIDER, groove(solid["half_angle"], solid["wall_length"]))
    if kind == "corner":
        return prim("Mesh", name, COLLIDER, mesh(*cells(*((-1, 0, 1),) * 3, missing={(1, 1, 1)})))
    sizes = f"double radius = {solid['radius']}\n"
    if kind != "sphere":
        sizes += f'double height = {2 * solid["half_length"]}\nuniform token axis = "Z"'
    return prim(kind.title(), name, COLLIDER, sizes)


def stage_of(tmp_path, cases, as_mesh):
    """Writes a stage with all cases at the same place, each in a collision group that collides with itself only."""
    content = ""
    for i, case in enumerate(cases):
        first, second = case["body_a"], case["body_b"]
        pose = {key: one[key] for one in (first,) for key in ("position", "orientation") if key in one}
        other = {key: second[key] for key in ("position", "orientation") if key in second}
        content += body(f"first_{i}", MASS + "\n" + collider(first, f"a_{i}", as_mesh), placed(**pose))
        content += prim("Xform", f"second_{i}", "", placed(**other) + "\n" + collider(second, f"b_{i}", as_mesh))
        group = (
            f"rel collection:colliders:includes = [</first_{i}>, </second_{i}>]\n"
            f"rel physics:filteredGroups = </group_{i}>\nbool physics:invertFilteredGroups = 1"
        )
        api = 'prepend apiSchemas = ["CollectionAPI:colliders"]'
        content += prim("PhysicsCollisionGroup", f"group_{i}", api, group)
    return stage(tmp_path, content)


def evaluate(tmp_path, cases, law, as_mesh, device, precision="float64"):
    """Forces, moments and depths of the cases, imported from one stage with a given law."""
    path = stage_of(tmp_path, cases, as_mesh)
    scene = wc.Scene.from_usd(path, material=wc.ContactMaterial(law=law), trusted=True)
    contacts = [*scene.body_contacts, *scene.contacts, *scene.shape_contacts]
    assert len(contacts) == len(cases)
    names = {frozenset((f"a_{i}", f"b_{i}")): i for i in range(len(cases))}
    model = scene.build(device=device, precision=precision)
    force, moment, depth = np.zeros((len(cases), 3)), np.zeros((len(cases), 3)), np.zeros(len(cases))
    for contact in scene.body_contacts:
        first, second = contact.pairs[0]
        i = names[frozenset((first.name, second.name))]
        assert first.name == f"a_{i}"
        force[i], moment[i] = (model.sensor(f"{contact.name}.{key}")[0] for key in ("force", "torque"))
        depth[i] = model.sensor(f"{contact.name}.depth")[0]
    return scene, model, force, moment, depth


def load_cases(shared, kind):
    """Reference cases with a type of law."""
    every = json.loads((shared / "spec" / "oracle_patches.json").read_text())["cases"]
    return [case for case in every if case.get("law", {}).get("type") == kind]


def check(cases, force, moment, depth, precision):
    """Checks forces and moments against the closed forms, within the tolerance of each case."""
    assert depth.min() > 0
    for i, case in enumerate(cases):
        magnitude, first = np.linalg.norm(case["force"]), case["body_a"]
        tolerance = case["rel_tol"]
        if precision == "float32":
            # Rounding of positions in float32, 6e-9 m for coordinates up to 0.1 m, over the depth.
            tolerance = max(tolerance, 2e-8 / depth[i] + 1e-6)
        size = np.max(first.get("size", 2 * first.get("half_length", first.get("radius", 0.15))))
        assert np.linalg.norm(force[i] - case["force"]) <= tolerance * magnitude, case["name"]
        allowed = max(tolerance * magnitude * size, case.get("moment_abs_tol", 0.0))
        assert np.linalg.norm(moment[i] - case["moment"]) <= allowed, case["name"]


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("as_mesh", [False, True], ids=["cubes", "meshes"])
def test_foundation_of_a_stage_equals_closed_forms(tmp_path, as_mesh, precision, shared, device):
    cases = load_cases(shared, "elastic_foundation")
    assert len(cases) == 40
    law = wc.laws.ElasticFoundation(stiffness=1e8)
    assert {case["law"]["k"] for case in cases} == {1e8}
    _, _, *found = evaluate(tmp_path, cases, law, as_mesh, device, precision)
    check(cases, *found, precision)


def test_nonlinear_pressure_and_two_moduli_of_a_stage_equal_closed_forms(tmp_path, shared, device):
    (case,) = cases = load_cases(shared, "power")
    law = PowerFoundation(stiffness=case["law"]["k"], exponent=case["law"]["exponent"])
    _, _, *found = evaluate(tmp_path, cases, law, False, device)
    check(cases, *found, "float64")
    (case,) = cases = load_cases(shared, "pressure_field")
    law = wc.laws.PressureField(modulus=case["law"]["k_a"], other_modulus=case["law"]["k_b"])
    _, _, *found = evaluate(tmp_path, cases, law, False, device)
    check(cases, *found, "float64")


def test_spheres_in_creases_of_a_stage_equal_closed_forms(tmp_path, shared, device):
    cases = load_cases(shared, "Hooke")
    assert len(cases) == 3
    law = wc.laws.Hooke(stiffness=cases[0]["law"]["stiffness"])
    scene, model, *_ = evaluate(tmp_path, cases, law, False, device)
    for contact in scene.contacts:
        assert contact.minima == "all"
        case = cases[int(contact.surface.name.rpartition("_")[2])]
        index = contact.points.body.index
        force = model.sensor(f"{contact.name}.force")[0]
        assert index >= 0
        # Points of meshes are float32 in USD; those of a groove have a rounding of 1e-8 m, of a depth of 1 mm.
        tolerance = max(case["rel_tol"], 2e-5 if case["body_b"]["shape"] == "groove" else 0.0)
        np.testing.assert_allclose(np.reshape(force, (-1, 3)).sum(axis=0), case["force"], atol=tolerance * 20)
