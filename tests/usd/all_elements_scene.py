"""Scenes with every kind of element, with arguments that differ from all defaults."""

from typing import Any

import numpy as np
import warp as wp

import warpcontact as wc


class Cubic(wc.Law):
    """N = k δ³."""

    stiffness: float = wc.parameter("N/m³", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * c.delta * c.delta


def turned(random):
    """A random orientation with four nonzero components."""
    q = random.normal(size=4)
    return q / np.linalg.norm(q)


def wavy(seed, count=6, half=1.0):
    """An uneven sheet whose vertices float32 cannot represent, in two groups of faces."""
    random = np.random.default_rng(seed)
    ticks = np.linspace(-half, half, count)
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    z = 0.03 * random.normal(size=x.shape)
    number = np.arange(count * count).reshape(count, count)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    groups = {"tread → left": np.arange(len(faces) // 2), "rest": np.arange(3, len(faces))}
    return wc.Mesh(np.stack([x, y, z], -1).reshape(-1, 3), faces, name=f"wavy <{seed}>", groups=groups)


def contact_scene(gravity=(0.1, -0.2, -9.7)):
    """Spheres, surfaces, springs and cables, all of which move."""
    odd = np.random.default_rng(7)  # numbers without a short decimal form
    scene = wc.Scene(gravity=gravity, max_speed=123.4, max_distance=55.5)
    bumps = wavy(1)
    chosen = ["rest", None, [3, 4, 5]]
    ground = scene.add_surface([bumps, wavy(2), bumps], name="ground", active_faces=chosen, scale=1.1)
    tensor = np.array([[2.0, 0.1, 0.2], [0.1, 2.5, 0.3], [0.2, 0.3, 3.0]]) * 1.1e-3
    ball = scene.add_body(
        0.5, tensor, (0.1, 0.2, 0.12), turned(odd), (0.3, 0.1, -0.5), (1.0, -2.0, 3.0),
        external_force=(0.01, 0.02, 0.03), external_torque=(1e-4, 2e-4, 3e-4), name="ball", color=(0.1, 0.2, 0.3),
    )  # fmt: skip
    law = wc.laws.HuntCrossley(stiffness=1.1e5, exponent=1.4, restitution=0.7)
    rubber = wc.ContactMaterial(
        law=law,
        friction=wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.4, stiffness=1e4),
        rolling=wc.friction.Tanh(mu=0.01),
        torsion=wc.friction.Tanh(mu=0.02),
    )
    centre = scene.add_point(ball, (0.001, 0.002, 0.003), name="centre")
    scene.add_contact(
        centre, ground, rubber, radius=0.1, kappa=0.25, entry="latched", swept=True, boundary="outer",
        search_radius=2.0, torsion_radius=0.01, force_scale=0.9, max_depth=0.5, name="touch-1", color=(1, 0, 0),
    )  # fmt: skip
    scene.add_contact(
        centre, ground, rubber, radius=0.09, minima="all", group_angle=(0.1, 0.5), max_minima=3, search="active",
        name="walls",
    )  # fmt: skip
    plate = scene.add_body(2.0, (0.1, 0.1, 0.15), (0.0, 0.0, 0.4), motion=wc.motions.Planar(normal=(0, 1, 0.1)))
    sheet = scene.add_surface(wavy(3, 4, 0.3), plate, (0, 0, 0.01), turned(odd), name="sheet", visible=False)
    under = scene.add_points(sheet, wc.sample_surface(wavy(3, 4, 0.3), 7), name="under")
    bed = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e6, damping=10.0))
    scene.add_contact(under, ground, bed, radius=0.02 + 0.001 * np.arange(7), name="bed", enabled=False)
    scene.add_points(plate, odd.normal(size=(3, 3)), areas=(0.1, 0.2, 0.3), name="loose")
    keep = wc.ContactRange.from_impact(mass=2.0, area=0.02, speed=1.5, effective_range=0.2, closest=0.005)
    scene.add_contact_coupling(
        sheet,
        ground,
        keep,
        wc.friction.Tanh(mu=0.3),
        sides="first",
        quadrature=3,
        damping_ramp=0.01,
        name="keep",
    )
    hook = scene.add_point(None, (0.0, 0.1, 1.5), name="hook")
    on_plate = scene.add_point(plate, (0.1, 0.0, 0.0), name="eye")
    scene.add_spring_damper(hook, centre, stiffness=51.0, damping=0.1, tension_only=True, break_force=80.0)
    table = wc.springs.ForceTable(table=((0.1, -1.0), (0.5, 0.3), (2.0, 4.0)), scale=1.5)
    scene.add_spring_damper(
        on_plate, centre, spring=table, damper=wc.springs.PolynomialDamping(a=0.1, b=0.02), rest_length=0.3
    )
    scene.add_bushing(
        hook, on_plate, stiffness=(10.0, 20.0, 30.0), turn_damping=(0.1, 0.2, 0.3), orientation=turned(odd)
    )
    scene.add_catenary(
        hook,
        on_plate,
        length=1.4,
        mass_per_length=0.2,
        axial_stiffness=1e4,
        floor=-0.5,
        name="line",
        visible=False,
    )
    return scene


def shape_scene():
    """Shapes, shape and particle contacts, body sets, and every joint and prescribed motion that USD can describe."""
    odd = np.random.default_rng(8)
    scene = wc.Scene()
    plane = scene.add_shape(None, wc.shapes.Plane(), orientation=turned(odd), name="plane", color=(0, 1, 0))
    egg = scene.add_body(0.06, (3e-5, 2e-5, 2.5e-5), (0, 0, 1.2), turned(odd), name="egg")
    shell = scene.add_shape(
        egg, wc.shapes.Ellipsoid((0.03, 0.022, 0.021)), (0.001, 0, 0), turned(odd), name="shell"
    )
    stone = wc.ContactMaterial(
        law=wc.laws.KelvinVoigt(stiffness=1e4, damping=1.0), friction=wc.friction.Tanh(mu=0.3)
    )
    scene.add_shape_contact(shell, plane, stone, kappa=0.3, max_depth=0.02, name="tap")
    places = odd.uniform(0.0, 0.1, (5, 3)) + np.array([0, 0, 0.6])
    grains = scene.add_bodies(
        places, 1e-3 * (1 + np.arange(5)), (4e-8, 5e-8, 6e-8), [turned(odd) for _ in range(5)], name="grains"
    )
    few = scene.add_bodies(
        odd.uniform(0.3, 0.4, (3, 3)), 2e-3, [np.eye(3) * 4e-8] * 3, linear_velocities=odd.normal(size=(3, 3))
    )
    sizes = [wc.shapes.Sphere(0.01 + 0.001 * i) for i in range(5)]
    balls = scene.add_shape(grains, sizes, odd.normal(size=(5, 3)) * 1e-3, group=3, name="balls")
    pills = scene.add_shape(few, wc.shapes.Capsule(0.01, 0.02), mask=0xFFFF0001, name="pills")
    one = scene.add_shape(egg, wc.shapes.Sphere(0.015), name="one")
    scene.add_particle_contact(
        [balls, pills, one],
        stone,
        exclude=[(balls, one), (pills, pills)],
        skin=0.004,
        max_neighbors=9,
        name="pile",
    )
    scene.add_shape(None, wc.shapes.RoundedBox((0.1, 0.2, 0.3), 0.01), visible=False)
    crate = scene.add_body(0.5, (1e-3, 1e-3, 1e-3), (0.4, 0.1, 0.9), turned(odd), name="crate")
    sides = [
        scene.add_shape(
            crate,
            wc.shapes.RoundedBox((0.05, 0.04, 0.03)),
            (0.1 * i, 0, 0),
            physics_material=("steel", "rubber")[i],
        )
        for i in range(2)
    ]
    foundation = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e7))
    scene.add_body_contact(sides, plane, foundation, kappa=0.4, reference="second", max_depth=0.01, name="press")
    scene.add_body_contact([*sides, plane], foundation, exclude=[(plane, sides[0])], margin=0.02, name="touch")
    plate = scene.add_surface(wc.meshes.box((1, 1, 0.1)), group=2, mask=3, physics_material="steel", name="slab")
    stiff = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=3e7))
    table = {("steel", "steel"): stiff, ("steel", "rubber"): foundation, ("rubber", "rubber"): None, None: stiff}
    scene.add_body_contact(sides, plate, table, name="table")
    motions = (
        wc.motions.Hinge(axis=(0, 1, 0.2), anchor=(0.1, 0.2, 0.3)),
        wc.motions.Ball(anchor=(0, 0, 2.0)),
        wc.motions.Slider(axis=(1, 1, 0)),
        wc.motions.Translation(),
        wc.motions.Fixed(),
        wc.motions.Harmonic(direction=(0, 0, 1), amplitude=0.1, frequency=2.2),
        wc.motions.Table(times=(0.0, 0.1, 0.4), displacements=((0, 0, 0), (0.1, 0, 0), (0.1, 0.2, 0.3))),
    )
    for i, motion in enumerate(motions):
        scene.add_body(1.0 + i, (0.1, 0.1, 0.1), (float(i), 2.0, 0.1), motion=motion)
    scene.add_body(1.0, (1, 1, 1), motion=wc.motions.Prescribed(), linear_velocity=(0.1, 0, 0))
    return scene


def custom_law_scene():
    """A ball with a custom law."""
    scene = wc.Scene()
    ground = scene.add_surface(wavy(4))
    ball = scene.add_body(0.5, (1e-3, 1e-3, 1e-3), (0, 0, 0.15), name="ball")
    material = wc.ContactMaterial(law=Cubic(stiffness=1e7))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, radius=0.1)
    return scene
