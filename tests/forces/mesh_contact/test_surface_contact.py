"""Surface contact: laws per area, closed forms in the limit, and both assignments of sides."""

from typing import Any

import numpy as np
import pytest
import warp as wp
from scenes import square

import warpcontact as wc
from warpcontact import laws, sample_surface

RADIUS, DEPTH, MODULUS = 0.05, 0.004, 1.0e9
# Springs on the sphere, each acting along the normal of the plane, with true area: π k R δ².
SPHERE_BED = 2513.274123
# Springs on the plane, each acting along the normal of the sphere, at distance s from its center: 2π k (R − δ) ∫
# (R − s) ds over s from R − δ to R.
PLANE_BED = np.pi * MODULUS * DEPTH**2 * (RADIUS - DEPTH)


class Suction(wc.Law):
    """A custom law whose area is set per point: N = p a δ/h."""

    pressure: float = wc.parameter("Pa", "pressure p", above=0.0)
    depth: float = wc.parameter("m", "depth h", above=0.0)
    area: float | None = wc.parameter("m²", "area a", default=None, above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.pressure * p.area * c.delta / p.depth


class Felt(wc.Friction):
    """A custom friction per area: F = −c a v."""

    drag: float = wc.parameter("N·s/m³", "drag c per area", at_least=0.0)
    area: float | None = wc.parameter("m²", "area a", default=None, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return (-p.drag * p.area) * s.velocity


def pressed_sphere(device, *, swap=False, subdivisions=5, depth=DEPTH, material=None, **options):
    """Returns the model of a meshed sphere at penetration ``depth`` in a square, and the names of the contacts."""
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square(0.03), name="ground")
    ball = scene.add_body(1.0, [1e-3] * 3, position=(0, 0, RADIUS - depth), name="ball")
    skin = scene.add_surface(wc.meshes.icosphere(RADIUS, subdivisions), ball, name="skin")
    pair = (ground, skin) if swap else (skin, ground)
    material = material or wc.ContactMaterial(law=laws.ElasticFoundation(stiffness=MODULUS))
    contacts = scene.add_surface_contact(*pair, material, name="press", **options)
    return scene.build(device=device, precision="float64"), [contact.name for contact in contacts]


def force(device, **options):
    return pressed_sphere(device, **options)[0].sensor("ball.force")[0, 2]


@pytest.mark.parametrize("samples", ["centroids", "vertices"])
def test_meshed_sphere_on_plane_converges_to_elastic_foundation(samples, device):
    errors = [abs(force(device, samples=samples, subdivisions=n) / SPHERE_BED - 1.0) for n in (3, 4, 5)]
    assert errors[-1] < 0.007
    # Second order in the edge length of the mesh, which is halved each time.
    order = np.log2(errors[0] / errors[-1]) / 2.0
    assert order > 1.8


def test_blue_noise_samples_converge_to_elastic_foundation(device):
    errors = []
    for count in (250, 1000, 4000):
        values = [force(device, samples=count, seed=seed, subdivisions=6) / SPHERE_BED - 1.0 for seed in range(3)]
        errors.append(np.sqrt(np.mean(np.square(values))))
    # 4 % of the points are in contact: 10, 40 and 160. The facets of the mesh leave 0.15 %.
    assert errors[1] < 0.02
    assert errors[2] < 0.004
    assert errors[2] < 0.2 * errors[0]


def test_samples_of_the_plane_converge_to_elastic_foundation_on_the_plane(device):
    errors = [abs(force(device, swap=True, samples=4000, subdivisions=n) / PLANE_BED - 1.0) for n in (3, 4, 5)]
    assert errors[-1] < 0.006
    # The facets are inside the sphere, by the square of their edge length.
    assert np.log2(errors[0] / errors[-1]) / 2.0 > 1.8
    # 250 points, of which 25 are in contact, add little error.
    assert abs(force(device, swap=True, samples=250) / PLANE_BED - 1.0) < errors[-1] + 0.005


def test_average_of_sides_is_the_mean_of_both(device):
    options = {"samples": 2000, "subdivisions": 4}
    first = force(device, **options)
    second = force(device, swap=True, **options)
    assert force(device, sides="average", **options) == pytest.approx(0.5 * (first + second), rel=1e-12)
    # The closed forms differ by δ/R, because the two sides of one contact describe two different foundations.
    np.testing.assert_allclose(PLANE_BED / SPHERE_BED, 1.0 - DEPTH / RADIUS, rtol=1e-9)


@pytest.mark.parametrize("samples", [(500, 500), (500, 2000), (500, 8000)])
def test_one_sided_and_averaged_contact_agree_on_flat_faces(samples, device):
    side, depth = 0.1, 1.0e-3
    found = {}
    for sides in ("first", "average"):
        scene = wc.Scene(gravity=(0, 0, 0))
        ground = scene.add_surface(wc.meshes.grid((0.2, 0.2)), name="ground")
        plate = scene.add_body(1.0, [1e-2] * 3, position=(0.013, 0.007, -depth), name="plate")
        sole = scene.add_surface(wc.meshes.grid((side, side)), plate, flip=True, name="sole")
        law = wc.ContactMaterial(law=laws.ElasticFoundation(stiffness=1.0e8))
        amount = samples if sides == "average" else samples[0]
        scene.add_surface_contact(sole, ground, law, samples=amount, sides=sides, name="press")
        found[sides] = scene.build(device=device, precision="float64").sensor("plate.force")[0, 2]
    exact = 1.0e8 * side**2 * depth
    # The points of the upper plate cover all of it. Points of the ground count if they are below the plate: 4
    # side/d grid cells at its boundary are counted or not, each with an error of half a cell.
    assert found["first"] == pytest.approx(exact, rel=1e-9)
    cell = 0.2 / np.sqrt(samples[1])
    assert found["average"] == pytest.approx(exact, rel=0.5 * cell / side)


@pytest.mark.parametrize("sides", ["first", "average"])
def test_free_collision_of_two_meshes_conserves_momentum(sides, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    block = scene.add_body(2.0, (0.02, 0.03, 0.04), (0.1, 0, 0), (0.1, 0.2, 0.3, np.sqrt(0.86)), name="block")
    ball = scene.add_body(
        0.5, [1e-3] * 3, (-0.12, 0.03, 0.02), linear_velocity=(2, 0, 0.3), angular_velocity=(5, 9, 0), name="ball"
    )
    hull = scene.add_surface(wc.meshes.box((0.2, 0.15, 0.1)), block, (0.01, 0, 0), (0, 0, 0.6, 0.8), name="hull")
    skin = scene.add_surface(wc.meshes.icosphere(0.06, 3), ball, name="skin")
    rubber = wc.ContactMaterial(
        law=laws.ElasticFoundation(stiffness=5e8, damping=0.3),
        friction=wc.friction.Tanh(mu=0.4, velocity_scale=0.02),
        torsion=wc.friction.Tanh(mu=0.1, velocity_scale=0.02),
    )
    contacts = scene.add_surface_contact(
        skin, hull, rubber, samples=300, sides=sides, name="hit", torsion_radius=0.01, max_depth=0.02
    )
    model = scene.build(device=device, precision="float64")
    sim = wc.Simulation(model, dt=2e-5)
    names = ["scene.linear_momentum", "scene.angular_momentum", *(f"{c.name}.normal_force" for c in contacts)]
    recording = sim.run(0.04, names, every=2e-4)
    for contact in contacts:
        assert recording[f"{contact.name}.normal_force"].sum(axis=2).max() > 50.0
    for name in names[:2]:
        momentum = recording[name].values[:, 0]
        # 2000 steps with a few roundings of 1e-16 each.
        np.testing.assert_allclose(momentum, momentum[:1].repeat(len(momentum), axis=0), atol=2e-13)
    assert abs(model.sensor("block.linear_velocity")[0, 0]) > 0.1


def test_force_scale_applies_to_all_forces_and_torques(device):
    material = wc.ContactMaterial(
        law=laws.KelvinVoigt(stiffness=1e5, damping=10.0),
        # Not proportional to N, so that scaling N alone would not scale the friction.
        friction=Felt(drag=3.0, area=1.0),
        rolling=wc.friction.Tanh(mu=0.1),
        torsion=wc.friction.Tanh(mu=0.1),
    )
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square())
    ball = scene.add_body(
        1.0, [1e-3] * 3, (0, 0, 0.09), linear_velocity=(1, 0, -1), angular_velocity=(1, 2, 3), name="ball"
    )
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, radius=0.1, name="touch")
    model = scene.build(envs=3, device=device, precision="float64")
    assert (model["touch.force_scale"] == 1.0).all()
    whole = {name: model.sensor(f"touch.{name}") for name in ("normal_force", "friction_force", "torque")}
    wrench = model.sensor("ball.force"), model.sensor("ball.torque")
    assert all(np.abs(values).max() > 0 for values in whole.values())
    share = np.array([0.0, 0.5, 2.0])
    model["touch.force_scale"] = share
    for name, values in whole.items():
        expected = values * share.reshape(-1, *[1] * (values.ndim - 1))
        np.testing.assert_allclose(model.sensor(f"touch.{name}"), expected, rtol=1e-14)
    for now, before in zip((model.sensor("ball.force"), model.sensor("ball.torque")), wrench, strict=True):
        np.testing.assert_allclose(now, before * share[:, None], rtol=1e-14)
    with pytest.raises(ValueError, match=r"touch\.force_scale must be at least 0, got -1"):
        model["touch.force_scale"] = -1.0


def areas_scene(material, **points):
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square(), name="ground")
    body = scene.add_body(1.0, [1e-2] * 3, linear_velocity=(1, 0, 0), name="body")
    carried = scene.add_points(body, [(0, 0, -1e-3), (0.1, 0, -2e-3)], name="pads", **points)
    scene.add_contact(carried, ground, material, name="press")
    return scene


@pytest.mark.parametrize(
    ("law", "pressure"),
    [
        (laws.ElasticFoundation(stiffness=1e8), 1e8),
        (laws.ContactRange(k1=1e8), 1e8),
        (laws.ElasticFoundation.from_layer(E=1e6, nu=0.0, thickness=0.01), 1e8),
        (Suction(pressure=1e5, depth=1e-3), 1e8),
    ],
)
def test_law_uses_areas_of_the_points(law, pressure, device):
    areas = np.array([1e-4, 3e-4])
    model = areas_scene(wc.ContactMaterial(law=law), areas=areas).build(envs=2, device=device, precision="float64")
    depth = np.array([1e-3, 2e-3])
    np.testing.assert_allclose(model["press.law.area"], [areas, areas])
    np.testing.assert_allclose(model.sensor("press.normal_force"), [pressure * areas * depth] * 2, rtol=1e-12)
    # Areas are parameters, per point and per environment.
    model["press.law.area"] = [[2e-4, 1e-4], [1e-4, 5e-4]]
    np.testing.assert_allclose(
        model.sensor("press.normal_force")[1], pressure * np.array([1e-7, 1e-6]), rtol=1e-12
    )
    wc.Simulation(model, dt=1e-6).step(2)


def test_area_of_the_law_overrides_areas_of_the_points(device):
    material = wc.ContactMaterial(law=laws.ElasticFoundation(stiffness=1e8, area=1e-2))
    model = areas_scene(material, areas=[1e-4, 3e-4]).build(device=device)
    np.testing.assert_allclose(model["press.law.area"], 1e-2)


def test_friction_uses_areas_of_the_points(device):
    material = wc.ContactMaterial(law=laws.Hooke(stiffness=1.0), friction=Felt(drag=1e3))
    model = areas_scene(material, areas=[1e-4, 3e-4]).build(device=device, precision="float64")
    np.testing.assert_allclose(model.sensor("press.friction_force")[0, :, 0], [-0.1, -0.3], rtol=1e-12)


def test_points_without_areas_are_refused():
    message = r"press: the law of its material, Suction, was given no area \[m²\], and the points 'pads' have none"
    with pytest.raises(ValueError, match=message):
        areas_scene(wc.ContactMaterial(law=Suction(pressure=1.0, depth=1.0)))
    with pytest.raises(ValueError, match=r"pads\.areas must be 2 numbers"):
        areas_scene(wc.ContactMaterial(law=laws.Hooke(stiffness=1.0)), areas=[1.0])
    with pytest.raises(ValueError, match=r"pads\.areas\[1\] must be greater than 0, got -1 m²"):
        areas_scene(wc.ContactMaterial(law=laws.Hooke(stiffness=1.0)), areas=[1.0, -1.0])
    scene, samples = wc.Scene(), sample_surface(wc.meshes.box(), 5)
    with pytest.raises(ValueError, match=r"hull\.areas must be left out"):
        scene.add_points(None, samples, areas=samples.areas, name="hull")
    np.testing.assert_array_equal(scene.add_points(None, samples, name="hull").areas, samples.areas)


def test_laws_and_friction_models_per_area_can_be_compared(device):
    bed = laws.ElasticFoundation(stiffness=1e9, damping=0.1)
    given = {"bed": bed, "with": laws.ElasticFoundation(stiffness=1e9, damping=0.1, area=1e-4)}
    impacts = wc.compare.impacts(given, [0.5], device=device)
    force = impacts["greatest_force"]
    np.testing.assert_allclose(force.sel(law="bed"), force.sel(law="with"))
    slips = wc.compare.slips({"felt": Felt(drag=1e3)}, device=device)
    assert slips.sizes["friction"] == 1


def test_points_of_a_surface_move_with_it(device):
    """Sample points lie on the surface for any pose: the distance to a copy of the surface is zero."""
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square(), name="ground")
    body = scene.add_body(1.0, [1e-2] * 3, (0, 0, 1), (0, 0.6, 0, 0.8), name="body")
    hull = scene.add_surface(wc.meshes.box((0.2, 0.1, 0.3)), body, (0.1, 0, 0), (0, 0, 0.6, 0.8), name="hull")
    points = scene.add_points(hull, [(0.1, 0.05, 0.15), (0, 0, 0.15)], name="corners")
    assert points.body is body
    scene.add_contact(points, ground, wc.ContactMaterial(law=laws.Hooke(stiffness=1.0)), kappa=1.0, name="touch")
    model = scene.build(envs=2, device=device, precision="float64")

    def rotated(q, v):
        return v + 2.0 * np.cross(q[:3], np.cross(q[:3], v) + q[3] * v)

    def expected(position, orientation, local):
        carried = [rotated(np.array(orientation), np.array(place)) + position for place in local]
        return [rotated(np.array([0, 0.6, 0, 0.8]), place)[2] + 1.0 for place in carried]

    local = [(0.1, 0.05, 0.15), (0, 0, 0.15)]
    gap = model.sensor("touch.gap")
    np.testing.assert_allclose(gap, [expected((0.1, 0, 0), (0, 0, 0.6, 0.8), local)] * 2, atol=1e-14)
    np.testing.assert_allclose(points.places[1], (0.1, 0, 0.15), atol=1e-15)
    model["hull.position"] = [(0.1, 0, 0), (0.2, 0.3, 0.4)]
    model["hull.orientation"] = (0.8, 0, 0.6, 0)
    gap = model.sensor("touch.gap")
    np.testing.assert_allclose(gap[0], expected((0.1, 0, 0), (0.8, 0, 0.6, 0), local), atol=1e-14)
    np.testing.assert_allclose(gap[1], expected((0.2, 0.3, 0.4), (0.8, 0, 0.6, 0), local), atol=1e-14)
    # The points are parameters, in the frame of the mesh.
    model["corners.position"] = [[(0, 0, 0), (0, 0, 0.15)]]
    gap = model.sensor("touch.gap")[1]
    np.testing.assert_allclose(gap, expected((0.2, 0.3, 0.4), (0.8, 0, 0.6, 0), [(0, 0, 0), local[1]]), atol=1e-14)


@pytest.mark.parametrize(
    "law", [laws.ElasticFoundation(stiffness=1e8), laws.ElasticFoundation(stiffness=1e8, area=1e-3)]
)
def test_areas_scale_with_their_surface(law, device):
    """A box of 2 m, a box of 1 m with scale 2, and the same scale in one environment: equal forces."""
    found = {}
    for size, scale in ((2.0, 1.0), (1.0, 2.0), (1.0, 1.0)):
        scene = wc.Scene(gravity=(0, 0, 0))
        ground = scene.add_surface(square(3.0), name="ground")
        body = scene.add_body(1.0, [1.0] * 3, position=(0, 0, 1.0 - 1e-3), name="body")
        skin = scene.add_surface(wc.meshes.box((size,) * 3), body, scale=scale, name="skin")
        felt = Felt(drag=1.0)
        scene.add_surface_contact(
            skin, ground, wc.ContactMaterial(law=law, friction=felt), samples="centroids", name="press"
        )
        model = scene.build(envs=2, device=device, precision="float64")
        model["body.linear_velocity"] = (1, 0, 0)
        if scale * size == 1.0:
            model["body.position"] = [(0, 0, 0.5 - 1e-3), (0, 0, 1.0 - 1e-3)]
            model["skin.scale"] = [1.0, 2.0]
        found[size, scale] = model.sensor("body.force")
        np.testing.assert_allclose(model["press.friction.area"].sum(axis=1), 6.0 * size**2)
    exact = 1e8 * 4.0 * 1e-3 if law.area is None else 2 * 1e8 * 1e-3 * 1e-3
    np.testing.assert_allclose(found[2.0, 1.0][:, [0, 2]], [[-4.0, exact]] * 2, rtol=1e-9)
    np.testing.assert_allclose(found[1.0, 2.0][:, [0, 2]], [[-4.0, exact]] * 2, rtol=1e-9)
    smaller = exact if law.area else exact / 4
    np.testing.assert_allclose(found[1.0, 1.0][:, [0, 2]], [[-1.0, smaller], [-4.0, exact]], rtol=1e-9)


def test_surface_contact_creates_named_points_and_contacts_of_both_sides():
    scene = wc.Scene()
    body = scene.add_body(1.0, [1.0] * 3, name="body")
    ground = scene.add_surface(wc.meshes.grid(), active_faces=[1], name="ground")
    hull = scene.add_surface(wc.meshes.box(), body, name="hull")
    spring = wc.ContactMaterial(law=laws.Hooke(stiffness=1.0))
    first, second = scene.add_surface_contact(
        hull, ground, spring, samples=("vertices", 30), sides="average", name="pair", radius=0.01, seed=3
    )
    assert (first.name, first.points.name, first.surface.name) == ("pair_first", "pair_first_points", "ground")
    assert (second.name, second.points.name, second.surface.name) == ("pair_second", "pair_second_points", "hull")
    assert [contact.count for contact in (first, second)] == [8, 30]
    assert first.force_scale == second.force_scale == 0.5
    assert first.radius == second.radius == 0.01
    # Points of the active faces only.
    assert second.points.areas.sum() == pytest.approx(0.5)
    (only,) = scene.add_surface_contact(hull, ground, spring, samples=7)
    assert (only.name, only.points.name, only.count) == ("contact", "contact_points", 7)


def test_each_mesh_of_a_surface_has_its_own_points(device):
    """The remedy of the error message: a box in one environment, a ball in the other, penetration 1 mm."""
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square(), name="ground")
    body = scene.add_body(1.0, [1.0] * 3, position=(0, 0, 0.499), name="body")
    meshes = [wc.meshes.box(), wc.meshes.icosphere(0.5, 4)]
    either = scene.add_surface(meshes, body, name="either")
    bed = wc.ContactMaterial(law=laws.ElasticFoundation(stiffness=1e8))
    for index, mesh in enumerate(meshes):
        points = scene.add_points(either, sample_surface(mesh, method="centroids"), name=f"points_{index}")
        scene.add_contact(points, ground, bed, name=f"press_{index}")
    model = scene.build(envs=2, device=device, precision="float64")
    model["either.mesh"] = [0, 1]
    for index in (0, 1):
        model[f"press_{index}.enabled"] = model["either.mesh"] == index
    force = model.sensor("body.force")[:, 2]
    assert force[0] == pytest.approx(1e8 * 1.0 * 1e-3, rel=1e-9)
    assert 0 < force[1] < 0.01 * force[0]


def test_invalid_surface_contact_leaves_scene_unchanged():
    scene = wc.Scene()
    body = scene.add_body(1.0, [1.0] * 3, name="body")
    ground = scene.add_surface(wc.meshes.grid(), name="ground")
    hull = scene.add_surface(wc.meshes.box(), body, name="hull")
    hidden = scene.add_surface(wc.meshes.box(), body, active_faces=[], name="hidden")
    either = scene.add_surface([wc.meshes.box(), wc.meshes.icosphere()], body, name="either")
    spring = wc.ContactMaterial(law=laws.Hooke(stiffness=1.0))
    names = scene.element_names()
    cases = [
        ((hull, hidden), {}, "press: points and surface are both fixed to body 'body'"),
        ((hull, ground), {"sides": "both"}, "press.sides must be one of 'first', 'average', got 'both'"),
        ((hull, ground), {"samples": 0}, "press.samples must be a whole number of points, at least 1, or"),
        ((hull, ground), {"samples": "blue"}, "or 'vertices' or 'centroids', got 'blue'"),
        ((hull, ground), {"samples": (5, 5)}, "press.samples must be one entry, or with sides='average' two"),
        ((hull, ground), {"radius": -1.0, "sides": "average"}, "press_first.radius must be at least 0"),
        ((hidden, ground), {}, "press.samples: 'hidden' has no active face"),
        (
            (either, ground),
            {},
            "press.samples: 'either' must have one mesh, got 2. Sample the other surface",
        ),
        ((ground, either), {"sides": "average"}, "press.samples: 'either' must have one mesh, got 2"),
        ((None, ground), {}, "press.surface_a must come from add_surface of this scene, got None"),
    ]
    for pair, options, message in cases:
        with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
            scene.add_surface_contact(*pair, spring, **{"samples": 5, "name": "press"} | options)
        assert message in str(error.value)
        assert scene.element_names() == names
        assert not scene.points
        assert not scene.contacts
