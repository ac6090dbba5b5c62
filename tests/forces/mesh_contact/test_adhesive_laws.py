"""Adhesive laws: friction with N plus the pull-off force, and rejection by nonsmooth integrators."""

from typing import Any

import custom_law
import numpy as np
import pytest
import warp as wp
from nonsmooth_scenes import HARD
from scenes import dropped_sphere

import warpcontact as wc

F = wc.friction


class JumpAtContact(wc.Law):
    """N = k δ − F_a, with a pull-off force of 2 F_a that the class declares."""

    pulls = True

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)
    adhesion: float = wc.parameter("N", "adhesive force F_a", at_least=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta - p.adhesion

    @wp.func
    def pull_off(p: Any, c: Any):
        return p.adhesion + p.adhesion


class Drag(wc.Friction):
    """F = −N v, without parameters."""

    @wp.func
    def force(p: Any, s: Any):
        return (-s.normal_force) * s.velocity


def sphere_in_overlap(law, friction, depth, device, **options):
    """A sphere that slides at 3 m/s along x, at given penetrations [m]."""
    model = dropped_sphere(
        law, friction=friction, velocity=(3, 0, 0), envs=len(depth), device=device, precision="float64", **options
    )  # fmt: skip
    model["ball.position"] = [(0.0, 0.0, 0.1 - one) for one in depth]
    return model


def test_friction_of_an_adhesive_law_acts_on_normal_force_plus_pull_off_force(device):
    # N = k (δ − d₀), F_p = k d₀ = 20 N: the load is k δ.
    law, depth = custom_law.Adhesive(stiffness=1e4, depth=2e-3), np.array([1e-4, 1e-3, 2e-3, 3e-3])
    model = sphere_in_overlap(law, F.Tanh(mu=0.5, velocity_scale=1e-3), depth, device)
    np.testing.assert_allclose(model.sensor("touch.normal_force"), 1e4 * (depth - 2e-3), atol=1e-9)
    np.testing.assert_allclose(model.sensor("touch.friction_force")[:, 0], -0.5 * 1e4 * depth, rtol=1e-5)


def test_friction_with_history_holds_a_body_hanging_by_adhesion(device):
    """A ball hangs below a ceiling; friction holds a lateral force of up to μ (F_p − m g)."""
    scene = wc.Scene(gravity=(0.0, 0.0, -10.0))
    ceiling = scene.add_surface(wc.meshes.grid((1, 1)), flip=True)
    # F_p = 4 k d₀ = 20 N; equilibrium at 4 k (d₀ − δ) = 10 N.
    box = scene.add_body(1.0, (0.01,) * 3, position=(0, 0, -0.05 + 2.5e-4), name="box")
    friction = F.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1e4, damping=100.0)
    material = wc.ContactMaterial(law=custom_law.Adhesive(stiffness=1e4, depth=5e-4), friction=friction)
    points = scene.add_points(box, [(x, y, 0.05) for x in (-0.04, 0.04) for y in (-0.04, 0.04)])
    scene.add_contact(points, ceiling, material, name="hold")
    model = scene.build(envs=2, device=device, precision="float64")
    # Friction acts 50 mm above the center of mass, so its torque must be that of the forces at the points.
    limit = 0.5 * (20.0 - 10.0)
    model["box.external_force"] = [(0.9 * limit, 0, 0), (1.1 * limit, 0, 0)]
    model["box.external_torque"] = [(0, 0.05 * 0.9 * limit, 0), (0, 0.05 * 1.1 * limit, 0)]
    with np.errstate(all="ignore"):
        wc.Simulation(model, dt=1e-4).step(2000)
    held, slid = model.sensor("box.position")[:, 0]
    np.testing.assert_allclose(held, 0.9 * limit / 4e4, rtol=0.2)
    # 0.1 μ (F_p − m g) over 0.2 s.
    assert slid > 0.5 * 0.5 * 0.1 * limit * 0.2**2


def test_stated_pull_off_force_equals_the_force(device):
    depth = np.array([0.0005, 0.002])
    model = sphere_in_overlap(
        JumpAtContact(stiffness=1e4, adhesion=10.0), F.Tanh(mu=0.5, velocity_scale=1e-3), depth, device
    )
    load = 1e4 * depth - 10.0 + 20.0
    np.testing.assert_allclose(model.sensor("touch.friction_force")[:, 0], -0.5 * load, rtol=1e-12)


def test_pull_off_of_a_law_without_adhesion_is_refused():
    with pytest.raises(TypeError, match=r"Tight\.pull_off is for a law that pulls; set pulls = True"):

        class Tight(wc.Law):
            """N = k δ."""

            stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

            @wp.func
            def force(p: Any, c: Any):
                return p.stiffness * c.delta

            @wp.func
            def pull_off(p: Any, c: Any):
                return p.stiffness


def test_pull_off_with_other_arguments_is_refused():
    with pytest.raises(TypeError, match=r"Short.pull_off must take 2 arguments, \(coefficients, state\)"):

        class Short(custom_law.Adhesive):
            """Lacks a parameter in the signature."""

            @wp.func
            def pull_off(p: Any):
                return p.stiffness * p.depth


def test_integrators_of_nonsmooth_contact_refuse_an_adhesive_law(device):
    model = dropped_sphere(custom_law.Adhesive(stiffness=1e4, depth=2e-3), device=device, precision="float64")
    sentence = r"touch\.law must be a law that does not pull, got Adhesive with pulls = True: rigid contact has no"
    with pytest.raises(ValueError, match=sentence + r" tension\. Or use SemiImplicitEuler, or compliant="):
        wc.Simulation(model, 1e-3, HARD)
    wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(compliant=["touch"]))
    for method in (wc.unilateral.EventDriven, wc.unilateral.equilibrium, wc.unilateral.assemble):
        with pytest.raises(ValueError, match=sentence):
            method(model)


def test_event_driven_refuses_friction_without_coefficient(device):
    model = dropped_sphere(wc.laws.Rigid(restitution=0.0), friction=Drag(), device=device, precision="float64")
    with pytest.raises(ValueError, match=r"touch.friction is Drag, which has no coefficient of friction"):
        wc.unilateral.EventDriven(model)


def test_force_scale_does_not_scale_an_impulse_and_is_refused_at_zero(device):
    sentence = r"touch\.force_scale must be greater than 0, got 0: rigid contact has no force to scale"
    model = dropped_sphere(wc.laws.Rigid(restitution=0.0), force_scale=0.0, device=device, precision="float64")
    with pytest.raises(ValueError, match=sentence):
        wc.Simulation(model, 1e-3, HARD)
    model["touch.force_scale"] = 0.5
    wc.Simulation(model, 1e-3, HARD).step()
    np.testing.assert_allclose(model.sensor("touch.impulse")[0], (0, 0, 1), atol=1e-12)
    with pytest.raises(ValueError, match=sentence):
        model["touch.force_scale"] = 0.0
    np.testing.assert_array_equal(model["touch.force_scale"], 0.5)


def test_force_scale_of_zero_is_refused_in_every_step_and_leaves_the_model_unchanged(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), device=device, precision="float64")
    rigid, compliant = wc.Simulation(model, 1e-3, HARD), wc.Simulation(model, 1e-3)
    compliant.step()
    model["touch.force_scale"] = 0.0
    names, device_fields = (
        list(model.sensor_names),
        list(model.find_parameter("touch.law.stiffness").device_fields),
    )
    for _ in range(2):
        with pytest.raises(ValueError, match=r"touch\.force_scale must be greater than 0, got 0"):
            rigid.step()
        assert model.nonsmooth is None
        assert list(model.sensor_names) == names
    assert model.find_parameter("touch.law.stiffness").device_fields == device_fields
    compliant.step()
    model["touch.force_scale"] = 1.0
    rigid.step()
    assert model.nonsmooth is not None
