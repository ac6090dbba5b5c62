"""Designs: rows of single environments, distributions, sampling methods, grids, correlations, value files."""

import pickle

import numpy as np
import pytest
from scipy import stats
from test_experiment import content

import warpcontact as wc
from warpcontact.experiment import sampling
from warpcontact.experiment.sampling import BLOCK, _sobol_engine

RANDOM = {
    "ball.mass": {"uniform": [0.2, 2.0]},
    "touch.radius": {"loguniform": [0.01, 0.1]},
    "ball.linear_velocity": {"normal": [[0, 0, -1], [0.1, 0.1, 0]]},
    "touch.law.stiffness": {"lognormal": [9.0, 0.5]},
    "touch.kappa": {"distribution": {"name": "beta", "a": 2, "b": 3}},
    "ball.position": {"distribution": {"name": "norm", "loc": [0, 0, 1], "scale": 0.01}},
    "ball.inertia": {"solid_sphere": {"mass": "ball.mass", "radius": "touch.radius"}},
}
ORDERED = {
    "ball.angular_velocity": {"linspace": [[0, 0, 0], [3, 0, 1]]},
    "scene.gravity": {"value": [0, 0, -1.6]},
    "touch.force_scale": {"grid": [0.1, 0.2, 0.3]},
    "touch.max_depth": {"grid": [0.01, 0.02], "group": "depth"},
    "ball.external_force": {"grid": [[0, 0, 0], [0, 0, 1]], "group": "depth"},
    "ball.external_torque": {"values": np.arange(3.0 * 2500).reshape(2500, 3).tolist()},
}
ALL = RANDOM | ORDERED
TOGETHER = [
    {"names": ["ball.mass", "touch.radius", "touch.kappa"], "matrix": [[1, 0.6, 0], [0.6, 1, -0.3], [0, -0.3, 1]]}
]


def design(variation, envs, method="random", **changes):
    raw = content(envs=envs, variation=variation, sampling={"method": method}, **changes)
    return wc.Experiment.from_dict(raw).design


def values_of(variation, envs, method="random", **changes):
    return design(variation, envs, method, **changes).rows(0, envs)


MIXTURES = [
    ("random", ALL, 2500, []),
    ("random", ALL, 2500, TOGETHER),
    ("latin_hypercube", ALL, 2500, TOGETHER),
    ("sobol", ALL, 2500, TOGETHER),
    ("saltelli", RANDOM, 11 * 256, []),  # a matrix is a part of a block
    ("saltelli", RANDOM, 11 * 2048, []),  # a block is a part of a matrix
]


@pytest.mark.parametrize(("method", "variation", "envs", "correlation"), MIXTURES)
def test_design_rows_are_bitwise_identical_to_rows_of_whole_design(method, variation, envs, correlation):
    whole = design(variation, envs, method, correlation=correlation)
    rows = whole.rows(0, envs)
    assert list(rows) == list(variation)
    cuts = [(0, 1), (0, 7), (7, 14), (BLOCK - 1, BLOCK + 1), (BLOCK, 2 * BLOCK), (envs - 64, envs), (5, 5)]
    for first, stop in [*cuts, (envs, envs), (1, envs - 1)]:
        part = whole.rows(first, stop)
        for name, values in rows.items():
            assert part[name].dtype == np.float64
            assert part[name].shape == (stop - first, *values.shape[1:])
            assert part[name].tobytes() == values[first:stop].tobytes(), name


@pytest.mark.parametrize(("method", "variation", "envs", "correlation"), MIXTURES[1:5])
def test_design_can_be_pickled(method, variation, envs, correlation):
    whole = design(variation, envs, method, correlation=correlation)
    sent = pickle.loads(pickle.dumps(whole))
    for name, values in whole.rows(0, 40).items():
        assert sent.rows(0, 40)[name].tobytes() == values.tobytes()


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_design_values_do_not_depend_on_number_of_environments(method):
    variation = RANDOM | {"touch.force_scale": {"grid": [0.1, 0.2, 0.3]}}
    few, many = (values_of(variation, envs, method, correlation=TOGETHER) for envs in (10, 3000))
    for name, values in few.items():
        assert values.tobytes() == many[name][:10].tobytes(), name


def test_design_rows_out_of_range_raise():
    some = design(RANDOM, 10)
    for first, stop in ((0, 11), (-1, 3), (4, 3)):
        with pytest.raises(IndexError, match=rf"from 0 to 10, got {first} to {stop}"):
            some.rows(first, stop)


@pytest.mark.parametrize("method", ["random", "latin_hypercube", "sobol"])
def test_plan_of_very_large_design_draws_no_samples(method, monkeypatch):
    variation = {
        name: RANDOM[name] for name in ("ball.mass", "touch.radius", "ball.linear_velocity", "touch.kappa")
    }
    experiment = wc.Experiment.from_dict(content(variation=variation, sampling={"method": method}))

    def blocks(*_):
        raise AssertionError("values are drawn")

    for sampler in (sampling.Random, sampling.LatinHypercube, sampling.Sobol):
        monkeypatch.setattr(sampler, "blocks", blocks)
    # Sampled in float64: a mass, a radius, three components of a velocity, and kappa.
    assert experiment.design.row_bytes == 6 * 8
    plan = experiment.plan(envs=2**31 - 1, device="cpu")
    assert plan.envs == 2**31 - 1
    with pytest.raises(wc.ExperimentError, match="envs must be at most 2147483647, got 2147483648"):
        experiment.plan(envs=2**31, device="cpu")


def test_unbounded_distributions_are_checked_by_drawing_all_values():
    """The range of a normal mass, or of correlated normal values, cannot be checked at its ends."""
    with pytest.raises(wc.ExperimentError, match=r'variation."ball.mass".*\[\d+'):
        design({"ball.mass": {"normal": [1.0, 0.5]}}, 1000)
    # Each factor is within the range of one normal value; the product exceeds it.
    lowest = 1.0 / 8.0
    variation = {"ball.mass": {"normal": [1.0, lowest]}, "touch.force_scale": {"normal": [0.5, 0.01]}}
    together = [{"names": ["ball.mass", "touch.force_scale"], "matrix": [[1, 0.5], [0.5, 1]]}]
    assert design(variation, 100, correlation=together).value_range("ball.mass") is None
    assert design(variation, 100).value_range("ball.mass") is not None


def test_grid_with_too_many_combinations_is_refused():
    names = ["ball.mass", "touch.radius", "touch.kappa", "touch.force_scale"]
    raw = content(variation={name: {"grid": np.linspace(0.1, 0.9, 216).tolist()} for name in names})
    raw.pop("envs")
    message = f"variation: grid must have at most 2147483647 combinations, got {216**4}"
    with pytest.raises(wc.ExperimentError, match=message):
        wc.Experiment.from_dict(raw)


def test_additional_parameter_does_not_change_random_values_of_others():
    together = values_of(RANDOM, 20)
    for name in set(RANDOM) - {"ball.inertia"}:
        np.testing.assert_array_equal(values_of({name: RANDOM[name]}, 20)[name], together[name])


def test_varied_values_of_a_set_have_unambiguous_environment_axis():
    """For any number of environments, also if it equals the number of points."""
    points = [{"name": "corners", "body": "ball", "positions": np.eye(3).tolist()}]
    contact = [content()["contact"][0] | {"points": "corners"}]
    varied = {
        "touch.radius": {"uniform": [0.01, 0.1]},
        "corners.position": {"values": np.arange(27.0).reshape(3, 3, 3).tolist()},
        "touch.force_scale": {"values": [[1, 2, 3], [4, 5, 6], [7, 8, 9]]},
    }
    raw = content(envs=3, point=[], points=points, contact=contact, variation=varied)
    experiment = wc.Experiment.from_dict(raw)
    rows = experiment.design.rows(0, 3)
    assert {name: values.shape for name, values in rows.items()} == {
        "touch.radius": (3, 1),
        "corners.position": (3, 3, 3),
        "touch.force_scale": (3, 3),
    }
    model = experiment.model(device="cpu")
    assert (model["touch.radius"] == rows["touch.radius"]).all()
    assert model["touch.force_scale"].tolist() == varied["touch.force_scale"]["values"]


# --- distributions


@pytest.mark.parametrize("method", ["random", "latin_hypercube", "sobol"])
def test_sampled_values_follow_their_distribution(method):
    rows = values_of(RANDOM, 4096, method)
    expected = {
        "ball.mass": stats.uniform(0.2, 1.8),
        "touch.radius": stats.loguniform(0.01, 0.1),
        "touch.law.stiffness": stats.lognorm(s=0.5, scale=np.exp(9.0)),
        "touch.kappa": stats.beta(2, 3),
    }
    columns = [(rows[name], law) for name, law in expected.items()]
    columns += [(rows["ball.linear_velocity"][:, i], stats.norm(0, 0.1)) for i in (0, 1)]
    columns += [(rows["ball.position"][:, i], stats.norm(mean, 0.01)) for i, mean in enumerate((0, 0, 1))]
    for values, law in columns:
        # Kolmogorov's statistic of 4096 random values exceeds 2.2/√4096 once in 10 000 cases. That of evenly
        # spaced points is 1/4096, or a few of them.
        distance = stats.kstest(values, law.cdf).statistic
        assert distance < (2.2 / 64 if method == "random" else 5 / 4096)
    assert (rows["ball.linear_velocity"][:, 2] == -1.0).all()


@pytest.mark.parametrize(
    "law",
    [
        {"name": "weibull_min", "c": 1.5, "scale": 2.0},
        {"name": "truncnorm", "a": -1, "b": 2, "loc": 3, "scale": 0.5},
        {"name": "gamma", "a": 3.0, "loc": 0.1},
        {"name": "triang", "c": 0.3, "loc": 1},
        {"name": "lognorm", "s": 0.4},
    ],
    ids=lambda law: law["name"],
)
def test_scipy_distributions_are_sampled_by_quantiles(law):
    mass = values_of({"ball.mass": {"distribution": law}}, 50)["ball.mass"]
    units = values_of({"ball.mass": {"uniform": [1, 2]}}, 50)["ball.mass"] - 1.0
    parameters = {key: value for key, value in law.items() if key != "name"}
    # 1 + u loses the last bits of u: an error of 1e-16, over the density times the value.
    np.testing.assert_allclose(mass, getattr(stats, law["name"]).ppf(units, **parameters), rtol=1e-12)


def test_discrete_distribution_selects_meshes():
    meshes = [{"shape": "grid", "size": [2, 2]}, {"shape": "grid"}, {"shape": "box"}]
    surface = [{"name": "ground", "mesh": meshes}]
    law = {"name": "binom", "n": 2, "p": 0.25}
    chosen = values_of({"ground.mesh": {"distribution": law}}, 4000, surface=surface)["ground.mesh"]
    counts = np.bincount(chosen.astype(int), minlength=3)
    # Four standard deviations of a count of 4000.
    np.testing.assert_allclose(counts, 4000 * stats.binom(2, 0.25).pmf(range(3)), atol=4 * np.sqrt(4000) / 2)


def test_quantiles_at_zero_and_one_are_finite():
    from warpcontact.experiment.distributions import LARGEST, SMALLEST, clip_to_open_interval, make_marginal

    ends = clip_to_open_interval(np.array([0.0, 1.0]))
    assert ends.tolist() == [SMALLEST, LARGEST]
    for kind, given in (
        ("normal", (0.0, 1.0)),
        ("lognormal", (0.0, 1.0)),
        ("distribution", {"name": "norm"}),
        ("distribution", {"name": "weibull_min", "c": 1.5}),
    ):
        values = make_marginal(kind, given, False).from_uniform(ends)
        assert np.isfinite(values).all()
        assert values[0] < values[1]
    assert make_marginal("uniform", (0, 2), True).from_uniform(ends).tolist() == [0, 2]


# --- designs


def test_latin_hypercube_has_one_value_in_each_interval():
    envs = 100
    varied = {"ball.mass": {"uniform": [1, 2]}, "ball.linear_velocity": {"uniform": [[0] * 3, [1] * 3]}}
    rows = values_of(varied, envs, "latin_hypercube")
    for values in (rows["ball.mass"] - 1.0, *rows["ball.linear_velocity"].T):
        assert sorted(np.floor(values * envs)) == list(range(envs))
    again = values_of(varied, envs, "latin_hypercube", seed=1)
    assert not np.array_equal(rows["ball.mass"], again["ball.mass"])


def test_sobol_points_match_scipy():
    varied = {"ball.mass": {"uniform": [1, 2]}, "ball.linear_velocity": {"uniform": [[0] * 3, [1] * 3]}}
    rows = values_of(varied, 2048, "sobol", seed=3)
    points = _sobol_engine(3, 4).random(2048) + 0.5**33  # centers of intervals of 32 bits
    np.testing.assert_array_equal(rows["ball.mass"], 1.0 + points[:, 0])
    np.testing.assert_array_equal(rows["ball.linear_velocity"], points[:, 1:])
    # A net: each of 2048 boxes of equal volume contains one point, in every plane of two columns.
    for i, j in ((0, 1), (2, 3)):
        boxes = np.floor(points[:, i] * 32) * 64 + np.floor(points[:, j] * 64)
        counts = np.bincount(boxes.astype(int), minlength=2048)
        assert counts.max() <= 4  # with random points some boxes contain 6 and more
    halves = np.floor(points * 2048)
    assert all(sorted(column) == list(range(2048)) for column in halves.T)


@pytest.mark.parametrize(("envs", "messages"), [(6, ["nearest: 4 and 8"]), (8, [])])
def test_sobol_with_number_not_a_power_of_two_warns(envs, messages, tmp_path):
    raw = content(
        envs=envs,
        variation={"ball.mass": {"uniform": [1, 2]}},
        sampling={"method": "sobol"},
        output={"usd_envs": 0},
        record={"series": False},
    )
    warnings_heard = []
    run = wc.Experiment.from_dict(raw).run(tmp_path / "run", device="cpu", on_warning=warnings_heard.append)
    assert [text.rpartition("; ")[2] for text in warnings_heard] == messages
    assert run.summary["warnings"] == warnings_heard


def test_saltelli_rows_are_a_b_and_a_with_columns_of_b():
    n, d = 8, 4
    varied = {"ball.mass": {"uniform": [1, 2]}, "ball.linear_velocity": {"uniform": [[0] * 3, [1] * 3]}}
    rows = values_of(varied, n * (d + 2), "saltelli")
    units = np.column_stack([rows["ball.mass"], rows["ball.linear_velocity"]]).reshape(d + 2, n, d)
    a, b = units[0], units[1]
    assert not np.isin(a, b).any()
    for j in range(d):
        expected = a.copy()
        expected[:, j] = b[:, j]
        np.testing.assert_array_equal(units[2 + j], expected)


@pytest.mark.parametrize("method", ["random", "latin_hypercube", "sobol", "saltelli"])
def test_constant_components_use_no_column_of_the_design(method):
    speed = {"uniform": [[0, -2, 1], [0, -1, 1]]}
    varied = {
        "ball.linear_velocity": speed,
        "ball.mass": {"uniform": [1, 2]},
        "touch.radius": {"normal": [0.1, 0]},
    }
    rows = values_of(varied, 64, method)  # with Saltelli's design 16 (2 + 2)
    velocity = rows["ball.linear_velocity"]
    assert (velocity[:, [0, 2]] == [0, 1]).all()
    assert (rows["touch.radius"] == 0.1).all()
    if method != "random":
        units = next(design(varied, 64, method).sampler.blocks(0))
        assert units.shape == (BLOCK, 2)
        np.testing.assert_array_equal(velocity[:, 1], -2.0 + units[:64, 0])
        np.testing.assert_array_equal(rows["ball.mass"], 1.0 + units[:64, 1])


def test_grid_has_all_combinations_with_the_first_varying_slowest():
    varied = {
        "ball.mass": {"grid": [1, 2]},
        "ball.linear_velocity": {"grid": [[0, 0, 0], [1, 0, 0], [2, 0, 0]], "group": "speed"},
        "touch.radius": {"uniform": [0.01, 0.02]},
        "touch.force_scale": {"grid": [0.1, 0.2]},
        "touch.kappa": {"grid": [0.0, 0.5, 1.0], "group": "speed"},
    }
    raw = content(variation=varied)
    del raw["envs"]
    experiment = wc.Experiment.from_dict(raw)
    assert experiment.settings.envs == 12
    rows = experiment.design.rows(0, 12)
    assert rows["ball.mass"].tolist() == [1] * 6 + [2] * 6
    assert rows["ball.linear_velocity"][:, 0].tolist() == [0, 0, 1, 1, 2, 2] * 2
    assert rows["touch.kappa"].tolist() == [0, 0, 0.5, 0.5, 1, 1] * 2
    assert rows["touch.force_scale"].tolist() == [0.1, 0.2] * 6
    assert len(np.unique(rows["touch.radius"])) == 12
    # For other numbers of environments it is truncated or repeated.
    more = experiment.changed(envs=20).design.rows(0, 20)
    assert more["ball.mass"].tolist() == [*rows["ball.mass"], *rows["ball.mass"][:8]]
    assert experiment.model(envs=5, device="cpu")["ball.mass"].tolist() == [1] * 5


# --- correlations


def test_correlated_normals_have_prescribed_correlation():
    varied = {
        "ball.mass": {"normal": [10, 1]},
        "touch.radius": {"lognormal": [-3, 0.1]},
        "touch.kappa": {"uniform": [0, 1]},
        "touch.force_scale": {"distribution": {"name": "expon"}},
    }
    matrix = [[1, 0.8, 0.5, 0.0], [0.8, 1, 0.3, 0.1], [0.5, 0.3, 1, -0.4], [0.0, 0.1, -0.4, 1]]
    correlation = [{"names": list(varied), "matrix": matrix}]
    envs = 2**14
    rows = values_of(varied, envs, correlation=correlation)
    mass, size, even, share = (rows[name] for name in varied)
    normals = [
        (mass - 10) / 1,
        (np.log(size) + 3) / 0.1,
        stats.norm.ppf(even),
        stats.norm.ppf(stats.expon.cdf(share)),
    ]
    # The error of a correlation r of n samples is (1 − r²)/√n, at most 1/128.
    np.testing.assert_allclose(np.corrcoef(normals), matrix, atol=4 / 128)
    for values in normals:
        assert stats.kstest(values, "norm").statistic < 2.2 / 128
    # For uniform marginals the correlation is (6/π) asin(r/2).
    both = np.corrcoef(even, stats.expon.cdf(share))[0, 1]
    assert both == pytest.approx(6 / np.pi * np.arcsin(-0.4 / 2), abs=4 / 128)
    # The first one is sampled as without correlation.
    alone = values_of({"ball.mass": varied["ball.mass"]}, envs)["ball.mass"]
    np.testing.assert_array_equal(mass, alone)


# --- files


def test_parameter_values_are_read_from_files(tmp_path):
    np.save(tmp_path / "velocities.npy", np.arange(15.0).reshape(5, 3))
    (tmp_path / "masses.csv").write_text("# kg\n1\n2\n3\n4\n5\n")
    varied = {"ball.mass": {"values": "masses.csv"}, "ball.linear_velocity": {"values": "velocities.npy"}}
    experiment = wc.Experiment.from_dict(content(envs=4, variation=varied), tmp_path)
    model = experiment.model(device="cpu")
    # Rows beyond the number of environments are ignored.
    assert model["ball.mass"].tolist() == [1, 2, 3, 4]
    assert model["ball.linear_velocity"].tolist() == np.arange(12.0).reshape(4, 3).tolist()
    assert experiment.model(envs=2, device="cpu")["ball.mass"].tolist() == [1, 2]


def test_written_experiment_draws_the_same_values(device, tmp_path):
    (tmp_path / "masses.csv").write_text("1\n2\n3\n4\n5\n")
    varied = {
        "ball.mass": {"values": "masses.csv"},
        "touch.kappa": {"distribution": {"name": "beta", "a": 2, "b": 3}},
        "touch.force_scale": {"lognormal": [0, 0.1]},
        "touch.radius": {"grid": [0.1, 0.11], "group": "size"},
    }
    correlation = [{"names": ["touch.force_scale", "touch.kappa"], "matrix": [[1, -0.5], [-0.5, 1]]}]
    raw = content(variation=varied, correlation=correlation, sampling={"method": "sobol"})
    first = wc.Experiment.from_dict(raw, tmp_path)
    run = first.run(tmp_path / "results" / "first", device=device)
    again = wc.Experiment.from_toml(run.files["experiment"])
    assert again.settings.sampling.method == "sobol"
    for name, values in first.design.rows(0, 4).items():
        np.testing.assert_array_equal(again.design.rows(0, 4)[name], values)


@pytest.mark.parametrize("method", ["latin_hypercube", "sobol"])
def test_constant_parameters_are_allowed_with_correlation(method):
    variation = {
        "ball.position": {"uniform": [[0, 0, 1], [0, 0, 1]]},  # which uses no column
        "ball.mass": {"lognormal": [0.0, 0.2]},
        "touch.law.stiffness": {"lognormal": [9.0, 0.1]},
    }
    names = ["ball.mass", "touch.law.stiffness"]
    rows = design(variation, 4096, method, correlation=[{"names": names, "matrix": [[1, 0.8], [0.8, 1]]}]).rows(
        0, 4096
    )
    assert (rows["ball.position"] == [0, 0, 1]).all()
    found = np.corrcoef(np.log(rows["ball.mass"]), np.log(rows["touch.law.stiffness"]))[0, 1]
    assert found == pytest.approx(0.8, abs=0.03)  # for 4096 pairs, more than five standard deviations
