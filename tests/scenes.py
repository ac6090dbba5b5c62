"""Small scenes that are shared by several tests."""

import numpy as np

import warpcontact as wc


def oracle_law():
    """Law and friction of the hand values of SPEC 1.6: k = 1e5 N/m, c = 100 N·s/m, μ = 0.3."""
    return wc.ContactMaterial(
        law=wc.laws.KelvinVoigt(stiffness=1.0e5, damping=100.0),
        friction=wc.friction.Tanh(mu=0.3, velocity_scale=1.0e-3),
    )


def square(half=1.0, z=0.0):
    """A flat square of two triangles, outer side up."""
    h = half
    return wc.Mesh([[-h, -h, z], [h, -h, z], [h, h, z], [-h, h, z]], [[0, 1, 2], [0, 2, 3]], name="square")


def probe(mesh, positions, *, device="cpu", precision="float32", **options):
    """Returns the sensors of one contact at each of ``positions``, one environment per position.

    ``options`` are passed to ``add_contact``, except those of the surface.
    """
    of_surface = ("active_faces", "flip", "position", "orientation", "scale")
    surface_options = {key: options.pop(key) for key in of_surface if key in options}
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    surface = scene.add_surface(mesh, name="surface", **surface_options)
    body = scene.add_body(mass=1.0, inertia=(0.1, 0.1, 0.1), name="body")
    material = options.pop("material", None) or wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0e4))
    scene.add_contact(scene.add_point(body, (0, 0, 0)), surface, material, name="touch", **options)
    positions = np.atleast_2d(positions)
    model = scene.build(envs=len(positions), device=device, precision=precision)
    model["body.position"] = positions
    names = ("gap", "penetration", "normal", "point", "status", "normal_force")
    return {name: model.sensor(f"touch.{name}") for name in names}


def dropped_sphere(
    law,
    *,
    friction=None,
    mass=1.0,
    radius=0.1,
    gravity=(0.0, 0.0, 0.0),
    height=0.0,
    velocity=(0.0, 0.0, -1.0),
    size=10.0,
    envs=1,
    device="cpu",
    precision="float32",
    **contact,
):
    """Returns the model of a solid sphere whose lowest point starts ``height`` above a flat square."""
    scene = wc.Scene(gravity=gravity)
    ground = scene.add_surface(square(size), name="ground")
    ball = scene.add_body(
        mass=mass,
        inertia=[0.4 * mass * radius**2] * 3,
        position=(0.0, 0.0, radius + height),
        linear_velocity=velocity,
        name="ball",
    )
    centre = scene.add_point(ball, (0, 0, 0), name="centre")
    scene.add_contact(
        centre, ground, wc.ContactMaterial(law=law, friction=friction), radius=radius, name="touch", **contact
    )
    return scene.build(envs=envs, device=device, precision=precision)
