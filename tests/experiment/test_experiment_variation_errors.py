"""Errors in variations and sampling: each names its key, the value and the condition."""

from math import inf, nan

import numpy as np
import pytest
from test_experiment import content
from test_experiment_errors import problems_of

import warpcontact as wc

MASS = "ball.mass"
UNIFORM = {"uniform": [1, 2]}
PAIR = {MASS: UNIFORM, "touch.radius": {"uniform": [0.01, 0.02]}}
HALF = [[1, 0.5], [0.5, 1]]


def law(**parameters):
    return varied(MASS, distribution=parameters)


def together(names=(MASS, "touch.radius"), matrix=HALF, **changes):
    return {"variation": PAIR, "correlation": [{"names": list(names), "matrix": matrix}]} | changes


def sampled(method, variation, **changes):
    return {"variation": variation, "sampling": {"method": method}} | changes


def varied(name, **entry):
    return {"variation": {name: entry}}


IN_MASS = 'variation."ball.mass".'
BAD = [
    # Distributions of SciPy.
    (
        law(name="weibul_min", c=1.5),
        f"{IN_MASS}distribution.name must be the name of a distribution of scipy.stats, got "
        "'weibul_min'; did you mean 'weibull_min'?",
    ),
    (
        law(name=3),
        f"{IN_MASS}distribution.name must be the name of a distribution of scipy.stats, got 3, such as norm, ",
    ),
    (
        law(name="os.system"),
        "distribution.name must be the name of a distribution of scipy.stats, got 'os.system'",
    ),
    (law(c=1.5), f"{IN_MASS}distribution.name is missing: the name of a distribution of scipy.stats"),
    (law(name="weibull_min"), f"{IN_MASS}distribution.c is missing: weibull_min has the parameters c, loc, scale"),
    (law(name="weibull_min", c=-1), f"{IN_MASS}distribution.c must be greater than 0, got -1"),
    (law(name="triang", c=1.5), f"{IN_MASS}distribution.c must be at least 0 and at most 1, got 1.5"),
    (law(name="norm", scale=0), f"{IN_MASS}distribution.scale must be greater than 0, got 0"),
    (law(name="norm", sclae=1), f"{IN_MASS}distribution.sclae is not known; did you mean 'scale'?"),
    (law(name="norm", sigma=1), f"{IN_MASS}distribution.sigma is not known; norm has: loc, scale"),
    (law(name="norm", loc="1"), f"{IN_MASS}distribution.loc must be a number or a list of numbers, got '1'"),
    (law(name="norm", loc=[[1]]), f"{IN_MASS}distribution.loc must be a number or a list of numbers, got [[1]]"),
    (law(name="norm", loc=nan), f"{IN_MASS}distribution.loc must be finite, got nan"),
    (law(name="truncnorm", a=0, b=inf), f"{IN_MASS}distribution.b must be finite, got inf"),
    (
        law(name="truncnorm", a=2, b=1),
        f"{IN_MASS}distribution: invalid parameters of truncnorm: a = 2.0, b = 1.0; see the documentation of",
    ),
    (
        law(name="norm", loc=[1, 2], scale=[1, 2, 3]),
        f"{IN_MASS}distribution: lists of parameters of norm must have the same length",
    ),
    (law(name="norm", loc=[1, 2]), f"{IN_MASS[:-1]} must have shape () or (4,), got (4, 2)"),
    (law(name="norm", loc=0), f"{IN_MASS[:-1]}["),
    (
        law(name="poisson", mu=3),
        f"{IN_MASS}distribution.name must be a continuous one, got 'poisson'; ball.mass is a real number",
    ),
    (varied(MASS, distribution="norm"), f"{IN_MASS}distribution must be a table, got 'norm'; write {{ name = "),
    (
        varied(MASS, distribtion={"name": "norm"}),
        f"{IN_MASS}distribtion is not known; did you mean 'distribution'?",
    ),
    # Others.
    (
        varied(MASS, lognormal=[0, -1]),
        f"{IN_MASS}lognormal must be [mean, deviation] with deviation ≥ 0, got [0, -1]",
    ),
    (varied(MASS, lognormal=[2000, 1]), f"{IN_MASS[:-1]}[0] must be greater than 0, got inf"),
    (
        varied(MASS, lognormal=[1]),
        f"{IN_MASS}lognormal must be two numbers, or two lists of numbers of the same length, got [1]",
    ),
    (
        varied(MASS, uniform=[1, 2], group="a"),
        f"{IN_MASS}group must be left out: it requires grid, got uniform",
    ),
    (
        varied(MASS, group="a"),
        f"{IN_MASS[:-1]} must have exactly one of uniform, loguniform, normal, lognormal, linspace, "
        "distribution, grid, ",
    ),
    # Grids.
    (varied(MASS, grid=[]), f"{IN_MASS}grid must be a list of values, got []"),
    (varied(MASS, grid=3), f"{IN_MASS}grid must be a list of values, got 3"),
    (varied(MASS, grid=[1, [2]]), f"{IN_MASS}grid[1] must be of the same kind as the values before, got (2.0,)"),
    (varied(MASS, grid=[1, 2, -3]), f"{IN_MASS}grid[2] must be greater than 0, got -3 kg"),
    (varied(MASS, grid=[1, nan]), f"{IN_MASS}grid must be finite, got nan"),
    (
        varied(MASS, grid=[1, 2], group="my group"),
        f"{IN_MASS}group must be letters, digits, _ and -, not starting with a digit, got 'my group'",
    ),
    (
        {"variation": {MASS: {"grid": [1, 2], "group": "size"}, "touch.radius": {"grid": [0.1], "group": "size"}}},
        "variation.\"touch.radius\".grid must have as many values as 'ball.mass' of the group 'size', 2, got 1",
    ),
    # Files.
    (
        varied(MASS, values="masses.txt"),
        f"{IN_MASS}values must be a list, or a file that ends in .npy or .csv, got 'masses.txt'",
    ),
    (varied(MASS, values="none.csv"), f"{IN_MASS}values: there is no file 'none.csv'"),
    # Sampling.
    (
        sampled("halton", PAIR),
        "sampling.method must be one of 'random', 'latin_hypercube', 'sobol', 'saltelli', got 'halton'",
    ),
    (
        sampled("sobol", PAIR) | {"sampling": {"metod": "sobol"}},
        "sampling.metod is not known; did you mean 'method'?",
    ),
    ({"sampling": "sobol"}, "sampling must be a table, got 'sobol'"),
    (
        sampled("saltelli", PAIR, envs=20),
        "envs must be 4 n, with n = 2, 4, 8, …, for sampling.method = 'saltelli' and 2 "
        "sampled numbers, got 20; nearest: 16 and 32",
    ),
    (sampled("saltelli", PAIR, envs=1), "got 1; nearest: 8"),
    (sampled("saltelli", PAIR, envs=33), "got 33; nearest: 32 and 64"),
    (
        sampled("saltelli", PAIR | {"touch.force_scale": {"linspace": [0, 1]}}, envs=16),
        "variation.\"touch.force_scale\".linspace must be left out with sampling.method = 'saltelli'; "
        "allowed: uniform, ",
    ),
    (
        sampled("saltelli", PAIR | {"touch.force_scale": {"grid": [0, 1]}}, envs=16),
        'variation."touch.force_scale".grid must be left out',
    ),
    (
        sampled("saltelli", {MASS: {"value": 1}}, envs=16),
        "variation must have a sampled entry that varies, for sampling.method = 'saltelli'",
    ),
    (
        sampled("saltelli", {MASS: {"uniform": [1, 1]}}, envs=16),
        "variation must have a sampled entry that varies, for sampling.method = 'saltelli'",
    ),
    # Correlation.
    (
        together(variation=PAIR | {MASS: {"normal": [1, 0]}}),
        "correlation[0].names[0] must differ between environments, got 'ball.mass', which is always the same",
    ),
    (
        together([MASS]),
        "correlation[0].names must be a list of the names of two or more entries of [variation], got "
        "['ball.mass']",
    ),
    (together([MASS, MASS]), "correlation[0].names[1] must be another name, got 'ball.mass' again"),
    (
        together([MASS, "touch.radus"]),
        "correlation[0].names[1] must be the name of a sampled entry of [variation], got "
        "'touch.radus'; did you mean 'touch.radius'?",
    ),
    (
        together(matrix=[[1, 0.5]]),
        "correlation[0].matrix must be a square list of lists of numbers, got [[1, 0.5]]",
    ),
    (
        together(matrix=[[1, 0.5], [0.5]]),
        "correlation[0].matrix must be a square list of lists of numbers, got [[1, 0.5], [0.5]]",
    ),
    (
        together(matrix=[[1, "x"], [0.5, 1]]),
        "correlation[0].matrix must be a square list of lists of numbers, got 'x'",
    ),
    (
        together(matrix=[[2, 0.5], [0.5, 1]]),
        "correlation[0].matrix[0, 0] must be at least -1 and at most 1, got 2",
    ),
    (together(matrix=[[1, 0.5], [0.5, 0.9]]), "correlation[0].matrix[1][1] must be 1, got 0.9"),
    (together(matrix=[[1, 0.5], [0.4, 1]]), "correlation[0].matrix[1][0] must be that of [0][1], 0.5, got 0.4"),
    (
        together(matrix=[[1, 1], [1, 1]]),
        "correlation[0].matrix must be positive definite, got [[1, 1], [1, 1]] with an eigenvalue of",
    ),
    (together(matrix=np.eye(3).tolist()), "correlation[0].matrix must have a row for each of the 2 names, got 3"),
    (
        together(variation=PAIR | {"touch.radius": {"linspace": [0.1, 0.2]}}),
        "correlation[0].names[1] must be sampled, by one of uniform, loguniform, normal, lognormal, "
        "distribution, got 'touch.radius', which has linspace",
    ),
    (
        together([MASS, "ball.position"], variation=PAIR | {"ball.position": {"uniform": [[0] * 3, [1] * 3]}}),
        "correlation[0].names[1] must be one number in each environment, got 'ball.position', which has 3",
    ),
    (
        together(
            correlation=[
                {"names": [MASS, "touch.radius"], "matrix": HALF},
                {"names": [MASS, "touch.kappa"], "matrix": HALF},
            ],
            variation=PAIR | {"touch.kappa": {"uniform": [0, 1]}},
        ),
        "correlation[1].names[0] must be in no other [[correlation]], got 'ball.mass' again",
    ),
    (
        together(sampling={"method": "saltelli"}, envs=16),
        "correlation[0] must be left out: sampling.method = 'saltelli' requires",
    ),
    (
        {"variation": PAIR, "correlation": {"names": []}},
        "correlation must be a list of tables, [[correlation]], got",
    ),
    (
        {"variation": PAIR, "correlation": [{"names": list(PAIR)}]},
        "correlation[0].matrix is missing: their correlations",
    ),
    (
        {"variation": PAIR, "correlation": [{"names": list(PAIR), "matrix": HALF, "kind": "t"}]},
        "correlation[0].kind is not known; allowed: names, matrix",
    ),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=[message[-60:] for _, message in BAD])
def test_invalid_variation_is_reported_with_its_key(changes, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    problems = problems_of(content(**changes))
    assert any(message in problem for problem in problems), problems
    # Exactly one problem: an error does not cause others.
    assert len(problems) == 1, problems


def test_integer_parameters_require_discrete_distributions():
    surface = [{"name": "ground", "mesh": [{"shape": "grid"}, {"shape": "box"}]}]
    for entry, message in (
        (
            {"distribution": {"name": "norm"}},
            "distribution.name must be a discrete one, got 'norm'; ground.mesh is a whole number",
        ),
        ({"distribution": {"name": "poisson", "mu": 5}}, "[0] must be at least 0 and at most 1, got"),
        ({"distribution": {"name": "bernoulli", "p": 0.5, "loc": 0.5}}, "[0] must be a whole number, got"),
        (
            {"lognormal": [0, 1]},
            "lognormal gives no whole numbers; ground.mesh takes one of value, values, uniform, linspace, ",
        ),
        ({"grid": [0, 0.5]}, "grid[1] must be a whole number, got 0.5"),
    ):
        (problem,) = problems_of(content(surface=surface, variation={"ground.mesh": entry}))
        assert problem.startswith('variation."ground.mesh"')
        assert message in problem


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n2\n", 'variation."ball.mass".values must have at least one row for each of 4 environments, got 2'),
        (
            "1\n2\nmany\n4\n",
            "masses.csv' holds no table of numbers: line 3, column 1 must be a number, got 'many'",
        ),
        ("# kg\n\n1\n2,\n", "holds no table of numbers: line 4, column 2 must be a number, got ''"),
        ("1,2\n3\n", "line 2 must have as many columns as those before, 2, got 1"),
        ("# kg\n", "masses.csv' holds no table of numbers: it is empty"),
        ("\udcff", "masses.csv' holds no table of numbers: it must be text in UTF-8"),
        ("1\n2\nnan\n4\n", 'variation."ball.mass"[2] must be greater than 0, got nan kg'),
        ("1,1\n2,2\n3,3\n4,4\n", 'variation."ball.mass" must have shape () or (4,), got (4, 2)'),
    ],
)
def test_invalid_value_files_are_reported(text, message, tmp_path):
    (tmp_path / "masses.csv").write_text(text, encoding="utf-8", errors="surrogateescape")
    (problem,) = problems_of(content(variation={MASS: {"values": "masses.csv"}}), tmp_path)
    assert message in problem
    assert "\n" not in problem


@pytest.mark.parametrize(
    ("saved", "message"),
    [
        (["a", "b"], "its values must be numbers, got text"),
        ([True, False], "its values must be numbers, got truth values"),
        ([1j], "its values must be numbers, got complex numbers"),
        (None, "it must be one array as written by numpy.save, got an archive of arrays (.npz)"),
        (b"\x93NUMPY", "it must be a complete array of numbers as written by numpy.save"),
        (b"1, 2, 3", "it must be a complete array of numbers as written by numpy.save"),
        (b"", "it must be a complete array of numbers as written by numpy.save"),
    ],
)
def test_invalid_npy_files_are_reported(saved, message, tmp_path):
    path = tmp_path / "masses.npy"
    if isinstance(saved, bytes):
        path.write_bytes(saved)
    elif saved is None:
        with path.open("wb") as file:
            np.savez(file, masses=np.ones(4))
    else:
        np.save(path, np.array(saved))
    (problem,) = problems_of(content(variation={MASS: {"values": "masses.npy"}}), tmp_path)
    assert problem.endswith(f"masses.npy' holds no table of numbers: {message}")


def test_pickled_arrays_are_refused(tmp_path):
    np.save(tmp_path / "masses.npy", np.array([1, "2", None, 4], dtype=object), allow_pickle=True)
    (problem,) = problems_of(content(variation={MASS: {"values": "masses.npy"}}), tmp_path)
    assert problem.endswith("it must be a complete array of numbers as written by numpy.save")


def test_invalid_values_are_reported_with_environment_number_in_any_block():
    envs = 70_000
    masses = np.ones(envs)
    masses[69_999] = -1.0
    (problem,) = problems_of(content(envs=envs, variation={MASS: {"values": masses.tolist()}}))
    assert problem == 'variation."ball.mass"[69999] must be greater than 0, got -1 kg'


def test_overrides_inconsistent_with_the_design_are_refused():
    experiment = wc.Experiment.from_dict(content(**sampled("saltelli", PAIR, envs=16)))
    with pytest.raises(wc.ExperimentError, match=r"envs must be 4 n.* got 10; nearest: 8 and 16"):
        experiment.changed(envs=10)
    assert experiment.changed(envs=32).settings.envs == 32


@pytest.mark.parametrize("method", ["random", "sobol", "saltelli"])
def test_invalid_entry_is_the_only_problem(method):
    for entry in ({"uniform": [2, 1]}, {"uniform": [-1, 1]}, {"uniform": [[1, 1], [2, 2]]}, {"unifrom": [1, 2]}):
        correlation = [] if method == "saltelli" else [{"names": list(PAIR), "matrix": HALF}]
        inertia = {"solid_sphere": {"mass": MASS, "radius": "touch.radius"}}
        changes = sampled(method, PAIR | {MASS: entry, "ball.inertia": inertia}, envs=16, correlation=correlation)
        (problem,) = problems_of(content(**changes))
        assert problem.startswith(IN_MASS)
