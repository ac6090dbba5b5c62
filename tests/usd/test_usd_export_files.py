"""Stage files: all formats, atomic writes, and errors that name the file."""

import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from pxr import Usd
from recorded_usd_scene import export, simulate, world

import warpcontact as wc


@pytest.fixture(scope="module")
def recording(device):
    return simulate(device)


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd", ".usdz"])
@pytest.mark.parametrize("envs", [[0, 2], None])
def test_every_usd_format_is_valid_and_has_equal_content(recording, tmp_path, suffix, envs):
    stage = export(recording, tmp_path, suffix, envs=envs)
    found = world(stage, "/World/env_2/ball", 17)[1]
    np.testing.assert_array_equal(found, recording["ball.position"].values[17, 2])
    assert wc.check_usd(tmp_path / f"stage{suffix}") == []
    assert [file.name for file in tmp_path.iterdir()] == [f"stage{suffix}"]


def test_usdz_package_has_one_binary_file(recording, tmp_path):
    export(recording, tmp_path, ".usdz")
    assert zipfile.ZipFile(tmp_path / "stage.usdz").namelist() == ["stage.usdc"]


def test_repeated_export_is_bitwise_identical(recording, tmp_path):
    for suffix in (".usda", ".usdc"):
        first, second = (tmp_path / name for name in (f"a{suffix}", f"b{suffix}"))
        for path in (first, second):
            wc.export_usd(recording, path, envs=1)
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_full_disk_is_reported_and_keeps_the_existing_stage(recording, tmp_path, suffix):
    """A limit on the file size simulates it."""
    path = tmp_path / f"stage{suffix}"
    wc.export_usd(recording, path, envs=0)
    before = path.read_bytes()
    code = f"""
import resource, signal, sys
sys.path.insert(0, {os.path.dirname(os.path.dirname(__file__))!r})
from recorded_usd_scene import simulate
import warpcontact as wc
recording = simulate("cpu")
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    wc.export_usd(recording, {str(path)!r})
except OSError as error:
    print("named:", error)
"""
    completed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert f"named: cannot write {path}: " in completed.stdout, completed.stderr
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_unwritable_path_is_reported(recording, tmp_path, suffix):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / f"a{suffix}", tmp_path / f"folder{suffix}"):
        if path.parent == tmp_path:
            path.mkdir()
        with pytest.raises(OSError, match=f"cannot write .*{path.name}"):
            wc.export_usd(recording, path, envs=0)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["file", f"folder{suffix}"]


def test_usd_export_is_atomic(recording, tmp_path, monkeypatch):
    """A reader finds the old stage or the new one."""
    path = tmp_path / "stage.usdc"
    wc.export_usd(recording, path, envs=0)
    seen = []
    replace = os.replace

    def observe(source, target, **folders):
        stage = Usd.Stage.Open(str(path))
        seen.append(stage.GetPrimAtPath("/World/env_0").IsValid())
        replace(source, target, **folders)

    monkeypatch.setattr("pathlib.os.replace", observe)
    wc.export_usd(recording, path, envs=2)
    assert seen == [True]
    stage = Usd.Stage.Open(str(path))
    assert stage.GetPrimAtPath("/World/env_2")
