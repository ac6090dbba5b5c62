"""Warp starts without a warning about a missing GPU, and names folders that it cannot use."""

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import warp as wp

from warpcontact.system import initialization
from warpcontact.system.devices import find_devices

without_driver = pytest.mark.skipif(initialization.missing_driver() is None, reason="has an NVIDIA driver")
DEVICES = """\
import warp as wp
wp.config.log_level = wp.LOG_ERROR
from warpcontact.system.devices import find_devices
print(*find_devices("auto"))
"""


def python(code, **environment):
    """Runs code in a new process with these environment variables."""
    environment = {**os.environ, **{name: str(value) for name, value in environment.items()}}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False
    )


@without_driver
def test_missing_gpu_is_not_mentioned():
    ended = python(DEVICES)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "cpu\n", "")


@without_driver
@pytest.mark.parametrize("device", ["cuda", "cuda:0", ["cpu", "cuda:0"]])
def test_missing_gpu_is_reported_on_request(device):
    with pytest.raises(
        ValueError, match=r"no CUDA device was found: the NVIDIA driver cannot be loaded \(.*libcuda"
    ):
        find_devices(device)


def test_other_output_of_native_code_is_written(capfd):
    unwanted = initialization._NO_DRIVER
    with initialization._stderr_without(unwanted):
        os.write(2, b"before\n" + unwanted + b" GPU execution will not be available.\nafter\n")
        print("of Python", file=sys.__stderr__)
    os.write(2, b"later\n")
    lines = capfd.readouterr().err.splitlines()
    assert [line for line in lines if line != "of Python"] == ["before", "after", "later"]


def test_output_of_native_code_is_written_after_an_error(capfd):
    def fail():
        os.write(2, b"before\nunwanted line\n")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), initialization._stderr_without(b"unwanted"):
        fail()
    assert capfd.readouterr().err == "before\n"


def test_unwritable_kernel_cache_is_reported(tmp_path):
    file = tmp_path / "file"
    file.touch()
    ended = python(DEVICES, WARP_CACHE_PATH=file / "cache")
    assert ended.stderr.splitlines()[-1].endswith(
        f"KernelCacheError: the kernel cache {file}/cache/{wp.config.version} must be a folder with free space "
        "that can be written, got: Not a directory; set the environment variable WARP_CACHE_PATH to such a folder"
    )


@pytest.mark.parametrize(
    ("error", "match"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "FOLDER/wp_x/wp_x.cpp"), "FOLDER must .* No space left"),
        (
            OSError(errno.EACCES, "Permission denied", "FOLDER"),
            "FOLDER must .* denied; set .*WARP_CACHE_PATH",
        ),
        (
            FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/x']"),
            r"any of \['/x'\].* TMPDIR",
        ),
    ],
)
def test_kernel_cache_error_states_the_remedy(error, match, monkeypatch):
    folder = str(Path("cache").resolve())
    monkeypatch.setattr(wp.config, "kernel_cache_dir", folder)
    if error.filename:
        error.filename = error.filename.replace("FOLDER", folder)
    with pytest.raises(OSError, match=match.replace("FOLDER", folder)), initialization.explaining():
        raise error


def test_full_disk_is_detected_before_the_compiler_is_called(monkeypatch, tmp_path):
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    (tmp_path / "wp_compiled").mkdir()
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=initialization.ROOM - 1))
    initialization.require_room(lambda: "wp_compiled")
    with pytest.raises(OSError, match="No space left"), initialization.explaining():
        initialization.require_room(lambda: "wp_other")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=initialization.ROOM))
    initialization.require_room(lambda: "wp_other")


def test_other_initialization_errors_are_unchanged():
    error = OSError(errno.EACCES, "Permission denied", "/elsewhere")
    assert initialization.explained(error) is error
