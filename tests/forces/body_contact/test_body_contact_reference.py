"""Force and moment of body contact in the reference cases, which are closed forms."""

import itertools
import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import warp as wp

import warpcontact as wc

# Smaller than the rounding of positions over the depth in float64: 1e-17 m / 1e-4 m, times some operations.
EXACT = 1e-9


class PowerFoundation(wc.Law):
    """p = k δⁿ."""

    stiffness: float = wc.parameter("Pa/mⁿ", "stiffness k", above=0.0)
    exponent: float = wc.parameter("-", "exponent n", above=0.0)
    area: float | None = wc.parameter("m²", "area of the point", default=None, above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * p.area * wp.pow(c.delta, p.exponent)


def union_of_boxes(boxes):
    """Returns the closed surface of boxes that touch at faces, as a mesh."""
    centers, sizes = (np.array([box[key] for box in boxes]) for key in ("centre", "size"))
    lower, upper = centers - sizes / 2, centers + sizes / 2
    grid = [np.unique(np.round(np.concatenate([lower[:, k], upper[:, k]]), 12)) for k in range(3)]
    middles = np.stack(np.meshgrid(*((axis[1:] + axis[:-1]) / 2 for axis in grid), indexing="ij"), axis=-1)
    inside = ((middles[..., None, :] > lower) & (middles[..., None, :] < upper)).all(axis=-1).any(axis=-1)
    filled = np.pad(inside, 1)
    vertices, faces = [], []
    for cell in np.argwhere(inside):
        for axis, side in itertools.product(range(3), (0, 1)):
            neighbor = cell + 1
            neighbor[axis] += 2 * side - 1
            if filled[tuple(neighbor)]:
                continue
            first, second = (axis + 1) % 3, (axis + 2) % 3
            corners = []
            for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = cell.copy()
                corner[axis] += side
                corner[first] += a
                corner[second] += b
                corners.append([grid[k][corner[k]] for k in range(3)])
            start = len(vertices)
            vertices += corners if side else corners[::-1]
            faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    return wc.Mesh(np.array(vertices), np.array(faces))


def mesh_of(body):
    return wc.meshes.box(body["size"]) if body["shape"] == "box" else union_of_boxes(body["boxes"])


def evaluate(cases, kind, law, device, precision):
    """Returns sensors of the cases, one environment each; ``kind``: "shape" or "mesh"."""
    first, second = ([case[f"body_{side}"] for case in cases] for side in "ab")
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    if kind == "shape":
        upper = scene.add_shape(body, wc.shapes.RoundedBox((1, 1, 1)), name="upper")
    else:
        upper = scene.add_surface([mesh_of(one) for one in first], body=body, name="upper")
    on_plane = second[0]["shape"] == "plane"
    if on_plane:
        lower = scene.add_shape(None, wc.shapes.Plane(), name="lower")
    elif kind == "shape":
        lower = scene.add_shape(None, wc.shapes.RoundedBox((1, 1, 1)), name="lower")
    else:
        lower = scene.add_surface([mesh_of(one) for one in second], name="lower")
    scene.add_body_contact(upper, lower, wc.ContactMaterial(law=law), name="press")
    model = scene.build(envs=len(cases), device=device, precision=precision)
    model["body.position"] = [one["position"] for one in first]
    model["body.orientation"] = [one["orientation"] for one in first]
    for name, bodies in (("upper", first), ("lower", second)):
        if kind == "shape" and not (name == "lower" and on_plane):
            model[f"{name}.half_extents"] = np.array([one["size"] for one in bodies]) / 2
        elif not (name == "lower" and on_plane):
            model[f"{name}.mesh"] = np.arange(len(cases))
    if not on_plane:
        model["lower.position"] = [one["position"] for one in second]
        model["lower.orientation"] = [one["orientation"] for one in second]
    if "stiffness" in law.parameters():
        model["press.law.stiffness"] = [case["law"]["k"] for case in cases]
    sensors = ("force", "torque", "area", "depth", "status", "reference", "volume", "center", "max_pressure")
    return SimpleNamespace(**{key: model.sensor(f"press.{key}") for key in sensors})


SHAPES = ("box", "union of boxes")


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("kind", ["shape", "mesh"])
@pytest.mark.parametrize("other", ["box", "plane"])
def test_force_and_moment_equal_closed_forms(other, kind, precision, shared, device):
    cases = [
        case
        for case in json.loads((shared / "spec" / "oracle_patches.json").read_text())["cases"]
        if case.get("body_a", {}).get("shape") in (SHAPES if kind == "mesh" else SHAPES[:1])
        and case["body_b"].get("shape") == other
        and case["law"]["type"] == "elastic_foundation"
    ]
    assert len(cases) >= 5
    found = evaluate(cases, kind, wc.laws.ElasticFoundation(stiffness=1.0), device, precision)
    force, moment = (np.array([case[key] for case in cases]) for key in ("force", "moment"))
    magnitude = np.linalg.norm(force, axis=1)
    tolerance = np.array([case["rel_tol"] for case in cases])
    size = np.array([np.max(case["body_a"].get("size", 0.3)) for case in cases])
    moment_tolerance = np.array([case.get("moment_abs_tol", 0.0) for case in cases])
    if precision == "float32":
        # Rounding of positions in float32, 6e-9 m for coordinates up to 0.1 m, over the depth; the state is rounded once.
        tolerance = np.maximum(tolerance, 2e-8 / found.depth + 1e-6)
    force_error = np.linalg.norm(found.force - force, axis=1) / magnitude
    moment_error = np.linalg.norm(found.torque - moment, axis=1)
    names = [case["name"] for case in cases]
    assert (force_error <= tolerance).all(), dict(zip(names, force_error, strict=True))
    assert (moment_error <= np.maximum(tolerance * magnitude * size, moment_tolerance)).all()
    with_area = [i for i, case in enumerate(cases) if "area" in case and "moment_abs_tol" not in case]
    area = np.array([cases[i]["area"] for i in with_area])
    np.testing.assert_allclose(found.area[with_area], area, rtol=1e-6 if precision == "float64" else 1e-3)


def test_nonlinear_pressure_equals_closed_form(shared, device):
    cases = [
        case
        for case in json.loads((shared / "spec" / "oracle_patches.json").read_text())["cases"]
        if case["name"] == "tilt 5 deg, power 1.5"
    ]
    law = PowerFoundation(stiffness=1.0, exponent=cases[0]["law"]["exponent"])
    found = evaluate(cases, "shape", law, device, "float64")
    # Error of the quadrature of √t next to the edge t = 0.
    np.testing.assert_allclose(found.force, [case["force"] for case in cases], rtol=1e-3, atol=1e-3)


def test_pressures_of_two_moduli_balance(shared, device):
    cases = [
        case
        for case in json.loads((shared / "spec" / "oracle_patches.json").read_text())["cases"]
        if case.get("law", {}).get("type") == "pressure_field"
    ]
    assert cases
    for case in cases:
        law = wc.laws.PressureField(modulus=case["law"]["k_a"], other_modulus=case["law"]["k_b"])
        found = evaluate([case], "shape", law, device, "float64")
        np.testing.assert_allclose(found.force[0], case["force"], rtol=case["rel_tol"], atol=1e-6)
        np.testing.assert_allclose(found.center[0, 2], case["surface_z"], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(found.max_pressure[0], case["max_pressure"], rtol=case["rel_tol"])


def test_columns_that_enter_a_convex_mesh_at_its_sides_leave_at_its_base(device):
    """A cone stands in a box. Columns outside of its section with the top of the box would enter it from the side."""
    corners, radius, height = 48, 0.05, 0.1
    angles = 2 * np.pi * np.arange(corners) / corners
    rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(corners)])
    vertices = np.vstack([rim, [[0.0, 0.0, 0.0], [0.0, 0.0, height]]])
    along = [(i, (i + 1) % corners) for i in range(corners)]
    faces = [(b, a, corners) for a, b in along] + [(a, b, corners + 1) for a, b in along]
    depths = np.array([1e-6, 1e-4, 1e-3, 5e-3])
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    cone = scene.add_surface(wc.Mesh(vertices, faces), body=body)
    box = scene.add_shape(None, wc.shapes.RoundedBox((0.3, 0.3, 0.05)), position=(0, 0, -0.05))
    law = wc.laws.ElasticFoundation(stiffness=1e9)
    scene.add_body_contact(cone, box, wc.ContactMaterial(law=law), name="press", reference="second")
    model = scene.build(envs=len(depths), device=device, precision="float64")
    model["body.position"] = np.outer(depths, [0.0, 0.0, -1.0])
    model.evaluate()
    # The section is a regular polygon; below it all columns have the same depth.
    section = corners / 2 * np.sin(2 * np.pi / corners) * (radius * (1 - depths / height)) ** 2
    # Faces that columns enter count partly within 1e-9 of the size of the solid: 9e-11 m times the length of the boundary over the area.
    np.testing.assert_allclose(model.sensor("press.area"), section, rtol=4e-9)
    np.testing.assert_allclose(model.sensor("press.force")[:, 2], 1e9 * depths * section, rtol=4e-9)
