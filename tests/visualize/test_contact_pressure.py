"""Areas of body contacts, colored by pressure, in drawings, stills, the replay of reports, the live view and USD."""

import base64
import zlib

import numpy as np
import pytest
import warp as wp
from viewer_helpers import viewing, wait_for_thread

import warpcontact as wc
from warpcontact.drawing.colors import pressure_scale
from warpcontact.drawing.contact_pressure import PressurePatches
from warpcontact.drawing.drawing import drawing_of
from warpcontact.usd.check import check_usd
from warpcontact.visualize.report.packing import Pack
from warpcontact.visualize.report.pressure import PressureData

SIDE, MASS, K, G = 0.1, 1.0, 2e7, 9.81
DEPTH = MASS * G / (K * SIDE**2)
CONTACTS = ("ground", "stack")


def simulation(integrator=None, law=None, visible=True, precision="float64"):
    """A simulation of two cubes on each other, offset by 3 cm, on a plane, in two environments."""
    scene = wc.Scene()
    below = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    friction = wc.friction.Tanh(mu=0.5, velocity_scale=1e-2)
    material = wc.ContactMaterial(
        law=law or wc.laws.ElasticFoundation(stiffness=K, damping=20.0), friction=friction
    )
    for i, name in enumerate(CONTACTS):
        # At their depth at rest.
        height = (i + 0.5) * SIDE - (2 - i) * DEPTH - i * 2 * DEPTH
        body = scene.add_body(
            mass=MASS, inertia=(MASS * SIDE**2 / 6,) * 3, position=(0.03 * i, 0, height), name=f"box_{i}"
        )
        box = scene.add_shape(body, wc.shapes.RoundedBox((SIDE / 2,) * 3), name=f"shape_{i}")
        scene.add_body_contact(box, below, material, name=name, visible=visible)
        below = box
    wp.config.log_level = wp.LOG_ERROR
    model = scene.build(envs=2, device="cpu", precision=precision)
    return wc.Simulation(model, dt=1e-4, integrator=integrator)


def recorded(sim, *quantities, duration=0.004):
    names = [f"{contact}.{key}" for contact in CONTACTS for key in quantities]
    names += [name for name in quantities if "." in name]
    names = [name for name in names if name in sim.model.sensor_names]
    return sim.run(duration, record=names, every=1e-3)


def areas(patches):
    """Returns the areas of the triangles of a patch [m²]."""
    edges = np.diff(patches.positions, axis=1)
    return 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)


def forces(patches):
    """Returns the integral of the pressure of a patch [N]."""
    return (areas(patches) * patches.pressures.mean(axis=1)).sum()


@pytest.fixture(scope="module")
def recording():
    return recorded(simulation(), "normal_force", "area", "force", "center")


def test_patches_have_area_and_force_of_the_sensors(recording):
    drawing = drawing_of(recording)
    for record in (0, 4):
        for row in (0, 1):
            found = {one.name: one for one in drawing.pressure.at(record, row)}
            assert set(found) == set(CONTACTS)
            for name, patches in found.items():
                area, force = (float(recording[f"{name}.{key}"][record, row]) for key in ("area", "normal_force"))
                assert areas(patches).sum() == pytest.approx(area, rel=1e-4)
                assert forces(patches) == pytest.approx(force, rel=1e-4)


def test_patches_are_on_the_surfaces_in_contact(recording):
    found = {one.name: one for one in drawing_of(recording).pressure.at(0, 0)}
    np.testing.assert_allclose(found["ground"].positions[..., 2], 0.0, atol=1e-12)
    assert np.ptp(found["stack"].positions[..., 0]) == pytest.approx(SIDE - 0.03, rel=1e-3)
    np.testing.assert_allclose(found["stack"].positions[..., 2], SIDE, atol=5 * DEPTH)
    # Counter-clockwise around the normals out of the second solids.
    for patches in found.values():
        edges = np.diff(patches.positions, axis=1)
        assert (np.einsum("ij,ij->i", np.cross(edges[:, 0], edges[:, 1]), patches.normals) > 0).all()


def test_pressure_without_recorded_forces_follows_from_poses_and_velocities():
    sim = simulation()
    sim.model["box_0.linear_velocity"] = (0, 0, -0.01)
    poses = recorded(sim)
    sim.reset()
    velocities = [f"box_{i}.{key}" for i in (0, 1) for key in ("linear_velocity", "angular_velocity")]
    moving = recorded(sim, *velocities, "normal_force").drop_vars([f"{name}.normal_force" for name in CONTACTS])
    sim.reset()
    exact = recorded(sim, "normal_force", "depth")
    force = float(exact["ground.normal_force"][0, 0])
    ground = [drawing_of(one, sim.model.scene).pressure.at(0, 0)[0] for one in (poses, moving)]
    assert forces(ground[1]) == pytest.approx(force, rel=1e-9)
    # Without velocities, without damping.
    assert forces(ground[0]) == pytest.approx(K * SIDE**2 * float(exact["ground.depth"][0, 0]), rel=1e-9)


def test_pairs_of_a_float32_scene_with_a_joint_and_a_set_of_bodies_have_the_recorded_forces():
    scene = wc.Scene()
    cube = wc.shapes.RoundedBox((SIDE / 2,) * 3)
    solids = [scene.add_shape(None, wc.shapes.Plane(), name="floor")]
    scene.add_bodies([(5, 0, 9), (6, 0, 9), (7, 0, 9)], mass=1.0, inertia=(1.0,) * 3, name="others")
    for i, motion in enumerate((None, wc.motions.Slider(axis=(0, 0, 1)))):
        height = (i + 0.5) * SIDE - (2 - i) * DEPTH - i * 2 * DEPTH
        options = {} if motion is None else {"motion": motion}
        body = scene.add_body(
            mass=MASS, inertia=(1e-3,) * 3, position=(0.02 * i, 0, height), name=f"body_{i}", **options
        )
        solids.append(scene.add_shape(body, cube, name=f"cube_{i}"))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
    scene.add_body_contact(solids, material, name="bin")
    wp.config.log_level = wp.LOG_ERROR
    sim = wc.Simulation(scene.build(envs=1, device="cpu"), dt=1e-4)
    recording = sim.run(0.002, record=["bin.normal_force"], every=1e-3)
    assert recording["bin.normal_force"].shape == (3, 1, 3)
    (patches,) = drawing_of(recording).pressure.at(2, 0)
    assert patches.name == "bin"
    np.testing.assert_allclose(forces(patches), recording["bin.normal_force"][2, 0].sum(), rtol=1e-3)
    # One area below each cube.
    lower = patches.positions[..., 2].mean(axis=1) < SIDE / 2
    below = PressurePatches("below", patches.positions[lower], patches.normals[lower], patches.pressures[lower])
    assert forces(below) == pytest.approx(float(recording["bin.normal_force"][2, 0].max()), rel=1e-3)


def test_changed_parameters_of_the_law_are_those_of_the_pictures():
    sim = simulation()
    sim.model["ground.law.stiffness"] = 3 * K  # in all environments
    sim.model["stack.law.stiffness"] = [K, 2 * K]
    recording = recorded(sim)
    pressure = drawing_of(recording).pressure
    first, second = pressure.at(0, 0), pressure.at(0, 1)
    plain = drawing_of(recorded(simulation())).pressure.at(0, 0)
    peak = lambda patches: [one.pressures.max() for one in patches]  # noqa: E731
    np.testing.assert_allclose(peak(first), np.array(peak(plain)) * [3, 1], rtol=1e-6)
    np.testing.assert_allclose(peak(second), np.array(peak(plain)) * [3, 2], rtol=1e-6)


def test_nonsmooth_contacts_have_forces_at_points_and_no_pressure():
    sim = simulation(wc.integrators.MoreauJean(), wc.laws.Rigid())
    recording = recorded(sim, "force", "center", "point", "point_force")
    drawing = drawing_of(recording)
    assert drawing.pressure is None
    ground = next(one for one in drawing.contact_forces if one.name == "ground")
    assert ground.points.shape[2] == 4
    np.testing.assert_allclose(ground.forces.sum(axis=2), recording["ground.force"].values, atol=1e-9)
    np.testing.assert_allclose(np.abs(ground.points[-1, 0, :, :2]), SIDE / 2, rtol=0.01)


def test_contacts_with_impulses_have_no_pressure():
    recording = recorded(simulation(), "normal_force")
    contacts = {}
    for compliant in ([], ["stack"], "stack"):
        recording.attrs.update(integrator="MoreauJean", compliant=compliant)
        pressure = drawing_of(recording).pressure
        contacts[str(compliant)] = [] if pressure is None else [one.name for one in pressure.contacts]
    assert contacts == {"[]": [], "['stack']": ["stack"], "stack": ["stack"]}


def test_recordings_name_compliant_contacts():
    sim = simulation(wc.integrators.MoreauJean(compliant=["stack"]))
    assert recorded(sim).attrs["compliant"] == ["stack"]


def test_invisible_contacts_have_no_pressure():
    assert drawing_of(recorded(simulation(visible=False))).pressure is None


def test_refined_patch_covers_the_same_area_in_small_steps():
    patches = PressurePatches(
        "one", np.array([[(0.0, 0, 0), (1, 0, 0), (0, 1, 0)]]), np.array([(0.0, 0, 1)]), np.array([(0.0, 8, 4)])
    )
    found = patches.refined(16.0)
    assert areas(found).sum() == pytest.approx(0.5)
    assert np.ptp(found.pressures, axis=1).max() <= 2.0
    np.testing.assert_allclose(found.pressures, 8 * found.positions[..., 0] + 4 * found.positions[..., 1])
    assert len(found.normals) == len(found.positions)


def test_still_shows_pressures_in_the_colors_of_its_scale(recording):
    view = {"size": (240, 160), "view_from": (-60, 35), "samples": 1, "forces": False, "labels": False}
    largest = K * 4 * DEPTH
    plain = wc.render(recording, pressure=False, **view).astype(int)
    colored = wc.render(recording, max_pressure=largest, **view).astype(int)
    changed = (np.abs(plain - colored).max(axis=2) > 40).mean()
    assert 0.01 < changed < 0.3
    labels = wc.render(recording, max_pressure=largest, **view | {"labels": True}).astype(int)
    bar = 255 * pressure_scale(1.0).colors(np.linspace(0, 1, 9))
    found = labels.reshape(-1, 1, 3) - bar
    assert (np.abs(found).max(axis=2).min(axis=0) <= 12).all()  # every color of the scale


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_upper_end_of_the_color_scale_must_be_positive(recording, value):
    with pytest.raises(ValueError, match="max_pressure"):
        wc.render(recording, max_pressure=value)


def unpacked(pack):
    """Arrays of a pack of floats and indices, as the page decodes them."""
    content = pack.content()
    data, place, found = zlib.decompress(base64.b64decode(content["data"])), 0, []
    for header in content["arrays"]:
        if header["type"] == "same":
            found.append(found[header["of"]])
            continue
        size = int(np.prod(header["shape"]))
        if header["type"] == "index":
            planes = np.frombuffer(data, np.uint8, 4 * size, place).reshape(4, -1)
            differences = np.ascontiguousarray(planes.T).view("<u4").reshape(-1)
            found.append(np.cumsum(differences, dtype=np.uint32).reshape(header["shape"]).astype(int))
            place += 4 * size
        else:
            low, high = np.frombuffer(data, np.uint8, 2 * size, place).reshape(2, -1).astype(np.uint16)
            rows = (low + 256 * high).reshape(-1, header["shape"][0])
            values = np.cumsum(rows, axis=1, dtype=np.uint16).T.reshape(header["shape"])
            found.append(np.array(header["low"]) + np.array(header["step"]) * values)
            place += 2 * size
    return found


def test_replay_of_a_report_has_the_areas_of_each_record(recording):
    drawing = drawing_of(recording)
    data, pack = PressureData(drawing), Pack()
    assert data.add(pack, 0, finest=1.0) == len(drawing.times)
    own, vertex_starts, face_starts, vertices, pressures, faces = unpacked(pack)
    np.testing.assert_array_equal(own, range(len(drawing.times)))
    assert data.description["largest"] == pytest.approx(pressures.max(), rel=1e-3)
    for record in own:
        corners = vertices[vertex_starts[record] : vertex_starts[record + 1]]
        values = pressures[vertex_starts[record] : vertex_starts[record + 1], 0]
        triangles = faces[face_starts[record] : face_starts[record + 1]]
        patches = PressurePatches("all", corners[triangles], np.zeros((len(triangles), 3)), values[triangles])
        force = sum(float(recording[f"{name}.normal_force"][record, 0]) for name in CONTACTS)
        assert forces(patches) == pytest.approx(force, rel=2e-3)  # quantized


def test_usd_has_a_mesh_of_each_contact_over_time(recording, tmp_path):
    from pxr import Usd, UsdGeom

    whole, clips = (
        wc.export_usd(recording, tmp_path / "a.usda"),
        wc.export_usd(recording, tmp_path / "b.usdc", clip_frames=2),
    )
    for file in (whole, clips):
        assert check_usd(file) == []
        stage = Usd.Stage.Open(str(file))
        for name in CONTACTS:
            mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/World/env_1/contacts/{name}/pressure"))
            for record in range(recording.sizes["time"]):
                corners = np.array(mesh.GetPointsAttr().Get(record), dtype=float)
                triangles = np.array(mesh.GetFaceVertexIndicesAttr().Get(record)).reshape(-1, 3)
                values = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("pressure").Get(record), dtype=float)
                patches = PressurePatches(
                    name, corners[triangles], np.zeros((len(triangles), 3)), values[triangles]
                )
                force = float(recording[f"{name}.normal_force"][record, 1])
                assert forces(patches) == pytest.approx(force, rel=1e-4)
                assert len(mesh.GetDisplayColorAttr().Get(record)) == len(corners)


def test_usd_without_pressure_has_no_meshes(recording, tmp_path):
    from pxr import Usd

    stage = Usd.Stage.Open(str(wc.export_usd(recording, tmp_path / "a.usda", pressure=False)))
    assert stage.GetPrimAtPath("/World/env_0/contacts/stack/force")
    assert not stage.GetPrimAtPath("/World/env_0/contacts/stack/pressure")
    with pytest.raises(ValueError, match="pressure must be True or False"):
        wc.export_usd(recording, tmp_path / "b.usda", pressure="no")


@pytest.mark.installed
def test_live_view_shows_pressure_on_request():
    with viewing(simulation()) as show:
        assert show.stage._patches == []
        show.pressure_input.value = True
        wait_for_thread(show)
        assert len(show.stage._patches) == len(CONTACTS)
        largest = show.stage.largest_pressure
        assert K * DEPTH < largest < 10 * K * DEPTH
        assert f"{largest:.3g} Pa" in show._pressure_legend.content
        assert show.stage._figures[0].nodes[0].opacity is None or show.stage._figures[0].nodes[0].opacity < 1
        show.pressure_input.value = False
        wait_for_thread(show)
        assert show.stage._patches == []
        assert show._pressure_legend.content == ""
