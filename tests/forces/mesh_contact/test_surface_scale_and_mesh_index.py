"""Scale and mesh index of a surface equal the use of another mesh, in each environment."""

import difficult_meshes
import numpy as np
import pytest
from scenes import probe

import warpcontact as wc
from warpcontact import ContactStatus

PRECISIONS = pytest.mark.parametrize("precision", ["float32", "float64"])
SENSORS = ("gap", "penetration", "normal", "point", "status", "normal_force")
STATE = ("ball.position", "ball.orientation", "ball.linear_velocity", "ball.angular_velocity")
FRICTION = wc.ContactMaterial(
    law=wc.laws.HuntCrossley(stiffness=1e5, restitution=0.6),
    friction=wc.friction.Tanh(mu=0.3, velocity_scale=1e-2),
)


def around(mesh, count=500):
    rng = np.random.default_rng(4)
    low, high = mesh.bounds
    middle, reach = 0.5 * (low + high), (high - low).max()
    return middle + rng.uniform(-0.8, 0.8, (count, 3)) * reach


@PRECISIONS
@pytest.mark.parametrize("scale", [0.5, 4.0, 1e-3, 3.7])
def test_scaled_surface_equals_mesh_with_scaled_vertices(scale, precision, device):
    for mesh in (
        difficult_meshes.angle_bracket(),
        difficult_meshes.moved(difficult_meshes.angle_bracket(), (3.0, -1.0, 2.0)),
    ):
        larger = wc.Mesh(scale * mesh.vertices, mesh.faces)
        points = around(larger)
        size = (larger.bounds[1] - larger.bounds[0]).max()
        options = {"radius": 0.1 * scale, "kappa": 0.3, "precision": precision, "device": device}
        scaled, plain = probe(mesh, points, scale=scale, **options), probe(larger, points, **options)
        # A few roundings of the coordinates, which are at most four times the size.
        length = {"float32": 4e-6, "float64": 1e-14}[precision] * size
        # Powers of two are exact.
        length *= np.log2(scale) % 1 != 0
        tolerances = {"gap": length, "penetration": length, "point": length, "normal_force": 1e4 * length}
        for name, atol in tolerances.items():
            np.testing.assert_allclose(scaled[name], plain[name], rtol=0, atol=atol, err_msg=name)
        certain = np.abs(plain["gap"]) > length
        np.testing.assert_array_equal(scaled["status"][certain], plain["status"][certain])


def scene_of(mesh, **surface):
    """A ball with eight points and a sphere, dropped on a surface that moves with a body."""
    scene = wc.Scene(gravity=(0, 0, -9.81))
    carrier = scene.add_body(5.0, (0.5, 0.6, 0.7), angular_velocity=(0.1, 0.2, 2.0), name="carrier")
    ground = scene.add_surface(mesh, carrier, name="ground", **surface)
    ball = scene.add_body(0.5, (2e-3, 3e-3, 4e-3), (0.1, 0.05, 0.9), linear_velocity=(0.1, 0, -2), name="ball")
    corners = 0.1 * (np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3))
    scene.add_contact(scene.add_points(ball, corners), ground, FRICTION, name="corners")
    scene.add_contact(
        scene.add_point(ball, (0, 0, 0)), ground, FRICTION, radius=0.12, entry="latched", swept=True, name="touch"
    )
    return scene


def results(sim, names=(*STATE, "carrier.position", "carrier.orientation", "corners.gap", "touch.normal_force")):
    return {name: sim.model.sensor(name) for name in names}


@PRECISIONS
def test_surface_scale_per_environment_equals_separate_scenes(precision, device):
    scales = [0.5, 0.8, 1.0, 1.3]
    model = scene_of(wc.meshes.icosphere(0.6, 2)).build(envs=4, precision=precision, device=device)
    model["ground.scale"] = scales
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(300)
    together = results(sim)
    for env, scale in enumerate(scales):
        alone = scene_of(wc.meshes.icosphere(0.6, 2), scale=scale).build(precision=precision, device=device)
        single = wc.Simulation(alone, dt=1e-3)
        single.step(300)
        for name, values in results(single).items():
            np.testing.assert_array_equal(values[0], together[name][env], err_msg=f"{name} at scale {scale}")


# Their bounding boxes have the same center, to which the mesh tables are relative.
CHOICE = (wc.meshes.icosphere(0.6, 2), wc.meshes.box((1.2, 1.2, 1.2)), wc.meshes.icosphere(0.6, 0))


@PRECISIONS
def test_mesh_index_per_environment_equals_separate_scenes(precision, device):
    chosen = [2, 0, 1, 1, 0, 2]
    model = scene_of(list(CHOICE)).build(envs=6, precision=precision, device=device)
    model["ground.mesh"] = chosen
    assert model["ground.mesh"].tolist() == chosen
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(300)
    together = results(sim)
    for which, mesh in enumerate(CHOICE):
        alone = scene_of(mesh).build(precision=precision, device=device)
        single = wc.Simulation(alone, dt=1e-3)
        single.step(300)
        for name, values in results(single).items():
            for env in np.flatnonzero(np.equal(chosen, which)):
                np.testing.assert_array_equal(together[name][env], values[0], err_msg=f"{name} on mesh {which}")


@PRECISIONS
def test_surface_scale_and_mesh_index_can_change_between_steps(precision, device):
    box, ball = wc.meshes.box((1.0, 1.0, 1.0)), wc.meshes.icosphere(0.5, 3)
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface([box, ball], name="ground")
    body = scene.add_body(1.0, (1, 1, 1), (0.4, 0.4, 0.6), name="body")
    scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, FRICTION, name="touch")
    model = scene.build(envs=2, precision=precision, device=device)
    sim = wc.Simulation(model, dt=1e-6)
    sim.step(3)
    np.testing.assert_allclose(model.sensor("touch.gap"), 0.1, atol=1e-6)
    model["ground.mesh"] = [0, 1]
    sim.step(3)
    distance = np.linalg.norm((0.4, 0.4, 0.6)) - 0.5
    np.testing.assert_allclose(model.sensor("touch.gap")[0], 0.1, atol=1e-6)
    # A facet is up to h²/6 inside the ball, h = 0.08.
    np.testing.assert_allclose(model.sensor("touch.gap")[1], distance, atol=2e-3)
    model["ground.scale"] = [1.5, 1.0]
    sim.step(3)
    np.testing.assert_allclose(model.sensor("touch.gap")[0], -0.15, atol=1e-6)
    assert model.sensor("touch.status").tolist() == [ContactStatus.CONTACT, ContactStatus.OPEN]


@PRECISIONS
@pytest.mark.parametrize("search", ["whole", "active"])
def test_each_mesh_has_its_own_active_faces(search, precision, device):
    square = wc.meshes.grid((2.0, 2.0), (1, 1))
    fine = wc.meshes.grid((2.0, 2.0), (2, 2))
    left = np.flatnonzero(fine.vertices[fine.faces].mean(axis=1)[:, 0] < 0)
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface([square, fine, fine], name="ground", active_faces=[[0, 1], left, None])
    body = scene.add_body(1.0, (1, 1, 1), (0.5, 0.3, -0.01), name="body")
    scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, FRICTION, search=search, name="touch")
    model = scene.build(envs=3, precision=precision, device=device)
    model["ground.mesh"] = [0, 1, 2]
    free = ContactStatus.INACTIVE if search == "whole" else ContactStatus.OPEN
    assert model.sensor("touch.status").tolist() == [ContactStatus.CONTACT, free, ContactStatus.CONTACT]


def test_invalid_scale_or_mesh_index_is_refused(device):
    box = wc.meshes.box()
    model = scene_of([box, box]).build(envs=2, device=device)
    single = scene_of(box).build(device=device)
    for value in (-1, 2, 0.5, [0, 3], [0, np.nan], [0, 1, 0]):
        with pytest.raises(ValueError, match=r"ground\.mesh"):
            model["ground.mesh"] = value
    for value in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match=r"ground\.scale"):
            model["ground.scale"] = value
    assert model["ground.mesh"].tolist() == [0, 0]
    assert model["ground.scale"].tolist() == [1, 1]
    with pytest.raises(KeyError, match=r"ground\.mesh"):
        single["ground.mesh"] = 0
    with pytest.raises(ValueError, match=r"ground\.scale"):
        scene_of(box, scale=-2.0)
    with pytest.raises(ValueError, match=r"ground"):
        scene_of([])
    for wrong in ([[0]], [[0], [1], [2]]):
        with pytest.raises(ValueError, match=r"ground\.active_faces must have one entry for each of 2 meshes"):
            scene_of([box, box], active_faces=wrong)
    for wrong in ("left", lambda centroids: centroids[:, 0] > 0, 3):
        with pytest.raises(ValueError, match=r"active_faces must have one entry for each of 2 meshes, got ['<3]"):
            scene_of([box, box], active_faces=wrong)
    with pytest.raises(ValueError, match=r"ground\.active_faces\[1\].*99"):
        scene_of([box, box], active_faces=[None, [99]])
