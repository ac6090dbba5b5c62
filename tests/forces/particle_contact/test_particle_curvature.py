"""Laws that use curvature get the curvatures of spheres, and of cylinders and caps of capsules."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from warpcontact.kernels.laws.hertz import LONGEST

import warpcontact as wc

MODULUS, DEPTH = 1e7, 2.0**-10  # a penetration that is exact in both precisions
HALF = 0.5
R, S = 0.125, 0.0625
X, Z = np.eye(3)[[0, 2]]


def turned(angle):
    """Returns the orientation of a capsule whose axis is in the plane of x and y, at an angle from x."""
    return (Rotation.from_rotvec([0, 0, angle]) * Rotation.from_rotvec([0, np.pi / 2, 0])).as_quat()


def crossed(angle, a, b):
    """Relative principal curvatures of cylinders whose axes are at an angle, Johnson, Contact Mechanics (4.3)."""
    first, second = 1 / a, 1 / b
    apart = np.sqrt(first**2 + second**2 + 2 * first * second * np.cos(2 * angle))
    return 0.5 * (first + second - apart), 0.5 * (first + second + apart)


def capsule(radius):
    return wc.shapes.Capsule(radius, HALF)


# Two shapes with their orientations, the direction from the second to the first, the distance of their centers,
# and the relative curvatures.
ALONG = turned(0.0)
PAIRS = {
    "two spheres": (wc.shapes.Sphere(R), ALONG, wc.shapes.Sphere(S), ALONG, Z, R + S, (24.0, 24.0)),
    "a sphere on a side": (wc.shapes.Sphere(R), ALONG, capsule(S), ALONG, Z, R + S, (8.0, 24.0)),
    "a side on a sphere": (capsule(R), ALONG, wc.shapes.Sphere(S), ALONG, Z, R + S, (16.0, 24.0)),
    "a sphere on a cap": (wc.shapes.Sphere(R), ALONG, capsule(S), ALONG, X, HALF + R + S, (24.0, 24.0)),
    "two caps": (capsule(R), ALONG, capsule(S), ALONG, X, 2 * HALF + R + S, (24.0, 24.0)),
    "a cap on a side": (capsule(R), turned(np.pi / 2), capsule(S), ALONG, [0, 1, 0], HALF + R + S, (8.0, 24.0)),
    "sides at 90°, alike": (capsule(R), turned(np.pi / 2), capsule(R), ALONG, Z, 2 * R, (8.0, 8.0)),
    "sides at 60°": (capsule(R), turned(np.pi / 3), capsule(S), ALONG, Z, R + S, crossed(np.pi / 3, R, S)),
    "sides at 1°": (capsule(R), turned(np.pi / 180), capsule(S), ALONG, Z, R + S, crossed(np.pi / 180, R, S)),
    "sides side by side": (capsule(R), ALONG, capsule(S), ALONG, Z, R + S, (24.0 / LONGEST, 24.0)),
}


# In float32, curvatures are accurate to a few roundings, and forces to those of elliptic integrals and of a
# penetration of 1e-3.
@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-9), ("float32", 1e-4)])
def test_hertz_force_of_particles_uses_curvatures_of_the_pair(precision, tolerance, device):
    """Forces match the closed form for all pairs of one particle contact, in every environment."""
    scene = wc.Scene(gravity=(0, 0, 0))
    shapes = []
    for number, (form, turn, other, other_turn, way, distance, _) in enumerate(PAIRS.values()):
        place = np.array([10.0 * number, 0, 0])
        for one, q, at in ((form, turn, place + (distance - DEPTH) * np.array(way)), (other, other_turn, place)):
            body = scene.add_body(1.0, (1.0, 1.0, 1.0), at, q, name=f"body_{len(shapes)}")
            shapes.append(scene.add_shape(body, one, name=f"shape_{len(shapes)}"))
    law = wc.laws.HertzElastic(modulus=MODULUS)
    scene.add_particle_contact(shapes, wc.ContactMaterial(law=law), name="pile")
    model = scene.build(2, device, precision)
    model["pile.law.modulus"] = [MODULUS, 3 * MODULUS]
    # A larger sphere in the second environment only, at a larger distance.
    model["shape_0.radius"] = [R, 2 * R]
    model["body_0.position"] = [[0, 0, R + S - DEPTH], [0, 0, 2 * R + S - DEPTH]]
    found = model.contact_pairs("pile")
    assert found["shape_1"].values.tolist() == 2 * list(range(0, len(shapes), 2))
    curvatures = np.array([[own[-1] for own in PAIRS.values()]] * 2)
    curvatures[1, 0] = 20.0
    np.testing.assert_allclose(found["gap"], -DEPTH, rtol=tolerance)
    # E* = E of a body with ν = 0 on a rigid one.
    expected = [
        [wc.laws.Hertz.elliptic(modulus, 0.0, *(1 / own)).stiffness * DEPTH**1.5 for own in of_env]
        for modulus, of_env in zip((MODULUS, 3 * MODULUS), curvatures, strict=True)
    ]
    names = [f"{name} in environment {env}" for env in range(2) for name in PAIRS]
    for name, force, expected_force in zip(names, found["normal_force"].values, np.ravel(expected), strict=True):
        assert force == pytest.approx(expected_force, rel=tolerance), name


def test_hertz_force_of_spheres_uses_both_radii(device):
    """Spheres only, more than the limit for lists of all pairs."""
    count = 40
    places = np.zeros((count, 3))
    places[:, 0] = np.arange(count)
    places[1::2, 0] += R + S - DEPTH - 1.0
    scene = wc.Scene(gravity=(0, 0, 0))
    balls = scene.add_bodies(places, 1.0, (1.0, 1.0, 1.0), name="ball")
    forms = [wc.shapes.Sphere(R if number % 2 == 0 else S) for number in range(count)]
    law = wc.laws.HertzElastic(modulus=MODULUS)
    scene.add_particle_contact(scene.add_shape(balls, forms), wc.ContactMaterial(law=law), name="pile")
    model = scene.build(1, device, "float64")
    expected_force = 4 / 3 * MODULUS * np.sqrt(1 / 24.0) * DEPTH**1.5
    np.testing.assert_allclose(
        model.contact_pairs("pile")["normal_force"], np.full(count // 2, expected_force), rtol=1e-9
    )


FRICTION = wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.4, stiffness=1e4, damping=1.0)
TWO = {
    "capsules": ((wc.shapes.Capsule(0.1, 0.3), wc.shapes.Capsule(0.06, 0.4)), {}),
    "spheres": (
        (wc.shapes.Sphere(0.1), wc.shapes.Sphere(0.06)),
        {"rolling": wc.friction.Tanh(mu=0.02), "torsion": wc.friction.Tanh(mu=0.3)},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TWO)
def test_particle_impact_matches_shape_contact(name, device):
    """Oblique and spinning: crossed capsules, and spheres that also roll and spin."""
    forms, friction_models = TWO[name]
    law = wc.laws.HertzElastic(modulus=1e7, restitution=0.6)
    material = wc.ContactMaterial(law=law, friction=FRICTION, **friction_models)
    ends = []
    for smooth in (True, False):
        scene = wc.Scene(gravity=(0, 0, 0))
        shapes = []
        for i, (form, at, turn) in enumerate(zip(forms, ((0, 0, 0), (0.17, 0.02, 0.03)), (0.0, 1.0), strict=True)):
            body = scene.add_body(
                1.0 + i, (0.01, 0.02, 0.025), at, Rotation.from_rotvec([turn, 0.2 * turn, 0.1 * turn]).as_quat(),
                linear_velocity=(5.0 - 10.0 * i, 0.1, -0.2 * i), angular_velocity=(1.0, 2.0 + i, -3.0 * i),
                name=f"body_{i}",
            )  # fmt: skip
            shapes.append(scene.add_shape(body, form))
        if smooth:
            scene.add_shape_contact(*shapes, material, name="touch")
        else:
            scene.add_particle_contact(shapes, material, name="touch")
        model = scene.build(1, device, "float64")
        recording = wc.Simulation(model, dt=2e-5).run(0.02, ["touch.normal_force"])
        assert (recording["touch.normal_force"] > 0).sum() > 100
        assert model.sensor("touch.normal_force")[0] == 0.0
        ends.append(
            [model.sensor(f"body_{i}.{key}") for i in range(2) for key in ("linear_velocity", "angular_velocity")]
        )
    for of_shapes, of_particles in zip(*ends, strict=True):
        # The same values in the same formulas, from contact points that are computed differently.
        np.testing.assert_allclose(of_particles, of_shapes, rtol=0, atol=1e-11)
