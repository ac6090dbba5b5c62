"""Files that are written past the memory of the system hold what was written, however much that is."""

import errno
import os
import threading
from pathlib import Path

import numpy as np
import pytest

from warpcontact.direct import BLOCK, PIECE, DirectFile
from warpcontact.run_folder import RunPath

SIZES = (0, 1, BLOCK - 1, BLOCK, BLOCK + 1, PIECE - 1, PIECE, PIECE + 1, 3 * PIECE + 2 * BLOCK + 7)


def written(path):
    """Opens a new file in a folder."""
    return DirectFile((RunPath(path.parent) / path.name).create)


def content_of(size, seed=0):
    return np.random.default_rng(seed).bytes(size)


@pytest.mark.parametrize("size", SIZES)
def test_a_file_holds_what_was_written(size, tmp_path):
    content = content_of(size)
    with written(tmp_path / "file") as file:
        file.write(content)
    assert (tmp_path / "file").read_bytes() == content


def test_parts_follow_each_other(tmp_path):
    parts = [content_of(size, size) for size in SIZES]
    with written(tmp_path / "file") as file:
        for part in parts:
            file.write(part)
    assert (tmp_path / "file").read_bytes() == b"".join(parts)


def test_a_longer_file_is_replaced(tmp_path):
    (tmp_path / "file").write_bytes(content_of(3 * PIECE))
    with written(tmp_path / "file") as file:
        file.write(b"short")
    assert (tmp_path / "file").read_bytes() == b"short"


def test_its_rights_are_those_of_other_files(tmp_path):
    (tmp_path / "other").write_bytes(b"")
    with written(tmp_path / "file"):
        pass
    assert (tmp_path / "file").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_threads_write_their_own_files(tmp_path):
    contents = [content_of(2 * PIECE + number, number) for number in range(4)]
    begun = threading.Barrier(len(contents))

    def write(number):
        with written(tmp_path / str(number)) as file:
            begun.wait()
            for start in range(0, len(contents[number]), 1000):
                file.write(contents[number][start : start + 1000])

    threads = [threading.Thread(target=write, args=(number,)) for number in range(len(contents))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [(tmp_path / str(number)).read_bytes() for number in range(len(contents))] == contents


@pytest.mark.skipif(not hasattr(os, "O_DIRECT"), reason="this system has one way to write a file")
@pytest.mark.parametrize("number", [errno.EINVAL, errno.EOPNOTSUPP])
def test_files_that_cannot_be_opened_to_be_written_directly_are_written(number, tmp_path, monkeypatch):
    content = content_of(PIECE + BLOCK + 3)
    usual = os.open

    def refusing(path, flags, *rest, **options):
        if flags & os.O_DIRECT:
            raise OSError(number, os.strerror(number), path)
        return usual(path, flags, *rest, **options)

    monkeypatch.setattr(os, "open", refusing)
    with written(tmp_path / "file") as file:
        file.write(content)
    assert (tmp_path / "file").read_bytes() == content


@pytest.mark.parametrize("size", [3, BLOCK, PIECE + BLOCK + 3])
def test_what_is_refused_when_it_is_written_goes_the_way_of_other_files(size, tmp_path):
    content = content_of(size)
    with written(tmp_path / "file") as file:
        # Memory that begins elsewhere is what a disk refuses.
        file._piece = np.zeros(PIECE + BLOCK, dtype=np.uint8)[1 : PIECE + 1]
        file.write(content)
    assert (tmp_path / "file").read_bytes() == content


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_what_does_not_fit_is_an_error():
    def create(flags):
        return os.open("/dev/full", os.O_WRONLY | flags)

    with pytest.raises(OSError, match="No space left"), DirectFile(create) as file:
        file.write(content_of(2 * BLOCK + 1))


def test_a_folder_is_no_file(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError):
        written(tmp_path / "folder")


def test_who_fails_while_writing_is_told_so(tmp_path):
    def write():
        with written(tmp_path / "file") as file:
            file.write(b"begun")
            raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        write()
    assert (tmp_path / "file").read_bytes() == b""
