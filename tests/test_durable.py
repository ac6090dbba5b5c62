"""Files that are there as a whole or not at all."""

import re

import pytest

from warpcontact.durable import check_place, replacing


def test_a_file_that_cannot_be_made_is_named_as_the_user_named_it(tmp_path):
    path = tmp_path / "nowhere" / "report.html"
    with pytest.raises(FileNotFoundError) as raised, replacing(path):
        pass
    assert raised.value.filename == str(path)
    assert ".partial" not in str(raised.value)


def test_what_fails_within_keeps_its_own_words(tmp_path):
    other = tmp_path / "input"
    with pytest.raises(FileNotFoundError, match=re.escape(str(other))), replacing(tmp_path / "a"):
        other.open()
    assert not list(tmp_path.iterdir())


def test_looking_whether_a_file_can_be_written_changes_nothing(tmp_path):
    there = tmp_path / "there"
    there.write_text("old")
    check_place(there)
    check_place(tmp_path / "new")
    link = tmp_path / "link"
    link.symlink_to("nothing")
    check_place(link)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "there"]
    link.unlink()
    assert there.read_text() == "old"
    for path, wrong in (
        (tmp_path, "is a folder"),
        (there / "a", "is not a folder"),
        (tmp_path / "no/a", "exist"),
    ):
        with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: .*{wrong}"):
            check_place(path)
