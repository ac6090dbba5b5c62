"""The comparison of results of two checkouts: hashes, differences, reports, names, coverage of the catalogs."""

import importlib
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import warpcontact as wc

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="benchmarks are in a checkout, not in an installed package"
)


@pytest.fixture(scope="module")
def golden():
    """The script, and its modules as attributes."""
    sys.path.insert(0, str(FOLDER))
    try:
        script = importlib.import_module("golden")
        modules = {
            name: importlib.import_module(f"golden_scenes.{name}")
            for name in ("catalog", "difference", "names", "plan")
        }
    finally:
        sys.path.remove(str(FOLDER))
    return SimpleNamespace(script=script, **modules)


@pytest.fixture
def result(golden, tmp_path):
    """Returns a function that makes the result of a scene from its arrays or an error."""

    def make(checkout, scene, error="", **arrays):
        path = tmp_path / f"{checkout}-{scene}.npz"
        np.savez(path, **{name.replace("__", "/"): values for name, values in arrays.items()})
        return golden.script.Result(scene, 1.0, 1.0, path, error)

    return make


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_ulps_count_representable_values_across_zero(golden, real):
    one = np.array([1.0, -1.0, 0.0, -0.0, 5e-324], real)
    ulps = golden.difference.ulp_distance
    np.testing.assert_array_equal(ulps(one, one), np.zeros(5))
    np.testing.assert_array_equal(ulps(one, np.nextafter(one, real(np.inf))), np.ones(5))
    below = np.nextafter(np.zeros(1, real), real(-1))
    np.testing.assert_array_equal(ulps(below, -below), [2])
    # A difference of sign alone counts, because results must be bitwise identical.
    np.testing.assert_array_equal(ulps(np.zeros(1, real), -np.zeros(1, real)), [1])
    np.testing.assert_array_equal(ulps(np.array([3, 7]), np.array([5, 7])), [2, 0])


def test_differences_report_magnitude_and_first_frame(golden):
    one = np.ones((5, 2), np.float32)
    other = one.copy()
    other[3:, 1] = [1.0 + 2.0**-23, 1.5]
    (found,) = golden.difference.differences({"recording/gap": one}, {"recording/gap": other})
    assert (found.name, found.absolute, found.count, found.size, found.first) == ("recording/gap", 0.5, 2, 10, 3)
    assert found.relative == pytest.approx(1 / 3)
    assert found.ulps == 2**22
    assert "recording/gap: 0.5 absolute" in str(found)
    assert golden.difference.differences({"a": one}, {"a": one.copy()}) == []


def test_differences_include_nan_sign_and_shape(golden):
    nan, zero = np.array([np.nan]), np.array([0.0])
    compare = golden.difference.compare_values
    assert compare("a", nan, nan.copy()) is None
    assert compare("a", nan, zero).absolute == np.inf
    assert compare("a", zero, -zero).ulps == 1
    assert "shape" in compare("a", zero, np.zeros(2)).note
    assert "type" in compare("a", zero, zero.astype(np.float32)).note
    assert "1 of 2 values" in compare("a", np.array(["up", "slow"]), np.array(["up", "fast"])).note
    assert compare("a", np.array([np.inf]), np.array([-np.inf])).absolute == np.inf


def test_largest_difference_is_first_and_missing_arrays_precede(golden):
    one = {"small": np.array([1.0]), "large": np.array([1.0]), "missing": np.array([1.0])}
    other = {"small": np.array([1.0 + 1e-15]), "large": np.array([2.0]), "new": np.array([1.0])}
    found = golden.difference.differences(one, other, ("this", "other"))
    assert [difference.name for difference in found] == ["missing", "new", "large", "small"]
    assert found[0].note == "only in this"
    assert found[1].note == "only in other"
    # A new sensor does not count as a change of results.
    assert golden.difference.differences({"sensors/new": one["small"]}, {}) == []


def test_hash_depends_on_name_type_shape_and_bits_only(golden):
    values = np.arange(6.0)
    digest = golden.difference.digest
    same = digest({"b": values, "a": values.copy()})
    assert digest({"a": values[::-1][::-1], "b": values}) == same
    changed = values.copy()
    changed[2] = np.nextafter(changed[2], 3.0)
    for other in ({"b": values}, {"a": values.reshape(2, 3), "b": values}, {"a": changed, "b": values}):
        assert digest(other) != same
    assert digest({"a": values.astype(np.float32), "b": values}) != same
    assert set(golden.difference.digests({"state/x": values, "state/y": values, "events/x": values})) == {
        "events",
        "state",
    }


def test_comparison_lists_differing_scenes_and_continues_after_failures(golden, result):
    zero, one = np.zeros(3), np.ones(3)
    mine = {
        "same": result("this", "same", state__x=zero),
        "moved": result("this", "moved", state__x=zero),
        "broken": result("this", "broken", error="ValueError: no"),
        "missing": result("this", "missing", state__x=zero),
    }
    other = {
        "same": result("other", "same", state__x=zero),
        "moved": result("other", "moved", state__x=one),
        "broken": result("other", "broken", state__x=zero),
    }
    found = golden.script.compare_results(mine, other)
    assert [one.scene for one in found] == ["moved", "broken", "missing"]
    lines, code = golden.script.report(found, 4)
    assert code == golden.script.FAILED
    assert lines[0].startswith("moved: 1 arrays differ, most state/x: 1 absolute")
    assert lines[1:] == [
        "broken: failed in this: ValueError: no",
        "missing: failed in other: no result",
        "1 differences in 2 scenes, 2 failed",
    ]
    assert golden.script.report(found[:1], 4)[1] == golden.script.DIFFERENT
    assert golden.script.report([], 4) == (["0 differences in 4 scenes"], golden.script.SAME)


def test_first_existing_spelling_of_a_name_is_used(golden):
    made = []
    old = SimpleNamespace(Template="old", laws=SimpleNamespace(Hooke=lambda **values: made.append(values)))
    both = SimpleNamespace(Template="old", ContactMaterial="new")
    assert golden.names.Names(old).ContactMaterial == "old"
    assert golden.names.Names(both).ContactMaterial == "new"
    with pytest.raises(AttributeError, match="has none of ContactMaterial, Template"):
        _ = golden.names.Names(SimpleNamespace()).ContactMaterial
    names = golden.names.Names(old)
    names.make("law", "Hooke", stiffness=1.0)
    assert made == [{"stiffness": 1.0}]
    assert names.used["law"] == {"Hooke"}
    with pytest.raises(AttributeError, match="laws have no Hertz"):
        names.make("law", "Hertz")


def test_keywords_and_sensor_names_follow_the_package(golden):
    def add_contact(points, *, rim="off", name=None):
        return points, rim, name

    names = golden.names.Names(SimpleNamespace())
    assert names.call(add_contact, 1, boundary="outer", name="touch") == (1, "outer", "touch")
    scene = SimpleNamespace(add_particle_contact=lambda shapes, partners=None: (shapes, partners))
    assert names.method(scene, "add_particle_contact", 3, max_neighbors=40) == (3, 40)
    with pytest.raises(AttributeError, match="none of boundary, rim"):
        names.call(lambda points: points, 1, boundary="outer")
    sensors = ("touch.gap", "touch.share", "scene.restrained")
    assert names.path("scene.restitution_limited", sensors) == "scene.restrained"
    assert names.path("touch.force_scale", sensors) == "touch.share"
    assert [golden.names.canonical(name) for name in sensors] == [
        "touch.gap",
        "touch.force_scale",
        "scene.restitution_limited",
    ]


def test_scenes_use_every_class_of_the_catalogs(golden):
    assert golden.catalog.uncovered(golden.names.Names(wc)) == {}


def test_scenes_declare_checks_and_different_environments(golden):
    names = golden.names.Names(wc)
    for name, describe in golden.catalog.SCENES.items():
        plan = describe(names)
        assert plan.touches or plan.check or plan.run, f"{name} checks nothing"
        assert plan.envs > 1 or plan.scene is None or plan.still, f"{name} has one environment"


def test_scene_without_contact_fails_its_check(golden):
    plan = golden.plan.Plan(touches=["touch.normal_force"])
    trial = golden.plan.Trial(None, plan, "cpu", Path())
    trial.arrays = {"recording/touch.normal_force": np.array([[0.0, 1.0], [0.0, 0.0]])}
    with pytest.raises(golden.plan.CheckError, match=r"0 in all frames of environments \[0\]"):
        trial.check()


def test_import_folder_follows_the_package_map_of_the_checkout(golden, tmp_path):
    checkout = tmp_path / "other"
    for path in ("host/__init__.py", "device/__init__.py", "host/__pycache__/old.pyc"):
        (checkout / path).parent.mkdir(parents=True, exist_ok=True)
        (checkout / path).touch()
    (checkout / "pyproject.toml").write_text(
        '[tool.setuptools]\npackage-dir = { "warpcontact.kernels" = "device", "warpcontact" = "host" }\n'
    )
    layout = golden.script.lay_out(checkout, tmp_path / "layout")
    found = {str(path.relative_to(layout)) for path in layout.rglob("*.py*")}
    assert found == {"warpcontact/__init__.py", "warpcontact/kernels/__init__.py"}
    with pytest.raises(golden.script.UsageError, match=r"no pyproject\.toml"):
        golden.script.lay_out(tmp_path / "nowhere", tmp_path / "layout")


def test_unknown_scene_is_refused(golden):
    with pytest.raises(golden.script.UsageError, match=r"--scene must be one of .*, got 'nothing'"):
        golden.script.chosen(["nothing"])
    assert golden.script.chosen(None) == list(golden.catalog.SCENES)


def test_help_names_the_command_that_makes_another_checkout():
    command = [sys.executable, str(FOLDER / "golden.py"), "compare", "--help"]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "git worktree add" in answer.stdout
