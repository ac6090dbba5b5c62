"""The command line: output, output streams, and exit codes."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment.shards import ShardRunner

pytestmark = pytest.mark.installed

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "terrain_drop.toml"
HEAVY = ["matplotlib", "numpy", "pxr", "pydantic", "scipy", "tqdm", "trimesh", "warp", "xarray"]
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def python(*words):
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)


@pytest.mark.smoke
def test_help_and_version_import_no_slow_package():
    code = (
        "import sys\nfrom warpcontact.cli import main\ntry: main(sys.argv[1:])\nexcept SystemExit: pass\n"
        f"print('imported', sorted(set({HEAVY}) & set(sys.modules)))"
    )
    for words in (["--help"], ["run", "--help"], ["--version"]):
        result = python("-c", code, *words)
        assert result.stdout.endswith("imported []\n"), result
    assert python("-m", "warpcontact", "--version").stdout == f"warpcontact {wc.__version__}\n"


@pytest.mark.smoke
def test_example_run_prints_result_paths(device, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["run", str(EXAMPLE), "--envs", "4", "--duration", "0.1", "--device", device]
    assert main(words) == 0
    out, err = capsys.readouterr()
    folder = Path("results/terrain_drop")
    for name in ("data.zarr", "animation.usdc", "picture.png", "experiment.toml", "run.json"):
        assert (folder / name).exists()
        assert str(folder / name) in out
    assert "4 environments × 0.1 s in 500 steps" in out
    assert "environment steps per second" in out
    assert "all 4 environments are active" in out
    for stage in ("reading", "building", "running", "writing"):
        assert stage in err

    assert main(words) == 2
    assert "results/terrain_drop: holds an earlier run" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 0
    assert main([*words, "--out", "another"]) == 0
    assert Path("another/run.json").exists()


def test_frozen_environments_are_reported_without_warning(tmp_path, capsys):
    path = tmp_path / "study.toml"
    path.write_text(
        "duration = 0.01\ndt = 1e-3\nenvs = 2\n"
        '[[surface]]\nname = "s"\nmesh = { shape = "grid" }\n'
        '[[body]]\nname = "b"\nmass = 1\ninertia = [1, 1, 1]\n'
        '[[point]]\nname = "p"\nbody = "b"\nposition = [0, 0, -0.1]\n'
        '[[material]]\nname = "t"\nlaw = { type = "Hooke", stiffness = 1e38 }\n'
        '[[contact]]\nname = "c"\npoints = "p"\nsurface = "s"\nmaterial = "t"\nradius = 10.0\n'
    )
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--device", "cpu"]) == 0
    assert "2 of 2 environments turned non-finite and are frozen" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "none.toml"], "none.toml: there is no such file"),
        (["run", "bad.toml"], "bad.toml: line 1, column 6: "),
        (["run", "wrong.toml"], "  - body[0] ('b').mass must be greater than 0, got -1 kg\n"),
        (
            ["run", str(EXAMPLE), "--device", "cuda:99"],
            "warpcontact: --device cuda:99: device must be 'auto' or one of",
        ),
        (["run", str(EXAMPLE), "--envs", "0"], "warpcontact: --envs 0: envs must be at least 1, got 0"),
        (
            ["run", str(EXAMPLE), "--duration", "nan"],
            "warpcontact: --duration nan: duration must be finite, got nan",
        ),
        (
            ["run", str(EXAMPLE), "--duration", "0.01"],
            "warpcontact: --duration 0.01: record.every must be at most",
        ),
        (["run", str(EXAMPLE), "--out", "."], "is not empty"),
        (["run", str(EXAMPLE), "--out", "bad.toml/x", "--envs", "1", "--duration", "0.02"], "bad.toml"),
        (["inspect", "none.stl"], "mesh file 'none.stl' does not exist"),
        (["inspect", "."], "is not a regular file"),
        (["inspect", "good.obj", "--scale", "0"], "scale must be a positive finite number, got 0.0"),
    ],
    ids=lambda value: " ".join(value)[-40:] if isinstance(value, list) else None,
)
def test_cli_error_is_one_message_and_exit_code_2(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("bad.toml").write_text("dt = = 1")
    Path("wrong.toml").write_text('dt = 0\nduration = 1\n[[body]]\nname = "b"\nmass = -1\ninertia = [1, 1, 1]\n')
    Path("good.obj").write_text(TRIANGLE)
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert "Traceback" not in err
    assert "warpcontact: " in err


@pytest.mark.parametrize("words", [[], ["dance"], ["run"], ["run", "x.toml", "--envs", "many"]])
def test_invalid_arguments_print_usage(words, capsys):
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    assert "usage: warpcontact" in capsys.readouterr().err


@pytest.mark.smoke
def test_interrupt_prints_no_traceback(monkeypatch, capsys, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(wc.Experiment, "from_toml", interrupted)
    assert main(["run", "x.toml", "--out", str(tmp_path / "out")]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_run_command_checks_results_folder_before_the_experiment(tmp_path, capsys, monkeypatch):
    """The experiment can take long to compile or have very many environments."""

    def checked(*_, **__):
        raise AssertionError("the experiment is checked")

    monkeypatch.chdir(tmp_path)
    experiment = wc.Experiment.from_toml(EXAMPLE)
    monkeypatch.setattr(wc.Experiment, "_check", checked)
    Path("results/a_b").mkdir(parents=True)
    Path("results/a_b/other").touch()
    Path("results/terrain_drop").symlink_to("a_b")
    for words, folder in (
        (["--out", "results/a_b"], "results/a_b"),
        (["--set", 'name="a b"'], "results/a_b"),
        ([], "results/terrain_drop"),
    ):
        assert main(["run", str(EXAMPLE), "--envs", "100", *words]) == 2
        assert f"warpcontact: {folder}: is not empty and holds" in capsys.readouterr().err
    with pytest.raises(wc.ExperimentError, match="results/a_b: is not empty"):
        experiment.run("results/a_b", envs=100)
    for words in (["--out", "nowhere"], ["--out", "nowhere", str(EXAMPLE)]):
        assert main(["run", "--resume", *words]) == 2
        assert "warpcontact: nowhere: holds no run to resume" in capsys.readouterr().err


def test_interrupted_run_prints_resume_command(tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    out = tmp_path / "a folder"
    words = ["run", str(EXAMPLE), "--envs", "2", "--duration", "0.02", "--device", "cpu", "--out", str(out)]
    with monkeypatch.context() as patch:
        patch.setattr(ShardRunner, "run", interrupted)
        assert main(words) == 130
    err = capsys.readouterr().err
    assert f"interrupted; completed steps are saved in {out}; to resume:\n" in err
    command = err.splitlines()[-1].split(maxsplit=1)[1]
    assert main(shlex.split(command)) == 0
    assert main(words) == 2
    # Before anything is written, there is no message about the folder.
    monkeypatch.setattr(wc.Scene, "snapshot", interrupted)
    assert main([*words, "--overwrite"]) == 130
    assert "saved in" not in capsys.readouterr().err
    assert wc.open_run(out).finished


def test_run_warnings_are_printed_once_and_stored(tmp_path, capsys):
    far = "v 0 0 0\nv 1000 0 0\nv 0 1000 0\nf 1 2 3\n"
    (tmp_path / "ground.obj").write_text(far)
    path = tmp_path / "study.toml"
    path.write_text(
        "duration = 0.01\ndt = 1e-3\n"
        '[[surface]]\nname = "s"\nmesh = { file = "ground.obj" }\n'
        '[[body]]\nname = "b"\nmass = 1\ninertia = [1, 1, 1]\n'
    )
    out = tmp_path / "out"
    assert main(["run", str(path), "--out", str(out), "--device", "cpu"]) == 0
    err = capsys.readouterr().err
    assert err.count("caution: mesh file 'ground.obj': the largest dimension is 1e+03 m") == 1
    warned = [line for line in err.splitlines() if line.startswith(("note: ", "caution: "))]
    assert json.loads((out / "run.json").read_text())["warnings"] == warned


@pytest.mark.smoke
def test_inspect_command_prints_report_and_exits_with_1_if_unusable(tmp_path, capsys):
    mesh = tmp_path / "mesh.obj"
    mesh.write_text(TRIANGLE)
    assert main(["inspect", str(mesh), "--scale", "0.001"]) == 0
    out = capsys.readouterr().out
    assert out == wc.meshes.examine_file(mesh, scale=0.001).to_text() + "\n"
    assert "0.001 × 0.001 × 0 m" in out
    mesh.write_text(TRIANGLE.replace("f 1 2 3", "f 1 2 9"))
    assert main(["inspect", str(mesh)]) == 1
    assert "out of index range" in capsys.readouterr().out
    broken = tmp_path / "broken.stl"
    broken.write_bytes(b"solid nothing")
    assert main(["inspect", str(broken)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"warpcontact: {broken}: ")


def test_closed_output_pipe_prints_no_error():
    command = f"{sys.executable} -m warpcontact laws | head -n 1"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert result.stdout.startswith("N: normal force")
    assert "Traceback" not in result.stderr
    assert "BrokenPipe" not in result.stderr
