"""Sensitivity of a simulated outcome: stopping distance of a sliding block, against its closed form."""

import numpy as np
import pytest
from example_files import load


@pytest.mark.slow
def test_stopping_distance_example_indices_match_closed_form(device, tmp_path, capsys):
    options = ["--envs", "2048", "--device", device, "--out", str(tmp_path / "out")]
    result = load("stopping_distance").main(options)
    assert "largest deviation of an index from its closed form" in capsys.readouterr().out
    # All have stopped, to the tolerance of the solver: 1e-5 of 4 m/s.
    assert result["speed"] < 4e-5
    # In two steps, the first contact and the stop, the error of the speed is at most μ g dt.
    assert result["distance"] < 2 * 0.6 * 9.81 * 1e-2**2
    # 512 rows of Sobol' points: below 1/√512 = 0.044.
    assert result["index"] < 0.044
    assert result["outside"] == 0


@pytest.mark.parametrize("ranges", [((1.0, 4.0), (0.2, 0.6)), ((2.0, 2.1), (0.1, 1.0))])
def test_closed_form_indices_match_their_definition(ranges):
    example = load("stopping_distance")
    first, total = example.closed_form(*ranges)
    # Quadrature over the parameter ranges; distances up to a factor.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    speed, mu = (low + (high - low) * (nodes + 1) / 2 for low, high in ranges)
    distance, w = np.multiply.outer(speed**2, 1 / mu), weights / 2
    mean = w @ distance @ w
    variance = w @ distance**2 @ w - mean**2
    of_speed, of_friction = distance @ w, w @ distance
    expected = np.array([w @ of_speed**2 - mean**2, w @ of_friction**2 - mean**2]) / variance
    np.testing.assert_allclose(first, expected, rtol=1e-9)
    np.testing.assert_allclose(total, 1 - expected[::-1], rtol=1e-9)
