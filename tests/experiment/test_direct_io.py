"""Files written with direct I/O contain what was written, for any size."""

import errno
import os
import threading
from pathlib import Path

import numpy as np
import pytest

from warpcontact.files.direct_io import BLOCK, PIECE, DirectFile
from warpcontact.files.run_folder import RunPath

SIZES = (0, 1, BLOCK - 1, BLOCK, BLOCK + 1, PIECE - 1, PIECE, PIECE + 1, 3 * PIECE + 2 * BLOCK + 7)


def written(path):
    """Opens a new file in a folder."""
    return DirectFile((RunPath(path.parent) / path.name).create)


def read_content(size, seed=0):
    return np.random.default_rng(seed).bytes(size)


@pytest.mark.parametrize("size", SIZES)
def test_direct_file_contains_written_bytes(size, tmp_path):
    content = read_content(size)
    with written(tmp_path / "file") as file:
        file.write(content)
    assert (tmp_path / "file").read_bytes() == content


def test_direct_file_appends_successive_writes(tmp_path):
    parts = [read_content(size, size) for size in SIZES]
    with written(tmp_path / "file") as file:
        for part in parts:
            file.write(part)
    assert (tmp_path / "file").read_bytes() == b"".join(parts)


def test_direct_file_replaces_a_longer_file(tmp_path):
    (tmp_path / "file").write_bytes(read_content(3 * PIECE))
    with written(tmp_path / "file") as file:
        file.write(b"short")
    assert (tmp_path / "file").read_bytes() == b"short"


def test_direct_file_has_default_permissions(tmp_path):
    (tmp_path / "other").write_bytes(b"")
    with written(tmp_path / "file"):
        pass
    assert (tmp_path / "file").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_direct_files_can_be_written_by_several_threads(tmp_path):
    contents = [read_content(2 * PIECE + number, number) for number in range(4)]
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
def test_direct_file_is_written_without_direct_io_support(number, tmp_path, monkeypatch):
    content = read_content(PIECE + BLOCK + 3)
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
def test_direct_file_falls_back_if_a_direct_write_is_refused(size, tmp_path):
    content = read_content(size)
    with written(tmp_path / "file") as file:
        # Direct I/O requires aligned memory; a disk rejects other addresses.
        file._piece = np.zeros(PIECE + BLOCK, dtype=np.uint8)[1 : PIECE + 1]
        file.write(content)
    assert (tmp_path / "file").read_bytes() == content


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_direct_file_raises_if_the_disk_is_full():
    def create(flags):
        return os.open("/dev/full", os.O_WRONLY | flags)

    with pytest.raises(OSError, match="No space left"), DirectFile(create) as file:
        file.write(read_content(2 * BLOCK + 1))


def test_direct_file_raises_for_a_folder(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError):
        written(tmp_path / "folder")


def test_exception_while_writing_direct_file_is_propagated(tmp_path):
    def write():
        with written(tmp_path / "file") as file:
            file.write(b"begun")
            raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        write()
    assert (tmp_path / "file").read_bytes() == b""
