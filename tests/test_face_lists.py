"""Lists of near faces: those that are kept in registers, for a GPU, are those that are kept in memory."""

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels import foot as feet
from warpcontact.kernels import search
from warpcontact.kernels.types import REMEMBERED_IN_QUEUES, structs

import warpcontact as wc

POINTS = 2000


def listed(real, how, points, device):
    """Returns (number, reach, rows of faces, row of the nearest) of the list of each point over a terrain."""
    t = structs(real)
    model_type, cache_type, vec3 = t.Model, t.Cache, t.vec3
    of_search = search.functions(real, REMEMBERED_IN_QUEUES)
    foot_on = feet.functions(real).foot_on
    to_list = of_search.nearest_to_remember if how == "in memory" else of_search.nearest_to_remember_aside

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

    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.sinusoidal_terrain((4, 4), (40, 40), 0.2, 2.5))
    body = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    law = wc.laws.Hooke(stiffness=1e4)
    # Faces near swept points are remembered on a GPU, too.
    scene.add_contact(scene.add_points(body, points), ground, wc.Template(law=law), radius=0.1, swept=True)
    precision = "float32" if real is wp.float32 else "float64"
    # Its meshes live as long as the model.
    model = scene.build(device=device, precision=precision)
    arrays = model.parts[0].arrays
    places = wp.array(points, dtype=vec3, device=device)
    best = wp.zeros(len(points), dtype=wp.int32, device=device)
    wp.launch(list_all, len(points), [arrays.model, arrays.cache, places, best], device=device)
    cache = arrays.cache
    count, reach = cache.faces.numpy()[0], cache.beyond.numpy()[0]
    rows = []
    for contact, number in enumerate(count):
        own = slice(contact * REMEMBERED_IN_QUEUES, contact * REMEMBERED_IN_QUEUES + number)
        faces, distances = cache.face.numpy()[0][own], cache.distance.numpy()[0][own]
        # Of several that are the farthest any may be there.
        rows.append(sorted(faces[distances < reach[contact]]))
    return count, reach, rows, best.numpy()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_lists_in_registers_are_those_in_memory(real, device):
    points = np.random.default_rng(5).uniform([-1.9, -1.9, -0.1], [1.9, 1.9, 0.6], (POINTS, 3))
    in_memory, aside = (listed(real, how, points, device) for how in ("in memory", "aside"))
    # Some have room left, and of others the farthest had to go.
    count = in_memory[0]
    assert ((count > 0) & (count < REMEMBERED_IN_QUEUES)).sum() > 50
    assert (count == REMEMBERED_IN_QUEUES).sum() > 50
    np.testing.assert_array_equal(aside[0], count)
    np.testing.assert_array_equal(aside[1], in_memory[1])
    assert aside[2] == in_memory[2]
    np.testing.assert_array_equal(aside[3], in_memory[3])
