"""Measures USD export: time and file size for stages of many bodies and 100 frames.

    python benchmarks/usd_export.py --write

Each kind is exported several times to a file on the disk; the median is reported. Recordings contain random poses,
which are hardest to compress.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from result_file import default_path, write

import warpcontact as wc
from warpcontact.benchmark.facts import facts
from warpcontact.system.resources import available_threads

RECORDS = 100


def recording(envs: int, bodies: int) -> wc.Recording:
    """Returns a recording of random poses, of one body per environment or of a body set."""
    scene, rng = wc.Scene(), np.random.default_rng(0)
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)), name="ground")
    items: tuple[str, ...] = ()
    if bodies == 1:
        body = scene.add_body(1.0, (1.0, 1.0, 1.0), name="body")
    else:
        body, items = scene.add_bodies(rng.random((bodies, 3)), 1.0, (1.0, 1.0, 1.0), name="body"), ("item",)
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3))
    scene.add_contact(scene.add_point(body, (0.0, 0.0, 0.0)), ground, material, radius=0.05, name="touch")
    shape = (RECORDS, envs) + ((bodies,) if items else ())
    turns = rng.normal(size=(*shape, 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    found = wc.Recording(
        {
            "body.position": (("time", "env", *items, "axis"), rng.normal(size=(*shape, 3))),
            "body.orientation": (("time", "env", *items, "component"), turns.astype(np.float32)),
            "body.mass": (("env", *items), np.ones(shape[1:])),
            "outcome": ("env", rng.random(envs)),
        },
        coords={"time": np.arange(RECORDS) / 100.0, "env": np.arange(envs)},
    )
    found.scene = scene
    return found


#: Number of environments, number of bodies in the set, and options.
KINDS: dict[str, tuple[int, int, dict[str, Any]]] = {
    "1000 environments as ensemble": (1000, 1, {"envs": 0, "ensemble": True}),
    "1000 environments as ensemble, coloured, 16 with physics": (1000, 1, {"color_by": "outcome"}),
    "1000 bodies in one set": (1, 1000, {}),
    "1000 environments with physics": (1000, 1, {"envs": range(1000)}),
    "1000 environments as ensemble, clips of 10 records": (
        1000,
        1,
        {"envs": 0, "ensemble": True, "clip_frames": 10},
    ),
}


def measure(export: Callable[[Path], Any], suffix: str, repeats: int) -> dict[str, float]:
    """Returns the median time [s] and the size of the output [bytes]."""
    seconds = []
    for _ in range(repeats + 1):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            export(Path(folder) / f"stage{suffix}")
            seconds.append(time.perf_counter() - start)
            size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    # The first run also imports modules.
    return {"seconds": statistics.median(seconds[1:]), "bytes": size}


def main() -> None:
    """Prints a table and optionally writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--suffixes", nargs="+", default=[".usdc", ".usda", ".usdz"])
    parser.add_argument("--write", action="store_true", help="write the figures to benchmarks/results")
    parser.add_argument("--out", type=Path, help="write the figures to this file")
    options = parser.parse_args()
    found: dict[str, dict[str, Any]] = {}
    for name, (envs, bodies, given) in KINDS.items():
        data = recording(envs, bodies)
        for suffix in options.suffixes:
            if suffix == ".usdz" and "clip_frames" in given:
                continue
            result = measure(
                lambda path, data=data, given=given: wc.export_usd(data, path, **given), suffix, options.repeats
            )
            found.setdefault(name, {})[suffix] = result
            print(f"{name}, {suffix}: {result['seconds']:.3f} s, {result['bytes'] / 1e6:.2f} MB", flush=True)
    if options.write or options.out:
        about = facts("cpu", available_threads())
        path = options.out or default_path("usd-export", "cpu", about)
        write(path, {"facts": about, "records": RECORDS, "usd_export": found})


if __name__ == "__main__":
    main()
