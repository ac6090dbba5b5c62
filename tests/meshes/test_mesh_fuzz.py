"""Mutated mesh files: no crash, no hang, and no mesh with an invalid index or vertex.

Every mutant is loaded with ``load_mesh`` and its limits, in one process that must survive all of them.
"""

import contextlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import mesh_fuzz_process
import numpy as np
import pytest
import trimesh
import warp as wp
from test_mesh_sandbox import doubling
from test_meshes import OUTWARD, TETRAHEDRON

from warpcontact.meshes import MeshError, examine_file, load_mesh

HANG = 20.0  # s
QUICK, MANY = 20, 200
LARGE = 200_000  # bytes; few mutants are made of larger files


def originals(folder, shared):
    """Files of every format: small ones made here, and real ones, if available."""
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdUtils, Vt

    ball = trimesh.creation.icosphere(subdivisions=1)
    scene = trimesh.Scene()
    scene.add_geometry(ball, geom_name="ball")
    scene.add_geometry(trimesh.Trimesh(TETRAHEDRON + 3, OUTWARD, process=False), geom_name="wedge")
    stage = Usd.Stage.CreateInMemory()
    for name, (v, f) in {"hull": (ball.vertices, ball.faces), "wedge": (TETRAHEDRON + 3, OUTWARD)}.items():
        mesh = UsdGeom.Mesh.Define(stage, f"/World/{name}")
        mesh.CreatePointsAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, p)) for p in v]))
        mesh.CreateFaceVertexCountsAttr([3] * len(f))
        mesh.CreateFaceVertexIndicesAttr([int(i) for i in np.ravel(f)])
        mesh.AddTranslateOp().Set((1, 2, 3))
    copy = stage.DefinePrim("/World/copy")
    copy.GetReferences().AddInternalReference("/World/wedge")
    copy.CreateAttribute("xformOp:translate", Sdf.ValueTypeNames.Double3).Set((5, 6, 7))
    for suffix in ("usda", "usdc"):
        stage.GetRootLayer().Export(str(folder / f"stage.{suffix}"))
    assets = Path(wp.__file__).parent / "examples" / "assets"
    for path in (folder / "stage.usda", folder / "stage.usdc", assets / "cube.usd"):
        assert UsdUtils.CreateNewUsdzPackage(str(path), str(folder / f"{path.stem}{path.suffix[-1]}.usdz"))
    found = {
        "stl": [ball.export(file_type="stl")],
        "stl_text": [ball.export(file_type="stl_ascii").encode()],
        "obj": [b"o ball\n" + ball.export(file_type="obj").encode()],
        "ply": [ball.export(file_type="ply")],
        "ply_text": [ball.export(file_type="ply", encoding="ascii")],
        "off": [ball.export(file_type="off").encode()],
        "glb": [scene.export(file_type="glb")],
        "usda": [(folder / "stage.usda").read_bytes()],
        "usdc": [
            path.read_bytes() for path in (folder / "stage.usdc", assets / "cube.usd", assets / "sphere.usd")
        ],
        "usdz": [path.read_bytes() for path in sorted(folder.glob("*.usdz"))],
    }
    for kind, names in REAL.items() if shared else ():
        found[kind] += [(shared / "data/meshes" / name).read_bytes() for name in names]
    return found


KINDS = ["stl", "stl_text", "obj", "ply", "ply_text", "off", "glb", "usda", "usdc", "usdz"]
REAL = {
    "stl": ["20mm-xyz-cube.stl", "multibody.stl", "soup.stl"],
    "obj": ["not_convex.obj", "nancolor.obj", "fandisk.obj"],
    "ply": ["cycloidal.ply"],
    "ply_text": ["bunny.ply", "points_emptyface.ply"],
    "off": ["ballA.off"],
    "glb": ["Duck.glb"],
}
NUMBERS = [
    b"0",
    b"-1",
    b"4294967296",
    b"99999999999999999999",
    b"1e39",
    b"nan",
    b"inf",
    b"-0.0",
    b"3",
    b"{",
    b"]",
    b'"',
]
WORDS = [0, 1, 3, 255, 2**15, 2**31 - 1, 2**31, 2**32 - 1]


def mutant(sources, rng):
    """One of ``sources``, changed in a way in which files are damaged or attacked."""
    data = bytearray(sources[rng.integers(len(sources))])
    if len(data) > LARGE and rng.random() < 0.9:
        data = bytearray(sources[0])
    for _ in range(rng.integers(1, 4)):
        # Half of the changes are near the front, where the headers are.
        at = int(rng.integers(min(len(data), 300) if rng.random() < 0.5 else len(data)) if data else 0)
        match rng.integers(6):
            case 0:  # bits
                for place in rng.integers(0, max(len(data), 1), rng.integers(1, 9)):
                    if place < len(data):
                        data[place] ^= 1 << rng.integers(8)
            case 1:  # truncated
                del data[at:]
            case 2:  # a part copied to another position
                length = int(rng.integers(1, 200))
                start = int(rng.integers(max(len(data), 1)))
                data[at : at + int(rng.integers(0, 200))] = data[start : start + length]
            case 3:  # a number in a header
                data[at : at + 4] = int(rng.choice(WORDS)).to_bytes(4, "little")
            case 4:  # a number in a text
                spans = [i for i in range(max(at - 40, 0), min(at + 40, len(data))) if chr(data[i]).isdigit()]
                if spans:
                    data[spans[0] : spans[0] + 1] = NUMBERS[rng.integers(len(NUMBERS))]
            case 5:  # a part removed
                del data[at : at + int(rng.integers(1, 60))]
    return bytes(data)


class Loader:
    """A process that loads mutants.

    Args:
        seconds: Limit on processor time that is given to ``load_mesh`` [s].
        hang: Processor time that a file may take [s].
        wait: Wall-clock time after which the process is killed [s]; long, because other processes may be busy.
    """

    def __init__(self, seconds=HANG - 1.0, hang=HANG, wait=30.0 * HANG):
        self.hang, self.wait = hang, wait
        words = [sys.executable, Path(__file__).with_name("mesh_fuzz_process.py"), str(seconds)]
        self.process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self.process.stdout.readline() == "ready\n"

    def load(self, path):
        """Returns the result for a file: "mesh", "refused", or a failure."""
        timer = threading.Timer(self.wait, self.process.kill)
        timer.start()
        try:
            self.process.stdin.write(json.dumps(str(path)) + "\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        finally:
            timer.cancel()
        if not line:
            return "the process that loads it ended"
        answer, seconds = json.loads(line)
        return answer if seconds <= self.hang else f"a hang of {seconds:.1f} s"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        with contextlib.suppress(BrokenPipeError), self.process:
            pass


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    beside = Path(__file__).resolve().parents[3] / "shared"
    shared = Path(os.environ.get("WARPCONTACT_SHARED", beside))
    return originals(tmp_path_factory.mktemp("originals"), shared if shared.is_dir() else None)


@pytest.fixture(scope="module")
def loader():
    with Loader() as started:
        yield started


def fuzz(kind, count, sources, folder, loader):
    """Loads ``count`` mutants of a format; returns the number of each result."""
    seen = {"mesh": 0, "refused": 0}
    for seed in range(count):
        rng = np.random.default_rng([KINDS.index(kind), seed])
        path = folder / f"mutant_{seed}.{kind.partition('_')[0]}"
        path.write_bytes(mutant(sources[kind], rng))
        answer = loader.load(path)
        assert answer in seen, (kind, seed, answer)
        seen[answer] += 1
        path.unlink()
    return seen


@pytest.mark.parametrize("kind", KINDS)
def test_few_mutated_mesh_files_load_or_are_refused(kind, sources, tmp_path, loader):
    assert fuzz(kind, QUICK, sources, tmp_path, loader)["refused"] > QUICK // 8


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_mutated_mesh_files_load_or_are_refused(kind, times, sources, tmp_path, loader):
    """200, or 1000 with --thorough."""
    seen = fuzz(kind, MANY * times, sources, tmp_path, loader)
    assert seen["refused"] > MANY * times // 8
    assert seen["mesh"] > 0, "every mutant was refused: the mutations are too coarse to find anything"


def test_unmutated_mesh_files_are_valid(sources, tmp_path):
    for kind, (data, *_) in sources.items():
        path = tmp_path / f"a.{kind.partition('_')[0]}"
        path.write_bytes(data)
        assert load_mesh(path).report.closed, kind


@pytest.mark.parametrize("kind", ["stl", "obj", "glb", "usdc"])
def test_mutated_mesh_files_are_read_in_a_separate_process(kind, sources, tmp_path):
    for seed in range(3):
        path = tmp_path / f"{seed}.{kind}"
        path.write_bytes(mutant(sources[kind], np.random.default_rng([99, seed])))
        report = examine_file(path)
        assert report.usable or report.errors


def test_mesh_fuzzer_detects_hang_and_crash(tmp_path):
    path = tmp_path / "a.usda"
    path.write_text(doubling(40))
    with Loader(seconds=0.5, hang=5.0) as loader:
        assert loader.load(path) == "refused"
    with Loader(seconds=1.0, hang=0.5) as loader:
        assert loader.load(path).startswith("a hang of 1.")
    with Loader(seconds=5.0, wait=1.0) as loader:
        assert loader.load(path) == "the process that loads it ended"
        assert loader.load(path) == "the process that loads it ended"


def test_mesh_fuzzer_detects_invalid_results():
    sound = {"vertices": TETRAHEDRON, "faces": OUTWARD, "groups": {}}

    def judged(**changes):
        return mesh_fuzz_process.verdict(lambda: SimpleNamespace(**sound | changes))

    def raises(error):
        def load():
            raise error

        return mesh_fuzz_process.verdict(load)

    assert judged() == "mesh"
    assert (
        judged(vertices=TETRAHEDRON * np.nan) == judged(vertices=TETRAHEDRON * 1e7) == "a mesh with a bad vertex"
    )
    assert judged(faces=OUTWARD + 1) == judged(faces=-OUTWARD) == "a mesh with a bad index"
    assert judged(groups={"a": np.array([4])}) == "a mesh with a bad group"
    assert raises(MeshError("it has no faces")) == "refused"
    assert raises(MeshError("")) == "refused without a word"
    assert raises(IndexError("7")) == "IndexError: 7"
    assert "failed" in raises(MeshError("the reader process failed: KeyError"))
