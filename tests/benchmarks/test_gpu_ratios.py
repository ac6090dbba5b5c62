"""Comparison of the GPU ratios of ``benchmarks/gpu_ratios.py`` with stored ones. Compiles no kernel."""

import importlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="benchmarks are in a checkout, not in an installed package"
)
RATIOS = {"W1": 0.25, "W2p8": 0.16, "W3": 0.4}


@pytest.fixture(scope="module")
def load():
    """Imports a file of the benchmarks, which import each other by name."""
    known = set(sys.modules)
    sys.path.insert(0, str(FOLDER))
    yield importlib.import_module
    sys.path.remove(str(FOLDER))
    for name in set(sys.modules) - known:
        file = getattr(sys.modules[name], "__file__", None)
        if file and Path(file).parent == FOLDER:
            del sys.modules[name]


def figures(**factors):
    """Returns figures with the ratios of some scenes multiplied by factors."""
    ratios = {
        name: {
            "ratio": ratio * factors.get(name, 1.0), "lowest": ratio, "highest": ratio,
            "ns_per_env_step": ratio, "ns_bare_query": 1.0,
        }
        for name, ratio in RATIOS.items()
    }  # fmt: skip
    return {
        "facts": {"device": "GPU A", "driver": "1.0"},
        "versions": {"warp-lang": "1.19.0"},
        "envs": 1000,
        "steps": 100,
        "ratios": ratios,
    }


@pytest.mark.parametrize("factor", [1.0, 1.049, 0.951])
def test_check_passes_within_five_percent(factor, load):
    lines, code = load("gpu_ratios").check(figures(W1=factor), figures())
    assert code == 0
    assert len(lines) == len(RATIOS)


def test_check_fails_with_the_name_of_a_slower_scene(load):
    measured = figures(W2p8=1.06)
    measured["versions"]["warp-lang"] = "1.20.0"
    lines, code = load("gpu_ratios").check(measured, figures())
    assert code == 1
    assert "W2p8 is 6.0% slower than stored; at most 5% is allowed." in lines
    assert not any("W1 is" in line or "W3 is" in line for line in lines)
    assert "warp-lang: 1.20.0 now, 1.19.0 when stored" in lines
    assert not any(line.startswith("driver") for line in lines)


def test_check_reports_a_faster_scene_and_passes(load):
    lines, code = load("gpu_ratios").check(figures(W3=0.9), figures())
    assert code == 0
    assert "W3 is 10.0% faster than stored: update the file with --write." in lines


@pytest.mark.parametrize("known", [None, "another device"])
def test_check_passes_without_stored_ratios_of_the_device(known, load):
    measured = figures(W1=2.0)
    stored = None
    if known:
        stored = figures()
        stored["facts"]["device"] = "GPU B"
    lines, code = load("gpu_ratios").check(measured, stored)
    assert code == 0
    assert lines[-1] == "There are no stored ratios for GPU A; store these with --write."


@pytest.mark.parametrize("condition", ["envs", "steps"])
def test_check_fails_for_other_conditions(condition, load):
    stored = figures()
    stored[condition] *= 2
    lines, code = load("gpu_ratios").check(figures(), stored)
    assert code == 1
    assert f"they are for {condition} = " in lines[-1]


def test_check_reports_a_scene_without_stored_ratio(load):
    stored = figures()
    del stored["ratios"]["W1"]
    lines, code = load("gpu_ratios").check(figures(), stored)
    assert code == 0
    assert lines[-1] == "W1 has no stored ratio; store it with --write."


def test_ratio_is_the_median_of_the_rounds(load):
    sim = SimpleNamespace(model=SimpleNamespace(envs=10))
    runs, queries = [2.0, 4.0, 9.0], [0.01, 0.02, 0.015]
    scene = load("gpu_ratios").Scene("W1", sim, None, 100, runs, queries)
    found = scene.figures()
    assert found["ratio"] == pytest.approx(2.0)
    assert (found["lowest"], found["highest"]) == pytest.approx((2.0, 6.0))
    assert found["ns_per_env_step"] == pytest.approx(1e9 * 4.0 / 100 / 10)
    assert found["ns_bare_query"] == pytest.approx(1e9 * 0.015 / 10)


def test_stored_ratios_and_comparison_keep_each_other(load, tmp_path):
    files = load("result_file")
    path = tmp_path / "gpu.json"
    assert files.stored(path) == {}
    comparison = {"facts": {"device": "GPU A"}, "measured": [1, 2]}
    files.write(path, comparison)
    files.write(path, files.stored(path) | {files.RATIOS: figures()})
    newer = {"facts": {"device": "GPU A"}, "measured": [3]}
    files.write(path, newer | files.stored(path, files.RATIOS))
    assert json.loads(path.read_text()) == newer | {files.RATIOS: figures()}


@pytest.mark.parametrize("path", sorted((FOLDER / "results").glob("nvidia-*.json")), ids=lambda path: path.stem)
def test_storing_ratios_leaves_other_figures_unchanged(path, load, tmp_path):
    files = load("result_file")
    target = tmp_path / path.name
    files.write(target, files.stored(path))
    assert target.read_text() == path.read_text()


def test_compare_keeps_stored_ratios(load, tmp_path, monkeypatch):
    compare, files = load("compare"), load("result_file")
    path = tmp_path / "cpu.json"
    files.write(path, {files.RATIOS: figures(), "measured": ["old"]})
    entry = {"engine": "warpcontact", "scene": "W1", "envs": 8, "why": "not run"}
    monkeypatch.setattr(compare, "compare", lambda *_: [dict(entry)])
    words = [
        "compare.py",
        "--engines",
        "warpcontact",
        "--scenes",
        "W1",
        "--envs",
        "8",
        "--here",
        "--out",
        str(path),
    ]
    monkeypatch.setattr(sys, "argv", words)
    compare.main()
    found = files.stored(path)
    assert found[files.RATIOS] == figures()
    assert found["measured"] == [entry]
