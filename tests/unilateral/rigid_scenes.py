"""Small scenes of rigid bodies in contact, shared by several tests."""

import numpy as np

import warpcontact as wc

G = 9.81


def rigid(mu=0.0, restitution=0.0):
    """A material of nonsmooth contact, always with friction, so that all scenes share kernels."""
    return wc.ContactMaterial(law=wc.laws.Rigid(restitution=restitution), friction=wc.friction.Coulomb(mu=mu))


def box_inertia(mass, size):
    x, y, z = np.square(size)
    return mass / 12.0 * np.array([y + z, z + x, x + y])


def turned_about_y(angle):
    return np.array([0.0, np.sin(0.5 * angle), 0.0, np.cos(0.5 * angle)])


def block(push=0.0, height=1.0, mu=0.5, slope=0.0, velocity=0.0, restitution=0.0, lift=0.0):
    """A block of 10 kg, 1 m wide and 2 m high, on four vertices, pushed along x at a height; slope along x."""
    size = np.array([1.0, 1.0, 2.0])
    q = turned_about_y(slope)
    along, out = np.array([np.cos(slope), 0.0, -np.sin(slope)]), np.array([np.sin(slope), 0.0, np.cos(slope)])
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(wc.meshes.grid((40.0, 40.0), (1, 1)), orientation=q, name="ground")
    box = scene.add_body(
        mass=10.0,
        inertia=box_inertia(10.0, size),
        position=(1.0 + lift) * out,
        orientation=q,
        linear_velocity=velocity * along,
        external_force=push * along,
        external_torque=(0.0, push * (height - 1.0), 0.0),
        name="box",
    )
    feet = [(x, y, -1.0) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    scene.add_contact(scene.add_points(box, feet, name="corners"), ground, rigid(mu, restitution), name="feet")
    return scene.build(device="cpu", precision="float64")


def ball(height=1.0, restitution=0.8, mu=0.0, velocity=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0), radius=0.1):
    """A solid ball above the ground."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(wc.meshes.grid((40.0, 40.0), (1, 1)), name="ground")
    body = scene.add_body(
        mass=2.0,
        inertia=[0.4 * 2.0 * radius**2] * 3,
        position=(0.0, 0.0, height + radius),
        linear_velocity=velocity,
        angular_velocity=spin,
        name="ball",
    )
    centre = scene.add_point(body, (0, 0, 0), name="centre")
    scene.add_contact(centre, ground, rigid(mu, restitution), radius=radius, name="touch")
    return scene.build(device="cpu", precision="float64")


def ladder(mu, angle, length=4.0):
    """A ladder at an angle to the ground, with friction there, against a frictionless wall."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    mesh = wc.meshes.grid((20.0, 20.0), (1, 1))
    ground = scene.add_surface(mesh, name="ground")
    foot = -length * np.cos(angle)
    wall = scene.add_surface(mesh, orientation=turned_about_y(-0.5 * np.pi), name="wall")
    rung = scene.add_body(
        mass=12.0,
        inertia=box_inertia(12.0, (length, 0.1, 0.1)),
        position=(0.5 * foot, 0.0, 0.5 * length * np.sin(angle)),
        orientation=turned_about_y(-angle),
        name="ladder",
    )
    half = 0.5 * length
    scene.add_contact(scene.add_point(rung, (-half, 0, 0)), ground, rigid(mu), name="foot")
    scene.add_contact(scene.add_point(rung, (half, 0, 0)), wall, rigid(0.0), name="top")
    return scene.build(device="cpu", precision="float64")


def three_balls(mu_between, mu_ground, spacing=2.1):
    """A ball of radius 1 on two others that are apart; returns also the sine of the slope of the line of centers."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(wc.meshes.grid((40.0, 40.0), (1, 1)), name="ground")
    top = 1.0 + np.sqrt(4.0 - 0.25 * spacing**2)
    places = {"left": (-0.5 * spacing, 0, 1), "right": (0.5 * spacing, 0, 1), "top": (0, 0, top)}
    shapes = []
    for name, place in places.items():
        body = scene.add_body(mass=3.0, inertia=[1.2] * 3, position=place, name=name)
        shapes.append(scene.add_shape(body, wc.shapes.Sphere(1.0), name=f"{name}_ball"))
        centre = scene.add_point(body, (0, 0, 0), name=f"{name}_centre")
        scene.add_contact(centre, ground, rigid(mu_ground), radius=1.0, name=f"{name}_floor")
    scene.add_particle_contact(shapes, rigid(mu_between), name="balls")
    return scene.build(device="cpu", precision="float64"), 0.25 * spacing
