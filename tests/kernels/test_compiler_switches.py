"""Kernels give the same results with and without code that depends on the compiler."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from warpcontact.kernels.lowlevel.switches import TECHNIQUES

# Contacts of boxes in clusters, with cached faces and history variables.
STEPS = """
import hashlib, sys
import numpy as np
sys.path[:0] = sys.argv[1:4]
import warpcontact as wc
from test_fused_step_gpu import SINGLE_BODY_SCENES, built, states
for name, precision in (("points in clusters", "float32"), ("with history", "float64"))[: int(sys.argv[5])]:
    model = built(SINGLE_BODY_SCENES[name], sys.argv[4], precision)
    wc.Simulation(model, dt=1e-3).step(300)
    force = model.sensor("touch.normal_force")
    assert (force > 0).any()
    values = [*states(model), force, model.sensor("touch.gap")]
    print("sha256:", hashlib.sha256(b"".join(np.ascontiguousarray(value).tobytes() for value in values)).hexdigest())
"""


def run_without(techniques, code, *words, mode="quick"):
    """Runs code in a new process without some techniques; returns the process."""
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, *words],
        env={**os.environ, "WARPCONTACT_COMPILE": mode, "WARPCONTACT_DISABLE": techniques},
        capture_output=True,
        text=True,
        check=False,
    )


def results_without(techniques, device, mode, scenes):
    tests = Path(__file__).parents[1]
    folders = [str(tests), str(tests / "stepping"), str(tests / "geometry")]
    result = run_without(techniques, STEPS, *folders, device, str(scenes), mode=mode)
    assert result.returncode == 0, result.stderr
    # Warp prints lines as well.
    digests = [line for line in result.stdout.splitlines() if line.startswith("sha256:")]
    assert len(digests) == scenes
    return digests


def test_plain_code_gives_bitwise_identical_results(device):
    assert results_without("all", device, "quick", 1) == results_without("", device, "quick", 1)


@pytest.mark.slow
def test_fused_kernels_without_each_technique_give_bitwise_identical_results(device):
    expected = results_without("", device, "release", 2)
    for technique in TECHNIQUES:
        assert results_without(technique, device, "release", 2) == expected, technique


def test_unknown_technique_is_refused():
    result = run_without("simd, speed", "import warpcontact.kernels.lowlevel.switches")
    assert result.returncode == 1
    assert "WARPCONTACT_DISABLE must name some of assumptions, strides, simd" in result.stderr
    assert "got 'simd, speed'" in result.stderr
