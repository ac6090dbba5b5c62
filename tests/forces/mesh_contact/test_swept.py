"""swept=True: points that cross a thin plate within a step are held on the side they came from."""

import difficult_meshes
import numpy as np
import pytest

import warpcontact as wc
from warpcontact import ContactStatus

PRECISIONS = pytest.mark.parametrize("precision", ["float32", "float64"])
# A spring that stops 1 kg within 0.3 m and 0.1 s: dt = 1e-2 resolves it, but not the crossing of a 2 mm plate.
SPRING = wc.laws.Hooke(stiffness=1e3)
BOUNCE = np.pi * np.sqrt(1.0 / 1e3)


def shoot_balls(
    mesh, start, velocity, *, dt, precision, device, carrier=None, crossing_substeps=1, law=SPRING, **contact
):
    """Returns a simulation of one ball of 1 kg per environment, shot at a surface in free space.

    Args:
        mesh: Mesh of the surface.
        start: Positions (envs, 3).
        velocity: Velocities (envs, 3).
        carrier: Motion of a body that carries the surface, as for ``add_body``; ``None``: it is fixed.
        contact: Keywords of ``add_contact``.
    """
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(1e9, (1e9, 1e9, 1e9), name="carrier", **carrier) if carrier else None
    surface = scene.add_surface(mesh, body, name="plate")
    ball = scene.add_body(1.0, (1e-3, 1e-3, 1e-3), name="ball")
    options = {"swept": True, **contact}
    scene.add_contact(
        scene.add_point(ball, (0, 0, 0)), surface, wc.ContactMaterial(law=law), name="touch", **options
    )
    model = scene.build(envs=len(start), device=device, precision=precision)
    model["ball.position"], model["ball.linear_velocity"] = start, velocity
    return wc.Simulation(model, dt=dt, crossing_substeps=crossing_substeps)


def fan_of_shots(count, side, seed=1):
    """Aims at faces, edges and vertices of the default plate, steeply and flat, from one side at 10 m/s.

    Returns starts, velocities and aims (count, 3). No ball comes near the boundary during a bounce.
    """
    rng = np.random.default_rng(seed)
    third = count // 3
    cells = rng.integers(-2, 3, (count, 2)) * 0.25
    aim = rng.uniform(-0.5, 0.5, (count, 2))
    aim[:third] = cells[:third]  # vertices of the triangulation
    along = rng.random((third, 1))
    edges = np.array([(0.25, 0.0), (0.0, 0.25), (0.25, 0.25), (0.25, -0.25)])[rng.integers(4, size=third)]
    aim[third : 2 * third] = cells[third : 2 * third] + along * edges
    turn, tilt = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 0.35, count)
    tilt[::4] = 0.0
    direction = np.column_stack([np.cos(turn) * np.sin(tilt), np.sin(turn) * np.sin(tilt), -side * np.cos(tilt)])
    aims = np.column_stack([aim, np.full(count, side * 1e-3)])
    velocity = 10.0 * direction
    return aims - velocity * rng.uniform(0.0005, 0.02, (count, 1)), velocity, aims


@PRECISIONS
@pytest.mark.parametrize("dt", [1e-3, 1e-2])
@pytest.mark.parametrize("radius", [0.0, 1e-3])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("entry", ["literal", "latched"])
def test_fast_spheres_do_not_pass_through_a_thin_plate_with_swept(entry, side, radius, dt, precision, device):
    start, velocity, _ = fan_of_shots(600, side)
    sim = shoot_balls(
        difficult_meshes.plate(),
        start,
        velocity,
        dt=dt,
        precision=precision,
        device=device,
        radius=radius,
        entry=entry,
    )
    sim.step(round((0.02 + BOUNCE + 0.03) / dt))
    height = side * sim.model.sensor("ball.position")[:, 2]
    speed = side * sim.model.sensor("ball.linear_velocity")[:, 2]
    assert (speed > 0).all(), f"{(speed <= 0).sum()} of {len(speed)} went through"
    assert (height > 0).all()
    assert (sim.model.sensor("touch.status") == ContactStatus.OPEN).all()
    # A ball that starts h = v t too deep returns with √(1 + ω² t²) of its speed, t ≤ dt.
    gain = speed / np.abs(velocity[:, 2])
    assert gain.max() < np.sqrt(1 + 1e3 * dt**2) + 0.1


@PRECISIONS
def test_fast_spheres_pass_through_a_plate_without_swept(precision, device):
    start, velocity, _ = fan_of_shots(600, 1.0)
    sim = shoot_balls(
        difficult_meshes.plate(), start, velocity, dt=1e-2, precision=precision, device=device, swept=False
    )
    sim.step(16)
    assert (sim.model.sensor("ball.position")[:, 2] < 0).mean() > 0.5


@PRECISIONS
def test_crossings_are_counted_and_timed(precision, device):
    start, velocity, aims = fan_of_shots(300, 1.0)
    sim = shoot_balls(difficult_meshes.plate(), start, velocity, dt=1e-2, precision=precision, device=device)
    assert np.isnan(sim.model.sensor("touch.crossing_time")).all()
    assert (sim.model.sensor("touch.crossings") == 0).all()
    sim.step(20)
    assert (sim.model.sensor("touch.crossings") == 1).all()
    due = (start[:, 2] - aims[:, 2]) / -velocity[:, 2]
    # Positions of order one at 10 m/s; the time itself is of order 0.02.
    exact = {"float32": 1e-6 / 9, "float64": 1e-14 / 9}[precision]
    np.testing.assert_allclose(sim.model.sensor("touch.crossing_time"), due, rtol=0, atol=exact)


def test_crossing_times_late_in_a_run_are_precise(device):
    """The clock is in float64. The remainder of the step is subtracted in float64 and rounded once."""
    start, velocity, aims = fan_of_shots(300, 1.0)
    sim = shoot_balls(difficult_meshes.plate(), start, velocity, dt=1e-2, precision="float32", device=device)
    late = 1000.3
    sim.model.arrays.time.fill_(late)
    sim.step(20)
    due = late + (start[:, 2] - aims[:, 2]) / -velocity[:, 2]
    half = 0.5 * np.spacing(np.float32(late))
    assert np.abs(sim.model.sensor("touch.crossing_time").astype(np.float64) - due).max() < half + 1e-6


@PRECISIONS
def test_reset_clears_crossings_and_latched_faces(precision, device):
    start, velocity, _ = fan_of_shots(30, 1.0)
    sim = shoot_balls(difficult_meshes.plate(), start, velocity, dt=1e-2, precision=precision, device=device)
    names = ("ball.position", "touch.crossings", "touch.crossing_time")

    def run():
        sim.step(5)
        return [sim.model.sensor(name) for name in names]

    first = run()
    mask = np.arange(30) % 2 == 0
    sim.reset(mask)
    assert (sim.model.sensor("touch.crossings") == ~mask).all()
    np.testing.assert_array_equal(np.isnan(sim.model.sensor("touch.crossing_time")), mask)
    sim.reset()
    for before, after in zip(first, run(), strict=True):
        np.testing.assert_array_equal(before, after)


@PRECISIONS
@pytest.mark.parametrize("radius", [0.0, 1e-3])
def test_fast_points_do_not_pass_through_a_rotating_moving_plate(radius, precision, device):
    start, velocity, _ = fan_of_shots(600, 1.0)
    # The plate flies towards the balls and rotates mainly in its plane, with some rotation about the other axes.
    carrier = {"linear_velocity": (0.5, -0.3, 3.0), "angular_velocity": (0.4, -0.3, 5.0)}
    sim = shoot_balls(
        difficult_meshes.plate((6.0, 6.0), cells=(24, 24)),
        start,
        velocity,
        dt=1e-2,
        precision=precision,
        device=device,
        carrier=carrier,
        radius=radius,
    )
    sim.step(20)
    outside = position_in_frame_of(sim.model, "carrier", "ball")
    assert (outside[:, 2] > 0).all(), f"{(outside[:, 2] <= 0).sum()} went through"
    assert (sim.model.sensor("touch.crossings") == 1).all()


def position_in_frame_of(model, body, other):
    """Position of another body in the frame of ``body`` (envs, 3)."""
    away = (model.sensor(f"{other}.position") - model.sensor(f"{body}.position")).astype(np.float64)
    q = model.sensor(f"{body}.orientation").astype(np.float64)
    axis, w = -q[:, :3], q[:, 3:]
    return away + 2 * np.cross(axis, np.cross(axis, away) + w * away)


@PRECISIONS
def test_swept_point_with_long_step_contacts_the_face_it_ends_over(precision, device):
    """A step of 1.3 m across more than a hundred faces: the walk from the crossed face must be as long."""
    mesh = difficult_meshes.plate((2.0, 0.2), cells=(200, 20))
    start, velocity = np.array([[-0.8, 0.013, 0.05]]), np.array([[130.0, 0.3, -10.0]])
    sim = shoot_balls(mesh, start, velocity, dt=1e-2, precision=precision, device=device)
    sim.step()
    np.testing.assert_allclose(sim.model.sensor("touch.gap"), -0.051, atol=1e-6)
    np.testing.assert_allclose(sim.model.sensor("touch.normal"), [[0, 0, 1]], atol=1e-6)


@PRECISIONS
@pytest.mark.parametrize("parts", [1, 4])
@pytest.mark.parametrize("entry", ["literal", "latched"])
def test_search_radius_does_not_hide_a_crossing(entry, parts, precision, device):
    """The point was never within the search radius."""
    sim = shoot_balls(
        difficult_meshes.plate(), [[0.1, 0.2, 0.05]], [[0, 0, -10.0]], dt=1e-2, precision=precision, device=device,
        search_radius=0.03, entry=entry, crossing_substeps=parts,
    )  # fmt: skip
    assert sim.model.sensor("touch.status").tolist() == [ContactStatus.FAR]
    sim.step(20)
    assert sim.model.sensor("ball.linear_velocity")[0, 2] > 0


@PRECISIONS
def test_point_on_the_inner_side_is_not_armed_by_a_crossing(precision, device):
    """From between the faces of a thick plate into a plate under it, in one step."""
    thick, under = (
        difficult_meshes.plate(thickness=0.1),
        difficult_meshes.moved(difficult_meshes.plate(), (0, 0, -0.1)),
    )
    both = wc.Mesh(
        np.concatenate([thick.vertices, under.vertices]),
        np.concatenate([thick.faces, under.faces + len(thick.vertices)]),
    )
    for start, status in ((0.02, ContactStatus.WRONG_SIDE), (0.0, ContactStatus.FAR)):
        sim = shoot_balls(
            both, [[0.1, 0.2, start]], [[0, 0, -15.0]], dt=1e-2, precision=precision, device=device,
            search_radius=0.04, entry="latched",
        )  # fmt: skip
        assert sim.model.sensor("touch.status").tolist() == [status]
        sim.step()
        # A point with status FAR can have come from the outer side, so its crossing counts.
        assert sim.model.sensor("touch.crossings").tolist() == [int(status == ContactStatus.FAR)]


@PRECISIONS
@pytest.mark.parametrize("gap", [0.02, 0.05, 0.09])
def test_ball_between_two_plates_stays_between_them(gap, precision, device):
    """A ball may leave one plate and enter the other within one step."""
    lower, upper = (difficult_meshes.moved(difficult_meshes.plate(cells=(2, 2)), (0, 0, z)) for z in (0.0, gap))
    both = wc.Mesh(
        np.concatenate([lower.vertices, upper.vertices]),
        np.concatenate([lower.faces, upper.faces + len(lower.vertices)]),
    )
    start = np.column_stack([np.zeros((50, 2)), np.linspace(0.002, gap - 0.002, 50)])
    velocity = np.tile([0.0, 0.0, -10.0], (50, 1))
    sim = shoot_balls(
        both, start, velocity, dt=1e-2, precision=precision, device=device, law=wc.laws.Hooke(stiffness=8e3)
    )
    seen = 0
    for _ in range(40):
        sim.step()
        free = sim.model.sensor("touch.status") == ContactStatus.OPEN
        height = sim.model.sensor("ball.position")[free, 2]
        assert ((height > 0) & (height < gap)).all()
        seen += len(height)
    assert seen >= 50
    assert (sim.model.sensor("touch.crossings") > 3).all()


@PRECISIONS
def test_rolling_ball_does_not_pass_through_a_wall_of_the_same_surface(precision, device):
    """The ball is in contact with the floor. The wall belongs to the same surface but is not connected."""
    floor, wall = wc.meshes.grid((4.0, 4.0), (4, 4)), difficult_meshes.plate((0.5, 2.0), cells=(2, 2))
    upright = np.column_stack([wall.vertices[:, 2] + 1.0, wall.vertices[:, 1], 0.3 - wall.vertices[:, 0]])
    both = wc.Mesh(
        np.concatenate([floor.vertices, upright]), np.concatenate([floor.faces, wall.faces + len(floor.vertices)])
    )
    x = np.linspace(0.7, 0.8, 40)
    start = np.column_stack([x, 0 * x, np.full(40, 0.09)])
    sim = shoot_balls(
        both, start, np.tile([20.0, 0, 0], (40, 1)), dt=1e-2, precision=precision, device=device, radius=0.1
    )
    sim.step(40)
    assert (sim.model.sensor("ball.linear_velocity")[:, 0] < 0).all()


@PRECISIONS
def test_inactive_faces_let_points_pass(precision, device):
    mesh = difficult_meshes.plate()
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    right = np.flatnonzero(middle[:, 0] > 0)
    start = np.array([[-0.3, 0.1, 0.05], [0.3, 0.1, 0.05]])
    scene = wc.Scene(gravity=(0, 0, 0))
    surface = scene.add_surface(mesh, name="plate", active_faces=right)
    ball = scene.add_body(1.0, (1e-3, 1e-3, 1e-3), name="ball", linear_velocity=(0, 0, -10))
    scene.add_contact(
        scene.add_point(ball, (0, 0, 0)), surface, wc.ContactMaterial(law=SPRING), name="touch", swept=True
    )
    model = scene.build(envs=2, precision=precision, device=device)
    model["ball.position"] = start
    wc.Simulation(model, dt=1e-2).step(20)
    assert model.sensor("touch.crossings").tolist() == [0, 1]
    np.testing.assert_allclose(model.sensor("ball.linear_velocity")[0], (0, 0, -10))
    assert model.sensor("ball.linear_velocity")[1, 2] > 0


@PRECISIONS
def test_disabled_contact_lets_points_pass_and_counts_no_crossing(precision, device):
    sim = shoot_balls(
        difficult_meshes.plate(), [[0.1, 0.2, 0.05]] * 2, [[0, 0, -10.0]] * 2, dt=1e-2, precision=precision,
        device=device,
    )  # fmt: skip
    sim.model["touch.enabled"] = [1, 0]
    sim.step(20)
    assert sim.model.sensor("touch.crossings").tolist() == [1, 0]
    assert (sim.model.sensor("ball.linear_velocity")[:, 2] > 0).tolist() == [True, False]


@PRECISIONS
def test_point_leaving_over_the_boundary_is_open(precision, device):
    """The point crosses 1 cm inside the boundary and is outside the boundary at the end of the step."""
    start, velocity = np.array([[0.98, 0.1, 0.011]]), np.array([[10.0, 0.0, -10.0]])
    sim = shoot_balls(difficult_meshes.plate(), start, velocity, dt=1e-2, precision=precision, device=device)
    sim.step(20)
    np.testing.assert_allclose(sim.model.sensor("ball.linear_velocity"), velocity)
    assert sim.model.sensor("touch.crossings").tolist() == [1]
