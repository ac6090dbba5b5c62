"""Newton loads exported stages with the right masses, poses, gravity and friction."""

import importlib.util

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import warpcontact as wc

LACKING = [name for name in ("newton", "newton_usd_schemas") if importlib.util.find_spec(name) is None]
pytestmark = [
    pytest.mark.skipif(bool(LACKING), reason=f"{' and '.join(LACKING)} not installed"),
    pytest.mark.filterwarnings("default"),  # of Newton, about ignored prims
    pytest.mark.slow,
]

MASSES = (1.0, 2.0, 3.0)


@pytest.fixture(scope="module")
def loaded(device, tmp_path_factory):
    """The exported file of a simulation of three balls, and the builder of Newton that read it."""
    import newton

    scene = wc.Scene(gravity=(0.0, 0.0, -3.7))
    plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
    rubber = wc.ContactMaterial(
        law=wc.laws.KelvinVoigt(stiffness=1e5, restitution=0.6),
        friction=wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.4, stiffness=1e4),
    )
    for i, mass in enumerate(MASSES):
        inertia = np.array([0.01, 0.02, 0.025]) * mass
        ball = scene.add_body(
            mass, inertia, (i, 0.5, 0.3), (0, 0, np.sin(0.2 * i), np.cos(0.2 * i)), name=f"ball_{i}"
        )
        skin = scene.add_shape(ball, wc.shapes.Sphere(0.1), name=f"skin_{i}")
        scene.add_shape_contact(skin, plane, rubber, name=f"touch_{i}")
    model = scene.build(device=device)
    recording = wc.Simulation(model, dt=1e-3).run(duration=0.02, every=1e-2)
    for i, mass in enumerate(MASSES):  # parameters without variation are not recorded, and not authored
        recording[f"ball_{i}.mass"] = ("env", [mass])
        tensor = np.diag([0.01, 0.02, 0.025]) * mass
        recording[f"ball_{i}.inertia"] = (("env", "row", "column"), tensor[None])
    path = wc.export_usd(recording, tmp_path_factory.mktemp("newton") / "balls.usda")
    builder = newton.ModelBuilder()
    found = builder.add_usd(str(path))
    return builder, found


def bodies(loaded):
    """Indices of the bodies in Newton, in the order of this library."""
    builder, found = loaded
    paths = {path.rpartition("/")[2]: number for path, number in found["path_body_map"].items()}
    return builder, [paths[f"ball_{i}"] for i in range(len(MASSES))]


def test_newton_reads_exported_masses_and_inertia(loaded):
    builder, numbers = bodies(loaded)
    assert [builder.body_mass[i] for i in numbers] == pytest.approx(MASSES)
    for mass, i in zip(MASSES, numbers, strict=True):
        tensor = np.array(builder.body_inertia[i]).reshape(3, 3)
        np.testing.assert_allclose(tensor, np.diag([0.01, 0.02, 0.025]) * mass, rtol=1e-5, atol=1e-8)
        np.testing.assert_allclose(np.array(builder.body_com[i]), 0.0, atol=1e-7)


def test_newton_reads_exported_initial_poses(loaded):
    builder, numbers = bodies(loaded)
    for i, number in enumerate(numbers):
        pose = np.array(builder.body_q[number])
        np.testing.assert_allclose(pose[:3], (i, 0.5, 0.3), atol=1e-6)
        np.testing.assert_allclose(pose[3:], (0, 0, np.sin(0.2 * i), np.cos(0.2 * i)), atol=1e-6)


def test_newton_reads_exported_gravity(loaded):
    builder, _ = loaded
    assert np.linalg.norm(np.asarray(builder.gravity)) == pytest.approx(3.7)


def test_newton_reads_exported_friction_and_restitution(loaded):
    builder, numbers = bodies(loaded)
    for number in numbers:
        (shape,) = builder.body_shapes[number]
        assert builder.shape_material_mu[shape] == pytest.approx(0.4)
        assert builder.shape_material_restitution[shape] == pytest.approx(0.6)


# Files of Newton with bodies whose mass, center and inertia follow from shapes, densities and materials.
WEIGHING = (
    "examples/assets/axis_cube.usda",
    "examples/assets/palletizer_scene.usda",
    "examples/assets/humanoid.usda",
    "tests/assets/cube_cylinder.usda",
    # Written by a converter, with each link below the previous one and no transform reset.
    "tests/assets/cartpole_mjc.usda",
    "tests/assets/humanoid_mjc.usda",
)


@pytest.mark.parametrize("name", WEIGHING)
def test_third_party_bodies_have_mass_and_pose_as_in_newton(name):
    import newton
    from test_usd_import_third_party import scene_file

    path = scene_file(name)
    scene = wc.Scene.from_usd(path, skip_unsupported=True)
    builder = newton.ModelBuilder()
    numbers = builder.add_usd(str(path))["path_body_map"]
    numbers = {path.rpartition("/")[2]: number for path, number in numbers.items()}
    assert len(numbers) == len(scene.bodies)
    for body in scene.bodies:
        if isinstance(body.motion, wc.motions.Fixed):
            continue  # the mass of a static body has no meaning
        i = numbers[body.name]
        pose, centre = np.array(builder.body_q[i]), np.array(builder.body_com[i])
        # Newton computes in single precision, with a few roundings.
        assert float(body.mass) == pytest.approx(builder.body_mass[i], rel=1e-6)
        place = pose[:3] + Rotation.from_quat(pose[3:]).apply(centre)
        np.testing.assert_allclose(body.position, place, atol=1e-6)
        own, theirs = (Rotation.from_quat(q).as_matrix() for q in (body.orientation, pose[3:]))
        inertia = np.array(builder.body_inertia[i]).reshape(3, 3)
        expected = theirs @ inertia @ theirs.T
        np.testing.assert_allclose(own @ body.inertia @ own.T, expected, atol=1e-5 * np.trace(expected))
