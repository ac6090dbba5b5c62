"""The command ``build-kernels``: kernels in the cache before a run, the key of the cache, and errors."""

import os
import subprocess
import sys

import pytest
import sharded_runs
import warp as wp

from warpcontact.cli import main
from warpcontact.system import cache_key

pytestmark = pytest.mark.installed

# Runs the command, then prints the names of the compiled modules.
COUNTED = """\
import sys
import warp._src.context as context
compiled, compile_module = [], context.Module._compile
def counted(self, *words, **options):
    done = compile_module(self, *words, **options)
    if done:
        compiled.append(self.name)
    return done
context.Module._compile = counted
from warpcontact.cli import main
code = main(sys.argv[1:])
print("compiled:", *compiled)
sys.exit(code)
"""
FREE_BODY = """\
duration = 0.01
dt = 1e-3
[[body]]
name = "body"
mass = 1.0
inertia = [1.0, 1.0, 1.0]
"""
# Shapes are drawn by separate kernels.
MORE = """
[outcome]
peak = { type = "Max", of = "touch.normal_force" }
[[shape]]
name = "egg"
body = "ball"
form = { type = "Ellipsoid", semi_axes = [0.03, 0.02, 0.02] }
"""


def command(*words, **environment):
    done = subprocess.run(
        [sys.executable, "-c", COUNTED, *map(str, words)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    *lines, last = done.stdout.splitlines()
    return lines, last.split()[1:]


def files_in(folder):
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())


@pytest.mark.slow
def test_run_after_build_kernels_compiles_no_module(tmp_path):
    study = sharded_runs.study(tmp_path, duration=0.02, usd_envs=1)
    with study.open("a") as file:
        file.write(MORE)
    lines, _ = command("build-kernels", study, "--device", "cpu")
    assert lines[0] == f"cache: {wp.config.kernel_cache_dir}"
    assert command("build-kernels", study, "--device", "cpu", "--key") == ([lines[1].removeprefix("key: ")], [])
    _, compiled = command("run", study, "--out", tmp_path / "out", "--device", "cpu")
    assert compiled == []
    assert (tmp_path / "out" / "picture.png").is_file()
    assert (tmp_path / "out" / "animation.usdc").is_file()


@pytest.mark.slow
def test_build_kernels_writes_only_into_the_cache(tmp_path):
    names = ("cache", "home", "temporary")
    cache, home, temporary = (tmp_path / name for name in names)
    for folder in (home, temporary):
        folder.mkdir()
    study = tmp_path / "study.toml"
    study.write_text(FREE_BODY)
    places = {"WARP_CACHE_PATH": cache, "HOME": home, "XDG_CACHE_HOME": home / "cache", "TMPDIR": temporary}
    variables = {name: str(place) for name, place in places.items()}
    lines, compiled = command("build-kernels", study, "--device", "cpu", **variables)
    assert lines[0] == f"cache: {cache / wp.config.version}"
    folders = [path.name for path in (cache / wp.config.version).iterdir()]
    # Each module has a folder, and the cache contains nothing else.
    assert len(folders) == len(compiled) > 3
    assert all(name.startswith("wp_") for name in folders)
    assert files_in(home) == files_in(temporary) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, study.name])


@pytest.fixture
def sources(tmp_path):
    """Folders of a small host package and of its kernels."""
    host, kernels = tmp_path / "host", tmp_path / "host" / "kernels"
    (kernels / "laws").mkdir(parents=True)
    (host / "schedule.py").write_text("from warpcontact.kernels.broadphase import contact_detection\n")
    (host / "report.py").write_text("import numpy\n")
    (kernels / "broadphase").mkdir()
    (kernels / "broadphase" / "contact_detection.py").write_text("contact_detection = 1\n")
    (kernels / "laws" / "elastic.py").write_text("elastic = 1\n")
    return {"host": host, "kernels": kernels}


def key(sources, *files):
    return cache_key.cache_key("cpu", files, **sources)


def test_kernel_cache_key_is_one_line_and_repeatable(sources, capsys):
    first = key(sources)
    assert first == key(sources)
    name, machine, source = first.split("-")
    assert name == "warpcontact"
    assert {len(machine), len(source)} == {16}
    assert main(["build-kernels", "--key", "--device", "cpu"]) == 0
    assert capsys.readouterr().out == f"{cache_key.cache_key('cpu')}\n"


@pytest.mark.parametrize(
    "name", ["schedule.py", "kernels/broadphase/contact_detection.py", "kernels/laws/elastic.py", "kernels/new.py"]
)
def test_kernel_cache_key_differs_if_a_source_differs(name, sources):
    before = key(sources)
    with (sources["host"] / name).open("a") as file:
        file.write("more = 1\n")
    after = key(sources)
    assert after != before
    # The first part of the key identifies the machine and compiler.
    assert after.rpartition("-")[0] == before.rpartition("-")[0]


def test_kernel_cache_key_is_equal_if_an_unrelated_host_module_differs(sources):
    before = key(sources)
    (sources["host"] / "report.py").write_text("import scipy\n")
    assert key(sources) == before


def test_kernel_cache_key_differs_with_experiments_and_their_files(sources, tmp_path):
    study, laws = tmp_path / "study.toml", tmp_path / "laws.py"
    study.write_text('law = { type = "laws.py:Cubic" }\n')
    laws.write_text("cubic = 3\n")
    keys = {key(sources), key(sources, study)}
    laws.write_text("cubic = 4\n")
    keys.add(key(sources, study))
    study.write_text('law = { type = "laws.py:Cubic" }\n# more\n')
    keys.add(key(sources, study))
    assert len(keys) == 4


def test_kernel_cache_key_differs_with_compiler_options_and_versions(sources, monkeypatch):
    keys = {key(sources)}
    monkeypatch.setitem(cache_key.unique_kernel.OPTIONS, "cpu_compiler_flags", "-O0")
    keys.add(key(sources))
    monkeypatch.setattr(wp.config, "version", "0.0.0")
    keys.add(key(sources))
    assert len({one.split("-")[1] for one in keys}) == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.toml"], "none.toml: there is no such file"),
        (["none.toml", "--key"], "none.toml: there is no such file"),
        (["--device", "cuda:99"], "--device cuda:99: device must be 'auto' or one of"),
        (["--device", "cpu,cpu"], "--device cpu,cpu: must be a single device without an experiment"),
        (["--threads", "0"], "--threads must be at least 1, got 0"),
        (["--envs", "0"], "--envs must be at least 1, got 0"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_build_kernels_error_is_one_message_and_exit_code_2(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["build-kernels", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"warpcontact: {message}")


@pytest.mark.parametrize("words", [[], ["--key"]])
def test_unwritable_kernel_cache_is_reported_with_folder_and_remedy(words, tmp_path, capsys, monkeypatch):
    (tmp_path / "file").touch()
    folder = tmp_path / "file" / "cache"
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(folder))
    assert main(["build-kernels", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (
        f"warpcontact: the kernel cache {folder} must be a folder with free space that can be written, got: "
        "Not a directory; set the environment variable WARP_CACHE_PATH to such a folder\n"
    )
