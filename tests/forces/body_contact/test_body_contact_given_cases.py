"""Scenes that contact at points gets wrong: equal cubes, crossing bars, a foundation, a flat floor of triangles, cubes at rest."""

import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

import warpcontact as wc

# Places at rest of the bodies of each stage [m]; ``None``: any. Duration of the motion [s], and a push along x [N].
STAGES = {
    "p01_tilted_cube": (4.0, {"b": (None, None, 0.1)}, 0.0),
    "p02_cube_at_rest": (2.0, {"b": (0, 0, 0.1)}, 20.0),
    "p03_equal_mesh_cubes": (1.0, {"a": (0, 0, 0.1), "b": (0, 0, 0.3)}, 0.0),
}


@pytest.mark.parametrize("nonsmooth", [True, False], ids=["impulses", "forces"])
@pytest.mark.parametrize("stage", list(STAGES))
def test_cubes_of_a_stage_come_to_rest(stage, nonsmooth, shared, device):
    """A tilted cube that is dropped, a cube that is pushed below its friction, and two equal mesh cubes."""
    seconds, places, push = STAGES[stage]
    scene = wc.Scene.from_usd(shared / "cases" / "patches" / f"{stage}.usda", trusted=True)
    assert len(scene.body_contacts) == (3 if stage == "p03_equal_mesh_cubes" else 1)
    model = scene.build(device=device, precision="float64")
    if push:
        model["b.external_force"] = (push, 0, 0)
    integrator, dt = (wc.integrators.MoreauJean(), 2e-3) if nonsmooth else (None, 2e-4)
    wc.Simulation(model, dt=dt, integrator=integrator).step(round(seconds / dt))
    for name, place in places.items():
        position = model.sensor(f"{name}.position")[0]
        off = [abs(own - right) for own, right in zip(position, place, strict=True) if right is not None]
        # Depth at rest of contacts of 10 ms: g (T/π)², 0.1 mm, twice that below two cubes, and of a push likewise.
        assert max(off) < (1e-6 if nonsmooth else 5e-4), name
        assert np.linalg.norm(model.sensor(f"{name}.angular_velocity")[0]) < 1e-6, name
        assert np.linalg.norm(model.sensor(f"{name}.linear_velocity")[0]) < 1e-6, name
        # The axes of a cube are those of the world, in some order.
        turn = Rotation.from_quat(model.sensor(f"{name}.orientation")[0]).as_matrix()
        np.testing.assert_allclose(np.sort(np.abs(turn[2])), [0, 0, 1], atol=1e-3)


def pressed_boxes(size, positions, law, device, *, turn=(0, 0, 0, 1), lower=None):
    """Returns forces and torques on a mesh box on another one, by position."""
    scene = wc.Scene(gravity=(0, 0, 0))
    low, high = (scene.add_body(1.0, (1, 1, 1), name=name) for name in ("low", "high"))
    first = scene.add_surface(wc.meshes.box(size), high)
    second = scene.add_surface(wc.meshes.box(size if lower is None else lower), low)
    scene.add_body_contact(first, second, wc.ContactMaterial(law=law), name="pair")
    model = scene.build(envs=len(positions), device=device, precision="float64")
    model["high.position"] = positions
    model["high.orientation"] = np.tile(turn, (len(positions), 1))
    return model.sensor("pair.force"), model.sensor("pair.torque")


def test_equal_boxes_carry_at_any_offset_without_side_force(device):
    """The mean of the law over the area is its force at the depth, for any area."""
    offsets = np.array(
        [(0, 0), (1e-9, 1e-9), (1e-6, 1e-6), (5e-4, 0), (1e-3, 1e-3), (0.01, 0), (0.01, 0.02)], dtype=float
    )
    positions = np.column_stack([offsets, np.full(len(offsets), 0.2 - 1e-3)])
    force, _ = pressed_boxes((0.2, 0.2, 0.2), positions, wc.laws.Hooke(stiffness=1e4), device)
    np.testing.assert_allclose(force, np.tile([0, 0, 10.0], (len(offsets), 1)), rtol=1e-9, atol=1e-9)


def test_crossing_bars_carry_the_load_of_their_common_square(device):
    size, turn = (0.2, 0.1, 0.1), (0, 0, np.sqrt(0.5), np.sqrt(0.5))
    for law, expected in (
        (wc.laws.Hooke(stiffness=1e4), 10.0),
        (wc.laws.ElasticFoundation(stiffness=1e8), 1e8 * 0.1**2 * 1e-3),
    ):
        force, torque = pressed_boxes(size, [(0, 0, 0.1 - 1e-3)], law, device, turn=turn)
        np.testing.assert_allclose(force[0], [0, 0, expected], rtol=1e-9, atol=1e-9 * expected)
        np.testing.assert_allclose(torque[0], 0.0, atol=1e-9 * expected)


def test_foundation_carries_its_area_times_the_depth(device):
    """Equal boxes and a smaller one, from 0.1 to 5 mm deep."""
    depths = np.array([1e-4, 1e-3, 5e-3])
    positions = np.column_stack([np.zeros((3, 2)), 0.1 - depths])
    for side in (0.1, 0.06):
        size = (side, side, 0.1)
        law = wc.laws.ElasticFoundation(stiffness=1e8)
        force, torque = pressed_boxes(size, positions, law, device, lower=(0.1, 0.1, 0.1))
        expected = 1e8 * side**2 * depths
        np.testing.assert_allclose(force[:, 2], expected, rtol=1e-9)
        assert (np.abs(np.column_stack([force[:, :2], torque])) <= 1e-9 * expected[:, None]).all()


def test_box_slides_over_a_flat_floor_of_triangles_without_a_bump(device):
    """Inner edges of the floor, at which the height and the velocity would change."""
    points = np.random.default_rng(1).uniform(-3, 3, (400, 2))
    faces = Delaunay(points).simplices
    up = np.linalg.det(points[faces[:, 1:]] - points[faces[:, :1]]) > 0
    faces = np.where(up[:, None], faces, faces[:, ::-1])
    scene = wc.Scene()
    floor = scene.add_surface(wc.Mesh(np.column_stack([points, np.zeros(len(points))]), faces))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e7))
    depth = 9.81 / (1e7 * 0.2**2)
    box = scene.add_body(
        1.0, (4e-3,) * 3, position=(-2, 0.1, 0.1 - depth), linear_velocity=(3, 0.4, 0), name="box"
    )
    shape = scene.add_shape(box, wc.shapes.RoundedBox((0.1, 0.1, 0.1)))
    scene.add_body_contact(shape, floor, material, name="touch")
    model = scene.build(device=device, precision="float64")
    sim = wc.Simulation(model, dt=2.5e-4)
    for _ in range(20):
        sim.step(200)
        np.testing.assert_allclose(model.sensor("box.linear_velocity")[0], [3, 0.4, 0], atol=1e-9)
        assert model.sensor("box.position")[0, 2] == pytest.approx(0.1 - depth, abs=1e-12)
        assert np.abs(model.sensor("box.angular_velocity")).max() < 1e-9


def test_capsule_that_falls_aslant_lies_on_a_box(device):
    """Its line needs two points; with one it sinks through the box in 20 s."""
    scene = wc.Scene(gravity=(0, 0, -10))
    turn = (0, np.sin(0.6), 0, np.cos(0.6))
    body = scene.add_body(1.0, (0.2, 0.2, 0.1), position=(0.1, 0, 2), orientation=turn, name="b")
    capsule = scene.add_shape(body, wc.shapes.Capsule(0.5, 0.5))
    box = scene.add_shape(None, wc.shapes.RoundedBox((1.0, 1.0, 0.1)), position=(0, 0, -0.1))
    stick = wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=8e3, damping=5.0)
    law = wc.laws.KelvinVoigt(stiffness=2e4, restitution=0.2)
    scene.add_body_contact(capsule, box, wc.ContactMaterial(law=law, friction=stick), name="c")
    model = scene.build(device=device, precision="float64")
    dt = 1 / 120
    sim = wc.Simulation(model, dt=dt, integrator=wc.integrators.MoreauJean())
    sim.step(1200)
    before = model.sensor("b.position")[0].copy()
    sim.step(1200)
    position = model.sensor("b.position")[0]
    # The overlap of its impact remains, at most the fall in a step.
    assert position[2] == pytest.approx(0.5, abs=10 * dt**2)
    assert np.abs(position - before).max() < 1e-6
    assert np.linalg.norm(model.sensor("b.angular_velocity")[0]) < 1e-6
