"""Forces of contact couplings and particle contacts as arrows with the recorded length and direction."""

import numpy as np
import pytest
import scenes
from recorded_usd_scene import arrows, export

import warpcontact as wc


@pytest.fixture(scope="module")
def coupled_recording(device):
    scene = wc.Scene()
    ground = scene.add_surface(scenes.square(5.0), name="ground")
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 0.505), name="cube")
    skin = scene.add_surface(wc.meshes.box(), body, name="skin")
    reach = wc.ContactRange(k1=4e4, k2=2e2, effective_range=0.02)
    scene.add_contact_coupling(skin, ground, reach, name="keep", color=(0, 0, 1))
    parts = ("normal_force", "normal", "point")
    record = ["keep.force", *(f"keep_first.{key}" for key in parts)]
    return wc.Simulation(scene.build(2, device, "float64"), 1e-3).run(5e-3, record)


def test_contact_coupling_arrow_acts_on_the_body_of_its_first_surface(coupled_recording, tmp_path):
    bare = coupled_recording.drop_vars("keep_first.normal_force")
    stage = export(bare, tmp_path, scene=coupled_recording.scene, force_scale=0.01)
    for code in range(6):
        start, force = arrows(stage, "/World/env_1/contacts/keep/force", code)
        np.testing.assert_allclose(start, coupled_recording["cube.position"].values[code, 1:2], atol=1e-6)
        np.testing.assert_allclose(
            force[0] / 0.01, coupled_recording["keep.force"].values[code, 1], rtol=1e-5, atol=1e-4
        )
    head = stage.GetPrimAtPath("/World/env_1/contacts/keep/force/head")
    np.testing.assert_array_equal(head.GetAttribute("primvars:displayColor").Get(), [(0, 0, 1)])


def test_contact_coupling_arrows_are_drawn_per_point_if_recorded(coupled_recording, tmp_path):
    stage = export(coupled_recording, tmp_path, force_scale=0.01)
    assert not stage.GetPrimAtPath("/World/env_0/contacts/keep/force")
    _, force = arrows(stage, "/World/env_0/contacts/keep_first/force", 3)
    total = np.nansum(force, axis=0) / 0.01
    np.testing.assert_allclose(total, coupled_recording["keep.force"].values[3, 0], rtol=1e-4, atol=1e-3)


def test_particle_contact_arrows_are_drawn_for_every_shape(device, tmp_path):
    scene = wc.Scene(gravity=(0, 0, 0))
    places = [(0.0, 0.0, 0.0), (0.19, 0.0, 0.0), (1.0, 0.0, 0.0)]
    grains = scene.add_bodies(places, mass=1.0, inertia=(1, 1, 1), name="grains")
    shape = scene.add_shape(grains, wc.shapes.Sphere(0.1), name="ball")
    other = scene.add_body(1.0, (1, 1, 1), (0.0, 0.18, 0.0), name="other")
    single = scene.add_shape(other, wc.shapes.Sphere(0.1), name="single")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_particle_contact([shape, single], material, name="pile")
    recording = wc.Simulation(scene.build(2, device, "float64"), 1e-4).run(2e-3, ["pile.force"], every=1e-3)
    stage = export(recording, tmp_path, force_scale=1e-3)
    for code in range(3):
        start, force = arrows(stage, "/World/env_1/contacts/pile/force", code)
        expected = recording["pile.force"].values[code, 1]
        np.testing.assert_array_equal(np.isfinite(start[:, 0]), [True, True, False, True])
        np.testing.assert_allclose(np.nan_to_num(force) / 1e-3, expected, rtol=1e-5, atol=1e-3)
        centres = np.concatenate(
            [recording["grains.position"].values[code, 1], recording["other.position"].values[code, 1:2]]
        )
        np.testing.assert_allclose(start[[0, 1, 3]], centres[[0, 1, 3]], atol=1e-6)


def test_contact_at_several_minima_has_one_arrow_of_the_total_force(device, tmp_path):
    scene = wc.Scene(gravity=(0, 0, 0))
    folded = wc.Mesh(
        [(0, -1, 0), (0, 1, 0), (1, -1, 1), (1, 1, 1), (-1, -1, 1), (-1, 1, 1)],
        [(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4)],
    )
    walls = scene.add_surface(folded, name="walls")
    ball = scene.add_body(1e3, (1, 1, 1), (0.0, 0.0, 0.14), name="ball")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    centre = scene.add_point(ball, (0, 0, 0))
    scene.add_contact(centre, walls, material, radius=0.1, minima="all", name="touch")
    keys = ("force", "center", "normal_force", "normal", "point")
    recording = wc.Simulation(scene.build(1, device, "float64"), 1e-3).run(2e-3, [f"touch.{key}" for key in keys])
    stage = export(recording, tmp_path, force_scale=0.01)
    start, force = arrows(stage, "/World/env_0/contacts/touch/force", 1)
    np.testing.assert_allclose(start, recording["touch.center"].values[1], atol=1e-6)
    np.testing.assert_allclose(force / 0.01, recording["touch.force"].values[1], atol=1e-3)
    assert force[0, 2] > 0.1
    # A normal alone has no direction for several forces.
    other = export(recording.drop_vars("touch.force"), tmp_path, force_scale=0.01, scene=recording.scene)
    assert not other.GetPrimAtPath("/World/env_0/contacts/touch/force")
