"""Motion of spheres in creases: rest, history of each wall, checkpoints, nonsmooth contact, warnings."""

import math
import warnings

import numpy as np
import pytest
from creases import RADIUS, ball_in, corner, groove, trough

import warpcontact as wc

MASS, G = 0.5, 9.81
RIGHT_ANGLE = math.pi / 2
DAMPED = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e4, damping=60.0))
# All kinds of history: entry speed, and springs of sliding, rolling and torsional friction.
GRIP = wc.ContactMaterial(
    law=wc.laws.HuntCrossley(stiffness=1e6, restitution=0.6),
    friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.5, stiffness=1e4, damping=5.0),
    rolling=wc.friction.CundallStrack(mu_static=0.05, mu_dynamic=0.04, stiffness=1e3, damping=1.0),
    torsion=wc.friction.Tanh(mu=0.1, velocity_scale=1e-3),
)
RIGID = wc.ContactMaterial(law=wc.laws.Rigid(), friction=wc.friction.Coulomb(mu=0.3))


def split_groove():
    """The two walls of a groove as separate meshes."""
    whole = groove(RIGHT_ANGLE)
    return tuple(wc.Mesh(whole.vertices[own], [(0, 2, 3), (0, 3, 1)]) for own in ([0, 1, 2, 3], [1, 0, 5, 4]))


def run_warnings(sim, duration):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sim.run(duration)
    return [str(one.message) for one in caught if one.category.__name__ == "RunWarning"]


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_sphere_comes_to_rest_in_a_groove(precision, device):
    model = ball_in(groove(RIGHT_ANGLE), DAMPED, device=device, precision=precision, gravity=(0, 0, -G))
    model["ball.position"] = (0.002, 0.01, RADIUS * math.sqrt(2) + 1e-3)
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(10000)
    # Both walls carry √2 k d = m g.
    depth = MASS * G / (math.sqrt(2) * 1e4)
    rest = (0, 0.01, (RADIUS - depth) * math.sqrt(2))
    resolution = 1e-8 if precision == "float32" else 1e-12
    np.testing.assert_allclose(model.sensor("ball.position")[0], rest, rtol=0, atol=resolution)
    assert np.linalg.norm(model.sensor("ball.linear_velocity")) < 1e-6
    np.testing.assert_allclose(model.sensor("touch.force")[0], [0, 0, MASS * G], atol=1e-3)
    sim.step(5000)
    np.testing.assert_allclose(model.sensor("ball.position")[0], rest, rtol=0, atol=resolution)


def test_groove_of_one_mesh_acts_as_two_contacts_with_a_wall_each(device):
    """Impacts with spin, then sliding and rolling along the groove: entry speeds and springs belong to a wall each."""
    start = (0.001, -0.1, RADIUS * math.sqrt(2) + 0.01)
    motion = []
    for meshes, minima in ((groove(RIGHT_ANGLE), "all"), (split_groove(), "nearest")):
        model = ball_in(meshes, GRIP, device=device, minima=minima, gravity=(0, 1, -G))
        model["ball.position"] = start
        model["ball.linear_velocity"] = (0.05, 0.2, 0)
        model["ball.angular_velocity"] = (5.0, 3.0, 8.0)
        recording = wc.Simulation(model, dt=2e-5).run(0.3, ["ball.position", "ball.angular_velocity"], every=0.01)
        motion.append([recording[key].values for key in ("ball.position", "ball.angular_velocity")])
    # Rounding grows in impacts and at changes between stick and slip.
    for one, other in zip(*motion, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())
    assert np.ptp(motion[0][0][:, 0, 2]) > 1e-3


def test_springs_of_both_walls_hold_a_sphere_on_a_slope(device):
    scene = wc.Scene(gravity=(0, 1.0, -G))
    walls = scene.add_surface(groove(RIGHT_ANGLE))
    depth = MASS * G / (math.sqrt(2) * 1e4)
    place = (0, 0, (RADIUS - depth) * math.sqrt(2))
    ball = scene.add_body(MASS, (1, 1, 1), place, name="ball", motion=wc.motions.Translation())
    grip = wc.ContactMaterial(
        law=DAMPED.law,
        friction=wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=2e3, damping=60.0),
    )
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), walls, grip, radius=RADIUS, minima="all", name="touch")
    model = scene.build(envs=1, device=device, precision="float64")
    wc.Simulation(model, dt=2e-4).step(5000)
    # Two springs in parallel.
    np.testing.assert_allclose(model.sensor("ball.position")[0, 1], MASS * 1.0 / (2 * 2e3), rtol=1e-9)
    assert np.abs(model.sensor("ball.linear_velocity")).max() < 1e-10
    springs = model.sensor("touch.friction.spring")[0]
    assert (np.linalg.norm(springs, axis=-1) > 1e-6).sum() == 2


def test_checkpoint_restores_the_history_of_each_wall(tmp_path, device):
    sims = []
    for _ in range(2):
        model = ball_in(groove(RIGHT_ANGLE), GRIP, envs=2, device=device, gravity=(0, 1, -G))
        model["ball.position"] = (0.0005, -0.1, RADIUS * math.sqrt(2) - 1e-4)
        model["touch.law.stiffness"] = [1e6, 5e5]
        sims.append(wc.Simulation(model, dt=2e-5))
    sims[0].step(700)
    sims[0].save(tmp_path / "half.npz")
    sims[1].load(tmp_path / "half.npz")
    for sim in sims:
        sim.step(700)
    for key in ("ball.position", "ball.angular_velocity", "touch.force", "touch.minimum_normal_force"):
        assert np.array_equal(*(sim.model.sensor(key) for sim in sims))
    assert (sims[0].model.sensor("touch.minimum_count") == 2).all()


def test_environment_with_its_own_parameters_is_bitwise_identical_alone(device):
    def stepped(rows):
        model = ball_in(corner(), DAMPED, envs=len(rows), device=device, precision="float32", gravity=(-6, -7, -G))
        model["ball.position"] = [(0.051 + 0.001 * row, 0.054, 0.053) for row in rows]
        model["touch.law.stiffness"] = [1e4 + 2e3 * row for row in rows]
        model["touch.radius"] = [RADIUS + 1e-3 * row for row in rows]
        wc.Simulation(model, dt=2e-4).step(3000)
        return model.sensor("ball.position")

    together = stepped(range(4))
    for row in range(4):
        assert np.array_equal(stepped([row])[0], together[row])
        radius, stiffness = RADIUS + 1e-3 * row, 1e4 + 2e3 * row
        np.testing.assert_allclose(together[row], radius - MASS * np.array([6, 7, G]) / stiffness, atol=1e-6)


def test_rigid_sphere_rests_on_both_walls(device):
    model = ball_in(groove(RIGHT_ANGLE), RIGID, device=device, gravity=(0, 0, -G))
    model["ball.position"] = (0.002, 0.01, RADIUS * math.sqrt(2) + 1e-3)
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean(recovery_time=0.02))
    sim.step(1500)
    np.testing.assert_allclose(model.sensor("ball.position")[0, [0, 2]], [0, RADIUS * math.sqrt(2)], atol=2e-5)
    assert np.linalg.norm(model.sensor("ball.linear_velocity")) < 1e-6
    np.testing.assert_allclose(model.sensor("touch.force")[0], [0, 0, MASS * G], atol=1e-5)
    load, normal = model.sensor("touch.minimum_normal_force")[0], model.sensor("touch.minimum_normal")[0]
    assert (load > 0).sum() == 2
    across = model.sensor("touch.friction_force")[0]
    # The mean of two points on walls at 45°.
    np.testing.assert_allclose(model.sensor("touch.center")[0], [0, 0.01, RADIUS / math.sqrt(2)], atol=1e-4)
    np.testing.assert_allclose(load @ normal + across, [0, 0, MASS * G], atol=1e-5)


def test_rigid_groove_of_one_mesh_acts_as_two_contacts(device):
    motion = []
    for meshes, minima in ((groove(RIGHT_ANGLE), "all"), (split_groove(), "nearest")):
        model = ball_in(meshes, RIGID, device=device, minima=minima, gravity=(0, 1, -G))
        model["ball.position"] = (0.001, -0.1, RADIUS * math.sqrt(2) + 0.01)
        model["ball.angular_velocity"] = (5.0, 3.0, 8.0)
        integrator = wc.integrators.MoreauJean(tolerance=1e-12)
        recording = wc.Simulation(model, dt=1e-3, integrator=integrator).run(0.3, ["ball.position"], every=0.01)
        motion.append(recording["ball.position"].values)
    np.testing.assert_allclose(*motion, atol=1e-9)


def test_rigid_facets_of_a_trough_count_as_one(device):
    model = ball_in(trough(96), RIGID, device=device, gravity=(0, 0, -G), max_minima=8)
    model["ball.position"] = (0, 0, -4e-4)
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean())
    sim.step(500)
    normal = model.sensor("touch.minimum_normal")[0]
    normal = normal[np.linalg.norm(normal, axis=1) > 0]
    # Facets are 3.75° apart.
    cosines = normal @ normal.T - 2 * np.eye(len(normal))
    assert len(normal) >= 1
    assert cosines.max() < math.cos(math.radians(10))
    np.testing.assert_allclose(model.sensor("touch.force")[0], [0, 0, MASS * G], atol=1e-6)
    assert np.linalg.norm(model.sensor("ball.linear_velocity")) < 1e-9


def test_rigid_ball_that_swings_over_ungrouped_facets_does_not_sink(device):
    model = ball_in(trough(48, radius=0.1), RIGID, envs=2, device=device, gravity=(0, 0, -G), max_minima=8)
    model["touch.group_angle"] = [(math.radians(10), math.radians(40)), (0.0, 0.0)]
    model["touch.friction.mu"] = 0.0
    model["ball.position"] = (0.03, 0, -0.0395)
    integrator = wc.integrators.MoreauJean()
    recording = wc.Simulation(model, dt=1e-3, integrator=integrator).run(2.0, ["ball.position"], every=0.01)
    lowest = recording["ball.position"].values[..., 2].min(axis=0)
    # The lowest position touches the two facets at the bottom; the steps after the release leave an overlap of some g h².
    floor = -(0.1 - RADIUS / math.cos(math.pi / 48))
    assert floor - 1e-4 < lowest[1] < floor + 1e-3
    assert lowest[0] < floor - 1e-3


def test_event_driven_solution_refuses_several_minima(device):
    model = ball_in(corner(), RIGID, device="cpu")
    with pytest.raises(ValueError, match=r"touch\.minima must be 'nearest'"):
        wc.unilateral.EventDriven(model)


def test_run_warns_of_a_sphere_in_a_crease_with_one_closest_point(device):
    for material, options in ((DAMPED, {}), (RIGID, {"integrator": wc.integrators.MoreauJean()})):
        for minima in ("nearest", "all"):
            model = ball_in(
                groove(RIGHT_ANGLE), material, envs=2, device=device, minima=minima, gravity=(0, 0, -G)
            )
            model["ball.position"] = [(0.3, 0, 1), (0.002, 0.01, RADIUS * math.sqrt(2))]
            texts = run_warnings(wc.Simulation(model, dt=2e-4, **options), 0.1)
            if minima == "all":
                assert texts == []
                continue
            (text,) = texts
            assert "touch: a sphere touches several walls of 'wall', up to 90° apart (environment 1)" in text
            assert "Use minima='all'" in text


@pytest.mark.parametrize("place", [(0.05, 0.05, 0.149), (0.1, 0.05, 0.1495), (0.13, 0.12, 0.13)])
def test_run_does_not_warn_of_a_sphere_on_a_convex_body(place, device):
    model = ball_in(wc.meshes.box((0.2, 0.2, 0.2)), DAMPED, device=device, minima="nearest")
    model["ball.position"] = place
    assert run_warnings(wc.Simulation(model, dt=1e-4), 1e-3) == []
    assert model.sensor("touch.status")[0] == wc.ContactStatus.CONTACT


def test_run_warns_of_a_sphere_between_edges_but_not_of_inactive_walls_and_boundaries(device):
    block = wc.meshes.box((1.0, 1.0, 0.1))
    sides = [block.vertices + np.array([side * 0.53, 0, -0.05]) for side in (-1, 1)]
    gap = wc.Mesh(np.concatenate(sides), np.concatenate([block.faces, block.faces + len(block.vertices)]))
    sheet = wc.Mesh([(0.03, -1, 0), (1, -1, 0), (1, 1, 0), (0.03, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    other = wc.Mesh(sheet.vertices * [-1, 1, 1], sheet.faces[:, ::-1])
    sheets = wc.Mesh(
        np.concatenate([sheet.vertices, other.vertices]), np.concatenate([sheet.faces, other.faces + 4])
    )
    # In a slot of 60 mm, the center is 40 mm above the edges.
    cases = {"edges": (gap, {}), "boundary": (sheets, {"boundary": "outer"}), "no boundary": (sheets, {})}
    for case, (mesh, options) in cases.items():
        model = ball_in(mesh, DAMPED, device=device, minima="nearest", **options)
        model["ball.position"] = (0.001, 0.2, 0.039)
        texts = run_warnings(wc.Simulation(model, dt=1e-4), 1e-3)
        assert len(texts) == (0 if case == "no boundary" else 1), case
    scene = wc.Scene(gravity=(0, 0, 0))
    walls = scene.add_surface(corner(), active_faces=[0, 1])
    ball = scene.add_body(1.0, (1, 1, 1), (0.04901, 0.1, 0.049), name="ball")
    options = {"radius": RADIUS, "search": "active", "name": "touch"}
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), walls, DAMPED, **options)
    model = scene.build(envs=1, device=device, precision="float64")
    assert run_warnings(wc.Simulation(model, dt=1e-4), 1e-3) == []
    assert model.sensor("touch.status")[0] == wc.ContactStatus.CONTACT


def test_run_warns_of_more_minima_than_room(device):
    model = ball_in(trough(24), device=device)
    model["ball.position"] = (0, 0, -1.5e-3)
    (text,) = run_warnings(wc.Simulation(model, dt=1e-4), 1e-3)
    assert "touch: a sphere had more than max_minima = 4 minima in 1 of 1 environments" in text
    assert "touch.minimum_overflow counts such steps" in text
