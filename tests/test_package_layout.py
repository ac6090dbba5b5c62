"""The two folders that form one package, errors if they are mixed up, and imports at startup."""

import ast
import gc
import importlib
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import warpcontact.kernels

import warpcontact
from warpcontact.system import process

pytestmark = [pytest.mark.installed, pytest.mark.smoke]

HOST = Path(warpcontact.__file__).parent
KERNELS = Path(warpcontact.kernels.__file__).parent
CHECKOUT = KERNELS.parent if (KERNELS.parent / "pyproject.toml").is_file() else None


def run(code, folder, words=(), **environment):
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_kernels_package_has_one_name(tmp_path):
    shutil.copytree(KERNELS, tmp_path / "kernels", ignore=shutil.ignore_patterns("__pycache__"))
    result = run("import kernels", tmp_path)
    assert result.returncode != 0
    assert "import this package as 'warpcontact.kernels', not as 'kernels'" in result.stderr


def test_mixed_checkouts_are_refused(tmp_path):
    shutil.copytree(HOST, tmp_path / "warpcontact", ignore=shutil.ignore_patterns("__pycache__", "kernels"))
    # The host from the current folder, its kernels from the installed package.
    code = (
        "import sys, warpcontact; from importlib import util;"
        f"spec = util.spec_from_file_location('warpcontact.kernels', {str(KERNELS / '__init__.py')!r});"
        "module = util.module_from_spec(spec); spec.loader.exec_module(module)"
    )
    result = run(code, tmp_path, PYTHONPATH=str(tmp_path))
    assert result.returncode != 0
    assert "two checkouts are mixed" in result.stderr


@pytest.mark.skipif(CHECKOUT is None, reason="reads pyproject.toml of a checkout")
def test_every_folder_is_packaged():
    listed = set(tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = set()
    for top, name in ((HOST, "warpcontact"), (KERNELS, "warpcontact.kernels")):
        for file in top.rglob("*.py"):
            parts = file.parent.relative_to(top).parts
            found.add(".".join((name, *parts)))
    assert listed == found
    for package in found:
        top, name = (KERNELS, "warpcontact.kernels") if ".kernels" in package else (HOST, "warpcontact")
        folder = top.joinpath(*package.removeprefix(name).strip(".").split("."))
        assert (folder / "__init__.py").is_file(), package


@pytest.mark.skipif(CHECKOUT is None, reason="reads pyproject.toml of a checkout")
def test_every_dependency_declares_its_lowest_version():
    result = subprocess.run(
        [sys.executable, CHECKOUT / ".ci" / "lowest_versions.py"], capture_output=True, text=True, check=False
    )
    assert (result.returncode, result.stderr) == (0, "")
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {
        *project["dependencies"],
        *(one for extra in project["optional-dependencies"].values() for one in extra),
    }
    listed = [line.partition(";")[0].strip().replace("==", ">=") for line in result.stdout.splitlines()]
    assert len(listed) == len([one for one in declared if not one.startswith("warpcontact[")])
    assert all(any(one.startswith(line) for one in declared) for line in listed)


def test_every_public_name_loads_and_is_listed_once():
    assert sorted(warpcontact.__all__) == warpcontact.__all__
    assert len(set(warpcontact.__all__)) == len(warpcontact.__all__)
    for name in warpcontact.__all__:
        assert getattr(warpcontact, name) is not None
    assert set(warpcontact._HOME) | {"__version__"} == set(warpcontact.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Scenes'"):
        _ = warpcontact.Scenes


ON_DEMAND = (
    *(f"kernels.{name}" for name in ("couplings.springs", "friction", "joints", "laws", "shapes")),
    *("experiment", "meshes", "stepping.outcomes", "unilateral"),
)


@pytest.mark.parametrize("name", ON_DEMAND)
def test_type_checkers_see_every_lazily_loaded_name(name):
    module = importlib.import_module(f"warpcontact.{name}")
    body = ast.parse(Path(module.__file__).read_text()).body
    (checked,) = (node for node in body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    homes = {
        alias.name: node.module
        for node in checked.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    declared = {node.target.id for node in checked.body if isinstance(node, ast.AnnAssign)}
    for one, home in homes.items():
        assert getattr(module, one) is getattr(importlib.import_module(home), one)
    for one in declared:  # a tuple of some of them
        assert {kind.__name__ for kind in getattr(module, one)} <= {*homes}
    at_once = {alias.name for node in body if isinstance(node, ast.ImportFrom) for alias in node.names}
    at_once |= {target.id for node in body if isinstance(node, ast.Assign) for target in node.targets}
    assert {*homes} | declared == {*module.__all__} - at_once


def test_package_import_loads_no_slow_package(tmp_path):
    code = "import sys, warpcontact; print([m for m in ('warp', 'numpy', 'xarray', 'pxr') if m in sys.modules])"
    result = run(code, tmp_path)
    assert result.stdout.strip() == "[]", result.stderr


def test_import_of_every_name_does_not_initialize_warp(tmp_path):
    # The message appears at startup, and the importing program may still disable it.
    code = (
        "import warpcontact as wc; every = [getattr(wc, name) for name in wc.__all__];"
        "import warp; print(warp._src.context.runtime is None)"
    )
    result = run(code, tmp_path)
    assert result.stdout == "True\n", result.stdout + result.stderr


def test_import_for_a_simulation_loads_no_optional_package(tmp_path):
    code = (
        "import sys, warpcontact as wc; wc.Scene, wc.Simulation, wc.ContactMaterial, wc.laws, wc.friction, wc.load_mesh;"
        "slow = ('xarray', 'pandas', 'scipy', 'zarr', 'pydantic', 'matplotlib', 'trimesh', 'pxr');"
        "print([m for m in slow if m in sys.modules])"
    )
    result = run(code, tmp_path)
    assert result.stdout.strip().splitlines()[-1] == "[]", result.stderr


# Modules that a first step does not need. Warp parses all functions of imported kernels.
NEEDLESS = (
    *("matplotlib", "numpy.f2py", "pandas", "pxr", "pyarrow", "ray", "scipy", "tqdm", "trimesh", "xarray", "zarr"),
    *(
        f"warpcontact.kernels.{part}"
        for part in ("couplings.catenary", "friction.bristle", "laws.nonlinear_dashpot")
    ),
    *(f"warpcontact.kernels.shapes.{part}" for part in ("curvature", "derivatives", "narrow_phase")),
    *("warpcontact.kernels.shapes.spheres", "warpcontact.kernels.shapes.superellipsoid"),
    *("warpcontact.kernels.joints.prescribed", "warpcontact.kernels.outcomes.catalogue"),
    "warpcontact.kernels.couplings.springs.models",
    *("warpcontact.experiment.cluster", "warpcontact.experiment.execute", "warpcontact.experiment.run"),
    *("warpcontact.meshes.picture", "warpcontact.meshes.readers", "warpcontact.unilateral.solving"),
)


def test_first_step_of_an_experiment_loads_no_optional_package(tmp_path):
    code = (
        "import sys, warpcontact as wc; experiment = wc.Experiment.from_toml(sys.argv[1]);"
        "wc.Simulation(experiment.model(2, 'cpu'), experiment.settings.dt).step();"
        f"print([m for m in {NEEDLESS} if m in sys.modules])"
    )
    example = Path(__file__).resolve().parents[1] / "examples" / "terrain_drop.toml"
    result = run(code, tmp_path, words=[str(example)])
    assert result.stdout.strip().splitlines()[-1] == "[]", result.stderr


def test_garbage_collection_resumes_after_a_pause_if_it_was_enabled():
    def fails():
        with process.gc_paused():
            with process.gc_paused():
                pass
            assert not gc.isenabled()
            raise ValueError("meanwhile")

    assert gc.isenabled()
    with pytest.raises(ValueError, match="meanwhile"):
        fails()
    assert gc.isenabled()


def test_objects_made_in_a_pause_are_in_the_oldest_generation_and_frozen_objects_stay_frozen():
    # The test runner may have frozen objects.
    gc.unfreeze()
    with process.gc_paused():
        made = [[] for _ in range(10)]
    assert any(one is made for one in gc.get_objects(generation=2))
    gc.freeze()
    try:
        frozen = gc.get_freeze_count()
        with process.gc_paused():
            made = [[] for _ in range(10)]
        assert any(one is made for one in gc.get_objects(generation=0))
        # Some of the frozen objects may be freed meanwhile.
        assert 0 < gc.get_freeze_count() <= frozen
    finally:
        gc.unfreeze()
