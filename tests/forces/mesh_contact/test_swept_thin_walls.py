"""swept=True against thin walls that are curved or meet at an angle: no point passes through."""

import difficult_meshes
import numpy as np
import pytest
from test_swept import PRECISIONS, shoot_balls

import warpcontact as wc
from warpcontact import ContactStatus

ENTRIES = pytest.mark.parametrize("entry", ["literal", "latched"])
COUNT = 500


def shell(mesh, thickness=2e-3):
    """A closed mesh about the origin and a slightly smaller inverted copy inside: a wall around a cavity."""
    inner = (1.0 - thickness) * mesh.vertices
    return wc.Mesh(
        np.concatenate([mesh.vertices, inner]), np.concatenate([mesh.faces, mesh.faces[:, ::-1] + len(inner)])
    )


def at_edges_and_corners(rng):
    """Starts inside a box of 2 m; aims at its edges and vertices, in turn."""
    aim = rng.uniform(-1, 1, (COUNT, 3))
    axis, item = rng.integers(3, size=COUNT), np.arange(COUNT)
    for one in (axis, (axis + 1) % 3):
        aim[item, one] = rng.choice([-1, 1], COUNT)
    aim[::2] = np.sign(aim[::2])
    return rng.uniform(-0.5, 0.5, (COUNT, 3)), aim


def all_around(rng):
    """Starts inside a ball of radius 1; aims in all directions."""
    aim = rng.normal(size=(COUNT, 3))
    return rng.uniform(-0.4, 0.4, (COUNT, 3)), aim / np.linalg.norm(aim, axis=1)[:, None]


def assert_contained(mesh, start, aim, speed, stiffness, steps, *, within, **options):
    """Shoots from inside; asserts that a point outside at any time has a contact force towards the inside."""
    away = aim - start
    velocity = speed * away / np.linalg.norm(away, axis=1)[:, None]
    law = wc.laws.Hooke(stiffness=stiffness)
    sim = shoot_balls(shell(mesh), start, velocity, dt=1e-2, law=law, **options)
    for _ in range(steps // 10):
        sim.step(10)
        place = sim.model.sensor("ball.position")
        inwards = (sim.model.sensor("touch.normal") * place).sum(axis=1) < 0
        held = (sim.model.sensor("touch.status") == ContactStatus.CONTACT) & inwards
        leaked = ~within(place) & ~held
        assert not leaked.any(), f"{leaked.sum()} of {COUNT} leaked"
    assert (sim.model.sensor("touch.crossings") > 0).all()


@PRECISIONS
@ENTRIES
@pytest.mark.parametrize("parts", [1, 16])
def test_points_do_not_leave_a_hollow_box(parts, entry, precision, device):
    assert_contained(
        wc.meshes.box((2.0, 2.0, 2.0)), *at_edges_and_corners(np.random.default_rng(0)), 20.0, 1e3, 60,
        within=lambda place: np.abs(place).max(axis=1) < 1.0 - 1e-3,
        crossing_substeps=parts, entry=entry, precision=precision, device=device,
    )  # fmt: skip


@PRECISIONS
@ENTRIES
@pytest.mark.parametrize(
    ("speed", "stiffness", "steps"),
    [(20.0, 1e3, 60), pytest.param(20.0, 1e4, 60, marks=pytest.mark.slow), (5.0, 1e3, 100)],
)
def test_points_do_not_leave_a_hollow_sphere(speed, stiffness, steps, entry, precision, device):
    assert_contained(
        wc.meshes.icosphere(1.0, 2), *all_around(np.random.default_rng(0)), speed, stiffness, steps,
        within=lambda place: np.linalg.norm(place, axis=1) < 1.0,
        entry=entry, precision=precision, device=device,
    )  # fmt: skip


@PRECISIONS
@ENTRIES
@pytest.mark.parametrize("stiffness", [1e3, pytest.param(1e4, marks=pytest.mark.slow)])
def test_points_do_not_pass_walls_at_an_acute_angle(stiffness, entry, precision, device):
    """Beyond such an edge, the face that the point left is as near as the one that it crossed."""
    mesh = difficult_meshes.moved(difficult_meshes.tetrahedron(), np.full(3, -0.25))
    rng = np.random.default_rng(0)

    def inside(place, size=1.0):
        return (place.min(axis=1) > -0.25 * size) & (place.sum(axis=1) < 0.25 * size)

    start = rng.uniform(-0.25, 0.75, (20 * COUNT, 3))
    start = start[inside(start, 0.9)][:COUNT]
    weights = rng.dirichlet([0.4, 0.4, 0.4], COUNT)
    aim = np.einsum("ni,nij->nj", weights, mesh.vertices[mesh.faces[rng.integers(4, size=COUNT)]])
    assert_contained(
        mesh, start, aim, 20.0, stiffness, 60, within=inside, entry=entry, precision=precision, device=device
    )  # fmt: skip


@PRECISIONS
@ENTRIES
def test_crossed_box_does_not_hide_the_wall_behind_it(entry, precision, device):
    """In through the top of a box, out through its side, and into the plate under it, all in one step."""
    box, plate = wc.meshes.box((0.2, 0.2, 0.2)), difficult_meshes.moved(difficult_meshes.plate(), (0, 0, -0.2))
    both = wc.Mesh(
        np.concatenate([box.vertices, plate.vertices]),
        np.concatenate([box.faces, plate.faces + len(box.vertices)]),
    )
    start, velocity = np.array([[0.05, 0.01, 0.12]]), np.array([[10.0, 0.0, -40.0]])
    sim = shoot_balls(
        both, start, velocity, dt=1e-2, precision=precision, device=device, entry=entry,
        law=wc.laws.Hooke(stiffness=1e4),
    )  # fmt: skip
    sim.step()
    np.testing.assert_allclose(sim.model.sensor("touch.gap"), -0.081, atol=1e-6)
    np.testing.assert_allclose(sim.model.sensor("touch.normal"), [[0, 0, 1]], atol=1e-6)
    assert sim.model.sensor("touch.crossings").tolist() == [1]
    sim.step(10)
    assert sim.model.sensor("ball.linear_velocity")[0, 2] > 0
