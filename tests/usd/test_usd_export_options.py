"""Options of export_usd: environments, spacing, times, names, files, and errors."""

import subprocess
import sys

import numpy as np
import pytest
import scenes
from recorded_usd_scene import RADII, export, findings, simulate, value, world

import warpcontact as wc


@pytest.fixture(scope="module")
def recording(device):
    return simulate(device)


def test_selected_environments_keep_their_numbers(recording, tmp_path):
    stage = export(recording, tmp_path, envs=[3, np.int32(1), 3])
    names = {prim.GetName() for prim in stage.GetPrimAtPath("/World").GetChildren()}
    assert {name for name in names if name.startswith("env_")} == {"env_1", "env_3"}
    np.testing.assert_array_equal(world(stage, "/World/env_3/ball", 9)[1], recording["ball.position"].values[9, 3])
    assert value(stage, "/World/env_1/ball/touch", "radius") == RADII[1]
    later = recording.isel(env=slice(2, 4))
    stage = export(later, tmp_path, envs=3, scene=recording.scene)
    np.testing.assert_array_equal(world(stage, "/World/env_3/ball", 9)[1], recording["ball.position"].values[9, 3])


def test_first_16_environments_are_exported_by_default(device, tmp_path):
    model = scenes.dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=20, device=device)
    stage = export(wc.Simulation(model, dt=1e-3).run(duration=2e-3), tmp_path)
    numbers = [env for env in range(20) if stage.GetPrimAtPath(f"/World/env_{env}")]
    assert numbers == list(range(16))


@pytest.mark.parametrize(
    ("spacing", "places"),
    [
        ((2, 3), [(0, 0), (2, 0), (0, 3), (2, 3)]),
        ((2, 0), [(0, 0), (2, 0), (4, 0), (6, 0)]),
        ((0, 3), [(0, 0), (0, 3), (0, 6), (0, 9)]),
    ],
)
def test_spacing_offsets_environments(recording, tmp_path, spacing, places):
    stage = export(recording, tmp_path, spacing=spacing)
    assert not stage.GetPrimAtPath("/World/Surfaces")
    assert findings(stage) == []
    floor = recording.scene.surfaces[0]
    for env, place in enumerate(places):
        offset = np.array([*place, 0.0])
        ball = recording["ball.position"].values[30, env]
        np.testing.assert_allclose(world(stage, f"/World/env_{env}/ball", 30)[1], ball + offset, atol=1e-12)
        path = f"/World/env_{env}/Surfaces/floor"
        np.testing.assert_allclose(world(stage, path, 30)[1], floor.position + offset, atol=1e-12)
        np.testing.assert_array_equal(value(stage, path, "points"), floor.mesh.vertices.astype(np.float32))


def test_uneven_records_keep_their_times(recording, tmp_path):
    stage = export(recording.isel(time=[2, 3, 7]), tmp_path, scene=recording.scene)
    layer = stage.GetRootLayer()
    assert layer.timeCodesPerSecond == pytest.approx(100.0)
    translate = stage.GetPrimAtPath("/World/env_0/ball").GetAttribute("xformOp:translate")
    np.testing.assert_allclose(translate.GetTimeSamples(), [0, 1, 5], atol=1e-9)
    assert layer.customLayerData["warpcontact"]["startTime"] == pytest.approx(0.02)
    np.testing.assert_array_equal(translate.Get(layer.endTimeCode), recording["ball.position"].values[7, 0])


def test_names_become_unique_usd_identifiers(device, tmp_path):
    scene = wc.Scene()
    for name in ("a-b", "a_b", "contacts"):
        scene.add_body(mass=1.0, inertia=(1, 1, 1), name=name)
    stage = export(wc.Simulation(scene.build(device=device), dt=1e-3).run(duration=1e-3), tmp_path)
    names = {
        prim.GetName(): (prim.GetCustomDataByKey("warpcontact:name"), prim.GetDisplayName())
        for prim in stage.GetPrimAtPath("/World/env_0").GetChildren()
    }
    expected = {"a_b": ("a_b", ""), "a_b_1": ("a-b", "a-b"), "contacts_1": ("contacts", "contacts")}
    assert names == expected


def test_open_stage_shows_the_new_export(recording, tmp_path):
    stage = export(recording, tmp_path, ".usdc", envs=0)
    assert not stage.GetPrimAtPath("/World/env_2")
    wc.export_usd(recording, tmp_path / "stage.usdc", envs=2)
    assert stage.GetPrimAtPath("/World/env_2")


def spoiled(recording, name, index, number):
    bad = recording.copy(deep=True)
    bad[name].values[index] = number
    return bad


@pytest.mark.parametrize(
    ("change", "options", "error", "message"),
    [
        (None, {"path": "a.obj"}, ValueError, r"must end in \.usd, \.usda, \.usdc, \.usdz, got .*a\.obj"),
        (None, {"path": "a"}, ValueError, "must end in"),
        (None, {"envs": 4}, ValueError, "environment 4 is not in the recording, which has 0 to 3"),
        (None, {"envs": [0, -1]}, ValueError, "environment -1 .* 0 to 3"),
        (None, {"envs": []}, ValueError, "at least one"),
        (None, {"envs": [0.5]}, TypeError, r"environment numbers, got 0\.5"),
        (None, {"envs": True}, TypeError, "environment numbers, got True"),
        (None, {"spacing": (1, -1)}, ValueError, "spacing.*-1"),
        (None, {"spacing": 2.0}, ValueError, "spacing must be 2 numbers"),
        (None, {"force_scale": 0.0}, ValueError, "force_scale"),
        (None, {"color_by": "peek"}, ValueError, r"got .peek.*run\.outcome\[name\]"),
        (None, {"scene": "scene"}, TypeError, "scene must be a wc.Scene"),
        (lambda r: r.isel(time=slice(3)), {}, ValueError, "pass scene="),
        (lambda r: r.to_dict(), {}, TypeError, "recording must be .* got dict"),
        (
            lambda r: r.drop_vars(["ball.position", "cube.orientation"]),
            {},
            ValueError,
            r"lacks ball\.position, cube\.orientation: .*poses=True",
        ),
        (lambda r: r.isel(env=0), {}, ValueError, "lacks the dimension 'env'"),
        (lambda r: r.isel(time=slice(0)), {}, ValueError, "no records"),
        (lambda r: r.isel(time=[1, 0]), {}, ValueError, "time coordinate .* increase"),
        (
            lambda r: spoiled(r, "ball.position", (7, 2, 1), np.nan),
            {},
            ValueError,
            r"ball\.position of environment 2 at 0\.07 s is not a position: .*nan",
        ),
        (
            lambda r: spoiled(r, "cube.orientation", (30, 0), 0.0),
            {},
            ValueError,
            r"cube\.orientation of environment 0 at 0\.3 s is not a rotation: \[0\.0",
        ),
        (lambda r: spoiled(r, "touch.radius", 1, -0.5), {}, ValueError, r"touch\.radius .* got -0\.5"),
        (lambda r: r.assign({"ball.mass": ("time", np.ones(31))}), {}, ValueError, r"ball\.mass|env"),
    ],
)
def test_invalid_export_request_is_refused(recording, tmp_path, change, options, error, message):
    target = tmp_path / options.pop("path", "a.usda")
    if change is not None:
        scene = recording.scene
        recording = change(recording)
        if message != "pass scene=":
            options["scene"] = scene
    with pytest.raises(error, match=message):
        wc.export_usd(recording, target, **options)
    assert not target.exists()


def test_failed_environment_can_be_omitted(recording, tmp_path):
    bad = spoiled(recording, "ball.position", (7, 2, 1), np.nan)
    stage = export(bad, tmp_path, scene=recording.scene, envs=[0, 1, 3])
    assert stage.GetPrimAtPath("/World/env_3")


def test_unwritable_usd_file_is_reported(recording, tmp_path):
    (tmp_path / "folder.usda").mkdir()
    with pytest.raises(OSError, match=r"folder\.usda"):
        wc.export_usd(recording, tmp_path / "folder.usda")


def test_import_of_usd_package_does_not_import_pxr():
    code = "import sys, warpcontact.usd; sys.exit('pxr' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
