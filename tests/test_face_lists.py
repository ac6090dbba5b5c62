"""Lists of near faces: those that are kept in registers, for a GPU, are those that are kept in memory."""

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels import foot as feet
from warpcontact.kernels import search
from warpcontact.kernels.types import structs

import warpcontact as wc

POINTS = 2000


def lister(real, aside):
    """Returns the kernel that makes the list of each of some places, and tells the row of its nearest face.

    ``aside``: how many faces are kept in registers; ``None``: in memory, as many as there is room for.
    """
    t = structs(real)
    model_type, cache_type, vec3 = t.Model, t.Cache, t.vec3
    foot_on = feet.functions(real).foot_on
    to_list = search.functions(real).nearest_to_remember
    if aside is not None:
        to_list = search.nearest_to_remember_aside(real, aside)

    @wp.kernel(module="unique", enable_backward=False)
    def list_all(
        model: model_type, cache: cache_type, places: wp.array(dtype=vec3), best: wp.array(dtype=wp.int32)
    ):
        contact = wp.tid()
        p = places[contact]
        place = wp.vec3f(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
        query = wp.mesh_query_point_no_sign(model.patch_mesh[0], place, wp.float32(10.0))
        first = foot_on(model, model.patch_face_start[0] + query.face, p)
        foot = to_list(model, 0, p, first, real(1e-6), cache, 0, contact)
        best[contact] = foot.row

    return list_all


def over_terrain(real, points, device):
    """Returns a model of points over a terrain, whose meshes live as long."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.sinusoidal_terrain((4, 4), (40, 40), 0.2, 2.5))
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    law = wc.laws.Hooke(stiffness=1e4)
    # Faces near swept points are remembered on a GPU, too.
    scene.add_contact(scene.add_points(body, points), ground, wc.Template(law=law), radius=0.1, swept=True)
    precision = "float32" if real is wp.float32 else "float64"
    return scene.build(device=device, precision=precision)


def room_in(model):
    """Returns how many faces are remembered per contact."""
    cache = model.parts[0].arrays.cache
    return cache.face.shape[1] // cache.faces.shape[1]


def nearest_listed(real, aside, model, points, device):
    """Makes the lists of all points; returns the rows of their nearest faces."""
    arrays = model.parts[0].arrays
    places = wp.array(points, dtype=structs(real).vec3, device=device)
    best = wp.zeros(len(points), dtype=wp.int32, device=device)
    wp.launch(lister(real, aside), len(points), [arrays.model, arrays.cache, places, best], device=device)
    return best.numpy()


def listed(real, how, points, device):
    """Returns (number, reach, rows of faces, row of the nearest) of the list of each point over a terrain."""
    model = over_terrain(real, points, device)
    room = room_in(model)
    best = nearest_listed(real, room if how == "aside" else None, model, points, device)
    arrays = model.parts[0].arrays
    cache = arrays.cache
    count, reach = cache.faces.numpy()[0], cache.beyond.numpy()[0]
    rows = []
    for contact, number in enumerate(count):
        own = slice(contact * room, contact * room + number)
        faces, distances = cache.face.numpy()[0][own], cache.distance.numpy()[0][own]
        # Of several that are the farthest any may be there.
        rows.append(sorted(faces[distances < reach[contact]]))
    return count, reach, rows, best, room


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_lists_in_registers_are_those_in_memory(real, device):
    points = np.random.default_rng(5).uniform([-1.9, -1.9, -0.1], [1.9, 1.9, 0.6], (POINTS, 3))
    in_memory, aside = (listed(real, how, points, device) for how in ("in memory", "aside"))
    # Some have room left, and of others the farthest had to go.
    count, room = in_memory[0], in_memory[-1]
    assert ((count > 0) & (count < room)).sum() > 50
    assert (count == room).sum() > 50
    np.testing.assert_array_equal(aside[0], count)
    np.testing.assert_array_equal(aside[1], in_memory[1])
    assert aside[2] == in_memory[2]
    np.testing.assert_array_equal(aside[3], in_memory[3])


def distances(real, model, points, device):
    """Returns the distance of each face from each point (point, face)."""
    t = structs(real)
    model_type, vec3, foot_on = t.Model, t.vec3, feet.functions(real).foot_on

    @wp.kernel(module="unique", enable_backward=False)
    def measure(model: model_type, places: wp.array(dtype=vec3), found: wp.array2d(dtype=real)):
        point, face = wp.tid()
        found[point, face] = foot_on(model, face, places[point]).distance

    own = model.parts[0].arrays.model
    found = wp.zeros((len(points), own.face_corner.shape[0]), dtype=real, device=device)
    places = wp.array(points, dtype=vec3, device=device)
    wp.launch(measure, found.shape, [own, places, found], device=device)
    return found.numpy()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_a_list_made_ahead_holds_all_faces_about_there_and_the_nearest_here(real):
    rng = np.random.default_rng(6)
    points = rng.uniform([-1.8, -1.8, -0.1], [1.8, 1.8, 0.4], (400, 3))
    model = over_terrain(real, points, "cpu")
    cache = model.parts[0].arrays.cache
    nearest_listed(real, None, model, points, "cpu")
    np.testing.assert_array_equal(cache.place.numpy()[0], points.astype(cache.place.numpy().dtype))  # no way yet
    reached = cache.beyond.numpy()[0] - distances(real, model, points, "cpu").min(axis=1)
    way = rng.normal(size=points.shape)
    # They leave their lists, but for those that jump, and one whose last place is not known.
    length = 1.01 * reached
    length[::8] = 3.0 * model.parts[0].arrays.model.patch_skin.numpy()[0]
    way *= (length / np.linalg.norm(way, axis=1))[:, None]
    here = points + way
    last = cache.place.numpy()
    last[0, 5] = np.nan
    cache.place.assign(last)
    nearest = nearest_listed(real, None, model, here, "cpu")

    place, beyond, count = cache.place.numpy()[0], cache.beyond.numpy()[0], cache.faces.numpy()[0]
    ahead = np.linalg.norm(place - here, axis=1)
    stay = np.zeros(len(points), dtype=bool)
    stay[::8] = stay[5] = True
    assert np.isfinite(place).all()
    assert ahead[stay].max() < 1e-6
    # Each goes ahead by what the last list reached, except where the surface came nearer or fell away by much.
    forward = np.einsum("pk,pk->p", place - here, way) / np.linalg.norm(way, axis=1)
    assert (forward[~stay] > 0.4 * reached[~stay]).mean() > 0.7
    assert forward[~stay].min() > -1e-6
    from_here, from_there = (distances(real, model, where, "cpu") for where in (here, place))
    # Rounding of coordinates of two metres.
    room = 1e-6 if real is wp.float32 else 1e-14
    assert (from_here[np.arange(len(here)), nearest] <= from_here.min(axis=1) + room).all()
    for point, number in enumerate(count):
        own = slice(point * room_in(model), point * room_in(model) + number)
        faces, least = cache.face.numpy()[0][own], cache.distance.numpy()[0][own]
        assert len(set(faces)) == number > 0
        assert (least <= from_there[point, faces] + room).all()
        others = np.delete(from_there[point], faces)
        assert others.min() >= beyond[point] - room


@pytest.mark.parametrize(
    ("radius", "scale", "least", "most"),
    [(0.0, 1.0, 16, 16), (0.09, 1.0, 20, 30), (0.9, 10.0, 20, 30), (0.9, 1.0, 48, 48)],
)
def test_more_faces_are_remembered_of_larger_spheres(radius, scale, least, most):
    """By their edges, in the unit of the mesh; the surface and the sphere with the most tell for all."""
    scene = wc.Scene()
    coarse, fine = (wc.meshes.sinusoidal_terrain((3, 3), (n, n), 0.1, 1.0) for n in (10, 100))
    ground = scene.add_surface([coarse, fine], scale=scale)
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    points = scene.add_points(body, np.zeros((3, 3)))
    template = wc.Template(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(points, ground, template, radius=[0.0, radius, 0.0])
    assert least <= room_in(scene.build(device="cpu")) <= most
