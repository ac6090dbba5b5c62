"""Bodies at rest under body contact: parts, stacks, a pyramid and an arch.

After they have settled they do not move, with heights and reactions in closed form, and a push holds below the limit of friction
only. Slow tests cover a minute.
"""

import numpy as np
import pytest
from part_meshes import bracket, centered, l_section, prism, random_hull
from scipy.spatial.transform import Rotation

import warpcontact as wc

GRAVITY = 9.81  # m/s²
K = 2e7  # Pa/m
MU = 0.5
STICK = 2e4  # N/m, of friction; low, because steps must be short for its damping where a body has several contacts
DT = 1.5e-4  # s
SETTLING = 1.0  # s
SIDE = 0.1  # m
# Of a push, relative to the limit of friction, by environment.
PUSHES = np.array([0.0, 0.98, 1.02])

on_floors = pytest.mark.parametrize(
    ("floor", "seconds"), [("half-space", 2.0), ("mesh", 2.0), pytest.param("mesh", 60.0, marks=pytest.mark.slow)]
)


def material(mass=0.25):
    """Returns a material in which bodies of 1 kg settle in some tenths of a second.

    ``mass`` is the mass that the slip of one contact moves [kg]; a body with several contacts has less for each.
    """
    friction = wc.friction.CundallStrack.from_overshoot(
        mu_static=MU, mu_dynamic=MU, stiffness=STICK, mass=mass, overshoot=0.01
    )
    return wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K, damping=50.0), friction=friction)


def add_floor(scene, kind):
    """Adds a floor at z = 0 and returns its solid."""
    if kind == "half-space":
        return scene.add_shape(None, wc.shapes.Plane(), name="floor")
    return scene.add_surface(wc.meshes.box((4.0, 4.0, 0.2)), position=(0, 0, -0.1), name="floor")


def run_at_rest(model, bodies, seconds):
    """Steps a model and checks that the bodies of its first environment are at rest after they have settled."""
    sim = wc.Simulation(model, dt=DT)
    assert sim.check() == []
    sim.step(round(SETTLING / DT))
    before = {body.name: model.sensor(f"{body.name}.position")[0].copy() for body in bodies}
    sim.step(round(seconds / DT))
    for name, position in before.items():
        assert np.abs(model.sensor(f"{name}.position")[0] - position).max() < 1e-6, name
        assert np.abs(model.sensor(f"{name}.linear_velocity")[0]).max() < 1e-6, name
        assert np.abs(model.sensor(f"{name}.angular_velocity")[0]).max() < 1e-6, name
    return sim


def push(model, name, mass, arm):
    """Pushes a body along x at the height of its base, ``arm`` below its center, in environments 1 and 2."""
    force = PUSHES * MU * mass * GRAVITY
    model[f"{name}.external_force"] = force[:, None] * [1.0, 0.0, 0.0]
    model[f"{name}.external_torque"] = -arm * force[:, None] * [0.0, 1.0, 0.0]


def check_push(model, name, time):
    """Checks that a pushed body holds below the limit of friction, and slides above it."""
    speed = model.sensor(f"{name}.linear_velocity")[:, 0]
    moved = model.sensor(f"{name}.position")[:, 0]
    assert abs(speed[1]) < 1e-6
    # It slips some tenths of a millimeter while it settles, because its load is smaller at times.
    assert abs(moved[1]) < 5e-4
    assert speed[2] == pytest.approx(0.02 * MU * GRAVITY * time, rel=0.05)


def triangle_depths(corners, height, weight):
    """Returns the depth of a triangle on a foundation below the center of mass, and at its corners [m].

    The pressure is linear, and its center is below the center of mass, which moves by its height times the tilt.

    Args:
        corners: Corners, about the projection of the center of mass, (3, 2) [m].
        height: Height of the center of mass [m].
        weight: Weight [N].
    """
    area = 0.5 * abs(np.linalg.det(corners[1:] - corners[0]))
    affine = np.c_[np.ones(3), corners]
    # Integral of the products of the coordinates (1, x, y): A/12 (Σ aᵢ Σ aᵢᵀ + Σ aᵢ aᵢᵀ).
    moments = area / 12 * (np.outer(affine.sum(axis=0), affine.sum(axis=0)) + affine.T @ affine)
    depth = np.linalg.solve(K * moments - weight * height * np.diag([0.0, 1.0, 1.0]), [weight, 0.0, 0.0])
    return depth[0], affine @ depth


@on_floors
def test_parts_of_any_shape_rest_and_hold_a_push(floor, seconds, device):
    hull, hull_inertia, foot = random_hull(SIDE / 2, seed=5)
    under, at_corners = triangle_depths(foot, -hull.vertices[:, 2].min(), GRAVITY)
    assert at_corners.min() > 0  # otherwise the hull would touch on a part of its base only
    ell, frame = l_section(SIDE, SIDE / 3, SIDE / 2), bracket(0.15, 0.08, 0.03, 0.06)
    parts = {
        "ell": (*ell, GRAVITY / (K * SIDE**2 * 5 / 9)),
        "bracket": (*frame, GRAVITY / (K * 2 * 0.03 * 0.08)),
        "hull": (hull, hull_inertia, under),
    }
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    ground = add_floor(scene, floor)
    base = {}
    for number, (name, (mesh, inertia, _)) in enumerate(parts.items()):
        base[name] = -mesh.vertices[:, 2].min()
        body = scene.add_body(mass=1.0, inertia=inertia, position=(0, number - 1.0, base[name]), name=name)
        scene.add_body_contact(scene.add_surface(mesh, body), ground, material(1.0), name=f"{name}_touch")
    model = scene.build(envs=len(PUSHES), device=device, precision="float64")
    for name in parts:
        push(model, name, 1.0, base[name])
    sim = run_at_rest(model, scene.bodies, seconds)
    for name, (_, _, depth) in parts.items():
        sunk = base[name] - model.sensor(f"{name}.position")[0, 2]
        if name == "hull":
            # Faces next to the base touch the floor, too, and carry part of the weight.
            assert 0.8 * depth < sunk < depth
        else:
            assert sunk == pytest.approx(depth, abs=1e-9)
        np.testing.assert_allclose(model.sensor(f"{name}_touch.force")[0], [0, 0, GRAVITY], atol=1e-6)
        check_push(model, name, sim.time)


def add_box(scene, side, mass, height, name, *, below, place=(0.0, 0.0), turn=0.0, mesh=False):
    """Adds a cube on solids below it; returns its solid."""
    body = scene.add_body(
        mass=mass,
        inertia=[mass * side**2 / 6] * 3,
        position=(*place, height + side / 2),
        orientation=(0, 0, np.sin(turn / 2), np.cos(turn / 2)),
        name=name,
    )
    if mesh:
        solid = scene.add_surface(wc.meshes.box((side,) * 3), body)
    else:
        solid = scene.add_shape(body, wc.shapes.RoundedBox((side / 2,) * 3))
    scene.add_body_contact(solid, below, material(), name=f"{name}_on")
    return solid


#: Sides and masses from below, and turns about the vertical.
STACKS = {
    "unequal": ([0.1, 0.07, 0.09, 0.05], [1.0, 0.8, 1.2, 0.6], [0.0] * 4),
    "turned": ([0.1] * 4, [1.0] * 4, [0.0, np.pi / 4, 0.0, np.pi / 4]),
}


@pytest.mark.parametrize("kind", STACKS)
@on_floors
def test_stacks_of_unequal_and_turned_boxes_rest(kind, floor, seconds, device):
    sides, masses, turns = (np.array(values) for values in STACKS[kind])
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    below = add_floor(scene, floor)
    bottoms = np.concatenate([[0.0], np.cumsum(sides)[:-1]])
    for i, side in enumerate(sides):
        # Meshes and boxes take turns.
        below = add_box(
            scene, side, masses[i], bottoms[i], f"box_{i}", below=below, turn=turns[i], mesh=i % 2 == 1
        )
    model = scene.build(device=device, precision="float64")
    run_at_rest(model, scene.bodies, seconds)
    areas = np.minimum(sides, np.concatenate([[np.inf], sides[:-1]])) ** 2
    if kind == "turned":
        areas[1:] = 2 * (np.sqrt(2) - 1) * sides[0] ** 2  # of an octagon
    carried = np.cumsum(masses[::-1])[::-1] * GRAVITY
    heights = bottoms + sides / 2 - np.cumsum(carried / (K * areas))
    for i in range(len(sides)):
        assert model.sensor(f"box_{i}.position")[0, 2] == pytest.approx(heights[i], abs=1e-9)
        # Walls in one plane count partly within 1e-9 of the size.
        assert model.sensor(f"box_{i}_on.area")[0] == pytest.approx(areas[i], rel=1e-8)
        np.testing.assert_allclose(model.sensor(f"box_{i}_on.force")[0], [0, 0, carried[i]], atol=1e-6)


@on_floors
def test_pyramid_of_five_boxes_rests(floor, seconds, device):
    """Each of four boxes carries a quarter of the fifth one."""
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    ground = add_floor(scene, floor)
    places = [(x, y) for x in (-0.07, 0.07) for y in (-0.07, 0.07)]
    lower = [add_box(scene, SIDE, 1.0, 0.0, f"box_{i}", below=ground, place=places[i]) for i in range(4)]
    add_box(scene, SIDE, 1.0, SIDE, "top", below=lower, mesh=True)
    model = scene.build(device=device, precision="float64")
    run_at_rest(model, scene.bodies, seconds)
    # Indeterminate: friction that remains from settling changes the symmetric loads.
    upper = model.sensor("top_on.force")[0, :, 2]
    np.testing.assert_allclose(upper, GRAVITY / 4, rtol=1e-4)
    assert upper.sum() == pytest.approx(GRAVITY, rel=1e-7)
    for i in range(4):
        assert model.sensor(f"box_{i}_on.force")[0, 2] == pytest.approx(GRAVITY + upper[i], rel=1e-6)


@on_floors
def test_arch_of_mesh_voussoirs_rests(floor, seconds, device):
    """Each end of a half circle of seven wedges carries half of its weight."""
    count, inner, outer, width = 7, 0.2, 0.3, 0.1
    half = np.pi / count / 2
    outline = np.array(
        [[r * np.sin(a), r * np.cos(a)] for r, a in ((inner, -half), (inner, half), (outer, half), (outer, -half))]
    )
    wedge = prism(outline, [[0, 1, 2], [0, 2, 3]], width)
    if wedge.report.volume < 0:
        wedge = wc.Mesh(wedge.vertices, wedge.faces[:, ::-1])
    # x, y, z → x, −z, y: the section is in the plane of x and z.
    upright = wc.Mesh(wedge.vertices[:, [0, 2, 1]] * [1, -1, 1], wedge.faces)
    mesh, inertia = centered(upright)
    radius = upright.vertices[:, 2].max() - mesh.vertices[:, 2].max()
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    ground = add_floor(scene, floor)
    solids = []
    for i in range(count):
        angle = (2 * i + 1) * half - np.pi / 2  # from the vertical
        body = scene.add_body(
            mass=1.0,
            inertia=inertia,
            position=(radius * np.sin(angle), 0, radius * np.cos(angle)),
            orientation=Rotation.from_rotvec([0, angle, 0]).as_quat(),
            name=f"wedge_{i}",
        )
        solids.append(scene.add_surface(mesh, body))
    scene.add_body_contact(
        solids, material(), name="joints", exclude=[(a, b) for i, a in enumerate(solids) for b in solids[i + 2 :]]
    )
    scene.add_body_contact([solids[0], solids[-1]], ground, material(), name="feet")
    model = scene.build(device=device, precision="float64")
    run_at_rest(model, scene.bodies, seconds)
    force = model.sensor("feet.force")[0]
    np.testing.assert_allclose(force[:, 2], count * GRAVITY / 2, rtol=1e-6)
    # The horizontal thrusts are opposite.
    assert force[0, 0] == pytest.approx(-force[1, 0], rel=1e-6)
    assert force[0, 0] > 0.1 * count * GRAVITY / 2
