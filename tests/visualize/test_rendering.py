"""Ray casting against closed forms."""

import math
import tracemalloc

import numpy as np
import pytest
import warp as wp
from handmade_drawings import PLATE, balls, camera, covered, drawing, figure, paint
from warpcontact.kernels.rendering.world import CONE, CYLINDER, SPHERE, World, intersect_shape, shape_normal, trace

from warpcontact.drawing.colors import linear
from warpcontact.drawing.drawing import Shape, ball
from warpcontact.meshes import icosphere
from warpcontact.visualize.rendering.painter import Painter, light_of
from warpcontact.visualize.rendering.stage import Items, Stage, place_figure

BLUE, RED = (0.1, 0.2, 0.9), (0.9, 0.1, 0.1)


@wp.kernel(module="unique", enable_backward=False)
def intersect_all(
    kind: int,
    origin: wp.array(dtype=wp.vec3),
    along: wp.array(dtype=wp.vec3),
    distance: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    distance[i] = intersect_shape(kind, origin[i], along[i])
    p = origin[i] + distance[i] * along[i]
    normal[i] = wp.normalize(shape_normal(kind, p, wp.vec3(1.0, 1.0, 1.0)))


@wp.kernel(module="unique", enable_backward=False)
def trace_all(
    world: World,
    origin: wp.array(dtype=wp.vec3),
    along: wp.array(dtype=wp.vec3),
    item: wp.array(dtype=int),
    distance: wp.array(dtype=float),
):
    i = wp.tid()
    hit = trace(world, origin[i], along[i], 1.0e6)
    item[i] = hit.item
    distance[i] = hit.t


def inside(kind, p):
    """Whether points are inside of a unit shape, by its definition."""
    radius = np.hypot(p[..., 0], p[..., 1])
    between = (p[..., 2] >= 0.0) & (p[..., 2] <= 1.0)
    if kind == SPHERE:
        return np.linalg.norm(p, axis=-1) <= 1.0
    return between & (radius <= (1.0 if kind == CYLINDER else 1.0 - p[..., 2]))


@pytest.mark.parametrize("kind", [SPHERE, CYLINDER, CONE])
def test_ray_intersections_match_shapes(kind, device):
    rng = np.random.default_rng(0)
    count = 3000
    origin = rng.normal(size=(count, 3))
    origin *= (rng.uniform(2.0, 4.0, count) / np.linalg.norm(origin, axis=1))[:, None]
    along = rng.uniform((-0.8, -0.8, -0.5), (0.8, 0.8, 1.1), (count, 3)) - origin
    along[:50] *= 3.0  # lengths other than 1
    along[50:60] = (0.0, 0.0, -1.0)  # along the axis
    arrays = [wp.array(v.astype(np.float32), dtype=wp.vec3, device=device) for v in (origin, along)]
    distance, normal = wp.zeros(count, dtype=float, device=device), wp.zeros(count, dtype=wp.vec3, device=device)
    wp.launch(intersect_all, dim=count, inputs=[kind, *arrays], outputs=[distance, normal], device=device)
    t, n = distance.numpy().astype(float), normal.numpy()
    steps = np.linspace(0.0, 3.0, 3001)
    within = inside(kind, origin[:, None] + steps[:, None] * along[:, None])
    first = np.where(within.any(axis=1), steps[within.argmax(axis=1)], np.inf)
    intersects = t > 0.0
    assert intersects.sum() > 500
    # A grazing ray may pass between two steps, or be lost to rounding.
    step = steps[1]
    assert (np.abs(t - first)[intersects & np.isfinite(first)] <= 1.01 * step).all()
    assert (intersects == np.isfinite(first)).mean() > 0.99
    # Just before the point, against the normal, it is outside, and just behind it inside.
    p = origin + t[:, None] * along
    assert not inside(kind, p + 1e-4 * n)[intersects].any()
    assert inside(kind, p - 1e-4 * n)[intersects].mean() > 0.99


def test_rendered_sphere_covers_its_projected_disk(device):
    radius, distance, angle, side = 1.3, 9.0, 24.0, 400
    picture = paint(
        [balls(BLUE, [0.0, 0.0, 0.0], radius)],
        camera(30, 20, distance=distance, angle=angle),
        (side, side),
        device=device,
    )
    mask = covered(picture)
    # Tangent rays make the angle asin(r/d) with the axis.
    disc = 0.5 * side * math.tan(math.asin(radius / distance)) / math.tan(math.radians(0.5 * angle))
    # Pixels on the edge have an error of half a pixel, and these errors cancel.
    assert mask.sum() == pytest.approx(math.pi * disc**2, rel=3e-3)
    rows, columns = np.nonzero(mask)
    assert (columns + 0.5).mean() == pytest.approx(0.5 * side, abs=0.1)
    assert (rows + 0.5).mean() == pytest.approx(0.5 * side, abs=0.1)


def test_rendered_mesh_covers_the_shape_it_approximates(device):
    mesh = icosphere(1.0, 4)
    turn = np.array([0.3, -0.2, 0.5, 0.8]) / np.linalg.norm([0.3, -0.2, 0.5, 0.8])
    eye = camera(40, 25, distance=8.0)
    masks = [
        covered(paint([figure(shape, BLUE, [[0.1, 0.2, -0.1]], (0.4, 0.9, 1.2), turn)], eye, device=device))
        for shape in (ball(), Shape(mesh.vertices, mesh.faces))
    ]
    # The mesh is inside the ellipsoid, by less than a pixel.
    assert not (masks[1] & ~masks[0]).any()
    assert (masks[0] & ~masks[1]).sum() < 0.03 * masks[0].sum()


def test_shadow_of_a_sphere_is_opposite_to_the_sun(device):
    radius, height, side = 0.4, 3.0, 300
    eye = camera(0, 90, distance=1000.0, angle=0.6)
    plate = figure(PLATE, (0.8, 0.8, 0.8), [0.0, 0.0, 0.0], 20.0)
    sphere = balls(BLUE, [0.0, 0.0, height], radius)
    picture = paint([plate, sphere], eye, (side, side), samples=16, device=device)
    brightness = linear(picture / 255.0).sum(axis=-1)
    rows, columns = np.mgrid[:side, :side]
    # The sphere itself is at the center.
    itself = np.hypot(rows - 0.5 * side, columns - 0.5 * side) < 1.3 * radius / (2.0 * eye.reach / side)
    brightness[itself] = lit = np.median(brightness)
    dark = brightness < 0.5 * (lit + brightness.min())
    sun = np.array(light_of(eye).sun)
    # Seen from straight above, right is +y and up is −x, and the picture is as wide as 2 reach.
    right, up, _ = eye.axes
    rows, columns = np.nonzero(dark)
    place = 2.0 * eye.reach / side * np.stack([columns + 0.5 - 0.5 * side, 0.5 * side - rows - 0.5], axis=-1)
    centre = place.mean(axis=0) @ np.stack([right, up])
    expected = -height / sun[2] * sun[:2]
    # The penumbra and the pixels are symmetric about it. Half a pixel, because perspective shifts it by height /
    # distance, and rays begin slightly above the plate.
    np.testing.assert_allclose(centre[:2], expected, atol=eye.reach / side)
    area = dark.sum() * (2.0 * eye.reach / side) ** 2
    # An ellipse of length 1 / sin(elevation); the boundary is where half of the sun is visible.
    assert area == pytest.approx(math.pi * radius**2 / sun[2], rel=0.1)


def test_nearer_object_hides_farther_one(device):
    near, far = balls(RED, [1.0, 0.0, 0.0], 0.5), balls(BLUE, [-3.0, 0.0, 0.0], 0.9)
    for figures in ([near, far], [far, near]):
        picture = paint(figures, camera(0, 0), device=device)
        middle = picture[64, 64].astype(int)
        assert middle[0] > 2 * middle[2]
        from_behind = paint(figures, camera(180, 0), device=device)[64, 64].astype(int)
        assert from_behind[2] > 2 * from_behind[0]


@pytest.mark.parametrize("below", [False, True])
def test_color_of_a_plate_is_the_sum_of_its_lights(below, device):
    color = np.array([0.6, 0.4, 0.2])
    eye = camera(0, -90 if below else 90, distance=5.0)
    picture = paint([figure(PLATE, color, [0.0, 0.0, 0.0], 10.0)], eye, samples=64, device=device)
    light = light_of(eye)
    around = np.array(light.ground_color if below else light.sky_color)
    facing = 0.0 if below else float(light.sun[2])
    received = around + facing * np.array(light.sun_color) + light.lamp
    # At the center of the picture the lamp has perpendicular incidence.
    expected = linear(color) * received
    if not below:  # specular reflection, along the bisector of sun and eye
        halfway = math.cos(0.5 * math.acos(light.sun[2]))
        expected += light.gloss * halfway**40 * np.array(light.sun_color)
    expected = np.where(expected <= 0.0031308, 12.92 * expected, 1.055 * expected ** (1 / 2.4) - 0.055)
    # The sun is a disk: its mean differs by the square of its radius. One more for rounding.
    np.testing.assert_allclose(picture[64, 64], 255.0 * expected, atol=2.0)


def test_faces_have_their_own_colors(device):
    shape = Shape(PLATE.vertices, PLATE.faces, colors=np.array([RED, BLUE]))
    picture = paint([figure(shape, (0.5, 0.5, 0.5), [0.0, 0.0, 0.0])], camera(0, 90), device=device).astype(int)
    # From above, right is +y and up is −x: the first face is on the side of −y.
    first, second = picture[72, 46], picture[56, 82]
    assert first[0] > 2 * first[2]
    assert second[2] > 2 * second[0]


def test_meshes_with_normals_are_shaded_smoothly(device):
    mesh = icosphere(1.0, 3)
    smooth = Shape(mesh.vertices, mesh.faces, normals=mesh.vertices)
    pictures = [
        paint(
            [figure(shape, BLUE, [0.0, 0.0, 0.0])], camera(10, 20, distance=8.0), samples=4, device=device
        ).astype(int)
        for shape in (ball(), smooth, Shape(mesh.vertices, mesh.faces))
    ]
    inner = covered(pictures[2])
    inner &= np.roll(inner, 3, 0) & np.roll(inner, -3, 0) & np.roll(inner, 3, 1) & np.roll(inner, -3, 1)
    errors = [np.abs(picture - pictures[0])[inner].mean() for picture in pictures[1:]]
    # Interpolated normals are accurate to the square of the edge angle; each face has a single normal.
    assert errors[0] < 0.5
    assert errors[1] > 4.0 * errors[0]


def test_convex_body_has_no_shadow_on_its_lit_side(device):
    # If shadow rays began below the surface, or on the flat faces of smooth meshes, there would be dark spots.
    mesh = icosphere(1.0, 2)
    for shape in (ball(), Shape(mesh.vertices, mesh.faces, normals=mesh.vertices)):
        eye = camera(0, 30, distance=8.0)
        picture = paint([figure(shape, (0.8, 0.8, 0.8), [0, 0, 0])], eye, (200, 200), device=device).astype(int)
        brightness = picture.sum(axis=-1)
        mask = covered(picture)
        for shift, axis in ((1, 0), (1, 1)):
            both = mask & np.roll(mask, shift, axis)
            both &= np.roll(both, 2, axis) & np.roll(both, -2, axis)
            step = np.abs(brightness - np.roll(brightness, shift, axis))[both]
            # From light to shadow the brightness decreases over many pixels; a spot would be a step of over 100.
            assert step.max() < 60


def mixed_items(count, seed):
    rng = np.random.default_rng(seed)
    mesh = icosphere(1.0, 1)
    shape = Shape(mesh.vertices, mesh.faces)
    found = []
    for kind in (SPHERE, CYLINDER, CONE, 0):
        turns = rng.normal(size=(count, 4))
        found.append(
            Items(
                kind,
                shape if kind == 0 else None,
                rng.uniform(-3, 3, (count, 3)),
                turns / np.linalg.norm(turns, axis=1, keepdims=True),
                rng.uniform(0.05, 0.4, (count, 3)),
                np.full((count, 3), 0.5),
            )
        )
    return found, drawing([figure(shape, BLUE, [0.0, 0.0, 0.0])])


def test_rendering_bvh_matches_brute_force(device):
    items, shown = mixed_items(40, seed=3)
    stage = Stage(shown, wp.get_device(device))
    rng = np.random.default_rng(4)
    count = 2000
    origin = rng.normal(size=(count, 3))
    origin *= 8.0 / np.linalg.norm(origin, axis=1, keepdims=True)
    along = rng.uniform(-2.5, 2.5, (count, 3)) - origin
    rays = [wp.array(v.astype(np.float32), dtype=wp.vec3, device=device) for v in (origin, along)]

    def search(groups):
        world = stage.world(groups, np.zeros(3), 1.0)
        item, distance = wp.zeros(count, dtype=int, device=device), wp.zeros(count, dtype=float, device=device)
        wp.launch(trace_all, dim=count, inputs=[world.struct, *rays], outputs=[item, distance], device=device)
        return item.numpy(), distance.numpy()

    item, distance = search(items)
    best, where = np.full(count, 1.0e6, dtype=np.float32), np.full(count, -1)
    number = 0
    for group in items:
        for i in range(len(group.positions)):
            one = Items(
                group.kind,
                group.shape,
                *(getattr(group, key)[i : i + 1] for key in ("positions", "rotations", "scales", "colors")),
            )
            found, t = search([one])
            closer = (found == 0) & (t < best)
            best[closer], where[closer] = t[closer], number
            number += 1
    assert (item >= 0).mean() > 0.3
    np.testing.assert_array_equal(item, where)
    np.testing.assert_array_equal(distance, best)


def scene_of_everything():
    rng = np.random.default_rng(1)
    plate = figure(PLATE, (0.7, 0.7, 0.6), [0.0, 0.0, 0.0], 4.0)
    return [plate, balls(BLUE, rng.uniform((-1, -1, 0.2), (1, 1, 1.0), (12, 3)), 0.2)], plate


def test_rendered_pictures_do_not_depend_on_number_of_threads():
    figures, _ = scene_of_everything()
    first, *others = [paint(figures, camera(20, 30), (90, 70), samples=16, threads=n) for n in (1, 2, 5)]
    for other in others:
        np.testing.assert_array_equal(first, other)


@pytest.mark.parametrize(("factor", "shift"), [(1e-4, 0.0), (1e5, 0.0), (1.0, 3e5)])
def test_rendered_pictures_are_invariant_to_scale_and_position(factor, shift, device):
    figures, plate = scene_of_everything()
    eye = camera(20, 30)
    first = paint(figures, eye, samples=4, device=device, has_grid=[plate]).astype(int)
    moved = [
        figure(one.shape, one.color, factor * one.positions + shift, factor * one.scales, name=one.name)
        for one in figures
    ]
    target = np.full(3, shift)
    other = paint(
        moved,
        camera(20, 30, distance=10.0 * factor, target=target),
        samples=4,
        device=device,
        has_grid=moved[:1],
    ).astype(int)
    # Rays that graze an edge may hit its other side.
    assert (np.abs(first - other).max(axis=-1) > 2).mean() < 0.005


def test_grid_lines_are_round_numbers_of_meters_apart(device):
    eye = camera(0, 90, distance=1000.0, angle=0.6, target=(2.0, 3.0, 0.0))
    plate = figure(PLATE, (0.8, 0.8, 0.8), [0.0, 0.0, 0.0], 40.0)
    side = 500
    row = (
        paint([plate], eye, (side, side), samples=16, device=device, has_grid=[plate])[side // 4 + 7]
        .astype(int)
        .sum(axis=-1)
    )
    y = 3.0 + 2.0 * eye.reach * ((np.arange(side) + 0.5) / side - 0.5)
    lines = y[row < row.max() - 12]
    assert len(lines) > 5
    # Half of the view is 5.2 m high: grid lines are 1 m apart.
    np.testing.assert_allclose(lines, np.round(lines), atol=2.5 * eye.reach / side)


def test_empty_scene_and_non_finite_objects_are_rendered(device):
    empty = paint([], camera(), device=device)
    assert (empty == 255).all()
    lost = balls(BLUE, [[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0]], 0.5)
    one = balls(BLUE, [[0.0, 0.0, 0.0]], 0.5)
    np.testing.assert_array_equal(paint([lost], camera(), device=device), paint([one], camera(), device=device))
    flat = balls(BLUE, [[0.0, 0.0, 0.0]], 0.0)
    assert (paint([flat], camera(), device=device) == 255).all()


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (Shape(np.eye(3), np.zeros((0, 3), dtype=np.int32)), "thing: the mesh must have faces"),
        (
            Shape(np.eye(3), np.array([[0, 1, 3]], dtype=np.int32)),
            "thing: vertex indices must be from 0 to 2, got 0 to 3",
        ),
        (Shape(np.full((3, 3), np.nan), np.array([[0, 1, 2]], dtype=np.int32)), "thing: vertices must be finite"),
        (
            Shape(np.eye(3), np.array([[0, 1, 2]], dtype=np.int32), normals=np.eye(2)),
            "thing: normals must have shape",
        ),
    ],
)
def test_meshes_invalid_for_warp_are_refused(shape, message):
    with pytest.raises(ValueError, match=message):
        Stage(drawing([figure(shape, BLUE, [0.0, 0.0, 0.0])]), wp.get_device("cpu"))


def test_memory_for_rendering_100000_spheres_is_bounded(device):
    places = np.random.default_rng(2).uniform(-10, 10, (100_000, 3))
    crowd = balls(BLUE, places, 0.1)
    stage = Stage(drawing([crowd]), wp.get_device(device))
    painter = Painter(stage, np.ones((2, 3)))
    tracemalloc.start()
    try:
        picture = painter.paint(
            [place_figure(crowd, 0, 0)], [], camera(20, 30, distance=40.0, angle=40.0), (160, 90), 1
        )
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert covered(picture).mean() > 0.3
    # About 30 numbers of 8 bytes per ray: 24 MB, and copies of them.
    assert peak < 150e6
