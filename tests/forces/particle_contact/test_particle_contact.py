"""Particle contact of spheres and capsules: closed forms, conservation of momentum, completeness of pairs."""

import itertools

import numpy as np
import pytest

import warpcontact as wc

RADIUS, MASS, STIFFNESS = 0.1, 0.5, 1.0e5
INERTIA = [0.4 * MASS * RADIUS**2] * 3
ELASTIC = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=STIFFNESS))


def spheres(positions, velocities, material=ELASTIC, *, gravity=(0, 0, 0), form=None, **options):
    """Returns a scene of equal bodies in particle contact."""
    scene = wc.Scene(gravity=gravity)
    balls = scene.add_bodies(positions, MASS, INERTIA, linear_velocities=velocities, name="ball")
    shape = scene.add_shape(balls, wc.shapes.Sphere(RADIUS) if form is None else form, name="shape")
    scene.add_particle_contact(shape, material, name="pile", **options)
    return scene


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_head_on_particle_impact_matches_spring_penetration_and_duration(device, precision):
    """Two masses and a spring: penetration v √(m/2k), contact duration π √(m/2k), velocities exchanged."""
    speed = 1.0
    time = np.sqrt(0.5 * MASS / STIFFNESS)
    scene = spheres([[0, 0, 0], [2.1 * RADIUS, 0, 0]], [[speed, 0, 0], [0, 0, 0]])
    model = scene.build(device=device, precision=precision)
    dt = time / 400
    recording = wc.Simulation(model, dt=dt).run(
        0.0208, record=["pile.max_penetration", "pile.contacts", "pile.force", "ball.linear_velocity"]
    )
    # The step samples the penetration; semi-implicit Euler is of second order in the penetration of a spring.
    assert recording["pile.max_penetration"].max() == pytest.approx(speed * time, rel=1e-3)
    touched = float(recording["pile.contacts"].sum()) * dt
    assert touched == pytest.approx(np.pi * time, abs=2 * dt)
    np.testing.assert_allclose(
        recording["ball.linear_velocity"][-1, 0], [[0, 0, 0], [speed, 0, 0]], atol=2e-3 * speed
    )
    forces = recording["pile.force"].values[:, 0]
    np.testing.assert_array_equal(forces[:, 0], -forces[:, 1])


def test_dissipative_particle_impact_has_restitution_of_its_law(device):
    """A law with restitution has the same e for particles and meshes; momentum is conserved."""
    restitution, speed = 0.6, 0.5
    law = wc.laws.HuntCrossley(stiffness=1e7, exponent=1.5, restitution=restitution)
    wall = wc.Scene(gravity=(0, 0, 0))
    floor = wall.add_surface(wc.meshes.box((2, 2, 0.2)), position=(0, 0, -0.1))
    ball = wall.add_body(
        MASS, INERTIA, position=(0, 0, 1.05 * RADIUS), linear_velocity=(0, 0, -speed), name="ball"
    )
    wall.add_contact(wall.add_point(ball, (0, 0, 0)), floor, wc.ContactMaterial(law=law), radius=RADIUS)
    at_wall = wall.build(device=device, precision="float64")
    # Equivalent to a wall at the plane of symmetry with half the penetration: the stiffness is divided by 2^1.5.
    twice = wc.laws.HuntCrossley(stiffness=1e7 / 2**1.5, exponent=1.5, restitution=restitution)
    pair = spheres(
        [[0, 0, 0], [0, 0, 2.1 * RADIUS]], [[0, 0, speed], [0, 0, -speed]], wc.ContactMaterial(law=twice)
    ).build(device=device, precision="float64")
    for model in (at_wall, pair):
        wc.Simulation(model, dt=2e-6).step(20_000)
    out = at_wall.sensor("ball.linear_velocity")[0, 2]
    velocities = pair.sensor("ball.linear_velocity")[0, :, 2]
    # Equal except for the speed that determines damping: twice the speed, half the penetration of each.
    np.testing.assert_allclose(velocities, [-out, out], rtol=1e-3)


def test_oblique_particle_impact_with_sticking_friction_matches_closed_form(device):
    """Sphere pair that sticks: the tangential impulse is 1/7 m v_t for equal spheres, and makes them rotate."""
    # So slow that the line of centers turns little.
    normal_speed, slip = 0.02, 0.1
    material = wc.ContactMaterial(
        law=wc.laws.Hooke(stiffness=1e6), friction=wc.friction.Tanh(mu=2.0, velocity_scale=1e-4)
    )
    scene = spheres([[0, 0, 0], [0, 0, 2.0001 * RADIUS]], [[0, 0, normal_speed], [slip, 0, 0]], material)
    model = scene.build(device=device, precision="float64")
    wc.Simulation(model, dt=2e-6).step(10_000)
    velocity = model.sensor("ball.linear_velocity")[0]
    spin = model.sensor("ball.angular_velocity")[0]
    # Impulse J stops the slip at K: slip = J (2/m + 2 R²/I).
    impulse = slip / (2 / MASS + 2 * RADIUS**2 / INERTIA[0])
    np.testing.assert_allclose(velocity[:, 0], [impulse / MASS, slip - impulse / MASS], rtol=5e-3)
    np.testing.assert_allclose(spin[:, 1], [impulse * RADIUS / INERTIA[0]] * 2, rtol=5e-3)


def test_chain_of_particles_conserves_momentum_and_energy(device):
    """A sphere that hits a chain: momentum is conserved to rounding, energy to the error of the step."""
    count = 6
    positions = np.zeros((count, 3))
    positions[:, 0] = 2.0 * RADIUS * np.arange(count)
    positions[0, 0] -= 0.01
    velocities = np.zeros((count, 3))
    velocities[0, 0] = 1.0
    model = spheres(positions, velocities).build(device=device, precision="float64")
    wc.Simulation(model, dt=4e-6).step(10_000)
    assert model.sensor("scene.linear_momentum")[0] == pytest.approx([MASS, 0, 0], abs=1e-13)
    assert model.sensor("scene.kinetic_energy")[0] == pytest.approx(0.5 * MASS, rel=1e-4)
    # Most of the momentum goes to the last sphere. With linear springs the others follow slowly.
    assert model.sensor("ball.linear_velocity")[0, -1, 0] > 0.9


def cloud(capsules, count=120, seed=5):
    """Returns positions, orientations, shapes and sizes of a random cloud with radii 1:5."""
    rng = np.random.default_rng(seed)
    radii = 0.03 * 5 ** rng.uniform(0, 1, count)
    half = np.where(np.arange(count) % 2 == 0, 2.0 * radii, 0.5 * radii) if capsules else np.zeros(count)
    positions = np.array([3.0, -7.0, 100.0]) + rng.uniform(-0.5, 0.5, (count, 3))
    turns = rng.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    forms = [
        wc.shapes.Capsule(float(r), float(h)) if capsules else wc.shapes.Sphere(float(r))
        for r, h in zip(radii, half, strict=True)
    ]
    return positions, turns, forms, radii, half


def segments_apart(c, g, d, h):
    """Returns the distance of segments c ± g and d ± h: from interior points or end points."""

    def to_end(p, middle, half):
        length = half @ half
        t = np.clip((p - middle) @ half / length, -1, 1) if length else 0.0
        return np.linalg.norm(p - middle - t * half)

    ends = [distance for s in (-1, 1) for distance in (to_end(c + s * g, d, h), to_end(d + s * h, c, g))]
    (s, t), *_ = np.linalg.lstsq(np.stack([g, -h], 1), d - c, rcond=None)
    if max(abs(s), abs(t)) <= 1:
        ends.append(np.linalg.norm(c + s * g - d - t * h))
    return min(ends)


def gaps_of(positions, axes, radii):
    """Returns the gaps of all pairs by brute force over the segments."""
    return {
        (i, j): segments_apart(positions[i], axes[i], positions[j], axes[j]) - radii[i] - radii[j]
        for i, j in itertools.combinations(range(len(radii)), 2)
    }


@pytest.mark.parametrize("capsules", [False, True])
@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
def test_particle_pairs_match_brute_force(device, capsules, precision):
    """A cloud of radii 1:5 moves through itself; its pairs, gaps and points match brute force."""
    positions, turns, forms, radii, half = cloud(capsules)
    scene = wc.Scene(gravity=(0, 0, 0))
    rng = np.random.default_rng(1)
    balls = scene.add_bodies(
        positions, MASS, INERTIA, turns, rng.normal(size=positions.shape), 5 * rng.normal(size=positions.shape),
        name="ball",
    )  # fmt: skip
    shape = scene.add_shape(balls, forms, name="shape")
    # So soft that they pass through each other.
    soft = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e-3))
    scene.add_particle_contact(shape, soft, name="pile", skin=0.02, max_neighbors=len(radii) - 1)
    model = scene.build(device=device, precision=precision)
    sim = wc.Simulation(model, dt=1e-3)
    # At 100 m a single float32 resolves 4 µm; rounding remainders make differences more accurate.
    within = 2e-6 if precision == "float32" else 1e-12
    for _ in range(3):
        sim.step(40)
        places = model.sensor("ball.position")[0]
        q = model.sensor("ball.orientation")[0].astype(np.float64)
        x, y, z, w = q.T
        axes = half[:, None] * np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)
        expected = gaps_of(places, axes, radii)
        found = model.contact_pairs("pile")
        pairs = list(zip(found["shape_1"].values.tolist(), found["shape_2"].values.tolist(), strict=True))
        deep = {pair for pair, gap in expected.items() if gap < -within}
        assert deep <= set(pairs)
        assert all(expected[pair] < within for pair in pairs)
        np.testing.assert_allclose(found["gap"], [expected[pair] for pair in pairs], atol=within)
        assert model.sensor("pile.contacts")[0] == len(pairs) > 50
        assert model.sensor("pile.coordination")[0].sum() == 2 * len(pairs)
    assert model.of_family("particle contact")[0].cell_list.build_count.numpy()[0] > 5


def test_parallel_capsules_contact_at_the_middle_of_their_overlap(device):
    """Parallel capsules have many closest points; the force acts in their middle and causes no rotation."""
    form = wc.shapes.Capsule(RADIUS, 0.3)
    scene = spheres([[0, 0, 0], [1.9 * RADIUS, 0, 0.2]], [[0, 0, 0]] * 2, form=form)
    model = scene.build(device=device, precision="float64")
    touch = model.contact_pairs("pile")
    np.testing.assert_allclose(touch["point"][0], [0.95 * RADIUS, 0, 0.1], atol=1e-15)
    np.testing.assert_allclose(touch["normal"][0], [-1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(touch["gap"], [-0.1 * RADIUS], rtol=1e-12)
    # End to end, the axes do not overlap; the caps are in contact.
    ends = spheres([[0, 0, 0], [0, 0, 0.6 + 1.9 * RADIUS]], [[0, 0, 0]] * 2, form=form)
    touch = ends.build(device=device, precision="float64").contact_pairs("pile")
    np.testing.assert_allclose(touch["point"][0], [0, 0, 0.3 + 0.95 * RADIUS], atol=1e-15)


def test_kappa_places_the_contact_point_between_the_surfaces(device):
    """K moves from the surface of the second shape to that of the first."""
    scene = spheres([[0, 0, 0], [1.9 * RADIUS, 0, 0]], [[0, 0, 0]] * 2, kappa=0.0)
    model = scene.build(envs=3, device=device, precision="float64")
    model["pile.kappa"] = [0.0, 0.5, 1.0]
    np.testing.assert_allclose(
        model.contact_pairs("pile")["point"][:, 0], np.array([0.9, 0.95, 1.0]) * RADIUS, atol=1e-15
    )


def test_shapes_of_one_body_contact_other_bodies_only(device):
    """Shapes of one body contact other bodies together, but never each other."""
    scene = wc.Scene(gravity=(0, 0, 0))
    pin = scene.add_body(MASS, INERTIA, name="pin")
    rod = scene.add_shape(pin, wc.shapes.Capsule(RADIUS, 0.5), name="rod")
    knob = scene.add_shape(pin, wc.shapes.Sphere(2 * RADIUS), position=(0, 0, 0.5), name="knob")
    ball = scene.add_body(MASS, INERTIA, position=(2.9 * RADIUS, 0, 0.5), name="ball")
    bead = scene.add_shape(ball, wc.shapes.Sphere(RADIUS), name="bead")
    scene.add_particle_contact([rod, knob, bead], ELASTIC, name="pile")
    model = scene.build(device=device, precision="float64")
    touch = model.contact_pairs("pile")
    assert [(a, b) for a, b in zip(touch["name_1"].values, touch["name_2"].values, strict=True)] == [
        ("knob", "bead")
    ]
    assert touch["body_1"].values.tolist() == ["pin"]
    force = STIFFNESS * 0.1 * RADIUS
    np.testing.assert_allclose(model.sensor("pin.force")[0], [-force, 0, 0], atol=1e-9)
    np.testing.assert_allclose(model.sensor("pin.torque")[0], [0, -0.5 * force, 0], atol=1e-9)
    np.testing.assert_allclose(model.sensor("ball.force")[0], [force, 0, 0], atol=1e-9)


def test_groups_masks_and_exclusions_prevent_particle_contact(device):
    """Shapes contact if the group of each is in the other's mask, and the pair is not excluded."""
    scene = wc.Scene(gravity=(0, 0, 0))
    groups = [(1, 0xFFFFFFFF), (2, 1), (2, 1), (4, 4), (1, 0xFFFFFFFF)]
    shapes = []
    for number, (group, mask) in enumerate(groups):
        body = scene.add_body(MASS, INERTIA, position=(0.001 * number, 0, 0), name=f"b{number}")
        shapes.append(scene.add_shape(body, wc.shapes.Sphere(RADIUS), group=group, mask=mask, name=f"s{number}"))
    scene.add_particle_contact(shapes, ELASTIC, name="pile", exclude=[(shapes[4], shapes[1])])
    touch = scene.build(device=device).contact_pairs("pile")
    pairs = list(zip(touch["shape_1"].values.tolist(), touch["shape_2"].values.tolist(), strict=True))
    assert pairs == [(0, 1), (0, 2), (0, 4), (2, 4)]


def test_particle_radii_can_vary_by_environment(device):
    """A larger radius gives contact in its environment only."""
    scene = spheres([[0, 0, 0], [2.1 * RADIUS, 0, 0]], [[0, 0, 0]] * 2)
    model = scene.build(envs=2, device=device, precision="float64")
    model["shape.radius"] = [[RADIUS, RADIUS], [RADIUS, 1.2 * RADIUS]]
    assert model.sensor("pile.contacts").tolist() == [0, 1]
    assert model.sensor("pile.max_penetration")[1] == pytest.approx(0.1 * RADIUS, rel=1e-12)
    assert model.sensor("pile.normal_force")[1] == pytest.approx(STIFFNESS * 0.1 * RADIUS, rel=1e-12)
    assert model.sensor("pile.max_normal_force").tolist() == model.sensor("pile.normal_force").tolist()


def test_invalid_particle_contact_is_refused(device):
    """Each error names the entry, the value and the condition."""
    scene = wc.Scene()
    body = scene.add_body(MASS, INERTIA, name="body")
    other = scene.add_body(MASS, INERTIA, name="other")
    box = scene.add_shape(body, wc.shapes.Cylinder(0.1, 0.2), name="drum")
    fixed = scene.add_shape(None, wc.shapes.Sphere(0.1), name="fixed")
    one, two = (scene.add_shape(b, wc.shapes.Sphere(0.1), name=f"s_{b.name}") for b in (body, other))
    for shapes, options, words in (
        ([one, box], {}, "'drum' is a Cylinder; particle contacts are of spheres and capsules"),
        ([one, fixed], {}, "'fixed' is fixed to the world"),
        ([one, one], {}, "'s_body' is listed more than once"),
        ([one], {}, "shapes must be at least 2, got 1"),
        ([one, two], {"skin": 0.0}, r"pile\.skin must be greater than 0, got 0 m"),
        ([one, two], {"max_neighbors": 0}, "max_neighbors must be a whole number of at least 1, got 0"),
        (
            [one, two],
            {"exclude": [(one, box)]},
            r"pairs of its shapes, got \(Shape 's_body', Shape 'drum'\)",
        ),
        (
            [one, two],
            {"exclude": (one, two)},
            "exclude of 'pile' must be pairs .*, got Shape 's_body'$",
        ),
        ([one, two], {"exclude": 5}, "exclude of 'pile' must be pairs of its shapes, got 5"),
        ("s_body", {}, "shapes of 'pile' must be a shape or a list of them, got 's_body'"),
    ):
        with pytest.raises(ValueError, match=words):
            scene.add_particle_contact(shapes, ELASTIC, name="pile", **options)
    assert scene.particle_contacts == []
