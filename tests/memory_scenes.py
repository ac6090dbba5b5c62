"""Scenes that cover all kinds of memory, and their memory estimates."""

import numpy as np

import warpcontact as wc
from warpcontact.geometry.query_mesh import _mesh_bytes
from warpcontact.system import resources

MIB = 2**20


def ball_scene():
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.sinusoidal_terrain((4, 4), (20, 20)), name="ground")
    ball = scene.add_body(0.5, (5e-4,) * 3, position=(0, 0, 1), name="ball")
    law = wc.laws.HuntCrossley(stiffness=1e5, restitution=0.7)
    material = wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=0.4))
    scene.add_contact(scene.add_point(ball, (0, 0, 0), name="centre"), ground, material, radius=0.05, name="touch")
    return scene


def mixed_scene():
    """Several bodies, sets, groups, meshes, latches, and models with history."""
    scene = ball_scene()
    ball = scene.bodies[0]
    box = scene.add_body(1.0, (1e-2,) * 3, position=(0, 0, 2), name="box")
    skin = scene.add_surface([wc.meshes.box((1, 1, 1)), wc.meshes.icosphere(0.5)], box, name="skin")
    hull = scene.add_points(box, np.random.default_rng(1).uniform(-0.5, 0.5, (40, 3)), name="hull")
    stuck = wc.ContactMaterial(
        law=wc.laws.Jankowski(stiffness=1e5, restitution=0.5),
        friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.4, stiffness=1e3, damping=1.0),
    )
    scene.add_contact(hull, scene.surfaces[0], stuck, name="stand", swept=True)
    scene.add_contact(scene.points[0], skin, stuck, radius=0.05, name="bump", entry="latched")
    tip = scene.add_points(ball, np.eye(3), name="tips")
    scene.add_contact(tip, skin, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)), name="tips_on_skin")
    return scene


def body_set_scene():
    """A body set with one contact per body, and other bodies."""
    scene = ball_scene()
    at = np.random.default_rng(1).uniform(-1, 1, (40, 3)) + 3.0
    grains = scene.add_bodies(
        at, mass=1.0, inertia=(1e-2,) * 3, motion=wc.motions.Slider(axis=(0, 0, 1)), name="grains"
    )
    scene.add_contact(scene.add_point(grains, (0, 0, 0)), *scene.surfaces, scene.contacts[0].material, radius=0.05)
    return scene


def free_scene():
    scene = wc.Scene()
    scene.add_body(1.0, (1, 1, 1), name="ball")
    return scene


def coupled_scene():
    """Couplings of every kind, and bodies with joints and with prescribed motion."""
    scene = ball_scene()
    ball = scene.bodies[0]
    swing = wc.motions.Table(times=(0.0, 1.0, 2.0), displacements=((0, 0, 0), (0, 0, 1), (0, 0, 0)))
    shake = wc.motions.Harmonic(direction=(0, 0, 1), amplitude=0.1, frequency=1.0)
    others = [
        scene.add_body(1.0, (1, 1, 1), position=(i, 2, 2), motion=motion, name=f"body_{i}")
        for i, motion in enumerate((swing, shake, wc.motions.Slider(axis=(0, 0, 1))))
    ]
    at, swung, shaken, slid = (scene.add_point(body, (0, 0, 0)) for body in (ball, *others))
    table = wc.springs.StiffnessTable(table=((0.0, 10.0), (1.0, 20.0), (3.0, 5.0)))
    scene.add_spring_damper(at, swung, spring=table, damping=1.0, rest_length=1.0)
    scene.add_spring_damper(at, slid, stiffness=10.0, name="spring")
    scene.add_bushing(at, shaken, stiffness=(1, 1, 1))
    for floor in (None, 0.0):
        scene.add_catenary(at, shaken, length=5.0, mass_per_length=1.0, axial_stiffness=1e5, floor=floor)
    skin = scene.add_surface(wc.meshes.icosphere(0.1), ball, name="skin")
    scene.add_contact_coupling(skin, scene.surfaces[0], wc.ContactRange(k1=1e5, effective_range=0.02), name="keep")
    return scene


def particle_scene():
    """Particle contact of spheres and capsules with neighbor lists, and one with lists of all pairs."""
    scene = ball_scene()
    places = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3)
    grains = scene.add_bodies(places, 1.0, (1, 1, 1), name="grains")
    stuck = wc.ContactMaterial(
        law=wc.laws.Hooke(stiffness=1e5),
        friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.4, stiffness=1e3, damping=1.0),
    )
    sphere = scene.add_shape(grains, wc.shapes.Sphere(0.5))
    rod = scene.add_shape(scene.bodies[0], wc.shapes.Capsule(0.1, 0.2))
    scene.add_particle_contact([sphere, rod], stuck, name="pile")
    others = scene.add_bodies(places[:9] + 10.0, 1.0, (1, 1, 1), name="others")
    scene.add_particle_contact(scene.add_shape(others, wc.shapes.Sphere(0.5)), stuck, name="few")
    return scene


def shape_contact_scene():
    """Shape contacts of two groups: with history and curvatures, of a body set, and with the world."""
    scene = ball_scene()
    grains = scene.add_bodies(np.eye(3) + 3.0, 1.0, (1, 1, 1), name="grains")
    egg = scene.add_shape(scene.bodies[0], wc.shapes.Ellipsoid((0.3, 0.2, 0.1)), name="egg")
    discs = scene.add_shape(grains, wc.shapes.Cylinder(0.2, 0.1), name="discs")
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    stuck = wc.ContactMaterial(
        law=wc.laws.HertzElastic(modulus=1e8),
        friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.4, stiffness=1e3, damping=1.0),
        rolling=wc.friction.Tanh(mu=0.01),
    )
    scene.add_shape_contact(discs, egg, stuck, name="lie")
    scene.add_shape_contact(egg, floor, stuck, name="stand")
    scene.add_shape_contact(discs, floor, scene.contacts[0].material, name="rest")
    return scene


SCENES = {
    "ball": ball_scene,
    "mixed": mixed_scene,
    "body set": body_set_scene,
    "no contacts": free_scene,
    "couplings": coupled_scene,
    "particles": particle_scene,
    "shape contacts": shape_contact_scene,
}


def array_bytes(memory, model):
    """Returns the part of a memory estimate that Warp arrays need [bytes]."""
    fields = {
        id(parameter.field): parameter.field.values.nbytes
        for part in model.parts
        for parameter in part.parameters.values()
    }
    # Bounding boxes and trees of the query meshes are not arrays.
    faces = [(len(mesh.indices) // 3, part.device) for part in model.parts for mesh in part._meshes]
    trees = sum(_mesh_bytes(count, where) - 48 * count for count, where in faces)
    return memory.device_bytes + memory.host_bytes - memory.bytes_for("launches") - sum(fields.values()) - trees


def set_available_memory(monkeypatch, size):
    """Sets the available memory of the machine to ``size`` bytes, in all modules."""
    monkeypatch.setattr(resources, "_host", lambda: size)
    monkeypatch.setattr(resources, "_device", lambda name: size)
