"""Errors in custom laws of an experiment: each names its key, with file and line if there is one."""

import sys

import pytest
from test_experiment import content
from test_experiment_custom_law import CUBIC, LAWS, TEXT, folder, study

import warpcontact as wc
from warpcontact.cli import main

__all__ = ["folder"]  # the fixture


def problems_of(raw, folder):
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict(raw, folder)
    return caught.value.problems


def custom_type(name, **parameters):
    return {"type": f"my_laws.py:{name}", **parameters}


def line(text):
    """Returns the line number of ``text`` in the file of custom laws."""
    return LAWS[: LAWS.index(text)].count("\n") + 1


OUTSIDE = ".type must name a file inside of the folder of the experiment, got "
BAD = [
    # Parameters, as for laws of the catalogue.
    (custom_type("Cubic", stiffness=-1), ".stiffness must be greater than 0, got -1 N/m³"),
    (custom_type("Cubic", stiffness="1"), ".stiffness must be a number [N/m³], got '1'"),
    (custom_type("Cubic", stiffness=1, stifness=1), ".stifness is not known; did you mean 'stiffness'?"),
    (custom_type("Cubic"), ".stiffness is missing: stiffness k [N/m³]"),
    (
        custom_type("Pad", stiffness=1, depth=1),
        ": Pad takes exactly one of stiffness and depth, got stiffness and depth",
    ),
    (custom_type("Pad"), ": Pad takes exactly one of stiffness and depth, got none"),
    (custom_type("Pad", stiffness=1, damping=-1), ".damping must be at least 0, got -1 s/m"),
    (custom_type("Reserved"), ".type: Reserved has a parameter 'type', a name that is reserved"),
    # Classes.
    (custom_type("Cubik"), ".type: my_laws.py has no law 'Cubik'; did you mean 'Cubic'?"),
    (custom_type("Xyz"), ".type: my_laws.py has no law 'Xyz'; there are: Cubic, Pad, Fading, Careless"),
    (custom_type(""), ".type: my_laws.py has no law ''; there are: Cubic"),
    (custom_type("Lubricated", drag=1), ".type: 'Lubricated' in my_laws.py is a friction and no law"),
    (custom_type("helper"), ".type: 'helper' in my_laws.py is no class derived from wc.Law"),
    (custom_type("wc"), ".type: 'wc' in my_laws.py is no class derived from wc.Law"),
    (custom_type("Powerless", stiffness=1), ".type: Powerless.force in my_laws.py must be a wp.func of"),
    # Errors that appear only when the code runs.
    (custom_type("Picky", stiffness=99), f": my_laws.py, line {line('too stiff')}: LookupError: too stiff"),
    (custom_type("Fading", stiffness=1e7), f": my_laws.py, line {line('no table')}: LookupError: no table"),
    (custom_type("Unnamed", stiffness=1), ": Unnamed.coefficients must return stiffness, chi, got no chi"),
    (custom_type("Misspelt", stiffness=1), ": law Misspelt "),
    # Files.
    ({"type": "my_laws.py"}, ".type must be one of Hooke, "),
    ({"type": "my_laws:Cubic"}, ", or FILE.py:CLASS, got 'my_laws:Cubic'"),
    ({"type": "my_law.py:Cubic"}, ".type: there is no file 'my_law.py'; did you mean 'my_laws.py'?"),
    ({"type": "sub/my_laws.py:Cubic"}, ".type: there is no file 'sub/my_laws.py'"),
    ({"type": "folder.py:Cubic"}, ".type: 'folder.py' is not a regular file"),
    ({"type": "../study/my_laws.py:Cubic"}, f"{OUTSIDE}'../study/my_laws.py'"),
    ({"type": "sub/../my_laws.py:Cubic"}, f"{OUTSIDE}'sub/../my_laws.py'"),
    ({"type": "/my_laws.py:Cubic"}, f"{OUTSIDE}'/my_laws.py'"),
    ({"type": "\0.py:Cubic"}, ".type: '\\x00.py' cannot be read"),
    ({"type": "Tanh"}, ", got 'Tanh'; that is a friction"),
    ("my_laws.py:Cubic", " must be a table, got 'my_laws.py:Cubic'; write law = { type = 'my_laws.py:Cubic', … }"),
]


@pytest.mark.parametrize(("law", "message"), BAD, ids=[message[:50] for _, message in BAD])
def test_invalid_custom_law_is_reported_with_its_key(law, message, folder):
    (folder / "folder.py").mkdir()
    (problem,) = problems_of(study(law=law), folder)
    assert problem.startswith("material[0].law")
    assert message in problem
    assert "_warpcontact_own_" not in problem


BROKEN = [
    ("x = (\n", ": my_laws.py, line 1: SyntaxError: '(' was never closed"),
    ("\n\nraise ValueError('no\\nway')\n", ": my_laws.py, line 3: ValueError: no\n    way"),
    ("def f():\n    return 1 / 0\n\n\nf()\n", ": my_laws.py, line 2: ZeroDivisionError: division by zero"),
    ("import there_is_no_such_module\n", ": my_laws.py, line 1: ModuleNotFoundError: No module named 'there_is"),
    ("raise SystemExit(3)\n", ": my_laws.py, line 1: SystemExit: 3"),
    ("assert False\n", ": my_laws.py, line 1: AssertionError"),
    ("# coding: klingon\n", ": my_laws.py: SyntaxError: "),
    (
        LAWS.replace("p: Any, c: Any", "p, c"),
        "WarpCodegenError: Incomplete argument annotations on function force",
    ),
    (LAWS.replace("float = wc.parameter(", "float = print("), "TypeError: "),
]


@pytest.mark.parametrize(("text", "message"), BROKEN, ids=[message for _, message in BROKEN])
def test_error_in_custom_law_file_is_reported_with_its_line(text, message, folder):
    (folder / "my_laws.py").write_text(text, encoding="utf-8")
    modules = set(sys.modules)
    (problem,) = problems_of(study(), folder)
    assert problem.startswith("material[0].law.type: my_laws.py")
    assert message in problem
    assert not {name for name in set(sys.modules) - modules if "my_laws" in name}
    # A file that failed is read again.
    (folder / "my_laws.py").write_text(LAWS, encoding="utf-8")
    assert wc.Experiment.from_dict(study(), folder)


def test_base_classes_are_not_accepted_as_laws(folder):
    (folder / "my_laws.py").write_text("from warpcontact import Law\n")
    (problem,) = problems_of(study(law=custom_type("Law")), folder)
    assert problem == "material[0].law.type: Law.force in my_laws.py must be a wp.func of (coefficients, state)"
    (problem,) = problems_of(study(law=custom_type("Cubic")), folder)
    assert problem == "material[0].law.type: my_laws.py has no law 'Cubic'; there are: none"


def test_link_out_of_the_folder_is_refused_and_link_inside_is_followed(folder):
    (folder.parent / "outside.py").write_text(LAWS, encoding="utf-8")
    try:
        (folder / "linked.py").symlink_to(folder.parent / "outside.py")
        (folder / "away").symlink_to(folder.parent, target_is_directory=True)
        (folder / "inner.py").symlink_to("my_laws.py")
        (folder / "loop.py").symlink_to("loop.py")
    except OSError:
        pytest.skip("no links here")
    for name in ("linked.py", "away/outside.py"):
        (problem,) = problems_of(study(law=CUBIC | {"type": f"{name}:Cubic"}), folder)
        assert problem.startswith("material[0].law.type must name a file inside of the folder of the experiment")
    (problem,) = problems_of(study(law=CUBIC | {"type": "loop.py:Cubic"}), folder)
    assert problem.startswith("material[0].law.type")
    run = wc.Experiment.from_dict(study(law=CUBIC | {"type": "inner.py:Cubic"}), folder).run(
        folder.parent / "out", device="cpu"
    )
    assert "my_laws.py" in run.files


def test_law_problems_are_reported_together_with_file_problems(folder):
    material = {"name": "rubber", "law": {"type": "my_laws.py:Misspelt", "stiffness": 1}}
    unused = {
        "name": "unused",
        "law": {"type": "my_laws.py:Careless", "stiffness": 1},
        "friction": {"type": "my_laws.py:Pad"},
    }
    idle = {"name": "idle", "law": {"type": "my_laws.py:Careless", "stiffness": 1}}
    raw = study(material=[material, unused, idle], precision="float64")
    raw["variation"] = {"ball.mas": {"uniform": [1, 2]}, "touch.law.stiffness": {"uniform": [1, 2]}}
    raw["record"] = {"sensors": ["ball.positon", "touch.gap"]}
    raw["contact"].append(content()["contact"][0] | {"name": "other", "points": "center"})
    problems = problems_of(raw, folder)
    begins = [
        "material[1].friction.type: 'Pad' in my_laws.py is a law and no friction",
        "contact[1].points must be the name of a point",
        "material[0].law: law Misspelt ",
        "material[2].law: law Careless ",
        'variation."ball.mas" is not the name of a parameter',
        "record.sensors[0] must be the name of a sensor",
    ]
    assert len(problems) == len(begins), problems
    for begin in begins:
        assert any(problem.startswith(begin) for problem in problems), (begin, problems)


LAWS_WITH_TYPE_ERRORS = """
@wp.func
def squared(x: Any):
    return x.y * x


class Helped(wc.Law):
    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * squared(c.delta)


class Twofold(wc.Law):
    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return wp.vec2(p.stiffness, c.delta)


class Unfounded(wc.Law):
    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        first = p.stiffness * c.delta
        return first * gain


class Straight(wc.Friction):
    @wp.func
    def force(p: Any, s: Any):
        return s.speed
"""
HELP = (
    "In the law, p has stiffness; "
    "c has delta, delta_dot, entry_speed, mass, inverse_mass, curvature_1, curvature_2, dt."
)
UNSOUND_LINES = [
    (
        "law",
        "Misspelt",
        "`stifness` is not an attribute of 'p'; did you mean 'stiffness'?",
        "p.stifness * c.delta",
    ),
    ("law", "Helped", "`y` is not an attribute of 'x' (float32)", "x.y * x"),
    ("law", "Unfounded", "Referencing undefined symbol: gain", "first * gain"),
]


@pytest.mark.parametrize(("part", "name", "wrong", "text"), UNSOUND_LINES, ids=[row[1] for row in UNSOUND_LINES])
def test_compile_error_is_reported_with_file_and_line_without_kernels(part, name, wrong, text, folder):
    laws = LAWS + LAWS_WITH_TYPE_ERRORS
    (folder / "my_laws.py").write_text(laws, encoding="utf-8")
    number = laws[: laws.index(text)].count("\n") + 1
    (problem,) = problems_of(study(law=custom_type(name, stiffness=1)), folder)
    place = f"{folder / 'my_laws.py'}, line {number}: {wrong}\n        return {text}\n    {HELP}"
    assert problem == f"material[0].law: law {name} does not compile in float32: {place}"


def test_wrong_return_type_is_reported_without_kernels(folder):
    (folder / "my_laws.py").write_text(LAWS + LAWS_WITH_TYPE_ERRORS, encoding="utf-8")
    (problem,) = problems_of(study(law=custom_type("Twofold", stiffness=1)), folder)
    results = (
        "A law returns a number in the precision of the simulation, such as type(c.delta)(0.0); a friction model "
        "returns a vector."
    )
    expected_problem = (
        f"law Twofold does not compile in float32: Twofold.force returns vec2f\n    {HELP}\n    {results}"
    )
    assert problem == f"material[0].law: {expected_problem}"
    (problem,) = problems_of(study(friction=custom_type("Straight")), folder)
    expected_problem = (
        "friction Straight does not compile in float32: Straight.force returns float32\n    In the friction, "
    )
    assert problem.startswith(f"material[0].friction: {expected_problem}")
    assert problem.endswith(results)


def test_error_in_host_code_for_varied_values_is_reported_with_its_line(folder, capsys):
    law = '{ type = "my_laws.py:Fading", stiffness = 1e4 }'
    text = TEXT.replace('{ type = "my_laws.py:Cubic", stiffness = 1e9 }', law)
    (folder / "study.toml").write_text(text)
    out = folder.parent / "out"
    assert main(["run", str(folder / "study.toml"), "--out", str(out), "--device", "cpu"]) == 2
    message = f"warpcontact: {folder / 'my_laws.py'}: line {line('no table')}: LookupError: no table\n"
    assert capsys.readouterr().err.endswith(message)
    with pytest.raises(wc.ExperimentError, match="LookupError: no table"):
        wc.Experiment.from_toml(folder / "study.toml").model(device="cpu")
