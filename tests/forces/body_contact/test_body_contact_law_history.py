"""Laws with history variables in body contact: one history per patch, with the force of the law at a flat contact."""

from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

import warpcontact as wc

SIDE, MASS, G = 0.1, 1.0, 9.81
DT = 1e-4
# Loading stiffness over unloading stiffness, in each environment.
RATIOS = np.array([1.0, 0.81, 0.25])
STIFFNESS = 1e5


class Plastic(wc.Law):
    """Loads with one stiffness, unloads with a larger one, with damping in terms of the entry speed."""

    loading: float = wc.parameter("N/m", "stiffness of first loading", above=0.0)
    unloading: float = wc.parameter("N/m", "stiffness of unloading", above=0.0)
    damping: float = wc.parameter("-", "damping factor", default=0.0, at_least=0.0)
    largest = wc.history("m", "largest penetration")

    @wp.func
    def advance(p: Any, c: Any, m: Any):
        m.largest = wp.max(m.largest, c.delta)
        return m

    @wp.func
    def force(p: Any, c: Any, m: Any):
        residual = (type(c.delta)(1.0) - p.loading / p.unloading) * m.largest
        spring = wp.max(p.unloading * (c.delta - residual), type(c.delta)(0.0))
        floor = type(c.delta)(1.0e-3)
        return spring * (type(c.delta)(1.0) + p.damping * c.delta_dot / wp.max(c.entry_speed, floor))


MATERIAL = wc.ContactMaterial(law=Plastic(loading=STIFFNESS, unloading=STIFFNESS, damping=0.0))


def body_at(scene, name, position, velocity=(0.0, 0.0, -0.5), mass=MASS):
    """Adds a body whose inertia is so large that it does not turn."""
    return scene.add_body(
        mass=mass, inertia=(1e6, 1e6, 1e6), position=position, linear_velocity=velocity, name=name
    )


def flat_scene():
    """Returns a scene of solids that fall on flat faces, and the names of their contacts; the last one is of a point."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
    block = scene.add_surface(wc.meshes.box((1.0, 1.0, 0.2)), position=(2.0, 0.0, -0.1), name="block")
    plate = scene.add_shape(None, wc.shapes.Cylinder(0.2, 0.1), position=(4.0, 0.0, -0.1), name="plate")
    ground = scene.add_surface(wc.meshes.grid((1.0, 1.0)), position=(6.0, 0.0, 0.0), name="ground")
    box, cylinder = wc.shapes.RoundedBox((SIDE / 2,) * 3), wc.shapes.Cylinder(SIDE / 2, SIDE / 2)
    names = []
    for x, below, shape in (
        (0.0, plane, box), (0.5, plane, cylinder), (1.8, block, box), (2.2, block, cylinder), (4.0, plate, cylinder)
    ):  # fmt: skip
        body = body_at(scene, f"body_{len(names)}", (x, 0.0, SIDE / 2 + 1e-4))
        solid = scene.add_shape(body, shape, name=f"solid_{len(names)}")
        names.append(f"touch_{len(names)}")
        scene.add_body_contact(solid, below, MATERIAL, name=names[-1])
    body = body_at(scene, "body_point", (6.0, 0.0, SIDE / 2 + 1e-4))
    point = scene.add_point(body, (0.0, 0.0, -SIDE / 2), name="point")
    scene.add_contact(point, ground, MATERIAL, name="touch_point")
    return scene, [*names, "touch_point"]


def built(scene, contacts, device, damping=0.0):
    """Returns a model with the ratios of ``RATIOS`` for ``contacts``."""
    model = scene.build(envs=len(RATIOS), device=device, precision="float64")
    for name in contacts:
        model[f"{name}.law.unloading"] = STIFFNESS / RATIOS
        model[f"{name}.law.damping"] = damping
    return model


def test_flat_contact_has_the_force_history_of_a_point(device):
    scene, contacts = flat_scene()
    model = built(scene, contacts, device, damping=[0.0, 0.3, 0.3])
    names = [f"{name}.normal_force" for name in contacts]
    recording = wc.Simulation(model, dt=DT).run(0.3, record=names, every=DT)
    expected = recording[names[-1]].values
    # Several impacts, with loading, unloading and reloading.
    assert (np.diff((expected > 0).astype(int), axis=0) == 1).sum(axis=0).min() >= 2
    for name in names[:-1]:
        # Rounding of positions of 1 m over depths of 1 mm, which impacts carry on.
        np.testing.assert_allclose(recording[name].values, expected, rtol=0, atol=1e-9 * expected.max())


def test_restitution_of_a_plastic_law_is_that_of_the_closed_form(device):
    scene, contacts = flat_scene()
    model = built(scene, contacts, device)
    model["scene.gravity"] = (0.0, 0.0, 0.0)
    wc.Simulation(model, dt=DT / 10).step(2000)
    for number in range(len(contacts) - 1):
        rebound = model.sensor(f"body_{number}.linear_velocity")[:, 2]
        # First order in the step over the duration of the impact, 1e-3.
        np.testing.assert_allclose(rebound, 0.5 * np.sqrt(RATIOS), rtol=2e-3)


def test_patches_of_a_pair_have_their_own_history(device):
    """A box meets two separate squares of one surface, a floor and a wall, at different times and speeds."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    square = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * 0.02
    # The wall is at x = −0.05, and its normal along x.
    wall = square[:, [2, 0, 1]] + (-SIDE / 2, 0.0, SIDE / 2)
    corner = wc.Mesh(np.vstack([square, wall]), [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)])
    surface = scene.add_surface(corner, name="corner")
    start, velocity = (3e-4, 0.0, SIDE / 2 + 1e-4), (-0.2, 0.0, -0.5)
    # Heavy bodies keep their velocity.
    box = body_at(scene, "box", start, velocity, mass=1e9)
    solid = scene.add_shape(box, wc.shapes.RoundedBox((SIDE / 2,) * 3), name="solid")
    scene.add_body_contact(solid, surface, MATERIAL, name="touch")
    twin = body_at(scene, "twin", start, velocity, mass=1e9)
    for name, position in (("floor", (0.0, 0.0, -SIDE / 2)), ("wall", (-SIDE / 2, 0.0, 0.0))):
        point = scene.add_point(twin, position, name=f"point_{name}")
        # The force is the mean over both squares.
        scene.add_contact(point, surface, MATERIAL, force_scale=0.5, name=f"touch_{name}")
    model = built(scene, ["touch", "touch_floor", "touch_wall"], device, damping=[0.0, 0.3, 0.3])
    sim = wc.Simulation(model, dt=DT)
    both = 0
    for number in range(60):
        if number == 40:
            sim.state.body_linear_velocity.fill_(wp.vec3d(0.1, 0.0, 0.2))
        sim.step()
        force = model.sensor("touch.force")
        wall_force, floor_force = (model.sensor(f"touch_{name}.normal_force") for name in ("wall", "floor"))
        are_both = (wall_force > 0) & (floor_force > 0)
        both += are_both.sum()
        np.testing.assert_allclose(force[are_both, 0], wall_force[are_both], rtol=1e-8)
        np.testing.assert_allclose(force[are_both, 2], floor_force[are_both], rtol=1e-8)
    assert both > 90


def test_pressure_of_a_linear_law_is_proportional_to_depths(device):
    """A box tilted on a half-space: the force is k V/S, at the centroid of the wedge below the plane."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
    angle, depth = 0.1, 1e-3
    turned = Rotation.from_euler("y", angle)
    lowest = turned.apply((SIDE / 2, 0.0, -SIDE / 2))
    box = scene.add_body(
        mass=MASS, inertia=(1.0, 1.0, 1.0), position=(-lowest[0], 0.0, -depth - lowest[2]),
        orientation=turned.as_quat(), name="box",
    )  # fmt: skip
    solid = scene.add_shape(box, wc.shapes.RoundedBox((SIDE / 2,) * 3), name="solid")
    scene.add_body_contact(solid, plane, MATERIAL, name="touch")
    model = built(scene, ["touch"], device)
    # The lowest edge is at x = 0. Vertices of the triangle below the plane: the edge and both crossings of the plane.
    crossings = np.array([-depth / np.tan(angle), depth * np.tan(angle)])
    volume = 0.5 * depth * (crossings[1] - crossings[0]) * SIDE
    area = (crossings[1] - crossings[0]) * SIDE
    force = model.sensor("touch.normal_force")[0]
    np.testing.assert_allclose(force, STIFFNESS * volume / area, rtol=1e-12)
    np.testing.assert_allclose(model.sensor("touch.center")[0, 0], crossings.sum() / 3, rtol=1e-10)


def test_friction_without_history_acts_per_patch(device):
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
    box = body_at(scene, "box", (0.0, 0.0, SIDE / 2 - MASS * G / STIFFNESS), (1.0, 0.0, 0.0))
    solid = scene.add_shape(box, wc.shapes.RoundedBox((SIDE / 2,) * 3), name="solid")
    material = wc.ContactMaterial(law=MATERIAL.law, friction=wc.friction.Tanh(mu=0.3, velocity_scale=1e-3))
    scene.add_body_contact(solid, plane, material, name="touch")
    model = built(scene, ["touch"], device)
    friction = model.sensor("touch.friction_force")
    np.testing.assert_allclose(friction, np.tile([-0.3 * MASS * G, 0.0, 0.0], (len(RATIOS), 1)), atol=1e-9)


def test_checkpoint_and_reset_keep_and_clear_the_history(device, tmp_path):
    scene, contacts = flat_scene()
    model = built(scene, contacts, device, damping=0.3)
    sim = wc.Simulation(model, dt=DT)
    # In contact, while the body moves out.
    sim.step(40)
    assert (model.sensor("touch_0.normal_force") > 0).all()
    sim.save(tmp_path / "state.npz")
    sim.step(200)
    expected = [model.sensor(f"{name}.normal_force") for name in contacts]
    sim.reset()
    sim.step(3)
    sim.load(tmp_path / "state.npz")
    sim.step(200)
    for name, force in zip(contacts, expected, strict=True):
        np.testing.assert_array_equal(model.sensor(f"{name}.normal_force"), force)


def test_law_with_history_that_pulls_is_refused_with_friction():
    class Sticky(Plastic):
        pulls = True

    scene = wc.Scene()
    plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
    box = body_at(scene, "box", (0.0, 0.0, 1.0))
    solid = scene.add_shape(box, wc.shapes.RoundedBox((SIDE / 2,) * 3), name="solid")
    law = Sticky(loading=STIFFNESS, unloading=STIFFNESS)
    material = wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=0.3, velocity_scale=1e-3))
    with pytest.raises(
        ValueError, match="touch: the law of its material, Sticky, has history variables, and its law"
    ):
        scene.add_body_contact(solid, plane, material, name="touch")
