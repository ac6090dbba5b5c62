"""Latched contacts track the part of the surface where contact began: through plates and over edges."""

from itertools import pairwise

import difficult_meshes
import numpy as np
import pytest
from test_swept import PRECISIONS

import warpcontact as wc
from warpcontact import ContactStatus


def pushed(mesh, path, *, precision, device, entry="latched", radius=0.0, surface=None, **contact):
    """Moves a point along ``path`` (steps, 3); returns the model and the sensors at all positions.

    The velocity is prescribed, and the mass so large that contact does not change it.
    """
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(mesh, name="ground", **(surface or {}))
    body = scene.add_body(1e12, (1e12, 1e12, 1e12), path[0], name="body")
    spring = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(
        scene.add_point(body, (0, 0, 0)), ground, spring, name="touch", entry=entry, radius=radius, **contact
    )
    model = scene.build(precision=precision, device=device)
    sim = wc.Simulation(model, dt=1.0)
    seen = {name: [] for name in ("gap", "normal", "status", "normal_force")}
    for place, following in pairwise(path):
        model.state.body_position.assign(np.array([[place]]))
        model.state.body_linear_velocity.assign(np.array([[np.subtract(following, place)]]))
        for name, values in seen.items():
            values.append(model.sensor(f"touch.{name}")[0])
        sim.step()
    return model, {name: np.array(values) for name, values in seen.items()}


def line(*corners, count=20):
    """A path through ``corners`` in ``count`` steps each."""
    legs = [np.linspace(a, b, count, endpoint=False) for a, b in pairwise(corners)]
    return np.concatenate([*legs, [corners[-1]]])


@PRECISIONS
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_latched_point_deeper_than_half_a_plate_is_pushed_back(side, precision, device):
    path = line((0.1, 0.2, side * 0.02), (0.13, 0.24, -side * 0.05))
    _, seen = pushed(difficult_meshes.plate(thickness=0.02), path, precision=precision, device=device)
    inside = side * path[:-1, 2] < 0.01
    assert inside.sum() > 10
    assert (seen["status"][inside] == ContactStatus.CONTACT).all()
    np.testing.assert_allclose(seen["gap"], side * path[:-1, 2] - 0.01, atol=1e-6)
    np.testing.assert_allclose(seen["normal"][inside], np.tile((0, 0, side), (inside.sum(), 1)), atol=1e-5)
    _, literal = pushed(
        difficult_meshes.plate(thickness=0.02), path, precision=precision, device=device, entry="literal"
    )
    assert (literal["normal"][inside, 2] * side < 0).any()


@PRECISIONS
def test_point_from_the_inner_side_is_not_latched(precision, device):
    path = line((0.1, 0.2, 0.003), (0.1, 0.2, 0.03), (0.12, 0.2, 0.004))
    _, seen = pushed(difficult_meshes.plate(thickness=0.02), path, precision=precision, device=device)
    inner = path[:-1, 2] < 0.01
    assert (seen["status"][:20][inner[:20]] == ContactStatus.WRONG_SIDE).all()
    assert (seen["normal_force"][:20] == 0).all()
    # It was outside before, so it is in contact now.
    assert (seen["status"][20:][inner[20:]] == ContactStatus.CONTACT).all()


@PRECISIONS
def test_point_from_the_inner_side_is_not_latched_by_swept_test(precision, device):
    path = line((0.1, 0.2, 0.003), (0.1, 0.2, -0.03), count=3)
    model, seen = pushed(
        difficult_meshes.plate(thickness=0.02), path, precision=precision, device=device, swept=True
    )
    assert (seen["normal_force"] == 0).all()
    assert model.sensor("touch.crossings").tolist() == [0]


@PRECISIONS
def test_latched_point_follows_over_convex_edges_and_into_valleys(precision, device):
    """A faceted ball from inside and outside: the contact face is the facet under the point, all around."""
    for mesh, depth in ((wc.meshes.icosphere(1.0, 2), 0.6), (wc.meshes.icosphere(1.0, 2).flipped(), -0.6)):
        turn = np.linspace(0, 2 * np.pi, 200)
        ring = np.column_stack([np.cos(turn), np.sin(turn), 0.05 * np.sin(3 * turn)])
        touch = line((1.3, 0, 0) if depth > 0 else (0.7, 0, 0), ring[0] * (1.0 - depth))
        path = np.concatenate([touch[:-1], ring * (1.0 - depth)])
        _, seen = pushed(mesh, path, precision=precision, device=device)
        around = slice(len(touch) - 1, None)
        assert (seen["status"][around] == ContactStatus.CONTACT).all()
        # Outwards, within the angle of the facets seen from half the distance to the center.
        outward = np.sign(depth) * path[:-1] / np.linalg.norm(path[:-1], axis=1)[:, None]
        assert np.einsum("ni,ni->n", seen["normal"], outward)[around].min() > 0.8
        np.testing.assert_allclose(seen["gap"][around], -abs(depth), atol=0.05)


@PRECISIONS
def test_latched_sphere_in_a_valley_contacts_the_nearer_slope(precision, device):
    flat = wc.meshes.grid((2.0, 2.0), (8, 8))
    valley = wc.Mesh(np.column_stack([flat.vertices[:, :2], np.abs(flat.vertices[:, 0])]), flat.faces)
    # No point of this path is equally near to both slopes.
    path = line((-0.4, 0.03, 0.8), (-0.4, 0.03, 0.5), (0.41, 0.07, 0.5), (0.41, 0.07, 0.6))
    for swept in (False, True):
        _, seen = pushed(valley, path, precision=precision, device=device, radius=0.15, swept=swept)
        _, literal = pushed(valley, path, precision=precision, device=device, radius=0.15, entry="literal")
        for name, values in seen.items():
            np.testing.assert_allclose(values, literal[name], atol=1e-6, err_msg=name)


@PRECISIONS
def test_latched_point_leaves_over_an_edge_without_force(precision, device):
    path = line((0.9, 0.1, 0.02), (0.9, 0.1, 0.006), (1.1, 0.1, 0.006), (1.3, 0.1, -0.1))
    _, seen = pushed(difficult_meshes.plate(thickness=0.02), path, precision=precision, device=device)
    over = path[:-1, 0] > 1.0 + 1e-6
    assert (seen["status"][over] == ContactStatus.OPEN).all()
    touching = (path[:-1, 2] < 0.01 - 1e-6) & (path[:-1, 0] < 1.0 - 1e-6)
    assert (seen["status"][touching] == ContactStatus.CONTACT).all()


@PRECISIONS
def test_latched_point_in_a_box_contacts_floor_and_walls(precision, device):
    """An inverted box: from inside, each wall is in contact where the point penetrates it."""
    room = wc.meshes.box((2.0, 2.0, 2.0)).flipped()
    path = line((0, 0, 0), (0, 0, -1.1), (0.9, 0, -1.1), (1.2, 0.1, -0.8), (0.5, 0, 0), (0.5, 1.3, 0))
    _, seen = pushed(room, path, precision=precision, device=device)
    outside = np.abs(path[:-1]).max(axis=1) > 1.0 + 1e-6
    assert (seen["status"][outside] == ContactStatus.CONTACT).all()
    assert (seen["status"][np.abs(path[:-1]).max(axis=1) < 1.0 - 1e-6] == ContactStatus.OPEN).all()
    inward = np.einsum("ni,ni->n", seen["normal"], -path[:-1])
    assert (inward[outside] > 0).all()


@PRECISIONS
def test_latched_face_is_cleared_after_a_change_of_mesh(precision, device):
    """The same box with its faces in another order: the index of a top face is that of a bottom face."""
    box = wc.meshes.box((2.0, 2.0, 1.0))
    turned = wc.Mesh(box.vertices, box.faces[::-1])
    for entry, swept in (("latched", False), ("literal", True)):
        path = line((0.1, 0.2, 0.6), (0.1, 0.2, 0.4), count=4)
        model, _ = pushed([box, turned], path, precision=precision, device=device, entry=entry, swept=swept)
        before = {name: model.sensor(f"touch.{name}") for name in ("gap", "normal", "status")}
        assert before["status"][0] == ContactStatus.CONTACT
        model["ground.mesh"] = 1
        for name, value in before.items():
            np.testing.assert_allclose(model.sensor(f"touch.{name}"), value, atol=1e-6)


@PRECISIONS
def test_latched_face_is_cleared_if_contact_is_disabled_or_lost(precision, device):
    path = line((0.1, 0.2, 0.02), (0.1, 0.2, -0.005), count=4)
    model, _ = pushed(difficult_meshes.plate(thickness=0.02), path, precision=precision, device=device)
    assert model.sensor("touch.normal")[0, 2] > 0.9
    sim = wc.Simulation(model, dt=1e-9)
    model["touch.enabled"] = 0
    sim.step()
    assert model.sensor("touch.status")[0] == ContactStatus.DISABLED
    model["touch.enabled"] = 1
    # The latch persists, but the face is cleared: the nearest face is now on the other side.
    assert model.sensor("touch.normal")[0, 2] < -0.9
    sim.reset()
    model.state.body_position.assign(np.array([[path[-1]]]))
    assert model.sensor("touch.status")[0] == ContactStatus.WRONG_SIDE


@PRECISIONS
def test_latched_point_follows_a_written_state_along_the_surface(precision, device):
    """From one end of a finely divided plate to the other, and off the plate."""
    mesh = difficult_meshes.plate((2.0, 0.2), thickness=0.02, cells=(400, 20))
    path = line((-0.9, 0.0, 0.02), (-0.9, 0.0, -0.005), count=4)
    model, _ = pushed(mesh, path, precision=precision, device=device)
    model.state.body_position.assign(np.array([[[0.93, 0.05, -0.007]]]))
    np.testing.assert_allclose(model.sensor("touch.gap"), -0.017, atol=1e-6)
    np.testing.assert_allclose(model.sensor("touch.normal"), [[0, 0, 1]], atol=1e-5)
    model.state.body_position.assign(np.array([[[0.93, 0.05, 0.5]]]))
    assert model.sensor("touch.status")[0] == ContactStatus.OPEN
    np.testing.assert_allclose(model.sensor("touch.gap"), 0.49, atol=1e-6)
