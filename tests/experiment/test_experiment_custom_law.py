"""Custom laws from a Python file run in an experiment, and can be repeated from the results."""

import hashlib
import importlib.util
import json
import os
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from test_experiment import content

import warpcontact as wc
from warpcontact.cli import main

pytestmark = [pytest.mark.installed, pytest.mark.usefixtures("no_pictures")]

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
LAWS = (Path(__file__).parents[1] / "custom_laws_file.py").read_text(encoding="utf-8")
CUBIC = {"type": "my_laws.py:Cubic", "stiffness": 1e9}


def study(law=CUBIC, friction=None, **changes):
    """A ball at a penetration of 2 mm that slides on the ground, with custom laws."""
    body = content()["body"][0] | {"position": [0.0, 0.0, 0.098], "linear_velocity": [1.0, 0.0, 0.0]}
    material = {"name": "rubber", "law": law} | ({"friction": friction} if friction else {})
    sensors = {"sensors": ["touch.normal_force", "touch.friction_force", "ball.position"]}
    return content(body=[body], material=[material], record=sensors) | changes


@pytest.fixture
def folder(tmp_path):
    """A folder of a study with a file of custom laws."""
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "my_laws.py").write_text(LAWS, encoding="utf-8")
    return tmp_path / "study"


TEXT = """
envs = 3
duration = 0.02
dt = 1e-3
[[surface]]
name = "ground"
mesh = { shape = "grid", size = [4, 4] }
[[body]]
name = "ball"
mass = 1
inertia = [4e-3, 4e-3, 4e-3]
position = [0, 0, 0.098]
linear_velocity = [1, 0, 0]
[[point]]
name = "centre"
body = "ball"
position = [0, 0, 0]
[[material]]
name = "rubber"
law = { type = "my_laws.py:Cubic", stiffness = 1e9 }
friction = { type = "my_laws.py:Lubricated", drag = 0.1 }
[[contact]]
name = "touch"
points = "centre"
surface = "ground"
material = "rubber"
radius = 0.1
[variation]
"touch.law.stiffness" = { loguniform = [1e9, 1e10] }
"touch.friction.drag" = { values = [0, 0.1, 0.2] }
[record]
sensors = ["touch.normal_force", "touch.friction_force", "ball.position"]
"""


def imported(path, name):
    """The file as a module of a user script."""
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.smoke
def test_run_command_with_custom_laws_equals_script(device, folder, capsys):
    (folder / "study.toml").write_text(TEXT)
    out = folder.parent / "out"
    assert main(["run", str(folder / "study.toml"), "--out", str(out), "--device", device]) == 0
    captured = capsys.readouterr()
    assert captured.err.count(f"loading {folder / 'my_laws.py'} …\n") == 1
    assert str(out / "my_laws.py") in captured.out
    recorded = wc.open_run(out).recording

    module = imported(folder / "my_laws.py", "laws_of_a_script")
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid(size=(4.0, 4.0)), name="ground")
    ball = scene.add_body(1.0, [4e-3] * 3, (0, 0, 0.098), linear_velocity=(1, 0, 0), name="ball")
    rubber = wc.ContactMaterial(law=module.Cubic(stiffness=1e9), friction=module.Lubricated(drag=0.1))
    scene.add_contact(scene.add_point(ball, (0, 0, 0), name="centre"), ground, rubber, radius=0.1, name="touch")
    model = scene.build(envs=3, device=device)
    model["touch.law.stiffness"] = recorded["touch.law.stiffness"].values
    model["touch.friction.drag"] = [0.0, 0.1, 0.2]
    names = ["touch.normal_force", "touch.friction_force", "ball.position"]
    expected = wc.Simulation(model, dt=1e-3).run(0.02, names)
    for name in names:
        np.testing.assert_array_equal(recorded[name].values, expected[name].values)
    force = recorded["touch.normal_force"].values[0]
    np.testing.assert_allclose(force, recorded["touch.law.stiffness"].values * 2e-3**3, rtol=1e-4)
    friction = recorded["touch.friction_force"].sel(axis="x").values[0]
    np.testing.assert_allclose(friction, -np.array([0.0, 0.1, 0.2]) * force, rtol=1e-4)


def test_run_with_custom_laws_is_repeated_from_its_results(device, folder):
    first = wc.Experiment.from_dict(study(friction={"type": "my_laws.py:Lubricated", "drag": 0.3}), folder).run(
        folder.parent / "first", device=device
    )
    (folder / "my_laws.py").unlink()
    assert {path.name for path in first.files.values()} == {path.name for path in first.folder.iterdir()}
    again = wc.Experiment.from_toml(first.files["experiment"])
    second = again.run(folder.parent / "second", device=device)
    assert first.recording.identical(second.recording)
    for name in ("experiment.toml", "my_laws.py"):
        assert (second.folder / name).read_bytes() == (first.folder / name).read_bytes()
    digest = hashlib.sha256(LAWS.encode()).hexdigest()
    assert json.loads(second.files["summary"].read_text())["law_files"] == {"my_laws.py": digest}
    # Into the same folder that the experiment is read from.
    third = wc.Experiment.from_toml(first.files["experiment"]).run(first.folder, device=device, overwrite=True)
    assert third.recording.identical(second.recording)
    assert (first.folder / "my_laws.py").read_text(encoding="utf-8") == LAWS


@pytest.mark.slow
def test_custom_law_files_of_equal_name_are_copied_separately(folder):
    for sub, factor in (("soft", "1.0"), ("hard", "3.0")):
        (folder / sub).mkdir()
        text = LAWS.replace("return p.stiffness *", f"return type(c.delta)({factor}) * p.stiffness *")
        (folder / sub / "laws.py").write_text(text, encoding="utf-8")
    materials = [
        {"name": sub, "law": {"type": f"{sub}/laws.py:Cubic", "stiffness": 1e9}}
        for sub in ("soft", "hard", "soft")
    ]
    materials[2] |= {"name": "again", "friction": {"type": "./soft/laws.py:Lubricated", "drag": 1}}
    contacts = [content()["contact"][0] | {"name": f"{t['name']}_touch", "material": t["name"]} for t in materials]
    raw = study(material=materials, contact=contacts)
    raw["record"] = {"sensors": [f"{contact['name']}.normal_force" for contact in contacts]}
    run = wc.Experiment.from_dict(raw, folder).run(folder.parent / "out", device="cpu")
    written = tomllib.loads(run.files["experiment"].read_text())["material"]
    assert [material["law"]["type"] for material in written] == [
        *("laws.py:Cubic", "laws_2.py:Cubic", "laws.py:Cubic")
    ]
    assert written[2]["friction"]["type"] == "laws.py:Lubricated"
    forces = [run.recording[name].values[0, 0] for name in raw["record"]["sensors"]]
    np.testing.assert_allclose(forces, [8.0, 24.0, 8.0], rtol=1e-4)
    again = wc.Experiment.from_toml(run.files["experiment"]).run(folder.parent / "again", device="cpu")
    assert again.recording.identical(run.recording)
    assert again.files["experiment"].read_bytes() == run.files["experiment"].read_bytes()


@pytest.mark.slow
def test_overwrite_replaces_copied_law_files_only(folder):
    out = folder.parent / "out"
    wc.Experiment.from_dict(study(), folder).run(out, device="cpu")
    (out / "notes.py").write_text("mine")
    catalogue = wc.Experiment.from_dict(study(law={"type": "Hooke", "stiffness": 1e4}), folder)
    catalogue.run(out, device="cpu", overwrite=True)
    assert not (out / "my_laws.py").exists()
    assert (out / "notes.py").read_text() == "mine"
    (out / "my_laws.py").write_text("mine too")
    with pytest.raises(wc.ExperimentError, match=r"holds a file 'my_laws\.py' of the user"):
        wc.Experiment.from_dict(study(), folder).run(out, device="cpu", overwrite=True)
    assert (out / "my_laws.py").read_text() == "mine too"
    assert (out / "data.zarr").exists()
    # For any content of run.json, no other file is removed.
    (folder / "kept.py").write_text("")
    for name in ("../study/kept.py", "notes.txt", str(folder / "kept.py"), 3):
        summary = json.loads((out / "run.json").read_text()) | {"law_files": {name: ""} if name != 3 else 3}
        (out / "run.json").write_text(json.dumps(summary))
        catalogue.run(out, device="cpu", overwrite=True)
    assert (folder / "kept.py").exists()


def test_interrupted_run_resumes_with_copied_law_files(folder):
    def interrupt(stage):
        if stage == "running":
            raise KeyboardInterrupt

    out = folder.parent / "out"
    with pytest.raises(KeyboardInterrupt):
        wc.Experiment.from_dict(study(), folder).run(out, device="cpu", on_stage=interrupt)
    assert json.loads((out / "run.json").read_text())["state"] == "interrupted"
    resumed = wc.Experiment.from_dict(study(), folder).run(out, device="cpu", resume=True)
    assert (out / "my_laws.py").read_bytes() == (folder / "my_laws.py").read_bytes()
    assert resumed.finished


def law_of(experiment):
    return experiment.scene().contacts[0].material.law


def force_of(experiment, device="cpu"):
    return experiment.model(envs=1, device=device).sensor("touch.normal_force")[0]


def test_unchanged_law_file_shares_classes_and_edited_file_gets_new_ones(folder, device):
    before = wc.Experiment.from_dict(study(), folder)
    assert type(law_of(wc.Experiment.from_dict(study(), folder))) is type(law_of(before))
    np.testing.assert_allclose(force_of(before, device), 8.0, rtol=1e-4)
    (folder / "my_laws.py").write_text(LAWS.replace("return p.stiffness *", "return type(c.delta)(2.0) *"))
    after = wc.Experiment.from_dict(study(law=CUBIC | {"stiffness": 1.0}), folder)
    np.testing.assert_allclose(force_of(after, device), 2.0 * 2e-3**3, rtol=1e-4)
    # The module that was read is unchanged, also if the experiment is validated again.
    np.testing.assert_allclose(force_of(before.changed(duration=0.01), device), 8.0, rtol=1e-4)
    run = before.run(folder.parent / "out", device=device)
    assert run.files["my_laws.py"].read_text(encoding="utf-8") == LAWS


def test_class_unchanged_by_an_edit_still_runs(folder, device):
    force_of(wc.Experiment.from_dict(study(), folder), device)
    (folder / "my_laws.py").write_text(f"# A remark.\n{LAWS}", encoding="utf-8")
    np.testing.assert_allclose(force_of(wc.Experiment.from_dict(study(), folder), device), 8.0, rtol=1e-4)


def test_class_with_inherited_force_is_updated_by_an_edit(folder, device):
    text = """
import warpcontact as wc


class Doubled(wc.laws.Hooke):
    \"\"\"N = 2 K δ.\"\"\"

    @staticmethod
    def coefficients(values):
        return {"stiffness": 2.0 * values["stiffness"]}
"""
    for factor in (2.0, 3.0):
        (folder / "my_laws.py").write_text(text.replace("2.0", str(factor)), encoding="utf-8")
        law = {"type": "my_laws.py:Doubled", "stiffness": 1e3}
        force = force_of(wc.Experiment.from_dict(study(law=law), folder), device)
        np.testing.assert_allclose(force, factor * 2.0, rtol=1e-4)
    hooke = wc.Experiment.from_dict(study(law={"type": "Hooke", "stiffness": 1e3}), folder)
    np.testing.assert_allclose(force_of(hooke, device), 2.0, rtol=1e-4)


def test_edit_of_equal_length_and_time_stamp_is_detected(folder):
    path = folder / "my_laws.py"
    force_of(wc.Experiment.from_dict(study(), folder))
    times = path.stat()
    path.write_text(LAWS.replace("return p.stiffness * c.delta * c", "return p.stiffness + c.delta * c"))
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    np.testing.assert_allclose(force_of(wc.Experiment.from_dict(study(), folder)), 1e9, rtol=1e-4)


def test_law_file_is_loaded_once_for_all_references(folder):
    (folder / "my_laws.py").write_text(
        f"{LAWS}\nfrom pathlib import Path\nwith Path(__file__).with_name('log').open('a') as log:\n"
        "    log.write(__name__ + '\\n')\n",
        encoding="utf-8",
    )
    modules = set(sys.modules)
    messages = []
    raw = study(friction={"type": "./my_laws.py:Lubricated", "drag": 0.1})
    experiment = wc.Experiment(raw, folder, on_stage=messages.append)
    experiment.changed(envs=2).run(folder.parent / "out", device="cpu")
    assert messages == [f"loading {folder / 'my_laws.py'}"]
    wc.Experiment(raw, folder)
    (name,) = (folder / "log").read_text().split()
    assert name != "__main__"
    new = {name for name in set(sys.modules) - modules if "my_laws" in name}
    assert new == {name}
    assert name.startswith("_warpcontact_own_")


def test_custom_law_parameters_can_vary_and_have_defaults(folder, device):
    pad = {"type": "my_laws.py:Pad", "depth": 1e-3, "damping": 0}
    varied = {"touch.law.depth": {"values": [1e-3, 2e-3, 4e-3, 8e-3]}}
    experiment = wc.Experiment.from_dict(study(law=pad, variation=varied), folder)
    force = experiment.model(device=device).sensor("touch.normal_force")
    np.testing.assert_allclose(force, [2.0, 1.0, 0.5, 0.25], rtol=1e-4)
    # Defaults are written as plain numbers, for any type.
    run = wc.Experiment.from_dict(study(law={"type": "my_laws.py:Pad", "stiffness": 1e3}), folder).run(
        folder.parent / "out", device=device
    )
    written = tomllib.loads(run.files["experiment"].read_text())["material"][0]["law"]
    assert written == {"type": "my_laws.py:Pad", "stiffness": 1e3, "damping": 0.5}


def test_string_annotations_of_custom_laws_are_supported(folder):
    (folder / "my_laws.py").write_text(f"from __future__ import annotations\n{LAWS}", encoding="utf-8")
    np.testing.assert_allclose(force_of(wc.Experiment.from_dict(study(), folder)), 8.0, rtol=1e-4)


def test_custom_law_example_file_rebounds_as_closed_form(device, tmp_path):
    words = ["run", str(EXAMPLES / "own_law.toml"), "--out", str(tmp_path / "out"), "--device", device]
    assert main(words) == 0
    recording = wc.open_run(tmp_path / "out").recording
    closed_form = imported(EXAMPLES / "own_law.py", "example_own_law_closed_form")
    after = recording.sel(time=slice(0.22, None))  # first contact at 0.202 s
    heights = after["ball.position"].sel(axis="z").max("time").values - 0.05
    speeds = after["ball.linear_velocity"].sel(axis="x").isel(time=0).values
    expected_heights, expected_speeds = closed_form.expected(recording["touch.law.damping"].values)
    assert len(heights) == 16
    # The tolerances are those of custom_law.py, explained in test_examples.py.
    np.testing.assert_allclose(heights, expected_heights, rtol=0.008)
    np.testing.assert_allclose(speeds, expected_speeds, rtol=0.002)


def test_custom_friction_with_history_can_be_used_for_rolling_and_torsion(folder, device, tmp_path):
    spring = {"type": "my_laws.py:StickSpring", "mu": 0.4, "stiffness": 1e5}
    material = {"name": "rubber", "law": CUBIC, "friction": spring, "rolling": spring, "torsion": spring}
    experiment = wc.Experiment(study(material=[material]), folder=folder)
    run = experiment.run(tmp_path / "out", device=device)
    force = run.recording["touch.friction_force"].sel(axis="x").values
    normal = run.recording["touch.normal_force"].values
    assert (force[1:] < 0).any()
    assert (np.abs(force) <= 0.4 * normal * (1 + 1e-5)).all()
    again = wc.Experiment.from_toml(run.files["experiment"]).run(tmp_path / "again", device=device)
    assert again.recording.identical(run.recording)
