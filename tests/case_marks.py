"""Marks of parametrized tests."""

import pytest


def slow_except(cases, kept):
    """Returns the cases of a parametrization; those for which ``kept(case)`` is false are marked slow."""
    return [
        case
        if kept(case)
        else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for case in cases
    ]
