"""Initial clearance from bounds: contacts are reported clear only if an exact search finds no contact."""

import subprocess
import sys
from itertools import product

import numpy as np
import pytest
from case_marks import slow_except
from scipy.spatial.transform import Rotation

import warpcontact as wc
from warpcontact import ContactStatus
from warpcontact.forces.advice import advice_needs_evaluation
from warpcontact.forces.mesh_contact.step_warnings import contacts_to_evaluate, starts_clear

LAW = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
TERRAIN = wc.meshes.sinusoidal_terrain(size=(2.0, 2.0), cells=(12, 12), amplitude=0.2, wavelength=1.0)
CONTAINER = wc.meshes.box((2.0, 2.0, 1.0)).flipped()


def surfaces(scene, kind):
    """Adds a surface; returns it with options of the contact."""
    if kind == "terrain":
        return scene.add_surface(TERRAIN, position=(0.1, 0.2, 0.3), scale=1.5), {}
    if kind == "rotated terrain":
        return scene.add_surface(TERRAIN, orientation=turn(0.5, (1, 2, 0.5)), flip=True), {}
    if kind == "solid":
        return scene.add_surface(wc.meshes.icosphere(0.5), scale=0.8, position=(0.2, 0.0, -0.1)), {}
    if kind == "top of a box":
        box = wc.meshes.box((1.0, 1.2, 0.4))
        return scene.add_surface(box, active_faces=lambda c: c[:, 2] > 0.19), {"search": "active"}
    if kind == "container":
        return scene.add_surface(CONTAINER), {}
    if kind == "plate of a body":
        carrier = scene.add_body(1.0, (1, 1, 1), name="carrier")
        plate = wc.meshes.box((1.0, 1.0, 0.1))
        return scene.add_surface(plate, carrier, position=(0.3, 0, 0), orientation=turn(0.3, (0, 0, 1))), {}
    two = [wc.meshes.box((0.4, 0.4, 0.4)), wc.meshes.icosphere(0.4)]
    return scene.add_surface(two), {}


def turn(angle, axis):
    axis = np.asarray(axis) / np.linalg.norm(axis)
    return Rotation.from_rotvec(angle * axis).as_quat()


def points_of(scene, form):
    """Adds points or spheres; returns them with their radius."""
    if form == "body set":
        three = scene.add_bodies(np.zeros((3, 3)), 1.0, (1, 1, 1), name="body")
        return scene.add_points(three, np.zeros((3, 3))), 0.1
    body = scene.add_body(1.0, (1, 1, 1), name="body")
    if form == "sphere":
        return scene.add_point(body, (0.05, 0, 0)), 0.1
    if form == "points":
        return scene.add_points(body, [(0.2, 0, 0), (-0.1, 0.1, 0.3), (0, -0.2, 0)]), 0.0
    hull = scene.add_surface(wc.meshes.box((0.2, 0.3, 0.4)), body, position=(0.1, 0, 0), scale=0.7, name="hull")
    return scene.add_points(hull, wc.sample_surface(hull.mesh, 30, seed=1)), 0.02


KINDS = ["terrain", "rotated terrain", "solid", "top of a box", "container", "plate of a body", "one of two"]


FORMS = ["sphere", "points", "hull", "body set"]


@pytest.mark.parametrize(
    ("kind", "form"),
    # Two forms of points per kind of surface in every test run.
    slow_except(product(KINDS, FORMS), lambda case: (KINDS.index(case[0]) + FORMS.index(case[1])) % 2 == 0),
)
def test_initially_clear_contact_set_has_no_contacts(kind, form, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    surface, options = surfaces(scene, kind)
    points, radius = points_of(scene, form)
    options |= {"boundary": "outer" if radius else "off", "entry": ("literal", "latched")[KINDS.index(kind) % 2]}
    contact = scene.add_contact(points, surface, LAW, name="touch", radius=radius, **options)
    envs = 40
    model = scene.build(envs=envs, device=device, precision=("float32", "float64")[len(form) % 2])
    rng = np.random.default_rng([KINDS.index(kind), len(form)])

    def vary(name, scale):
        model[name] = model[name] + rng.normal(scale=scale, size=model[name].shape)

    clear, apart = 0, 0
    for number in range(100):
        # Similar distance in all environments, because one environment in contact makes the whole model not clear.
        place = rng.normal(size=3)
        place *= rng.uniform(0.0, 2.0) / np.linalg.norm(place)
        if number % 10 == 0:
            place = np.array([0.0, 0.0, 1.5])
        for name in ["body", "carrier"][: 1 + (kind == "plate of a body")]:
            here = place * (name == "body") + rng.normal(scale=0.05, size=model[f"{name}.position"].shape)
            model[f"{name}.position"] = here
            turns = Rotation.random(here.size // 3, random_state=rng).as_quat()
            model[f"{name}.orientation"] = turns.reshape(*here.shape[:-1], 4)
        if kind == "one of two":
            model[f"{surface.name}.mesh"] = rng.integers(2, size=envs)
        if number == 50:  # until here all environments had the same
            vary(f"{surface.name}.position", 0.02)
            vary(f"{points.name}.position", 0.02)
            model[f"{surface.name}.scale"] = model[f"{surface.name}.scale"] * rng.uniform(0.9, 1.1, size=envs)
            model["touch.radius"] = radius * rng.uniform(0.9, 1.1, size=envs)
            if form == "hull":
                model["hull.scale"] = rng.uniform(0.6, 0.8, size=envs)
        touching = model.sensor("touch.status") == ContactStatus.CONTACT
        apart += not touching.any()
        if starts_clear(model, contact, envs):
            clear += 1
            assert not touching.any()
            gap = model.sensor("touch.gap")
            assert (gap[~np.isnan(gap)] > 0.0).all()
        assert starts_clear(model, contact, envs) != advice_needs_evaluation(model, None)
    assert apart > 0
    # A mesh seen from inside has no outer side beyond its bounds.
    assert (clear > 0) == (kind != "container")


def test_initial_clearance_far_from_the_origin_includes_rounding():
    """At coordinates of kilometers, float32 resolves tenths of a millimeter."""
    tilted = turn(0.7, (1, 0.3, 0.2))
    corners = Rotation.from_quat(tilted).apply(np.array(wc.meshes.grid((1e4, 1e4)).vertices))
    scene = wc.Scene(gravity=(0, 0, 0))
    plane = scene.add_surface(wc.Mesh(corners, wc.meshes.grid((1e4, 1e4)).faces))
    up = Rotation.from_quat(tilted).apply((0, 0, 1))
    near, away = (scene.add_body(1.0, (1, 1, 1), (0.1 + gap) * up) for gap in (1e-4, 1.0))
    lever = scene.add_body(1.0, (1, 1, 1), (0.1 + 1e-4) * up - (1000, 0, 0))
    arms = [
        scene.add_point(near, (0, 0, 0)),
        scene.add_point(lever, (1000, 0, 0)),
        scene.add_point(away, (0, 0, 0)),
    ]
    contacts = [scene.add_contact(arm, plane, LAW, radius=0.1) for arm in arms]
    model = scene.build(envs=2, device="cpu")
    assert [starts_clear(model, contact, 2) for contact in contacts] == [False, False, True]


@pytest.mark.parametrize(("height", "expected"), [(0.1001, True), (0.0999, False), (-0.5, False), (np.nan, False)])
def test_sphere_above_the_highest_vertex_is_initially_clear(height, expected):
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0), (4, 4)))
    balls = scene.add_bodies([(0, 0, 1), (1, 0, 1)], 1.0, (1, 1, 1), name="balls")
    contact = scene.add_contact(scene.add_points(balls, np.zeros((2, 3))), ground, LAW, radius=0.1)
    model = scene.build(envs=3, device="cpu")
    assert starts_clear(model, contact, model.envs)
    # Uses the current state, also if the user writes it directly.
    model.state.body_position.numpy()[1, 1, 2] = height
    assert starts_clear(model, contact, model.envs) == expected


def test_sphere_beyond_the_boundary_is_not_initially_clear():
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0), (4, 4)))
    ball = scene.add_body(1.0, (1, 1, 1), (1.8, 0, 1), name="ball")
    contact = scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, LAW, radius=0.1)
    model = scene.build(envs=2, device="cpu")
    assert starts_clear(model, contact, model.envs)
    model["ball.position"] = [(0, 0, 1), (1.95, 0, 1)]
    assert not starts_clear(model, contact, model.envs)


@pytest.mark.slow
@pytest.mark.launch_shapes
def test_first_step_of_initially_clear_scene_compiles_no_sensor_kernel():
    """No kernel of the contact force alone is compiled for a law of the library."""
    code = """
import sys, warpcontact as wc
scene = wc.Scene()
ground = scene.add_surface(wc.meshes.grid((4.0, 4.0), (4, 4)))
ball = scene.add_body(1.0, (1, 1, 1), (0, 0, 1), name="ball")
point, material = scene.add_point(ball, (0, 0, 0)), wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
scene.add_contact(point, ground, material, radius=0.1)
model = scene.build(envs=2, device="cpu")
model["ball.position"] = [(0, 0, 1), (0, 0, float(sys.argv[1]))]
wc.Simulation(model, dt=1e-3).step()
import warp._src.context as context
print(*(name for name, module in context.user_modules.items() if module.execs))
"""

    def loaded(height):
        ended = subprocess.run([sys.executable, "-c", code, height], capture_output=True, text=True, check=True)
        return ended.stdout.split()

    steps, sensors = "fused_steps", ("closest_point", "contact_force")
    names = loaded("0.2")
    assert any(steps in name for name in names)
    assert not any(sensor in name for name in names for sensor in sensors)
    names = loaded("0.05")
    assert all(any(part in name for name in names) for part in (steps, *sensors))


def test_initial_search_covers_only_requested_contacts():
    def search(height, *, piled=False, integrator=None):
        scene = wc.Scene()
        ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)))
        balls = scene.add_bodies([(0, 0, height), (1, 0, height)], 1.0, (1, 1, 1))
        scene.add_contact(scene.add_points(balls, np.zeros((2, 3))), ground, LAW, radius=0.1, name="touch")
        if piled:
            scene.add_particle_contact(scene.add_shape(balls, wc.shapes.Sphere(0.1)), LAW)
        sim = wc.Simulation(scene.build(device="cpu"), 1e-3, integrator)
        if not sim.evaluates_start:
            return None
        return [contact.name for contact in contacts_to_evaluate(sim.model, sim._buffers[0].nonsmooth)]

    assert search(0.05) == ["touch"]
    assert search(0.2) is None
    # The initial penetration of particles is read from a sensor, which evaluates contacts as well.
    assert search(0.2, piled=True) == []
    impulses = wc.integrators.MoreauJean()
    assert search(0.05, integrator=impulses) == ["touch"]
    assert search(0.2, integrator=impulses) is None
    assert search(0.05, integrator=wc.integrators.MoreauJean(recovery_time=0.1)) is None
