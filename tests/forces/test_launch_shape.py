"""The launch shape of a step is the fastest one that is possible, and the reasons are explained."""

import pytest

import warpcontact as wc
from warpcontact.forces import launch_shape
from warpcontact.forces.launch_shape import (
    FUSED_CONTACT,
    LOOP_PER_ENVIRONMENT,
    SHAPES,
    STAGED,
    WARP_PER_ENVIRONMENT,
)

pytestmark = pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")

GROUND = wc.meshes.sinusoidal_terrain((4, 4), (4, 4), amplitude=0.1, wavelength=2.0)
RIGID = wc.ContactMaterial(law=wc.laws.Rigid(restitution=0.5), friction=wc.friction.Coulomb(mu=0.3))
MATERIAL = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e3, damping=1.0))


@pytest.fixture(autouse=True)
def fused_kernels(monkeypatch):
    """Fuses stages, also if kernels are compiled for short compile times; nothing is compiled here."""
    monkeypatch.setattr(launch_shape, "FUSE_STAGES", True)


def ball(scene, **contact):
    """Adds a ball above the ground and returns its body."""
    ground = scene.surfaces[0] if scene.surfaces else scene.add_surface(GROUND, name="ground")
    body = scene.add_body(mass=1.0, inertia=(1e-2,) * 3, position=(0, 0, 0.5))
    point = scene.add_point(body, (0, 0, 0))
    scene.add_contact(point, ground, **{"material": MATERIAL, "radius": 0.1} | contact)
    return body


def two_balls(scene):
    ball(scene)
    ball(scene)


def ball_on_a_spring(scene):
    body = ball(scene)
    ends = scene.add_point(body, (0, 0, 0)), scene.add_point(None, (0, 0, 1))
    scene.add_spring_damper(*ends, stiffness=10.0, damping=0.1, rest_length=0.5)


def two_models(scene):
    body = ball(scene)
    other = wc.ContactMaterial(law=wc.laws.Hertz(stiffness=1e4))
    scene.add_contact(scene.add_point(body, (0.1, 0, 0)), scene.surfaces[0], other)


def simulation(make, **options):
    scene = wc.Scene()
    make(scene)
    return wc.Simulation(scene.build(envs=3, device="cpu"), dt=1e-3, **options)


# Scene, options of the simulation, name of the launch shape, and reason for which it is not a loop per environment.
CASES = {
    "one ball": (ball, {}, LOOP_PER_ENVIRONMENT, None),
    "two balls": (two_balls, {}, FUSED_CONTACT, "environments have 2 bodies"),
    "spring": (ball_on_a_spring, {}, FUSED_CONTACT, "the model has force elements of the family 'couplings'"),
    "two contact models": (two_models, {}, FUSED_CONTACT, "there are 2 contact models"),
    "latched contact": (
        lambda scene: ball(scene, entry="latched"), {}, STAGED, "a contact is latched or swept",
    ),
    "monitor": (
        ball,
        {"outcomes": {"most": wc.outcomes.Max("contact.normal_force")}},
        STAGED,
        "outcomes, events, stop conditions or frames read the contacts",
    ),
    "no distance cache": (
        ball, {"distance_cache": False}, STAGED, "distance_cache is off, or a monitor reads all distances",
    ),
    "nonsmooth contact": (
        lambda scene: ball(scene, material=RIGID),
        {"integrator": wc.integrators.MoreauJean()},
        STAGED,
        "contacts are nonsmooth",
    ),
    "selected": (ball, {"launch_shape": STAGED}, STAGED, 'launch_shape is "staged"'),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_launch_shape_is_the_fastest_one_without_an_obstacle(name):
    make, options, expected, reason = CASES[name]
    (part,) = simulation(make, **options).explain().parts
    assert part.shape.name == expected
    assert part.shape.rejected.get(LOOP_PER_ENVIRONMENT) == reason
    faster = list(SHAPES)[: list(SHAPES).index(expected)]
    assert list(part.shape.rejected) == faster
    assert part.shape.rejected[WARP_PER_ENVIRONMENT] == (
        'launch_shape is "staged"' if "launch_shape" in options else "it is for GPUs"
    )


def test_explanation_lists_kernels_and_reasons():
    sim = simulation(two_balls, threads=2)
    assert str(sim.explain()) == (
        "cpu: 3 environments, 2 slices, 2 threads\n"
        "  launch shape: fused contact (contact detection and force in one kernel per contact model, then the other "
        "stages)\n"
        "  kernels of a step:\n"
        "    update_sets (kernels/launch_shapes/fused_contact.py)\n"
        "    semi_implicit_euler (kernels/integrators/semi_implicit.py)\n"
        "    advance_history (kernels/contact/history.py)\n"
        "  not warp per environment: it is for GPUs\n"
        "  not loop per environment: environments have 2 bodies"
    )
    with_loop = simulation(ball).explain().parts[0]
    assert with_loop.kernels == ("fused_steps",)
    staged = simulation(ball, launch_shape=STAGED).explain().parts[0].kernels
    assert staged == ("add_travel", "closest_point", "contact_force", "semi_implicit_euler")


def test_quick_compilation_selects_staged_kernels(monkeypatch):
    monkeypatch.setattr(launch_shape, "FUSE_STAGES", False)
    shape = simulation(ball).explain().parts[0].shape
    assert shape.name == STAGED
    assert shape.rejected[FUSED_CONTACT] == "WARPCONTACT_COMPILE=quick selects staged kernels"


def test_impossible_launch_shape_is_refused_with_its_reason():
    with pytest.raises(
        ValueError, match='launch_shape must not be "loop per environment": environments have 2 bod'
    ):
        simulation(two_balls, launch_shape=LOOP_PER_ENVIRONMENT)
    with pytest.raises(ValueError, match="launch_shape must be one of 'auto', 'warp per environment'"):
        simulation(ball, launch_shape="fused")
