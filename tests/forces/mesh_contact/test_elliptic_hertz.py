"""Hertz contact with the stiffness of the local curvatures: elliptic integrals on the device, and the law."""

import numpy as np
import pytest
import warp as wp
from scenes import dropped_sphere
from warpcontact.kernels.laws.hertz import elliptic_stiffness, hertz_stiffness, stiffness_per_modulus
from warpcontact.kernels.laws.hunt_crossley import damping_factor_of_restitution

import warpcontact as wc

STEEL = wc.laws.HertzElastic.from_materials(E=210e9, nu=0.3, E2=70e9, nu2=0.33)


def device_stiffness(curvature_1, curvature_2, real, device):
    """Returns K/E* for pairs of curvatures, as computed by the law."""

    @wp.kernel(module="unique", enable_backward=False)
    def each(first: wp.array(dtype=real), second: wp.array(dtype=real), out: wp.array(dtype=real)):
        i = wp.tid()
        out[i] = stiffness_per_modulus(first[i], second[i])

    first, second = (wp.array(values, dtype=real, device=device) for values in (curvature_1, curvature_2))
    out = wp.zeros(len(curvature_1), dtype=real, device=device)
    wp.launch(each, len(curvature_1), inputs=[first, second, out], device=device)
    return first.numpy().astype(float), second.numpy().astype(float), out.numpy()


# Error of 5 Newton steps and a few roundings of the mean. float32 rounds to 6e-8 and evaluates logarithms of 1e6.
@pytest.mark.parametrize(("real", "tolerance"), [(wp.float64, 1e-12), (wp.float32, 2e-6)])
def test_elliptic_hertz_stiffness_matches_closed_form(real, tolerance, device):
    quotient = np.concatenate([[1.0, 1.0 + 1e-12, 1.0 + 1e-7], np.geomspace(1.0 + 1e-6, 0.999e6, 150)])
    first, second, stiffness = device_stiffness(np.full(len(quotient), 3.0), 3.0 * quotient, real, device)
    # E* = 1 for a body with E = 1 and ν = 0 on a rigid one.
    exact = [elliptic_stiffness(1.0, 0.0, 1.0 / a, 1.0 / b) for a, b in zip(first, second, strict=True)]
    np.testing.assert_allclose(stiffness, exact, rtol=tolerance)


def test_elliptic_hertz_stiffness_has_correct_limits(device):
    inf = np.inf
    first = np.array([0.0, -2.0, 5e-6, 0.0, 1.0, -1.0, np.nan])
    second = np.array([5.0, 5.0, 5.0, 0.0, inf, -1.0, 1.0])
    _, _, stiffness = device_stiffness(first, second, wp.float64, device)
    # Ellipses longer than the limit count as the limit, ...
    np.testing.assert_allclose(stiffness[:3], elliptic_stiffness(1.0, 0.0, 2e5, 0.2), rtol=1e-9)
    # ... and non-finite curvatures give NaN, so that they are not mistaken for zero force.
    assert np.isnan(stiffness[3:]).all()


def test_elliptic_hertz_stiffness_matches_published_crossed_cylinders(device):
    """Equal cylinders crossed at right angles have the stiffness of a sphere of their radius on a plane."""
    _, _, stiffness = device_stiffness(np.array([20.0]), np.array([20.0]), wp.float64, device)
    np.testing.assert_allclose(
        STEEL.modulus * stiffness, hertz_stiffness(210e9, 0.3, 0.05, 70e9, 0.33), rtol=1e-14
    )


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-12), ("float32", 1e-6)])
def test_elliptic_hertz_sphere_on_mesh_uses_its_radius(precision, tolerance, device):
    depth = 2.0**-10  # exact in both precisions
    model = dropped_sphere(STEEL, radius=0.125, height=-depth, envs=2, precision=precision, device=device)
    # The radius of each environment applies; the center is the same.
    model["touch.radius"] = [0.125, 0.125 + depth]
    expected = [
        hertz_stiffness(210e9, 0.3, r, 70e9, 0.33) * d**1.5
        for r, d in ((0.125, depth), (0.125 + depth, 2 * depth))
    ]
    # The ball approaches at 1 m/s, which does not change an elastic force.
    np.testing.assert_allclose(model.sensor("touch.normal_force"), expected, rtol=tolerance)


def test_elliptic_hertz_damping_equals_hunt_crossley(device):
    law = wc.laws.HertzElastic(modulus=1e9, restitution=0.5, damping=0.1)
    model = dropped_sphere(law, radius=0.1, height=-1e-3, precision="float64", device=device)
    factor = 1.0 + damping_factor_of_restitution(0.5) + 0.1  # at δ̇ = v₀ = 1 m/s
    elastic = 4.0 / 3.0 * 1e9 * np.sqrt(0.1) * 1e-3**1.5
    np.testing.assert_allclose(model.sensor("touch.normal_force"), factor * elastic, rtol=1e-9)


def test_elliptic_hertz_law_is_refused_for_a_point():
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((1.0, 1.0)))
    ball = scene.add_body(1.0, (1.0, 1.0, 1.0), position=(0, 0, 1))
    centre = scene.add_point(ball, (0, 0, 0))
    with pytest.raises(
        ValueError, match="the law of its material, HertzElastic, needs a radius, got a radius of 0 m"
    ):
        scene.add_contact(centre, ground, wc.ContactMaterial(law=STEEL), name="touch")
    scene.add_contact(centre, ground, wc.ContactMaterial(law=STEEL), radius=0.1, name="touch")
    with pytest.raises(ValueError, match=r"touch\.radius must be greater than 0, got 0 m"):
        scene.build()["touch.radius"] = 0.0
