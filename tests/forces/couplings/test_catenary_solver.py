"""The equations of an elastic catenary are solved for every cable and from every initial guess."""

import numpy as np
import pytest
from catenary_cases import in_elastic_units, random_lines, solve_suspended, solve_with_seabed

COUNT = 100_000


@pytest.fixture(scope="module")
def random():
    lines = random_lines(COUNT)
    return lines, solve_suspended(lines)


def _allowed(lines):
    return 1e-10 * np.maximum(1.0, np.hypot(lines[:, 0], lines[:, 1]))


def test_catenary_solver_converges_in_few_iterations(random):
    lines, (_, off, used, converged) = random
    assert converged.all()
    assert (off <= _allowed(lines)).all()
    assert used.max() <= 20
    assert used.mean() < 3.0


def test_catenary_span_matches_integrated_tension(random):
    lines, (found, *_) = random
    # Cables whose tension does not vanish near a point; there the quadrature would be inaccurate.
    smooth = (found[:, 0] > 0.1) & (lines[:, 2] > 0.1)
    assert smooth.sum() > COUNT // 10
    (x, y, weight, give), (h, v) = lines[smooth].T, found[smooth].T
    places, parts = np.polynomial.legendre.leggauss(60)
    s, ds = 0.5 * (places + 1.0), 0.5 * parts
    vertical = v[:, None] + weight[:, None] * s
    stretch = 1.0 / np.hypot(h[:, None], vertical) + give[:, None]
    # The poles of 1/|t| are a tenth of the length away from the cable: 60 points integrate it to 1e-10.
    np.testing.assert_allclose((h[:, None] * stretch) @ ds, x, atol=1e-8)
    np.testing.assert_allclose((vertical * stretch) @ ds, y, atol=1e-8)


@pytest.mark.parametrize("seed", [0, 1])
def test_catenary_solver_converges_to_same_solution_from_any_warm_start(random, seed):
    lines, (cold, *_) = random
    rng = np.random.default_rng(seed)
    h = 10.0 ** rng.uniform(-9, 5, COUNT)
    v = rng.normal(size=COUNT) * 10.0 ** rng.uniform(-9, 5, COUNT)
    found, off, used, converged = solve_suspended(lines, np.stack([h, v], axis=1))
    assert converged.all()
    assert (off <= _allowed(lines)).all()
    assert used.max() <= 20
    # Cables whose span determines the force: strains are above 1e-6, so a residual of 1e-10 is at most 1e-4 of
    # them.
    firm = np.abs(np.hypot(lines[:, 0], lines[:, 1]) - 1.0) > 1e-3
    np.testing.assert_allclose(found[firm], cold[firm], rtol=1e-5, atol=1e-9)


def test_catenary_solver_ignores_non_finite_warm_start():
    lines = random_lines(10)
    warm = np.full((10, 2), np.nan)
    warm[5:] = np.inf
    found, _, _, converged = solve_suspended(lines, warm)
    assert converged.all()
    np.testing.assert_array_equal(found, solve_suspended(lines)[0])


def test_catenary_solver_needs_one_iteration_from_the_solution(random):
    lines, (cold, *_) = random
    found, _, used, converged = solve_suspended(lines, cold)
    upright = cold[:, 0] == 0.0
    assert converged.all()
    assert (used[~upright] == 1).all()
    assert np.abs(found - cold).max() <= 1e-6 * np.abs(cold).max()


def test_vertical_catenary_is_the_limit_of_nearly_vertical_ones():
    heights = np.array([0.0, 0.3, 0.9, 0.9999, 1.0, 1.0001, 1.2, 1.5])
    for stiffness_over_weight in (2.0, 50.0, 1e5):
        upright = in_elastic_units(np.zeros_like(heights), heights, stiffness_over_weight)
        nearly = upright.copy()
        nearly[:, 0] = 1e-13
        there, _, used, _ = solve_suspended(upright)
        beside, _, _, converged = solve_suspended(nearly)
        assert (used == 0).all()
        assert converged.all()
        # The ends differ by 1e-13, and the forces by at most the stiffness times that.
        np.testing.assert_allclose(beside[:, 1], there[:, 1], rtol=1e-7, atol=1e-9)
        assert (beside[:, 0] < 1e-8).all()


def test_weightless_catenary_is_a_linear_spring_or_slack():
    lines = np.array(
        [[0.6, 0.8 * 1.1, 0.0, 1.0], [1.0, 0.5, 0.0, 1.0], [0.3, 0.2, 0.0, 1.0], [0.0, 1.3, 0.0, 1.0]]
    )
    found, _, _, converged = solve_suspended(lines)
    chord = np.hypot(lines[:, 0], lines[:, 1])
    tension = np.maximum(chord - 1.0, 0.0)
    assert converged.all()
    np.testing.assert_allclose(found, tension[:, None] * lines[:, :2] / chord[:, None], atol=1e-14)


def _rising(h, height, weight, give):
    """Horizontal span, unstretched length and vertical force of the suspended part, from its catenary."""
    more = np.maximum(weight * height, 0.0)
    tension = h + 2 * more / (1 + give * h + np.sqrt((1 + give * h) ** 2 + 2 * give * more))
    v = np.sqrt(tension**2 - h**2)
    return (h * np.arcsinh(v / h) + give * h * v) / weight, v / weight, v


def test_grounded_catenary_span_is_the_sum_of_its_parts():
    rng = np.random.default_rng(0)
    count = 20_000
    high = rng.uniform(0.05, 0.9, count)
    low = np.where(rng.random(count) < 0.3, 0.0, high * rng.random(count))
    give = 10.0 ** rng.uniform(-6, -0.5, count)
    h = 10.0 ** rng.uniform(-4, 1, count)
    reach_1, own_1, v_1 = _rising(h, low, 1.0, give)
    reach_2, own_2, v_2 = _rising(h, high, 1.0, give)
    rest = 1.0 - own_1 - own_2
    lies = rest > 0.0
    assert lies.sum() > 2000
    x = reach_1 + reach_2 + rest * (1.0 + give * h)
    lines = np.stack([x, high - low, np.ones(count), give], axis=1)[lies]
    heights = np.stack([low, high], axis=1)[lies]
    starts = [None, h[lies], h[lies] * 10.0 ** rng.uniform(-5, 5, lies.sum())]
    starts.append(solve_with_seabed(lines, heights)[0][:, 0])
    for warm in starts:
        found, used, converged = solve_with_seabed(lines, heights, warm)
        assert converged.all()
        assert used.max() <= 20
        # A residual of 1e-10 in a span that changes by at least 1e-6 of the change of h.
        np.testing.assert_allclose(found[:, 0], h[lies], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found[:, 1:], np.stack([v_1, v_2], axis=1)[lies], rtol=1e-5, atol=1e-5)


def test_grounded_catenary_matches_suspended_one_at_touchdown():
    """When the lowest point touches the seabed, the equations of the suspended and the grounded cable agree."""
    lines = random_lines(20_000, seed=3)
    found, *_ = solve_suspended(lines)
    weight, give = lines[:, 2], lines[:, 3]
    h, v = found.T
    sags = (v < -0.02 * weight) & (v + weight > 0) & (h > 1e-6)
    assert sags.sum() > 1000
    h, v, weight, give = h[sags], v[sags], weight[sags], give[sags]
    depth = v**2 / weight * (1.0 / (np.hypot(h, v) + h) + 0.5 * give)
    held, _, converged = solve_with_seabed(lines[sags], np.stack([depth, depth + lines[sags, 1]], axis=1))
    assert converged.all()
    np.testing.assert_allclose(held, np.stack([h, -v, v + weight], axis=1), rtol=1e-5, atol=1e-6)
