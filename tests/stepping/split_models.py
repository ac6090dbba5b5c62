"""A model with a different initial state in each environment, on one device and split over several."""

import numpy as np

import warpcontact as wc

ENVS = 7
STICKY = wc.ContactMaterial(
    law=wc.laws.HuntCrossley(stiffness=2e4, restitution=0.5),
    friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.4, stiffness=1e3, damping=1.0),
)
SMOOTH = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=2e3, damping=4.0), friction=wc.friction.Tanh(mu=0.5))


def scene():
    """A box of points with friction history, and a small fast sphere, on a terrain."""
    made = wc.Scene()
    ground = made.add_surface(wc.meshes.sinusoidal_terrain((4, 4), (20, 20), amplitude=0.1), name="ground")
    box = made.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.35), name="box")
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    made.add_contact(made.add_points(box, 0.1 * corners, name="corners"), ground, STICKY, radius=0.01, name="hull")
    ball = made.add_body(0.2, (1e-3, 1e-3, 1e-3), position=(0.5, 0, 0.6), linear_velocity=(0, 0, -40), name="ball")
    made.add_contact(
        made.add_point(ball, (0, 0, 0), name="centre"), ground, SMOOTH, radius=0.02, swept=True, name="touch"
    )
    return made


def varied(model):
    """Gives each environment its own initial state and parameters."""
    spread = np.linspace(0.0, 1.0, model.envs)
    still = 0.0 * spread
    model["box.mass"] = 0.5 + spread
    model["hull.law.restitution"] = 0.2 + 0.6 * spread
    model["touch.radius"] = 0.02 + 0.03 * spread
    model["touch.friction.mu"] = 0.7
    model["box.position"] = np.stack([spread - 0.5, 0.3 - spread, 0.22 + 0.1 * spread], axis=1)
    model["box.linear_velocity"] = (0.5, 0, -2)
    model["ball.linear_velocity"] = np.stack([spread, still, -40.0 * spread], axis=1)
    return model


def both(device, devices, envs=ENVS, precision="float32"):
    """Returns the model on one device, and split over ``devices``."""
    return tuple(varied(scene().build(envs, where, precision)) for where in (device, devices))


def assert_same_recordings(one, other):
    assert list(one.variables) == list(other.variables)
    for name in one.variables:
        assert one[name].dims == other[name].dims
        assert one[name].attrs == other[name].attrs
        np.testing.assert_array_equal(one[name].values, other[name].values, err_msg=name)
    assert {**one.attrs, "device": ""} == {**other.attrs, "device": ""}


def assert_same_state(one, other):
    for name in one.sensor_names:
        np.testing.assert_array_equal(one.sensor(name), other.sensor(name), err_msg=name)
