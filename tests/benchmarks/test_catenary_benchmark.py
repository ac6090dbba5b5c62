"""The benchmark of catenaries runs and finds the expected solutions."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "catenary.py"


@pytest.mark.skipif(not SCRIPT.is_file(), reason="benchmarks are in a checkout, not in an installed package")
def test_catenary_benchmark_runs(device, tmp_path):
    out = tmp_path / "catenary.json"
    words = ["--device", device, "--envs", "3", "--moves", "2", "--rounds", "1", "--precision", "float64"]
    done = subprocess.run(
        [sys.executable, SCRIPT, *words, "--out", out], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    results = json.loads(out.read_text())["results"]
    assert {(row["line"], row["start"]) for row in results} == {
        (line, start) for line in ("slack", "on the floor", "taut") for start in ("warm", "cold")
    }
    # A warm start saves evaluations where they are costly: on a seabed the search is nested.
    floor = {row["start"]: row["evaluations"] for row in results if row["line"] == "on the floor"}
    assert floor["warm"] < 0.6 * floor["cold"]
