"""Untrusted texts are shortened for display."""

import pytest

from warpcontact.validation.safe_text import single_line, truncate


@pytest.mark.parametrize("middle", [False, True])
@pytest.mark.parametrize("most", [1, 2, 3, 4, 79, 80])
def test_shortened_text_has_exactly_the_maximum_length(most, middle):
    assert len(truncate("ab" * 5000, most, middle=middle)) == most


def test_short_text_is_unchanged():
    assert truncate("a\nc", 3) == truncate("a\nc", 3, middle=True) == "a\nc"


def test_single_line_text_has_no_line_breaks():
    assert single_line(" a\n b\u2028\tc ") == "a b c"
    assert single_line(12.5) == "12.5"


def test_shortened_text_omits_the_end_or_the_middle():
    assert truncate("abcdefghi", 5) == "abcd…"
    assert truncate("abcdefghi", 5, middle=True) == "ab…hi"
    assert truncate("abcdefghi", 6, middle=True) == "abc…hi"
