"""Texts from anywhere are shown short."""

import pytest

from warpcontact.hostile import in_one_line, shortened


@pytest.mark.parametrize("middle", [False, True])
@pytest.mark.parametrize("most", [1, 2, 3, 4, 79, 80])
def test_a_long_text_has_exactly_as_many_characters_as_it_may(most, middle):
    assert len(shortened("ab" * 5000, most, middle=middle)) == most


def test_a_text_that_fits_stays():
    assert shortened("a\nc", 3) == shortened("a\nc", 3, middle=True) == "a\nc"


def test_a_text_in_one_line_has_no_breaks():
    assert in_one_line(" a\n b\u2028\tc ") == "a b c"
    assert in_one_line(12.5) == "12.5"


def test_the_end_or_the_middle_is_left_out():
    assert shortened("abcdefghi", 5) == "abcd…"
    assert shortened("abcdefghi", 5, middle=True) == "ab…hi"
    assert shortened("abcdefghi", 6, middle=True) == "abc…hi"
