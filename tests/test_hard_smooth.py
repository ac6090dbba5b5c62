"""Hard contact of smooth shapes: that of the same sphere on a flat mesh, and closed forms."""

import numpy as np
import pytest
from hard_scenes import ENERGY, HARD, LOSSES, G, energy, rigid
from scenes import square

import warpcontact as wc

RADIUS = 0.1
INERTIA = (0.4 * RADIUS**2,) * 3


def sphere(smooth, template, *, position=(0.0, 0.0, 0.15), velocity=(1.5, 0.3, -2.0), spin=(3.0, -2.0, 9.0), **built):
    """A solid ball of 1 kg over a plane at z = 0, a shape or a mesh."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    options = {"linear_velocity": velocity, "angular_velocity": spin}
    body = scene.add_body(1.0, INERTIA, position=position, name="ball", **options)
    if smooth:
        plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
        own = scene.add_shape(body, wc.shapes.Sphere(RADIUS), name="sphere")
        scene.add_smooth_contact(own, plane, template, torsion_radius=0.02, name="touch")
    else:
        ground = scene.add_surface(square(50.0), name="ground")
        centre = scene.add_point(body, (0.0, 0.0, 0.0))
        scene.add_contact(centre, ground, template, radius=RADIUS, torsion_radius=0.02, name="touch")
    return scene.build(**{"precision": "float64", **built})


SHOWN = ["ball.position", "ball.angular_velocity", "touch.impulse", "touch.mode", "touch.torque", "touch.slip_speed"]


def test_a_sphere_on_a_plane_is_that_on_a_flat_mesh(device):
    template = rigid(0.6, 0.3, rolling=wc.frictions.Coulomb(mu=0.05), torsion=wc.frictions.Coulomb(mu=0.2))
    names = [*SHOWN, "touch.normal_force", "touch.friction_force", "touch.gap", "touch.approach_speed", *LOSSES]
    runs = [
        wc.Simulation(sphere(smooth, template, device=device), 1e-3, HARD).run(2.0, names) for smooth in (True, False)
    ]
    # Two ways to the same place of contact, to rounding; it grows with every bounce.
    for name in names:
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=1e-9, atol=1e-9, err_msg=name)
    assert (runs[0]["touch.impulse"].values[..., 2] > 0).any()
    assert np.ptp(runs[0]["touch.mode"].values) == 2
