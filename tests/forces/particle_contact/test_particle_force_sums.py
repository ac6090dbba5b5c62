"""Contact forces of particles have the same sum for each way of summation."""

import numpy as np
import pytest
from gpu_schedule_on_cpu import sum_by_body
from test_particle_contact import ELASTIC, INERTIA, MASS, cloud

import warpcontact as wc
from warpcontact.forces.particle_contact.contact_set import ParticleContactSet

FRICTION = wc.friction.Tanh(mu=0.4, velocity_scale=0.1)


@pytest.mark.parametrize("several", [pytest.param(False, marks=pytest.mark.slow), True])
def test_particle_forces_summed_by_body_match_sequential_sums(several):
    """A GPU, where threads share an environment, sums per body in a kernel; a CPU thread adds each force."""
    positions, turns, forms, _, _ = cloud(capsules=True)
    scene = wc.Scene(gravity=(0, 0, 0))
    velocities = np.random.default_rng(2).normal(size=positions.shape)
    balls = scene.add_bodies(positions, MASS, INERTIA, turns, velocities, name="ball")
    shapes = [scene.add_shape(balls, forms)]
    if several:
        shapes.append(scene.add_shape(balls, wc.shapes.Sphere(0.05), position=(0.1, 0.02, 0.0)))
    material = wc.ContactMaterial(law=ELASTIC.law, friction=FRICTION)
    scene.add_particle_contact(shapes, material, name="pile", max_neighbors=200)
    forces = []
    for alone in (True, False):
        model = scene.build(2, "cpu", "float64")
        if not alone:
            sum_by_body(model.of_family("particle contact")[0])
        forces.append([model.sensor(f"ball.{name}") for name in ("force", "torque")])
    assert not np.array_equal(forces[0][1], forces[1][1])  # rounding differs: the other summation was used
    for sequential, summed in zip(*forces, strict=True):
        assert (np.linalg.norm(sequential, axis=-1) > 0).mean() > 0.9
        # The same terms in another order.
        np.testing.assert_allclose(summed, sequential, rtol=0, atol=1e-13 * np.abs(sequential).max())


def particle_scene():
    """Returns spheres of several sizes on a floor, all in particle contact, and a separate body."""
    rng = np.random.default_rng(3)
    scene = wc.Scene()
    floor = scene.add_surface(wc.meshes.box((1.0, 1.0, 0.2)), position=(0, 0, -0.1))
    scene.add_body(MASS, INERTIA, position=(0, 0, 9.0), name="lone")
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in (4, 5, 2)]), -1).reshape(-1, 3)
    places = 0.15 * cells - [0.2, 0.25, -0.06]
    balls = scene.add_bodies(places, MASS, INERTIA, name="ball")
    material = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e3, damping=20.0), friction=FRICTION)
    scene.add_contact(scene.add_point(balls, (0, 0, 0)), floor, material, radius=0.05)
    forms = [wc.shapes.Sphere(float(radius)) for radius in rng.uniform(0.05, 0.1, 40)]
    scene.add_particle_contact(scene.add_shape(balls, forms), material, name="pile", max_neighbors=39)
    return scene


@pytest.mark.parametrize("watched", [False, True])
def test_particle_sums_in_integrator_are_bitwise_identical_to_wrench_sums(monkeypatch, watched):
    """Bitwise equal to a separate launch that adds forces to wrenches, with and without monitors."""
    ends = []
    for by_body in (True, False):
        model = particle_scene().build(3, "cpu", "float64")
        sum_by_body(model.of_family("particle contact")[0])
        assert model.of_family("particle contact")[0].sums_by_body
        if not by_body:
            monkeypatch.setattr(ParticleContactSet, "sums_by_body", False)
        outcomes = {"load": wc.outcomes.Max("ball.force")} if watched else {}
        simulation = wc.Simulation(model, dt=5e-4, outcomes=outcomes)
        simulation.step(100)
        assert model.sensor("pile.contacts").min() > 20
        names = ("ball.position", "ball.angular_velocity", "lone.position")
        ends.append([model.sensor(name) for name in names])
        ends[-1] += [variable.values for variable in simulation.outcomes().values()] if watched else []
    for one, other in zip(*ends, strict=True):
        np.testing.assert_array_equal(one, other)
