"""All errors in an experiment are found before it runs and reported together, each with its key."""

import copy
from math import inf, nan

import pytest

import warpcontact as wc

VALID_STUDY = {
    "envs": 3,
    "duration": 0.1,
    "dt": 1.0e-3,
    "surface": [{"name": "ground", "mesh": {"shape": "grid"}}],
    "body": [{"name": "ball", "mass": 1.0, "inertia": [0.1, 0.1, 0.1], "position": [0, 0, 1]}],
    "point": [{"name": "centre", "body": "ball", "position": [0, 0, 0]}],
    "points": [{"name": "hull", "body": "ball", "positions": [[0, 0, 0], [0, 0, 1]]}],
    "material": [{"name": "rubber", "law": {"type": "HuntCrossley", "stiffness": 1e5, "restitution": 0.7}}],
    "contact": [{"name": "touch", "points": "centre", "surface": "ground", "material": "rubber"}],
    "variation": {"ball.mass": {"uniform": [1, 2]}},
    "record": {"every": 0.01, "sensors": ["touch.gap"]},
    "output": {"usd_envs": 2},
}
REMOVED = object()
VARIED = ("variation", "ball.mass")
LAW = ("material", 0, "law")
GROUND = ("surface", 0)
NAMES = ", ".join(law.__name__ for law in (*wc.laws.CATALOGUE, *wc.laws.RIGID)) + ", or FILE.py:CLASS"
MATERIAL_WITH_FRICTION = (*wc.friction.CATALOGUE, *wc.friction.RIGID)
FRICTIONS = ", ".join(friction.__name__ for friction in MATERIAL_WITH_FRICTION) + ", or FILE.py:CLASS"


def invalid_study(*changes):
    """``RIGHT`` with other values: pairs of a path, as a tuple of keys, and the new value."""
    content = copy.deepcopy(VALID_STUDY)
    for place, value in changes:
        target = content
        for key in place[:-1]:
            target = target[key]
        if value is REMOVED:
            del target[place[-1]]
        elif isinstance(target, list):
            target[place[-1] :] = [value]
        else:
            target[place[-1]] = value
    return content


def problems_of(content, folder="."):
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict(content, folder)
    return caught.value.problems


BAD = [
    # Keys.
    (("nmae",), "x", "nmae is not known; did you mean 'name'?"),
    (("bodys",), [], "bodys is not known; did you mean 'body'?"),
    (("xyz",), 1, "xyz is not known; allowed: name, envs, duration"),
    (("body", 0, "mas"), 1, "body[0].mas is not known; did you mean 'mass'?"),
    (("body", 0, "velocity"), [0, 0, 1], "body[0].velocity is not known; did you mean 'linear_velocity'?"),
    ((*LAW, "k"), 1, "material[0].law.k is not known; did you mean 'stiffness'?"),
    (("contact", 0, "raduis"), 1, "contact[0].raduis is not known; did you mean 'radius'?"),
    ((*LAW, "stifness"), 1, "material[0].law.stifness is not known; did you mean 'stiffness'?"),
    ((*GROUND, "mesh", "celss"), 1, "surface[0].mesh.celss is not known; did you mean 'cells'?"),
    (("record", "evry"), 1, "record.evry is not known; did you mean 'every'?"),
    (("output", "usd_env"), 1, "output.usd_env is not known; did you mean 'usd_envs'?"),
    ((*VARIED, "unifrom"), [1, 2], "variation.\"ball.mass\".unifrom is not known; did you mean 'uniform'?"),
    # Missing keys.
    (("dt",), REMOVED, "dt is missing: time step [s]"),
    (("duration",), REMOVED, "duration is missing: simulated time [s]"),
    (("body",), REMOVED, "body is missing: an experiment needs a [[body]]"),
    (("body", 0, "mass"), REMOVED, "body[0].mass is missing: mass [kg]"),
    (("body", 0, "name"), REMOVED, "body[0].name is missing"),
    ((*LAW, "stiffness"), REMOVED, "material[0].law.stiffness is missing: stiffness K [N/mⁿ]"),
    ((*LAW, "type"), REMOVED, f"material[0].law.type is missing: one of {NAMES}"),
    ((*GROUND, "mesh", "shape"), REMOVED, "surface[0].mesh.shape is missing: one of grid, "),
    # Types: a text is not a number, and true is not 1.
    (("dt",), "1e-3", "dt must be a number [s], got '1e-3'"),
    (("envs",), 8.0, "envs must be a whole number, got 8.0"),
    (("envs",), True, "envs must be a whole number, got True"),
    (("seed",), "one", "seed must be a whole number, got 'one'"),
    (("name",), 3, "name must be a text on one line, got 3"),
    (("body",), {"name": "ball"}, "body must be a list of tables, [[body]], got"),
    (("body", 0), 3, "body[0] must be a table, got 3"),
    (("body", 0, "mass"), True, "body[0].mass must be a number [kg], got True"),
    (("body", 0, "mass"), [1], "body[0].mass must be a number [kg], got [1]"),
    (("body", 0, "position"), [0, 1], "body[0].position must be 3 numbers [m], got [0, 1]"),
    (("body", 0, "position"), [0, 1, "2"], "body[0].position must be 3 numbers [m], got '2'"),
    (("body", 0, "inertia"), [[1, 0], [0, 1]], "body[0].inertia must be 3 numbers or a 3×3 tensor [kg·m²], got"),
    (("body", 0, "inertia"), [[1, 0], [0]], "body[0].inertia must be 3 numbers or a 3×3 tensor [kg·m²], got"),
    (("points", 0, "positions"), [0, 0, 1], "points[0].positions[0] must be 3 numbers [m], got 0.0"),
    (("points", 0, "positions"), [], "points[0].positions must be a list of 3 numbers each [m], got []"),
    ((*GROUND, "flip"), "yes", "surface[0].flip must be true or false, got 'yes'"),
    ((*GROUND, "mesh"), "grid", "surface[0].mesh must be a table, got 'grid'; write mesh = { shape = 'grid', … }"),
    ((*GROUND, "mesh", "cells"), [2.5, 1], "surface[0].mesh.cells must be 2 whole numbers, got [2.5, 1]"),
    ((*GROUND, "active_faces"), [0, True], "surface[0].active_faces must be a list of face numbers"),
    (LAW, "Hooke", "material[0].law must be a table, got 'Hooke'; write law = { type = 'Hooke', … }"),
    (
        ("record", "sensors"),
        ["foo"],
        "record.sensors[0] must be the name of a sensor, got 'foo'; there are: ball.*, touch.*, scene.*",
    ),
    (
        ("record", "sensors"),
        ["touch.zzzzzz"],
        "record.sensors[0] must be the name of a sensor, got 'touch.zzzzzz'; there are: touch.point, touch.",
    ),
    (
        ("record", "sensors"),
        ["touch.impulse"],
        "record.sensors[0] must be the name of a sensor, got 'touch.impulse'; only nonsmooth contact has it, with",
    ),
    (("record", "sensors"), "touch.gap", "record.sensors must be a list, got 'touch.gap'"),
    # Ranges, with their units.
    (("envs",), 0, "envs must be at least 1, got 0"),
    (("envs",), 2**31, "envs must be at most 2147483647, got 2147483648"),
    (("dt",), 0, "dt must be greater than 0, got 0 s"),
    (("duration",), -1.0, "duration must be greater than 0, got -1 s"),
    (("duration",), inf, "duration must be finite, got inf"),
    (("seed",), -1, "seed must be at least 0, got -1"),
    (("precision",), "float16", "precision must be one of 'float32', 'float64', got 'float16'"),
    (("gravity",), [0, 0, nan], "gravity must be finite, got nan"),
    (("body", 0, "mass"), -1, "body[0].mass must be greater than 0, got -1 kg"),
    (("body", 0, "mass"), 10**400, "body[0].mass must be finite, got 1000"),
    (("body", 0, "inertia"), [1, 1, 3], "body[0].inertia must be physical: no principal moment may exceed"),
    (("body", 0, "orientation"), [1, 1, 0, 0], "body[0].orientation must be a unit quaternion (x, y, z, w), got"),
    (("body", 0, "color"), [0, 2, 0], "body[0].color[1] must be at least 0 and at most 1, got 2"),
    (
        ("point", 1),
        {"name": "my eye", "position": [0, 0, 0]},
        "point[1].name must be letters, digits, _ and -, not starting with a digit",
    ),
    ((*LAW, "stiffness"), -5, "material[0].law.stiffness must be greater than 0, got -5 N/mⁿ"),
    ((*LAW, "exponent"), 9, "material[0].law.exponent must be at least 1 and at most 4, got 9"),
    ((*LAW, "damping"), 1, "material[0].law: HuntCrossley takes exactly one of restitution and damping, got"),
    (
        (*LAW, "type"),
        "HuntCrosley",
        f"material[0].law.type must be one of {NAMES}, got 'HuntCrosley'; did you mean 'HuntCrossley'?",
    ),
    ((*LAW, "type"), "huntcrossley", "got 'huntcrossley'; did you mean 'HuntCrossley'?"),
    ((*LAW, "type"), ["Hooke"], f"material[0].law.type must be one of {NAMES}, got"),
    (
        ("material", 0, "friction"),
        {"type": "Tanh", "mu": -1},
        "material[0].friction.mu must be at least 0, got -1",
    ),
    (
        ("material", 0, "friction"),
        {"type": "tahn"},
        f"material[0].friction.type must be one of {FRICTIONS}, got 'tahn'; did you mean 'Tanh'?",
    ),
    (("contact", 0, "radius"), -0.1, "contact[0].radius must be at least 0, got -0.1 m"),
    (("contact", 0, "kappa"), 1.5, "contact[0].kappa must be at least 0 and at most 1, got 1.5"),
    (("contact", 0, "max_depth"), inf, "contact[0].max_depth must be finite, got inf; leave the key out"),
    (("contact", 0, "search"), "all", "contact[0].search must be one of 'whole', 'active', got 'all'"),
    ((*GROUND, "mesh", "size"), [1, -1], "surface[0].mesh.size[1] must be a positive finite number, got -1.0"),
    ((*GROUND, "mesh", "shape"), "gird", "surface[0].mesh.shape must be one of grid, "),
    ((*GROUND, "mesh"), {"file": "no.stl"}, "surface[0].mesh.file: mesh file 'no.stl' does not exist"),
    ((*GROUND, "mesh"), {"file": "no.stl", "scale": 0}, "surface[0].mesh.scale must be greater than 0, got 0"),
    ((*GROUND, "active_faces"), [0, 7], "surface[0].active_faces must be face numbers from 0 to 1, got 7"),
    (("output", "usd_envs"), -1, "output.usd_envs must be at least 0, got -1"),
    (
        ("point", 0, "position"),
        [[0, 0, 0], [1, 0, 0]],
        "point[0].position must be 3 numbers [m], got [[0, 0, 0], [1, 0, 0]]; a list of positions belongs into",
    ),
    (
        ("point", 0),
        {"name": "centre", "body": "ball", "positions": [[0, 0, 0]]},
        "point[0].positions is not known; a list of positions belongs into [[points]], as positions",
    ),
    ((*GROUND, "mesh"), "ramp.stl", """got 'ramp.stl'; write mesh = { file = "ramp.stl" }"""),
    # References.
    ((*GROUND, "body"), "bal", "surface[0].body must be the name of a body, got 'bal'; did you mean 'ball'?"),
    (("point", 0, "body"), "x", "point[0].body must be the name of a body, got 'x'; there are: ball"),
    (
        ("contact", 0, "points"),
        "center",
        "contact[0].points must be the name of a point, got 'center'; did you mean",
    ),
    (("contact", 0, "surface"), "grund", "contact[0].surface must be the name of a surface, got 'grund'; did you"),
    (("contact", 0, "material"), "ruber", "contact[0].material must be the name of a material, got 'ruber'; did"),
    ((*GROUND, "body"), "ball", "contact[0]: points and surface are both fixed to body 'ball'; one must move"),
    (("point", 1), {"name": "ball", "position": [0, 0, 0]}, "point[1]: name 'ball' of a point is taken"),
    (("material", 1), VALID_STUDY["material"][0], "material[1]: name 'rubber' is already used"),
    (
        ("record", "sensors"),
        ["touch.gpa"],
        "record.sensors[0] must be the name of a sensor, got 'touch.gpa'; did",
    ),
    # Times.
    (
        ("record", "every"),
        0.0125,
        "record.every must be a multiple of dt = 0.001 s, got 0.0125 s; nearest: ",
    ),
    (("record", "every"), 0.2, "record.every must be at most the duration, 0.1 s, got 0.2 s"),
    # Variations.
    (
        ("variation", "ball.mas"),
        {"uniform": [1, 2]},
        'variation."ball.mas" is not the name of a parameter; did you',
    ),
    (VARIED, {}, 'variation."ball.mass" must have exactly one of uniform, loguniform, normal, lognormal, '),
    (VARIED, {"uniform": [1, 2], "values": [1]}, 'variation."ball.mass" must have exactly one of'),
    (VARIED, 3, 'variation."ball.mass" must be a table, got 3'),
    (VARIED, [1, 2, 3], 'variation."ball.mass" must be a table, got [1, 2, 3]; write { values = [...] }'),
    (
        ("variation", "ball"),
        {"mass": {"uniform": [1, 2]}},
        'variation.ball.mass must be one name in quotes: "ball.mass" = { … }',
    ),
    (
        ("variation", "touch"),
        {"law": {"stiffness": {"uniform": [1, 2]}}},
        'variation.touch.law must be one name in quotes: "touch.law.stiffness" = { … }',
    ),
    (
        ("variation", "touch.stiffness"),
        {"uniform": [1, 2]},
        "\"touch.stiffness\" is not the name of a parameter; did you mean 'touch.law.stiffness'?",
    ),
    (VARIED, {"uniform": [1]}, 'variation."ball.mass".uniform must be two numbers, or two lists of numbers of'),
    (VARIED, {"uniform": [2, 1]}, 'variation."ball.mass".uniform must be [low, high] with low ≤ high, got [2, 1]'),
    (VARIED, {"uniform": [-1, 2]}, 'variation."ball.mass".uniform[0] must be greater than 0, got -1 kg'),
    (VARIED, {"loguniform": [0, 2]}, 'variation."ball.mass".loguniform must be [low, high] with 0 < low ≤ high'),
    (VARIED, {"normal": [1, -1]}, 'variation."ball.mass".normal must be [mean, deviation] with deviation ≥ 0'),
    (VARIED, {"normal": [1, 99]}, 'variation."ball.mass"['),
    (VARIED, {"linspace": [1, inf]}, 'variation."ball.mass".linspace must be finite, got inf'),
    (
        VARIED,
        {"values": [1, 2]},
        'variation."ball.mass".values must have one value for each of 3 environments, got 2',
    ),
    (VARIED, {"values": [1, 2, -3]}, 'variation."ball.mass"[2] must be greater than 0, got -3 kg'),
    (
        VARIED,
        {"uniform": [[1, 1], [2, 2]]},
        'variation."ball.mass".uniform[0] must have shape () or (1,), got (2,)',
    ),
    (VARIED, {"solid_sphere": {"mass": 1, "radius": 1}}, 'variation."ball.mass".solid_sphere gives an inertia'),
    (
        ("variation", "ball.inertia"),
        {"solid_sphere": {"mass": "ball.mas", "radius": 1}},
        'variation."ball.inertia".solid_sphere.mass must be a number or the name of a parameter; did you mean',
    ),
    (
        ("variation", "ball.inertia"),
        {"solid_sphere": {"mass": "ball.position", "radius": 1}},
        "variation.\"ball.inertia\".solid_sphere.mass must be a parameter that is one number, got 'ball.position'",
    ),
    (
        ("variation", "touch.law.damping"),
        {"uniform": [1, 2]},
        'variation."touch.law.damping" is not the name of a parameter',
    ),
]


@pytest.mark.parametrize(("place", "value", "message"), BAD, ids=[message[:50] for _, _, message in BAD])
def test_experiment_error_names_the_key(place, value, message):
    problems = problems_of(invalid_study((place, value)))
    assert any(message in problem for problem in problems), problems
    # Exactly one problem: an error does not cause others.
    assert len(problems) == 1, problems


def test_unknown_names_are_reported_if_the_scene_can_be_built():
    """As documented in ``docs/experiments.md``."""
    unknown = [(("record", "sensors"), ["foo"]), (("variation", "xyz.mass"), {"uniform": [1, 2]})]
    variation, sensor = 'variation."xyz.mass" is not the name', "record.sensors[0] must be the name of a sensor"

    def problems_with(*changes):
        return [
            line[: len(start)]
            for line in problems_of(invalid_study(*unknown, *changes))
            for start in (variation, sensor)
        ]

    assert set(problems_with()) & {variation, sensor} == {variation, sensor}
    assert set(problems_with((("contact", 0, "surface"), "x"))) & {variation, sensor} == {variation, sensor}
    assert set(problems_with((("dt",), REMOVED))) & {variation, sensor} == {variation}
    assert set(problems_with((("body", 0, "mass"), -1))) & {variation, sensor} == set()
