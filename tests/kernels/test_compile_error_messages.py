"""Common errors in a custom law or friction model: the message names the line and the correction."""

import math
from typing import Any

import numpy as np
import pytest
import warp as wp
from scenes import dropped_sphere

import warpcontact as wc
from warpcontact.validation.custom_law_errors import advice


class Linear(wc.Law):
    stiffness: float = wc.parameter("N/m", "stiffness k", default=1e4, above=0.0)


class Power(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta**3


class PowerOfWarp(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * wp.pow(c.delta + c.delta, 2)


class FloatPower(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta**1.5


class Doubled(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return 2 * c.delta


class Halved(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return c.delta / 2


class Positive(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return max(0, p.stiffness * c.delta)


class Choice(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return c.delta if c.delta_dot > c.delta else 0


class Returns(Linear):
    @wp.func
    def force(p: Any, c: Any):
        if c.delta_dot > c.delta:
            return 0
        return p.stiffness * c.delta


class Bare(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return stiffness * c.delta  # noqa: F821


class Depth(Linear):
    @wp.func
    def force(par: Any, contact: Any):
        return par.stiffness * contact.depth


class Whole(Linear):
    @wp.func
    def force(p: Any, c: Any):
        return 0


class Drag(wc.Friction):
    damping: float = wc.parameter("N·s/m", "damping b", default=1.0, at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return -2 * s.velocity


class Norm(wc.Friction):
    @wp.func
    def force(p: Any, s: Any):
        return -s.velocity / np.linalg.norm(s.velocity)


DELTA_3 = "write c.delta * c.delta * c.delta or wp.pow(c.delta, type(c.delta)(3.0)) instead of c.delta**3"
TWICE = "(c.delta + c.delta)"
MISTAKES = [
    (Power, "float32", DELTA_3),
    (Power, "float64", DELTA_3),
    (
        PowerOfWarp,
        "float32",
        f"write {TWICE} * {TWICE} or wp.pow(c.delta + c.delta, type(c.delta)(2.0)) "
        "instead of wp.pow(c.delta + c.delta, 2)",
    ),
    (FloatPower, "float64", "write wp.pow(c.delta, type(c.delta)(1.5)) instead of c.delta**1.5"),
    (Doubled, "float32", "write type(c.delta)(2.0) instead of 2"),
    (Halved, "float64", "write type(c.delta)(2.0) instead of 2"),
    (Positive, "float32", "write type(p.stiffness)(0.0) instead of 0"),
    (Choice, "float32", "write type(c.delta)(0.0) instead of 0"),
    (Returns, "float32", "write return type(p.stiffness)(0.0) instead of return 0"),
    (Bare, "float32", "did you mean p.stiffness?"),
    (Depth, "float32", "did you mean 'delta'?"),
    (Whole, "float32", "Whole.force returns int32"),
    (Drag, "float32", "write type(s.speed)(-2.0) instead of -2"),
    (Norm, "float32", "did you mean wp.length?"),
]


@pytest.mark.parametrize(
    ("kind", "precision", "expected_advice"), MISTAKES, ids=[f"{k.__name__}-{p}" for k, p, _ in MISTAKES]
)
def test_compile_error_states_the_line_and_its_correction(kind, precision, expected_advice, device):
    is_law = issubclass(kind, wc.Law)
    law, friction = (kind(), None) if is_law else (wc.laws.Hooke(stiffness=1e4), kind())
    with pytest.raises(TypeError) as caught:
        dropped_sphere(law, friction=friction, device=device, precision=precision)
    text = str(caught.value)
    assert f"{'law' if is_law else 'friction'} {kind.__name__}" in text
    assert expected_advice in text
    if kind is not Whole:
        assert f"{__file__}, line {kind.force.func.__code__.co_firstlineno + 2 + 2 * (kind is Returns)}: " in text
        assert "type(c.delta)(1.5) in a law" in text or "did you mean" in expected_advice


def test_square_roots_of_python_numpy_and_warp_compile_alike(device):
    class Roots(Linear):
        @wp.func
        def force(p: Any, c: Any):
            return abs(p.stiffness * (math.sqrt(c.delta) + np.sqrt(c.delta) - wp.sqrt(c.delta)))

    model = dropped_sphere(Roots(), height=-0.04, device=device)
    np.testing.assert_allclose(model.sensor("touch.normal_force"), 1e4 * 0.2, rtol=1e-5)


def test_function_without_return_on_every_path_is_refused():
    def partial(p: Any, c: Any):  # noqa: RET503
        if c.delta > p.stiffness:
            return p.stiffness * c.delta

    def branches(p: Any, c: Any):
        if c.delta > p.stiffness:
            return p.stiffness * c.delta
        else:  # noqa: RET505
            if c.delta_dot > c.delta:
                return c.delta
            return c.delta_dot

    with pytest.raises(TypeError, match=r"Partial\.force must return on every path; it can end without a return"):
        type("Partial", (Linear,), {"force": wp.func(partial)})
    assert type("Branches", (Linear,), {"force": wp.func(branches)})()


MIXED = "Input types must be the same, got ['int32', 'float32']"
LINES = [
    ("f += 2 * x", "; write type(f)(2.0) instead of 2"),
    ("if 2 * c.delta > x:", "; write type(c.delta)(2.0) instead of 2"),
    ("elif 2 * c.delta > x:", "; write type(c.delta)(2.0) instead of 2"),
    ("return 1 / (3 + c.delta)", "; write type(c.delta)(1.0) instead of 1; write type(c.delta)(3.0) instead of 3"),
    ("return float(2) * c.delta", "; write type(c.delta)(2.0) instead of float(2)"),
    ("return x[0] * type(x)(2.0) * wp.float64(3.0)", ""),
    ("x = wp.vec3(s.velocity[0], 2", ""),
    ("return 2 * wp.PI", "; write type(c.delta)(2.0) instead of 2"),
    ("return 2 * s.velocity", "; write type(c.delta)(2.0) instead of 2"),
]


@pytest.mark.parametrize(("line", "expected_advice"), LINES, ids=[line for line, _ in LINES])
def test_suggested_line_uses_constants_of_the_precision(line, expected_advice):
    assert advice(MIXED, line, {}, {"s.velocity"}, "c.delta") == expected_advice


def test_messages_of_other_errors_are_unchanged():
    assert advice("Only constants are allowed here", "return 2 * x", {}) == ""
    assert advice("Input types must be the same, got ['vec3f', 'int32']", "return s.velocity**2", {}) == ""
    assert advice("Referencing undefined symbol: gain", "first * gain", {"p": ["stiffness"]}) == ""
    assert "wp.sqrt instead of math.sqrt" in advice("Referencing undefined symbol: math", "math.sqrt(x)", {})
