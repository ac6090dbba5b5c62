"""Custom laws, defined outside of the package, work like those of the library."""

from typing import Any

import custom_law
import numpy as np
import pytest
import warp as wp
from scenes import dropped_sphere

import warpcontact as wc
from warpcontact.validation.custom_law_errors import _functions

pytestmark = pytest.mark.installed


@pytest.mark.smoke
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_custom_law_bounces_elastically(precision, device):
    model = dropped_sphere(
        custom_law.Cubic(stiffness=1e8), gravity=(0, 0, -9.81), height=0.3, velocity=(0, 0, 0), envs=4,
        device=device, precision=precision,
    )  # fmt: skip
    model["touch.law.stiffness"] = np.geomspace(1e7, 1e9, 4)
    recording = wc.Simulation(model, dt=1e-4).run(0.6, ["ball.position"], every=1e-3)
    height = recording["ball.position"].sel(axis="z") - 0.1
    second = height.where(height.time > 0.3).max("time")
    # Except for the time in contact, no energy is lost: first-order scheme with at least 100 steps per contact.
    np.testing.assert_allclose(second, 0.3, rtol=2e-3)


def test_custom_friction_slows_a_sphere(device):
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e4), friction=custom_law.Viscous(damping=2.0), height=-1e-3, velocity=(3, 0, 0),
        device=device,
    )  # fmt: skip
    np.testing.assert_allclose(model.sensor("touch.friction_force")[0], (-6, 0, 0), rtol=1e-5)


def test_custom_law_with_declared_adhesion_can_pull(device):
    model = dropped_sphere(custom_law.Adhesive(stiffness=1e4, depth=2e-3), height=-1e-3, device=device)
    np.testing.assert_allclose(model.sensor("touch.normal_force"), -10.0, rtol=1e-4)
    np.testing.assert_allclose(model.sensor("ball.force")[0], (0, 0, -10), rtol=1e-4, atol=1e-6)


def test_law_parameter_without_unit_is_refused():
    with pytest.raises(TypeError, match=r"Bare\.k must be declared with wc\.parameter"):

        class Bare(wc.Law):
            """A default that is a plain number."""

            k: float = 3.0


@pytest.mark.parametrize(
    ("base", "shape", "message"),
    [
        (wc.Law, (3,), r"a parameter of a law must have shape \(\), got \(3,\)"),
        (wc.Friction, (3,), r"a parameter of a friction must have shape \(\), got \(3,\)"),
        (wc.Spring, (-1, 2), r"a parameter of a spring must have shape \(\), got \(-1, 2\)"),
        (wc.Motion, (2,), r"a parameter of a motion must have shape \(\) or \(3,\), got \(2,\)"),
    ],
    ids=["law", "friction", "spring", "motion"],
)
def test_law_parameter_of_unsupported_type_is_refused(base, shape, message):
    with pytest.raises(TypeError, match=rf"Wide\.sizes: {message}"):

        class Wide(base):
            """A parameter with several components."""

            sizes: tuple[float, ...] = wc.parameter("m", "sizes", shape=shape)


def test_law_class_without_force_is_refused():
    class Empty(wc.Law):
        """Has no force."""

    with pytest.raises(TypeError, match=r"Empty.force must be a wp.func of \(coefficients, state\)"):
        Empty()


def test_law_with_compile_error_is_explained(device):
    law = custom_law.Careless(stiffness=1e4)
    model = dropped_sphere(law, height=-1e-3, device=device)
    np.testing.assert_allclose(model.sensor("touch.normal_force"), 20.0, rtol=1e-4)
    with pytest.raises(TypeError, match=r"(?s)law Careless does not compile in float64: .*type\(c.delta\)\(1.5\)"):
        dropped_sphere(law, device=device, precision="float64")


def test_undefined_function_in_a_law_does_not_hide_the_error():
    @wp.func
    def early(p: Any, c: Any):
        return later(p) * c.delta

    found = list(_functions([type("Early", (wc.Law,), {"force": early})]))
    later = early
    assert found[0] is later
