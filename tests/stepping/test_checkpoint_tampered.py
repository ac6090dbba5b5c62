"""Untrusted checkpoints: tampered files are rejected or run; they never end the process."""

import collections
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_checkpoint import simulation, state_bytes

import warpcontact as wc
from warpcontact.stepping import checkpoint

HERE = Path(__file__).parent
# Environment of the process, which finds helper modules.
PATHS = os.environ | {"PYTHONPATH": str(HERE.parent)}
# Time limit [s] for 50 files and the start of a process on a slow machine.
PATIENCE = 300


@pytest.mark.parametrize("case", ["forces", "impulses"])
def test_tampered_checkpoint_neither_crashes_nor_hangs(case, times, tmp_path):
    ends = collections.Counter()
    for first in range(0, 50 * times, 50):
        command = [sys.executable, HERE / "tampered_checkpoints.py", case, str(first), "50", tmp_path]
        done = subprocess.run(
            command, check=False, capture_output=True, text=True, cwd=HERE, timeout=PATIENCE, env=PATHS
        )
        lines = done.stdout.splitlines()
        assert done.returncode == 0, f"{lines[-1:]}\n{done.stderr[-2000:]}"
        assert len(lines) == 50
        ends.update(line.rpartition(" ")[2] for line in lines)
    # Both results occur: bits of positions can have any value, indices cannot.
    assert ends["refused"] > 10 * times
    assert ends["ran"] > 5 * times


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A simulation, its checkpoint, and the arrays in it."""
    sim = simulation("forces", "cpu", envs=2)
    sim.step(20)
    path = tmp_path_factory.mktemp("saved") / "state.npz"
    sim.save(path)
    return sim, path, dict(np.load(path).items())


def named(arrays, end):
    return next(name for name in arrays if name.endswith(end))


def changed(values, place, new):
    """Returns the bytes of an array with ``new`` written at ``place``."""
    content = values.copy()
    content[place : place + new.nbytes] = new.view(np.uint8)
    return content


def test_checkpoint_stores_no_caches(saved):
    _, _, arrays = saved
    kinds = {name.rpartition(":")[0].rpartition(":")[2] for name in arrays if ":" in name}
    assert kinds == {"state", "contacts", "couplings", "shape contacts", "particles"}
    names = {name.rpartition(":")[2] for name in arrays}
    assert names.isdisjoint(
        {"safe_travel", "nearest", "list_center", "gap", "penetration", "key", "head", "wrenches"}
    )
    assert {"body_position", "entry_speed", "armed", "face", "neighbor", "slot", "status", "time"} <= names


@pytest.mark.parametrize(
    ("end", "new", "message"),
    [
        ("contacts:face", np.int32([10**6]), r"contacts:face': face\[0, 0\] must be from -1 to 1, got 1000000"),
        ("contacts:armed", np.int32([2]), r"armed\[0, 0\] must be from 0 to 1, got 2"),
        ("state:status", np.int32([4]), r"status\[0\] must be one of \[0, 2, 6\], got 4"),
        ("state:cause", np.int32([-1]), r"cause\[0\] must be from 0 to 3, got -1"),
        ("state:time", np.float64([np.nan]), r"time\[0\] must be a time of at least 0 s, got nan"),
        ("state:body_position", np.float32([np.inf]), r"body_position\[0, 0\] must be finite, got \[inf"),
        ("state:body_orientation", np.float32([3.0]), r"body_orientation\[0, 0\] must be a unit quaternion"),
        ("warm_start", np.int32([9, 9] * 16), r"warm_start\.valid\[0, 0\] must be from 0 to 1"),
        ("particles:neighbor", np.int32([40]), r"neighbor\[0, 0\] must be from 0 to 39, got 40"),
        ("particles:slot", np.int32([-2]), r"slot\[0, 0\] must be from -1 to \d+, got -2"),
        ("particles:owned", np.int32([10**4]), r"owned\[0, 0\] must be from 0 to \d+, got 10000"),
        ("particles:flags", np.int32([4]), r"flags\[0, 0\] must be from 0 to 3, got 4"),
        ("couplings:grounded", np.int32([-1]), r"grounded\[0, 0\] must be from 0 to 1, got -1"),
    ],
)
def test_out_of_range_checkpoint_value_is_refused_without_changes(end, new, message, saved, tmp_path):
    sim, _, arrays = saved
    name = named(arrays, end)
    np.savez(tmp_path / "bad.npz", **(arrays | {name: changed(arrays[name], 0, new)}))
    before = state_bytes(sim)
    with pytest.raises(wc.CheckpointError, match=message):
        sim.load(tmp_path / "bad.npz")
    assert state_bytes(sim) == before


def test_invalid_parameter_or_force_in_checkpoint_is_refused(saved, tmp_path):
    sim, _, arrays = saved
    before = {name: sim.model[name].copy() for name in sim.model}
    count = sum("/values/" in name for name in arrays)
    for key in range(count):
        values = arrays[f"0/values/{key}"]
        for bad in (np.full_like(values, np.nan), values.astype(np.float32), values[:, :0], values.astype(str)):
            np.savez(tmp_path / "bad.npz", **(arrays | {f"0/values/{key}": bad}))
            with pytest.raises(wc.CheckpointError, match=r"must be"):
                sim.load(tmp_path / "bad.npz")
    np.savez(tmp_path / "bad.npz", **(arrays | {"0/external/force": np.zeros((2, 3, 3), np.float32)}))
    with pytest.raises(wc.CheckpointError, match="'0/external/force' must be float32 of shape"):
        sim.load(tmp_path / "bad.npz")
    for name, values in before.items():
        np.testing.assert_array_equal(sim.model[name], values, err_msg=name)
    assert not sim.model.external_exposed


def test_zero_force_scale_in_nonsmooth_checkpoint_is_refused(tmp_path):
    sim, path = simulation("impulses", "cpu", envs=2), tmp_path / "state.npz"
    sim.model["feet.force_scale"] = 0.75
    sim.save(path)
    arrays = dict(np.load(path).items())
    (name,) = [name for name, values in arrays.items() if "/values/" in name and np.all(values == 0.75)]
    np.savez(path, **(arrays | {name: 0.0 * arrays[name]}))
    sim.model["feet.force_scale"] = 0.5
    sim.step(2)
    before = state_bytes(sim)
    with pytest.raises(
        wc.CheckpointError, match=r"feet\.force_scale must be greater than 0, got 0: rigid contact"
    ):
        sim.load(path)
    assert state_bytes(sim) == before
    np.testing.assert_array_equal(sim.model["feet.force_scale"], 0.5)


@pytest.mark.parametrize("value", [np.array(["a"]), np.array([np.nan]), np.array([-1.0]), np.zeros(2)], ids=str)
def test_invalid_clock_in_checkpoint_is_refused(value, saved, tmp_path):
    sim, _, arrays = saved
    np.savez(tmp_path / "bad.npz", **(arrays | {"elapsed": value}))
    with pytest.raises(wc.CheckpointError, match="elapsed"):
        sim.load(tmp_path / "bad.npz")


def test_frozen_environment_with_non_finite_state_is_restored(tmp_path):
    """The user wrote that state; no step leads to it."""
    sim = simulation("impulses", "cpu", envs=2)
    sim.step(3)
    velocity = sim.state.body_linear_velocity.numpy()
    velocity[1] = np.nan
    sim.state.body_linear_velocity.assign(velocity)
    sim.save(tmp_path / "before.npz")
    with pytest.raises(wc.CheckpointError, match=r"body_linear_velocity\[1, 0\] must be finite"):
        sim.load(tmp_path / "before.npz")
    sim.step(3)
    assert sim.model.health().frozen.tolist() == [1]
    sim.save(tmp_path / "after.npz")
    other = simulation("impulses", "cpu", envs=2)
    other.load(tmp_path / "after.npz")
    assert state_bytes(other) == state_bytes(sim)
    other.step(5)
    sim.step(5)
    assert state_bytes(other) == state_bytes(sim)
    assert other.model.health().frozen.tolist() == [1]


def test_compressed_checkpoint_is_refused(saved, tmp_path):
    sim, _, arrays = saved
    np.savez_compressed(tmp_path / "bomb.npz", **(arrays | {"elapsed": np.zeros(10**8)}))
    with pytest.raises(wc.CheckpointError, match="its arrays are compressed"):
        sim.load(tmp_path / "bomb.npz")


def test_checkpoint_of_earlier_schema_is_refused_with_its_version(saved, tmp_path):
    sim, _, _ = saved
    checkpoint.write(tmp_path / "old.npz", {}, {"schema": 3, "program": "warpcontact 0.0.1"})
    with pytest.raises(
        wc.CheckpointError, match=r"has schema 3, written by 'warpcontact 0\.0\.1'; this version reads schema 5"
    ):
        sim.load(tmp_path / "old.npz")


@pytest.mark.parametrize("identity", [None, 3, {}, {"parameters": 3}, {"envs": "\x1b[31m"}], ids=str)
def test_invalid_checkpoint_header_is_refused_with_printable_message(identity, saved, tmp_path):
    sim, _, arrays = saved
    arrays = {name: values for name, values in arrays.items() if name != "header"}
    checkpoint.write(tmp_path / "bad.npz", arrays, {"identity": identity})
    with pytest.raises(wc.CheckpointError) as caught:
        sim.load(tmp_path / "bad.npz")
    assert str(caught.value).isprintable()
