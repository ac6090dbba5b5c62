"""Atomic writes: a file appears complete or not at all."""

import re

import pytest

from warpcontact.files.atomic_files import atomic_file, check_writable


def test_atomic_write_error_names_the_requested_path(tmp_path):
    path = tmp_path / "nowhere" / "report.html"
    with pytest.raises(FileNotFoundError) as raised, atomic_file(path):
        pass
    assert raised.value.filename == str(path)
    assert ".partial" not in str(raised.value)


def test_exception_inside_atomic_write_is_unchanged(tmp_path):
    other = tmp_path / "input"
    with pytest.raises(FileNotFoundError, match=re.escape(str(other))), atomic_file(tmp_path / "a"):
        other.open()
    assert not list(tmp_path.iterdir())


def test_check_of_output_path_leaves_files_unchanged(tmp_path):
    there = tmp_path / "there"
    there.write_text("old")
    check_writable(there)
    check_writable(tmp_path / "new")
    link = tmp_path / "link"
    link.symlink_to("nothing")
    check_writable(link)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "there"]
    link.unlink()
    assert there.read_text() == "old"
    for path, wrong in (
        (tmp_path, "is a folder"),
        (there / "a", "is not a folder"),
        (tmp_path / "no/a", "exist"),
    ):
        with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: .*{wrong}"):
            check_writable(path)
