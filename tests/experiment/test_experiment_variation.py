"""Variations between environments: reproducible random values, spaced, listed, or computed."""

import numpy as np
import pytest
from test_experiment import content

import warpcontact as wc

VARIED = {
    "ball.mass": {"uniform": [0.2, 2.0]},
    "touch.radius": {"loguniform": [0.01, 0.1]},
    "ball.linear_velocity": {"normal": [[0, 0, -1], [0.1, 0.1, 0]]},
}


def drawn(names=VARIED, *, envs=50, seed=0):
    raw = content(envs=envs, seed=seed, variation={name: VARIED[name] for name in names})
    model = wc.Experiment(raw).model(device="cpu")
    return {name: model[name] for name in VARIED}


def test_random_values_follow_their_distribution():
    values = drawn(envs=4000)
    mass, radius, velocity = (values[name] for name in VARIED)
    assert 0.2 <= mass.min() < 0.21
    assert 1.99 < mass.max() <= 2.0
    # With 4000 samples, the median of a unit interval has an uncertainty of 1/(2 √4000) = 0.008.
    assert np.median(mass) == pytest.approx(1.1, abs=4 * 0.008 * 1.8)
    assert np.log10(np.median(radius)) == pytest.approx(-1.5, abs=4 * 0.008)
    assert (velocity[:, 2] == -1.0).all()
    assert velocity[:, :2].std(axis=0) == pytest.approx(0.1, rel=4 / np.sqrt(8000))
    assert abs(np.corrcoef(mass, radius)[0, 1]) < 4 / np.sqrt(4000)


def test_random_values_depend_on_the_seed_only():
    for name, values in drawn().items():
        np.testing.assert_array_equal(values, drawn()[name])
        assert not np.array_equal(values, drawn(seed=1)[name])
        # Values depend neither on other variations nor on the number of environments.
        np.testing.assert_array_equal(values, drawn([name])[name])
        np.testing.assert_array_equal(values, drawn(envs=200)[name][:50])


def test_random_values_are_equal_in_every_version():
    # A file means the same run in all versions. These are values of version 0.1.0; normal values are of later
    # ones.
    values = drawn(envs=1)
    np.testing.assert_allclose(values["ball.mass"], [1.8575271503517654], rtol=1e-12)
    np.testing.assert_allclose(values["touch.radius"], [0.035928239002009234], rtol=1e-12)
    expected = [[0.2807168660214724, -0.04177655058165358, -1.0]]
    np.testing.assert_allclose(values["ball.linear_velocity"], expected, rtol=1e-12)


def test_listed_and_linspace_values_are_unchanged():
    raw = content(
        variation={
            "ball.mass": {"values": [1, 2, 3, 4]},
            "ball.position": {"linspace": [[0, 0, 1], [3, 0, 1]]},
        }
    )
    model = wc.Experiment(raw).model(device="cpu")
    assert model["ball.mass"].tolist() == [1, 2, 3, 4]
    assert model["ball.position"].tolist() == [[0, 0, 1], [1, 0, 1], [2, 0, 1], [3, 0, 1]]
    # Fewer environments are the first ones.
    assert wc.Experiment(raw).model(envs=2, device="cpu")["ball.mass"].tolist() == [1, 2]
    with pytest.raises(
        wc.ExperimentError, match=r'variation."ball.mass".values must have one value for each of 5'
    ):
        wc.Experiment(raw).model(envs=5, device="cpu")


def test_single_value_is_used_for_all_environments():
    raw = content(
        points=[{"name": "corners", "body": "ball", "positions": [[0, 0, 0.1], [0.1, 0, 0]]}],
        variation={
            "touch.law.stiffness": {"value": 2e4},
            "ball.position": {"value": [1, 0, 2]},
            "ball.inertia": {"value": [1, 2, 2]},
            "corners.position": {"value": [[0, 0, 1], [0, 0, 2]]},
            "ball.mass": {"value": 3},
        },
    )
    for envs in (1, 2, 3, 4):
        model = wc.Experiment(raw).model(envs=envs, device="cpu")
        assert model["touch.law.stiffness"].tolist() == [2e4] * envs
        assert model["ball.position"].tolist() == [[1, 0, 2]] * envs
        assert model["ball.inertia"].tolist() == [np.diag([1, 2, 2]).tolist()] * envs
        assert model["corners.position"].tolist() == [[[0, 0, 1], [0, 0, 2]]] * envs
        assert model["ball.mass"].tolist() == [3] * envs


@pytest.mark.parametrize("order", [("ball.inertia", "ball.mass"), ("ball.mass", "ball.inertia")])
def test_solid_sphere_inertia_follows_mass_and_radius(order):
    varied = {
        "ball.mass": {"uniform": [0.2, 2.0]},
        "ball.inertia": {"solid_sphere": {"mass": "ball.mass", "radius": "touch.radius"}},
    }
    model = wc.Experiment(content(variation={name: varied[name] for name in order})).model(device="cpu")
    expected = 0.4 * model["ball.mass"] * model["touch.radius"] ** 2
    np.testing.assert_allclose(model["ball.inertia"], expected[:, None, None] * np.eye(3))


def test_three_principal_moments_for_three_environments_are_not_a_tensor():
    moments = [[1, 1, 1], [1, 2, 2], [1, 1, 1.5]]
    model = wc.Experiment(content(envs=3, variation={"ball.inertia": {"values": moments}})).model(device="cpu")
    assert model["ball.inertia"].tolist() == [np.diag(row).tolist() for row in moments]
