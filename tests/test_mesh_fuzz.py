"""Mutated files: no crash, no hang, no mesh with a bad index or vertex, whatever is in a file.

Many mutants are read in one process under the limits of ``load_mesh``. One that ends that process, or keeps it
busy, is not held against the reader, which may do so: ``load_mesh`` itself then has to survive it.
"""

import contextlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_meshes import OUTWARD, TETRAHEDRON

from warpcontact.meshes import Limits, MeshError, examine_file, load_mesh

HANG = 20.0  # s
QUICK, THOROUGH = 40, 1000

# Reads mutants one after the other; says of each what came of it, before it begins with the next one.
READER = """
import sys, json, warnings
from warpcontact.meshes.reader_process import limit
limit(4 * 2**30, 600.0)
import numpy as np
from warpcontact.meshes import Mesh, MeshError
from warpcontact.meshes.examine import examine
from warpcontact.meshes.readers import Unreadable, read
for line in sys.stdin:
    path = json.loads(line)
    try:
        content = read(path, None, 200_000, confined=True)
        mesh = Mesh(content.vertices, content.faces, groups=content.groups)
        sound = np.isfinite(mesh.vertices).all() and 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
        answer = "mesh" if sound and np.abs(mesh.vertices).max() <= 1e6 else "bad mesh"
    except (Unreadable, MeshError) as error:
        answer = "refused" if str(error).strip() else "refused without a word"
    except BaseException as error:
        answer = f"{type(error).__name__}: {error}"
    sys.__stdout__.write(json.dumps(answer) + "\\n")
    sys.__stdout__.flush()
"""


def originals(folder, shared):
    """A few hundred bytes to some kilobytes of every format, from real meshes if they are there."""
    from pxr import Gf, Sdf, Usd, UsdGeom, Vt

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
    found = {
        "stl": ball.export(file_type="stl"),
        "stl_text": ball.export(file_type="stl_ascii").encode(),
        "obj": b"o ball\n" + ball.export(file_type="obj").encode(),
        "ply": ball.export(file_type="ply"),
        "ply_text": ball.export(file_type="ply", encoding="ascii"),
        "off": ball.export(file_type="off").encode(),
        "glb": scene.export(file_type="glb"),
        "usda": (folder / "stage.usda").read_bytes(),
        "usdc": (folder / "stage.usdc").read_bytes(),
    }
    real = {"stl": "multibody.stl", "obj": "not_convex.obj", "glb": "Duck.glb", "ply_text": "points_emptyface.ply"}
    more = {kind: (shared / "data/meshes" / name).read_bytes() for kind, name in real.items()} if shared else {}
    return {kind: [data, *([more[kind]] if kind in more else [])] for kind, data in found.items()}


KINDS = ["stl", "stl_text", "obj", "ply", "ply_text", "off", "glb", "usda", "usdc"]
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
    """One of ``sources``, changed in one of the ways in which files are damaged or attacked."""
    data = bytearray(sources[rng.integers(len(sources))])
    for _ in range(rng.integers(1, 4)):
        # Half of the time near the front, where the headers are.
        at = int(rng.integers(min(len(data), 300) if rng.random() < 0.5 else len(data)) if data else 0)
        match rng.integers(6):
            case 0:  # bits
                for place in rng.integers(0, max(len(data), 1), rng.integers(1, 9)):
                    if place < len(data):
                        data[place] ^= 1 << rng.integers(8)
            case 1:  # cut short
                del data[at:]
            case 2:  # a piece of it elsewhere
                length = int(rng.integers(1, 200))
                start = int(rng.integers(max(len(data), 1)))
                data[at : at + int(rng.integers(0, 200))] = data[start : start + length]
            case 3:  # a number of a header
                data[at : at + 4] = int(rng.choice(WORDS)).to_bytes(4, "little")
            case 4:  # a number of a text
                spans = [i for i in range(max(at - 40, 0), min(at + 40, len(data))) if chr(data[i]).isdigit()]
                if spans:
                    data[spans[0] : spans[0] + 1] = NUMBERS[rng.integers(len(NUMBERS))]
            case 5:  # a piece taken out
                del data[at : at + int(rng.integers(1, 60))]
    return bytes(data)


class Reader:
    """A process that reads mutants, started again when one of them has ended it."""

    def __init__(self):
        self.process = None

    def read(self, path):
        """What came of a file, or ``None`` if it ended the process or kept it busy."""
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, "-c", READER], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, text=True,
            )  # fmt: skip
        timer = threading.Timer(HANG, self.process.kill)
        timer.start()
        self.process.stdin.write(json.dumps(str(path)) + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        timer.cancel()
        if not answer:
            self.close()
            return None
        return json.loads(answer)

    def close(self):
        if self.process is not None:
            self.process.kill()
            with self.process:
                pass
        self.process = None


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    beside = Path(__file__).resolve().parents[2] / "shared"
    shared = Path(os.environ.get("WARPCONTACT_SHARED", beside))
    return originals(tmp_path_factory.mktemp("originals"), shared if shared.is_dir() else None)


def fuzz(kind, count, sources, folder):
    """Reads ``count`` mutants of a format and returns how many came to what."""
    reader, seen = Reader(), {}
    try:
        for seed in range(count):
            rng = np.random.default_rng([KINDS.index(kind), seed])
            # A name of its own: USD keeps what it has read by name.
            path = folder / f"mutant_{seed}.{kind.partition('_')[0]}"
            path.write_bytes(mutant(sources[kind], rng))
            answer = reader.read(path)
            if answer is None:
                with contextlib.suppress(MeshError):
                    load_mesh(path, limits=Limits(seconds=HANG))
                answer = "survived"
            assert answer in ("mesh", "refused", "survived"), (kind, seed, answer)
            seen[answer] = seen.get(answer, 0) + 1
            path.unlink()
    finally:
        reader.close()
    return seen


@pytest.mark.parametrize("kind", KINDS)
def test_some_mutants_end_in_a_mesh_or_a_sentence(kind, sources, tmp_path):
    seen = fuzz(kind, QUICK, sources, tmp_path)
    assert seen.get("refused", 0) > QUICK // 8


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_thousand_mutants_end_in_a_mesh_or_a_sentence(kind, sources, tmp_path):
    seen = fuzz(kind, THOROUGH, sources, tmp_path)
    assert seen.get("refused", 0) > THOROUGH // 8
    assert seen.get("mesh", 0) > 0, "every mutant was refused: the mutations are too coarse to find anything"


def test_the_originals_are_sound(sources, tmp_path):
    for kind, (data, *_) in sources.items():
        path = tmp_path / f"a.{kind.partition('_')[0]}"
        path.write_bytes(data)
        assert load_mesh(path).report.closed, kind


@pytest.mark.parametrize("kind", ["stl", "obj", "glb", "usdc"])
def test_mutants_are_read_apart_one_by_one(kind, sources, tmp_path):
    for seed in range(3):
        path = tmp_path / f"{seed}.{kind}"
        path.write_bytes(mutant(sources[kind], np.random.default_rng([99, seed])))
        report = examine_file(path)
        assert report.usable or report.errors
