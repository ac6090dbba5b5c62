"""The command line: what it prints, where it prints it, and its exit codes."""

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path

import matplotlib
import pytest

import warpcontact as wc
from warpcontact.cli import main

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "terrain_drop.toml"
HEAVY = ["matplotlib", "numpy", "pxr", "pydantic", "scipy", "tqdm", "trimesh", "warp", "xarray"]
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def python(*words):
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)


def test_help_and_version_answer_without_anything_heavy():
    code = (
        "import sys\nfrom warpcontact.cli import main\ntry: main(sys.argv[1:])\nexcept SystemExit: pass\n"
        f"print('imported', sorted(set({HEAVY}) & set(sys.modules)))"
    )
    for words in (["--help"], ["run", "--help"], ["--version"]):
        result = python("-c", code, *words)
        assert result.stdout.endswith("imported []\n"), result
    assert python("-m", "warpcontact", "--version").stdout == f"warpcontact {wc.__version__}\n"


def test_example_runs_and_says_where_the_results_are(device, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["run", str(EXAMPLE), "--envs", "4", "--duration", "0.1", "--device", device]
    assert main(words) == 0
    out, err = capsys.readouterr()
    folder = Path("results/terrain_drop")
    for name in ("recording.zarr", "animation.usdc", "picture.png", "experiment.toml", "run.json"):
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


def test_frozen_environments_are_said_without_a_warning(tmp_path, capsys):
    path = tmp_path / "study.toml"
    path.write_text(
        "duration = 0.01\ndt = 1e-3\nenvs = 2\n"
        '[[surface]]\nname = "s"\nmesh = { shape = "grid" }\n'
        '[[body]]\nname = "b"\nmass = 1\ninertia = [1, 1, 1]\n'
        '[[point]]\nname = "p"\nbody = "b"\nposition = [0, 0, -0.1]\n'
        '[[template]]\nname = "t"\nlaw = { type = "Hooke", stiffness = 1e38 }\n'
        '[[contact]]\nname = "c"\npoints = "p"\nsurface = "s"\ntemplate = "t"\nradius = 10.0\n'
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
def test_errors_are_one_message_and_exit_code_2(words, message, tmp_path, capsys, monkeypatch):
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
def test_wrong_words_show_the_usage(words, capsys):
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    assert "usage: warpcontact" in capsys.readouterr().err


def test_interrupt_is_no_traceback(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(wc.Experiment, "from_toml", interrupted)
    assert main(["run", "x.toml"]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_interrupted_run_keeps_nothing_and_says_so(tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    words = ["run", str(EXAMPLE), "--envs", "2", "--duration", "0.02", "--device", "cpu", "--out", str(tmp_path)]
    with monkeypatch.context() as patch:
        patch.setattr(wc.Simulation, "run", interrupted)
        assert main(words) == 130
    assert f"interrupted; nothing was kept in {tmp_path}\n" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]
    assert main(words) == 0
    monkeypatch.setattr(wc.Simulation, "run", interrupted)
    assert main(words) == 2
    # Before anything is touched there is nothing to say about the folder.
    monkeypatch.setattr(wc.Scene, "build", interrupted)
    assert main([*words, "--overwrite"]) == 130
    assert "nothing was kept" not in capsys.readouterr().err
    assert (tmp_path / "recording.zarr").exists()


def test_warnings_are_printed_once_and_kept(tmp_path, capsys):
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
    assert err.count("warning: mesh file 'ground.obj': the largest dimension is 1e+03 m") == 1
    warned = [line.removeprefix("warning: ") for line in err.splitlines() if line.startswith("warning: ")]
    assert json.loads((out / "run.json").read_text())["warnings"] == warned


def test_inspect_prints_the_report_and_says_whether_it_is_usable(tmp_path, capsys):
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


def test_laws_lists_the_whole_catalogue(capsys):
    assert main(["laws"]) == 0
    out = capsys.readouterr().out
    words = " ".join(out.split())
    for formula in (*wc.laws.CATALOGUE, *wc.frictions.CATALOGUE):
        for text in (formula.__name__, formula.formula, formula.validity, formula.reference):
            assert " ".join(text.split()) in words, formula
        for field in dataclasses.fields(formula):
            limits = formula.limits(field.name)
            assert f"{field.name} {limits['unit']} " in words
            assert limits["meaning"] in words
        assert formula.provenance in ("S", "D", "R", "S, D", "S, R"), formula
    assert max(map(len, out.splitlines())) <= 100


def test_laws_say_in_words_how_sure_a_formula_is(capsys):
    assert main(["laws"]) == 0
    out = capsys.readouterr().out
    legend = " ".join(out[: out.index("LAWS")].split())
    for text in ("S: read in a public source", "D: derived and confirmed", "R: recalled from the literature"):
        assert text in legend
    entries = dict(zip(*[iter(re.split(r"\n  (\w+)\n", out)[1:])] * 2, strict=True))
    for formula in (*wc.laws.CATALOGUE, *wc.frictions.CATALOGUE):
        known = " ".join(entries[formula.__name__].partition("    known ")[2].split())
        assert ("recalled from the literature (R)" in known) == ("R" in formula.provenance), formula
        assert ("read in a public source (S)" in known) == ("S" in formula.provenance), formula
        assert ("derived and confirmed by integration (D)" in known) == ("D" in formula.provenance), formula


def test_laws_of_a_name_shows_that_entry_only(capsys):
    assert main(["laws", "HuGuo"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("  HuGuo\n    formula N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)/(2e)\n")
    assert "known   recalled from the literature (R)" in out
    assert "Hertz\n" not in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["HuntCrosley"], "there is no law or friction 'HuntCrosley'; did you mean 'HuntCrossley'?"),
        (["tanh"], "there is no law or friction 'tanh'; did you mean 'Tanh'?"),
        (["Xyzzy"], "there is no law or friction 'Xyzzy'; 'warpcontact laws' lists them"),
        (["Hooke", "--plot", "a.pdf"], "a.pdf: must end in .svg or .png, got .pdf"),
        (["Hooke", "--plot", "a"], "a: must end in .svg or .png, got no suffix"),
        (["Hooke", "--plot", "none/a.svg"], "none/a.svg: none does not exist"),
        (["Hooke", "--plot", "file/a.svg"], "file/a.svg: file is not a folder"),
        (["Hooke", "--plot", "folder.svg"], "folder.svg: is a folder; the picture needs the name of a file"),
        (["--plot", "a.svg"], "--plot needs the NAME of a law or friction, or --compare NAME NAME …"),
        (["--compare", "Hooke", "Hertz"], "--compare draws a picture: say where by --plot FILE"),
        (
            ["--compare", "Hooke", "Hooke", "--plot", "a.svg"],
            "--compare needs at least two names, got Hooke Hooke",
        ),
        (["Hooke", "--compare", "Tanh", "Hollars"], "give Hooke to --compare, or leave --compare out"),
        (
            ["--compare", "Hooke", "Tanh", "Hertz", "--plot", "a.svg"],
            "laws and frictions cannot be compared with each other: Hooke, Hertz with Tanh",
        ),
        (["--compare", "Hooke", "Herz", "--plot", "a.svg"], "no law or friction 'Herz'; did you mean 'Hertz'?"),
        (
            ["--plot", "a.svg", "--compare", *(law.__name__ for law in wc.laws.CATALOGUE[:9])],
            "a picture shows at most 8 laws, got 9: Hooke, Hertz,",
        ),
        (["Hooke", "--mass", "2"], "--mass is of the picture: say where it goes by --plot FILE"),
        (["Tanh", "--mass", "2", "--plot", "a.svg"], "--mass is an option of laws, and not of Tanh"),
        (["Hooke", "--load", "2", "--plot", "a.svg"], "--load is an option of frictions, and not of Hooke"),
        (["Hooke", "--speed", "0", "--plot", "a.svg"], "speed must be greater than 0, got 0 m/s"),
        (
            ["Gonthier", "--restitution", "0.5", "2", "--plot", "a.svg"],
            "restitution[1] must be at least 0.01 and at most 1, got 2",
        ),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else None,
)
def test_wrong_use_of_laws_is_one_message_and_draws_nothing(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    Path("folder.svg").mkdir()
    assert main(["laws", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert "Traceback" not in err
    assert not Path("a.svg").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["Hertz", "--mass", "2", "--speed", "3", "--depth", "0.002"], "sphere of 2 kg on a plate at 3 m/s"),
        (["--compare", "Hertz", "Flores", "--restitution", "0.5"], "force over time, e = 0.5"),
        (["Tanh", "--load", "25"], "pressed on a plate with 25 N"),
        (["--compare", "Tanh", "Hollars"], "friction force F/N against +x [-]"),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else None,
)
def test_laws_draws_what_is_asked_for(words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # With texts as texts, so that they can be looked for.
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        assert main(["laws", *words, "--plot", "a.svg"]) == 0
    assert capsys.readouterr().out == "picture: a.svg\n"
    assert said in Path("a.svg").read_text()
    assert main(["laws", *words, "--plot", "a.PNG"]) == 0
    assert Path("a.PNG").read_bytes().startswith(b"\x89PNG")


def test_output_may_be_cut_off():
    command = f"{sys.executable} -m warpcontact laws | head -n 1"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert result.stdout.startswith("N: normal force")
    assert "Traceback" not in result.stderr
    assert "BrokenPipe" not in result.stderr
