"""Static friction under a sudden load: the tangential spring overshoots, and damping limits the overshoot."""

import numpy as np
import pytest
from scenes import square

import warpcontact as wc

STICK = wc.friction.CundallStrack
G = 10.0
STIFFNESS = 1.0e4
# Damping ratio: overshoot exp(−2 φ cot φ), φ = arccos ζ.
OVERSHOOT = {0.0: 1.0, 0.5: np.exp(-2.0 * np.pi / 3.0 / np.sqrt(3.0)), 1.0: np.exp(-2.0)}


def slide_of_blocks(device, slope, mu_static, damping):
    """Returns the displacements [m] of blocks of 1 kg, 0.3 s after they are placed on a slope.

    Each block is in a separate environment. They start in normal equilibrium, with an unstretched tangential
    spring.
    """
    scene = wc.Scene(gravity=(G * np.sin(slope), 0.0, -G * np.cos(slope)))
    ground = scene.add_surface(square(50.0), name="ground")
    depth = G * np.cos(slope) / STIFFNESS
    block = scene.add_body(1.0, (1e6,) * 3, position=(0.0, 0.0, -depth), name="block")
    friction = STICK(mu_static=0.5, mu_dynamic=0.4, stiffness=STIFFNESS)
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=STIFFNESS), friction=friction)
    scene.add_contact(scene.add_point(block, (0.0, 0.0, 0.0)), ground, material, name="foot")
    model = scene.build(envs=len(mu_static), device=device, precision="float64")
    model["foot.friction.mu_static"], model["foot.friction.damping"] = mu_static, damping
    wc.Simulation(model, dt=1.0e-5).step(30_000)
    return model.sensor("block.position")[:, 0]


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
def test_block_sticks_if_the_overshooting_load_is_below_static_friction(device):
    # F (1 + o) ≤ μ_s N: 2 % above and below, for three damping ratios. As μ_d N < F, a sliding block never stops.
    ratio = np.repeat(list(OVERSHOOT), 2)
    mu_static = 0.5 * (1.0 + np.repeat(list(OVERSHOOT.values()), 2)) * np.tile([1.02, 0.98], 3)
    slide = slide_of_blocks(device, np.arctan(0.5), mu_static, 2.0 * ratio * np.sqrt(STIFFNESS))
    held = np.tile([True, False], 3)
    stretch = G * np.sin(np.arctan(0.5)) / STIFFNESS
    assert (np.abs(slide[held]) < 2.0 * stretch).all()
    assert (slide[~held] > 5.0 * stretch).all()


def test_recommended_damping_holds_a_block_just_below_static_friction(device):
    # μ_s = 0.5001 on tan θ = 0.5 leaves an overshoot of 2e-4.
    chosen = [STICK.from_overshoot(
        mu_static=0.5001, mu_dynamic=0.4, stiffness=STIFFNESS, mass=1.0, overshoot=o
    ) for o in (1.0e-4, 4.0e-4)]  # fmt: skip
    slide = slide_of_blocks(device, np.arctan(0.5), [0.5001, 0.5001], [one.damping for one in chosen])
    stretch = G * np.sin(np.arctan(0.5)) / STIFFNESS
    assert slide[0] < stretch
    assert slide[1] > 5.0 * stretch


def test_from_overshoot_inverts_the_closed_form():
    for ratio, overshoot in OVERSHOOT.items():
        chosen = STICK.from_overshoot(
            mu_static=0.5, mu_dynamic=0.4, stiffness=4.0e4, mass=0.25, overshoot=float(overshoot)
        )
        np.testing.assert_allclose(chosen.damping, 2.0 * ratio * 100.0, atol=1e-6)
    patch = wc.friction.Mindlin.from_overshoot(
        mu_static=0.5, mu_dynamic=0.4, shear_modulus=1.0e6, patch_radius=5.0e-3, mass=0.25, overshoot=np.exp(-2.0)
    )
    np.testing.assert_allclose(patch.damping, 2.0 * np.sqrt(8.0e6 * 5.0e-3 * 0.25), rtol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"mass": 0.0}, "mass must be greater than 0, got 0"),
        ({"stiffness": -1.0}, "stiffness must be greater than 0, got -1"),
        ({"overshoot": 1.5}, "overshoot must be greater than 0 and at most 1, got 1.5"),
        ({"mass": True}, "mass must be a number, got True"),
    ],
)
def test_from_overshoot_raises_for_values_out_of_range(wrong, message):
    values = {"mu_static": 0.5, "mu_dynamic": 0.4, "stiffness": 1.0e4, "mass": 1.0} | wrong
    with pytest.raises(ValueError, match=message):
        STICK.from_overshoot(**values)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"shear_modulus": -1.0}, "shear_modulus must be greater than 0, got -1"),
        ({"patch_radius": 0.0}, "patch_radius must be greater than 0, got 0"),
        ({"shear_modulus": "1"}, "shear_modulus must be a number, got '1'"),
    ],
)
def test_from_overshoot_of_mindlin_names_its_own_arguments(wrong, message):
    values = {"mu_static": 0.5, "mu_dynamic": 0.4, "shear_modulus": 1e6, "patch_radius": 5e-3, "mass": 1.0}
    with pytest.raises(ValueError, match=f"^{message}$"):
        wc.friction.Mindlin.from_overshoot(**(values | wrong))
