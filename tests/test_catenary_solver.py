"""The equations of an elastic line are solved for every line, and from every start."""

import numpy as np
import pytest
from lines import free, grounded, random_lines, with_units

COUNT = 100_000


@pytest.fixture(scope="module")
def random():
    lines = random_lines(COUNT)
    return lines, free(lines)


def _allowed(lines):
    return 1e-10 * np.maximum(1.0, np.hypot(lines[:, 0], lines[:, 1]))


def test_every_line_is_solved_in_few_iterations(random):
    lines, (_, off, used, met) = random
    assert met.all()
    assert (off <= _allowed(lines)).all()
    assert used.max() <= 20
    assert used.mean() < 3.0


def test_the_span_is_that_of_the_tension_integrated_along_the_line(random):
    lines, (found, *_) = random
    # Lines whose tension does not vanish near a point, where the quadrature would not see it.
    smooth = (found[:, 0] > 0.1) & (lines[:, 2] > 0.1)
    assert smooth.sum() > COUNT // 10
    (x, y, weight, give), (h, v) = lines[smooth].T, found[smooth].T
    places, parts = np.polynomial.legendre.leggauss(60)
    s, ds = 0.5 * (places + 1.0), 0.5 * parts
    vertical = v[:, None] + weight[:, None] * s
    stretch = 1.0 / np.hypot(h[:, None], vertical) + give[:, None]
    # The poles of 1/|t| are a tenth of a line off it: 60 points integrate it to 1e-10.
    np.testing.assert_allclose((h[:, None] * stretch) @ ds, x, atol=1e-8)
    np.testing.assert_allclose((vertical * stretch) @ ds, y, atol=1e-8)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_wrong_start_never_leads_to_failure_or_another_answer(random, seed):
    lines, (cold, *_) = random
    rng = np.random.default_rng(seed)
    h = 10.0 ** rng.uniform(-9, 5, COUNT)
    v = rng.normal(size=COUNT) * 10.0 ** rng.uniform(-9, 5, COUNT)
    found, off, used, met = free(lines, np.stack([h, v], axis=1))
    assert met.all()
    assert (off <= _allowed(lines)).all()
    assert used.max() <= 20
    # Where the span tells the force: strains are above 1e-6, so that a residual of 1e-10 is 1e-4 of them at most.
    firm = np.abs(np.hypot(lines[:, 0], lines[:, 1]) - 1.0) > 1e-3
    np.testing.assert_allclose(found[firm], cold[firm], rtol=1e-5, atol=1e-9)


def test_a_start_that_is_not_a_number_is_given_up():
    lines = random_lines(10)
    warm = np.full((10, 2), np.nan)
    warm[5:] = np.inf
    found, _, _, met = free(lines, warm)
    assert met.all()
    np.testing.assert_array_equal(found, free(lines)[0])


def test_from_the_answer_nothing_is_left_to_do(random):
    lines, (cold, *_) = random
    found, _, used, met = free(lines, cold)
    upright = cold[:, 0] == 0.0
    assert met.all()
    assert (used[~upright] == 1).all()
    assert np.abs(found - cold).max() <= 1e-6 * np.abs(cold).max()


def test_an_upright_line_is_the_limit_of_one_that_is_nearly_so():
    heights = np.array([0.0, 0.3, 0.9, 0.9999, 1.0, 1.0001, 1.2, 1.5])
    for stiffness_over_weight in (2.0, 50.0, 1e5):
        upright = with_units(np.zeros_like(heights), heights, stiffness_over_weight)
        nearly = upright.copy()
        nearly[:, 0] = 1e-13
        there, _, used, _ = free(upright)
        beside, _, _, met = free(nearly)
        assert (used == 0).all()
        assert met.all()
        # Its ends differ by 1e-13, and forces by no more than its own stiffness times that.
        np.testing.assert_allclose(beside[:, 1], there[:, 1], rtol=1e-7, atol=1e-9)
        assert (beside[:, 0] < 1e-8).all()


def test_a_line_without_weight_is_a_straight_spring_or_slack():
    lines = np.array(
        [[0.6, 0.8 * 1.1, 0.0, 1.0], [1.0, 0.5, 0.0, 1.0], [0.3, 0.2, 0.0, 1.0], [0.0, 1.3, 0.0, 1.0]]
    )
    found, _, _, met = free(lines)
    chord = np.hypot(lines[:, 0], lines[:, 1])
    tension = np.maximum(chord - 1.0, 0.0)
    assert met.all()
    np.testing.assert_allclose(found, tension[:, None] * lines[:, :2] / chord[:, None], atol=1e-14)


def _rising(h, height, weight, give):
    """Reach, own length and vertical force of a part that hangs from a height to the floor, by its catenary."""
    more = np.maximum(weight * height, 0.0)
    tension = h + 2 * more / (1 + give * h + np.sqrt((1 + give * h) ** 2 + 2 * give * more))
    v = np.sqrt(tension**2 - h**2)
    return (h * np.arcsinh(v / h) + give * h * v) / weight, v / weight, v


def test_a_line_on_a_floor_reaches_as_far_as_its_parts():
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
    starts.append(grounded(lines, heights)[0][:, 0])
    for warm in starts:
        found, used, met = grounded(lines, heights, warm)
        assert met.all()
        assert used.max() <= 20
        # A residual of 1e-10 of a span that grows by a millionth at least of what h grows by.
        np.testing.assert_allclose(found[:, 0], h[lies], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found[:, 1:], np.stack([v_1, v_2], axis=1)[lies], rtol=1e-5, atol=1e-5)


def test_a_line_that_just_touches_a_floor_is_held_as_without_it():
    """At the moment that the lowest point comes down, both equations have one solution."""
    lines = random_lines(20_000, seed=3)
    found, *_ = free(lines)
    weight, give = lines[:, 2], lines[:, 3]
    h, v = found.T
    sags = (v < -0.02 * weight) & (v + weight > 0) & (h > 1e-6)
    assert sags.sum() > 1000
    h, v, weight, give = h[sags], v[sags], weight[sags], give[sags]
    depth = v**2 / weight * (1.0 / (np.hypot(h, v) + h) + 0.5 * give)
    held, _, met = grounded(lines[sags], np.stack([depth, depth + lines[sags, 1]], axis=1))
    assert met.all()
    np.testing.assert_allclose(held, np.stack([h, -v, v + weight], axis=1), rtol=1e-5, atol=1e-6)
