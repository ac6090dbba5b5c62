"""The command ``laws``: catalogue, figures, and errors for invalid arguments."""

import dataclasses
import re
import shutil
from pathlib import Path

import matplotlib
import pytest

import warpcontact as wc
from warpcontact.cli import main

pytestmark = pytest.mark.installed

CUSTOM_LAWS = Path(__file__).parents[1] / "custom_laws_file.py"
TOO_STIFF = CUSTOM_LAWS.read_text().partition("too stiff")[0].count("\n") + 1


@pytest.mark.smoke
def test_laws_command_lists_the_whole_catalogue(capsys):
    assert main(["laws"]) == 0
    out = capsys.readouterr().out
    words = " ".join(out.split())
    entries = dict(zip(*[iter(re.split(r"\n  (\w+)\n", out)[1:])] * 2, strict=True))
    for formula in (*wc.laws.CATALOGUE, *wc.friction.CATALOGUE):
        for text in (formula.__name__, formula.formula, formula.validity, formula.reference):
            assert " ".join(text.split()) in words, formula
        for field in dataclasses.fields(formula):
            limits = formula.limits(field.name)
            assert f"{field.name} {limits['unit']} " in words
            assert limits["meaning"] in words
            optional = field.default is None and field.name not in formula.exactly_one_of
            line = next(line for line in entries[formula.__name__].splitlines() if f"    {field.name} " in line)
            assert (" optional " in line) == optional, formula
        assert formula.provenance in ("S", "D", "R", "S, D", "S, R"), formula
    assert max(map(len, out.splitlines())) <= 100


def test_laws_command_states_provenance_of_each_formula(capsys):
    assert main(["laws"]) == 0
    out = capsys.readouterr().out
    legend = " ".join(out[: out.index("LAWS")].split())
    for text in ("S: read in a public source", "D: derived and confirmed", "R: recalled from the literature"):
        assert text in legend
    entries = dict(zip(*[iter(re.split(r"\n  (\w+)\n", out)[1:])] * 2, strict=True))
    for formula in (*wc.laws.CATALOGUE, *wc.friction.CATALOGUE):
        known = " ".join(entries[formula.__name__].partition("    known ")[2].split())
        assert ("recalled from the literature (R)" in known) == ("R" in formula.provenance), formula
        assert ("read in a public source (S)" in known) == ("S" in formula.provenance), formula
        assert ("derived and confirmed by integration (D)" in known) == ("D" in formula.provenance), formula


def test_laws_command_with_a_name_prints_that_entry_only(capsys):
    assert main(["laws", "HuGuo"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("  HuGuo\n    formula N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)/(2e)\n")
    assert "known   recalled from the literature (R)" in out
    assert "Hertz\n" not in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["HuntCrosley"], "there is no law or friction model 'HuntCrosley'; did you mean 'HuntCrossley'?"),
        (["tanh"], "there is no law or friction model 'tanh'; did you mean 'Tanh'?"),
        (["Xyzzy"], "there is no law or friction model 'Xyzzy'; 'warpcontact laws' lists them"),
        (["Hooke", "--plot", "a.pdf"], "a.pdf: must end in .svg or .png, got .pdf"),
        (["Hooke", "--plot", "a"], "a: must end in .svg or .png, got no suffix"),
        (["Hooke", "--plot", "none/a.svg"], "none/a.svg: none does not exist"),
        (["Hooke", "--plot", "file/a.svg"], "file/a.svg: file is not a folder"),
        (["Hooke", "--plot", "folder.svg"], "folder.svg: is a folder; give the name of a file"),
        (["--plot", "a.svg"], "--plot requires the NAME of a law or friction model, or --compare NAME NAME …"),
        (["--compare", "Hooke", "Hertz"], "--compare requires --plot FILE"),
        (
            ["--compare", "Hooke", "Hooke", "--plot", "a.svg"],
            "--compare requires at least two names, got Hooke Hooke",
        ),
        (["Hooke", "--compare", "Tanh", "Hollars"], "NAME must be left out with --compare, got Hooke"),
        (
            ["--compare", "Hooke", "Tanh", "Hertz", "--plot", "a.svg"],
            "laws and friction models cannot be compared with each other: Hooke, Hertz with Tanh",
        ),
        (
            ["--compare", "Hooke", "Herz", "--plot", "a.svg"],
            "no law or friction model 'Herz'; did you mean 'Hertz'?",
        ),
        (
            ["--plot", "a.svg", "--compare", *(law.__name__ for law in wc.laws.CATALOGUE[:9])],
            "a plot shows at most 8 laws, got 9: Hooke, Hertz,",
        ),
        (["Hooke", "--mass", "2"], "--mass requires --plot FILE"),
        (["Tanh", "--mass", "2", "--plot", "a.svg"], "--mass is an option of laws, not of Tanh"),
        (["Hooke", "--load", "2", "--plot", "a.svg"], "--load is an option of friction models, not of Hooke"),
        (["Hooke", "--speed", "0", "--plot", "a.svg"], ": --speed must be greater than 0, got 0 m/s"),
        (["Hooke", "--mass", "-1", "--plot", "a.svg"], ": --mass must be greater than 0, got -1 kg"),
        (["Tanh", "--load", "nan", "--plot", "a.svg"], ": --load must be greater than 0, got nan N"),
        (
            ["Gonthier", "--restitution", "0.5", "2", "--plot", "a.svg"],
            ": --restitution must be at least 0.01 and at most 1, got 2",
        ),
        (["Hooke", "--set", "stiffness=1"], "--set requires --plot FILE"),
        (["Hooke", "--plot", "a.svg", "--set", "stiffness"], "--set takes PARAMETER=VALUE, such as"),
        (["Hooke", "--plot", "a.svg", "--set", "stiffness=soft"], "--set stiffness must be a number, got 'soft'"),
        (
            ["Hooke", "--plot", "a.svg", "--set", "stiffness=0"],
            "--set stiffness must be greater than 0, got 0 N/m",
        ),
        (
            ["Hooke", "--plot", "a.svg", "--set", "stiffness=inf"],
            "--set stiffness must be greater than 0, got inf",
        ),
        (["Hooke", "--plot", "a.svg", "--set", "stiffness=1", "stiffness=2"], "--set stiffness is given twice"),
        (
            ["--compare", "Hooke", "Hertz", "--plot", "a.svg", "--set", "stifness=1"],
            "--set stifness=1: stifness is no parameter of Hooke or Hertz; did you mean 'stiffness'?",
        ),
        (
            ["Tanh", "--plot", "a.svg", "--set", "E=1"],
            "--set E=1: E is no parameter of Tanh; there are: mu, velocity_scale",
        ),
        (
            ["KelvinVoigt", "--plot", "a.svg", "--set", "damping=1", "restitution=0.5"],
            "KelvinVoigt takes exactly one of restitution and damping, got restitution and damping",
        ),
        (
            ["Hooke", "--plot", "a.svg", "--set", "stiffness=1", "--depth", "0.1"],
            "--depth must be left out, because all stiffnesses are given",
        ),
        (["my_law.py:Cubic"], "my_law.py:Cubic: there is no file 'my_law.py'; did you mean 'my_laws.py'?"),
        (["my_laws.py:Cubik"], "my_laws.py has no law or friction 'Cubik'; did you mean 'Cubic'?"),
        (["my_laws.py:helper"], "'helper' in my_laws.py is no class derived from wc.Law or wc.Friction"),
        (
            ["my_laws.py:Picky", "--plot", "a.svg", "--set", "stiffness=99"],
            f"my_laws.py: line {TOO_STIFF}: LookupError: too stiff",
        ),
        (
            ["--compare", "Cubic", "my_laws.py:Cubic", "--plot", "a.svg"],
            "there is no law or friction model 'Cubic'",
        ),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else None,
)
def test_invalid_laws_command_prints_one_message_and_draws_nothing(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    Path("folder.svg").mkdir()
    shutil.copy(CUSTOM_LAWS, "my_laws.py")
    assert main(["laws", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert "running" not in err
    assert "Traceback" not in err
    assert not Path("a.svg").exists()


@pytest.mark.parametrize(
    ("words", "expected_text"),
    [
        (["Hertz", "--mass", "2", "--speed", "3", "--depth", "0.002"], "sphere of 2 kg on a plate at 3 m/s"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                (["--compare", "../my_laws.py:Cubic", "Hertz"], "Cubic: stiffness 2e+12 N/m³"),
                (["Tanh", "--load", "25"], "pressed on a plate with 25 N"),
                (["--compare", "Hertz", "Flores", "--restitution", "0.5"], "force over time, e = 0.5"),
                (["--compare", "Tanh", "Hollars"], "friction force F/N against +x [-]"),
                (["Hertz", "--set", "stiffness=1.5e6"], "stiffness 1.5e+06 N/m^1.5"),
                (["Tanh", "--set", "mu=0.8"], "mu 0.8, velocity_scale 0.01 m/s"),
                (["KelvinVoigt", "--set", "damping=300"], "damping 300 N·s/m"),
                (["../my_laws.py:Cubic"], "Cubic"),
                (["../my_laws.py:Lubricated", "--set", "drag=2"], "drag 2 s/m"),
            )
        ),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else None,
)
def test_laws_command_draws_the_requested_plot(words, expected_text, tmp_path, capsys, monkeypatch):
    shutil.copy(CUSTOM_LAWS, tmp_path / "my_laws.py")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    # With text elements in the SVG, so that the test can search them.
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        assert main(["laws", *words, "--plot", "a.svg"]) == 0
    assert capsys.readouterr().out == "picture: a.svg\n"
    assert expected_text in Path("a.svg").read_text()
    assert main(["laws", *words, "--plot", "a.PNG"]) == 0
    assert Path("a.PNG").read_bytes().startswith(b"\x89PNG")


def test_laws_command_distinguishes_custom_law_from_library_law_of_equal_name(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("my_laws.py").write_text(CUSTOM_LAWS.read_text().replace("Cubic", "Hertz"))
    assert main(["laws", "my_laws.py:Hertz"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("  Hertz\n    formula N = k δ³.\n    stiffness         N/m³    > 0")
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        assert main(["laws", "--compare", "my_laws.py:Hertz", "Hertz", "--plot", "a.svg"]) == 0
    assert "my_laws.py:Hertz (Hertz): stiffness" in Path("a.svg").read_text()


def test_laws_command_explains_a_compile_error(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(CUSTOM_LAWS, "my_laws.py")
    assert main(["laws", "my_laws.py:Careless", "--plot", "a.svg"]) == 2
    err = capsys.readouterr().err
    assert "law Careless does not compile in float64" in err
    assert "_warpcontact_own_" not in err
    assert not Path("a.svg").exists()


def test_laws_command_asks_for_required_values(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(CUSTOM_LAWS.with_name("custom_law.py"), "own_law.py")
    assert main(["laws", "own_law.py:Plastic", "--plot", "a.svg", "--set", "loading=1e6"]) == 2
    assert "Plastic needs unloading: add --set unloading=…" in capsys.readouterr().err
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        words = ["--plot", "a.svg", "--set", "loading=1e6", "unloading=4e6"]
        assert main(["laws", "own_law.py:Plastic", *words]) == 0
    assert "e = 0.5" in Path("a.svg").read_text()


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder in which nobody can write")
def test_laws_command_checks_output_path_before_running(capsys):
    assert main(["laws", "Hertz", "--plot", "/proc/a.png"]) == 2
    assert capsys.readouterr().err == "warpcontact: /proc/a.png: cannot be written: No such file or directory\n"
