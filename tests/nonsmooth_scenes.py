"""Scenes of nonsmooth contact that are shared by several tests."""

import numpy as np
from scenes import square

import warpcontact as wc

G = 9.81
HARD = wc.integrators.MoreauJean()


def rigid(restitution=0.0, mu=None, **parts):
    """A material of nonsmooth contact; frictionless without ``mu``."""
    friction = None if mu is None else wc.friction.Coulomb(mu=mu)
    return wc.ContactMaterial(law=wc.laws.Rigid(restitution=restitution), friction=friction, **parts)


def add_box(scene, edges, surface, material, *, name="box", density=1000.0, feet=None, **options):
    """Adds a box and the contact ``<name>_feet`` of its vertices, or of points ``feet``, with ``surface``."""
    edges = np.asarray(edges, dtype=float)
    mass = options.pop("mass", density * edges.prod())
    inertia = mass / 12.0 * (np.square(edges).sum() - np.square(edges))
    body = scene.add_body(mass, inertia, name=name, **options)
    if feet is None:
        feet = 0.5 * edges * np.array(np.meshgrid(*[(-1, 1)] * 3)).T.reshape(-1, 3)
    points = scene.add_points(body, feet, name=f"{name}_points")
    scene.add_contact(points, surface, material, name=f"{name}_feet")
    return body


def block(mu, *, slope=0.0, velocity=(0.0, 0.0, 0.0), height=0.0, envs=1, external_force=(0, 0, 0), **options):
    """A block of 10 kg, 1 m wide and 2 m high, on a plane at z = 0 with gravity tilted by ``slope`` [rad]."""
    scene = wc.Scene(gravity=(G * np.sin(slope), 0.0, -G * np.cos(slope)))
    ground = scene.add_surface(square(50.0), name="ground")
    feet = [(x, y, -1.0) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    add_box(
        scene,
        (1.0, 1.0, 2.0),
        ground,
        rigid(mu=mu),
        name="block",
        mass=10.0,
        feet=feet,
        position=(0.0, 0.0, 1.0 + height),
        linear_velocity=velocity,
        external_force=external_force,
    )
    return scene.build(envs=envs, **{"precision": "float64", **options})


def ball(
    restitution=0.0,
    mu=None,
    *,
    radius=0.1,
    height=1.0,
    velocity=(0.0, 0.0, 0.0),
    spin=(0.0, 0.0, 0.0),
    envs=1,
    gravity=G,
    material=None,
    **options,
):
    """A solid ball of 1 kg whose lowest point starts ``height`` above a plane at z = 0.

    Forces act at its lowest point for any penetration, so lever arms are those of the closed forms.
    """
    scene = wc.Scene(gravity=(0.0, 0.0, -gravity))
    ground = scene.add_surface(square(50.0), name="ground")
    body = scene.add_body(
        1.0,
        (0.4 * max(radius, 0.1) ** 2,) * 3,
        position=(0.0, 0.0, radius + height),
        linear_velocity=velocity,
        angular_velocity=spin,
        name="ball",
    )
    centre = scene.add_point(body, (0.0, 0.0, 0.0))
    scene.add_contact(centre, ground, material or rigid(restitution, mu), radius=radius, kappa=1.0, name="touch")
    return scene.build(envs=envs, **{"precision": "float64", **options})


def energy(data):
    """Kinetic and potential energy of all bodies (time, env) [J]."""
    return (data["scene.kinetic_energy"] + data["scene.potential_energy"]).values


ENERGY = ["scene.kinetic_energy", "scene.potential_energy"]
LOSSES = ["scene.friction_dissipation", "scene.impact_dissipation"]
