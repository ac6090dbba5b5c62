"""A partial reset leaves the history and poses of couplings and joints in other environments unchanged."""

import numpy as np
import pytest
from contact_coupling_scenes import sole

import warpcontact as wc

SENSORS = ("rope.status", "line.iterations", "keep.effective_area", "keep.minimum_distance")


@pytest.fixture
def sim(device):
    """A broken rope, a solved cable, a surface within coupling range, a shaker and a slider."""
    scene = wc.Scene(gravity=(0, 0, -9.81))
    plate = scene.add_surface(wc.meshes.grid((1.0, 1.0)), name="plate")
    block = scene.add_body(50.0, (1.0,) * 3, (0, 0, 0.02), linear_velocity=(0, 0, -1.5), name="block")
    face = scene.add_surface(sole(), block, name="face")
    scene.add_contact_coupling(face, plate, wc.ContactRange(k1=2.5e7, effective_range=0.02), name="keep")
    harmonic = wc.motions.Harmonic(direction=(0, -1, 0), amplitude=1e-3, frequency=5.0)
    shaker = scene.add_body(1.0, (1.0,) * 3, (2, 0, 0), motion=harmonic, name="shaker")
    slider = scene.add_body(1.0, (1.0,) * 3, (2, 2, 0), motion=wc.motions.Slider(axis=(1, 0, 0)), name="slider")
    ends = [scene.add_point(body, (0, 0, 0)) for body in (shaker, slider)]
    scene.add_spring_damper(
        *ends, stiffness=10.0, rest_length=2.0, break_force=1e-3, tension_only=True, name="rope"
    )
    scene.add_catenary(*ends, length=5.0, mass_per_length=0.1, axial_stiffness=1e4, name="line")
    model = scene.build(2, device)
    return wc.Simulation(model, dt=1e-3)


def values(model):
    return {name: model.sensor(name) for name in SENSORS}


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
def test_reset_clears_coupling_state_of_masked_environments_only(sim):
    model = sim.model
    begin = values(model)
    sim.step(20)
    # Velocities that are inconsistent with the shaker and the slider.
    for array in (sim.state.body_linear_velocity, sim.state.body_angular_velocity):
        array.fill_(0.25)
    model["rope.break_force"] = 1e6  # now only the history marks it as broken
    before = values(model)
    for name, value in before.items():
        assert (value != begin[name]).all(), name
    assert (before["rope.status"] == wc.CouplingStatus.BROKEN).all()
    state = {name: array.numpy().copy() for name, array in vars(sim.state).items()}
    sim.reset([True, False])
    for name, value in values(model).items():
        np.testing.assert_array_equal(value, [begin[name][0], before[name][1]], err_msg=name)
    for name, array in vars(sim.state).items():
        np.testing.assert_array_equal(array.numpy()[1], state[name][1], err_msg=name)
    velocity = sim.state.body_linear_velocity.numpy()[0]
    # Velocities of the prescribed motion and of the joint: the derivative 2π f a, and zero.
    np.testing.assert_allclose(
        velocity, [(0, 0, -1.5), (0, -2 * np.pi * 5e-3, 0), (0, 0, 0)], rtol=1e-6, atol=1e-9
    )
