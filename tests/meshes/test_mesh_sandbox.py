"""Files that crash, hang or exhaust memory give one error message, for every function that loads meshes."""

import io
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict

import numpy as np
import pytest
import trimesh
from case_marks import slow_except
from test_mesh_files import STL, binary_stl, glb
from test_meshes import OUTWARD, TETRAHEDRON

from warpcontact.meshes import Limits, Mesh, MeshError, box, examine_file, isolation, load_mesh
from warpcontact.meshes.readers import Unreadable

pytestmark = pytest.mark.installed

POSIX = pytest.mark.skipif(os.name != "posix", reason="limits on processes are a matter of POSIX")
SECONDS = 20.0


def nested(depth):
    """A stage with nested dictionaries: the parser of usda exhausts its stack."""
    return "#usda 1.0\n(\n customLayerData = {" + "dictionary a = {" * depth + "}" * depth + "}\n)\n"


def doubling(levels):
    """A stage of few prims, each made of twice the one before."""
    prims = ['def Xform "p0" {\n def Mesh "m" {\n int[] faceVertexCounts = [3]\n }\n }']
    for i in range(1, levels):
        parts = "".join(f'def "{side}" (references = </p{i - 1}>) {{\n }}\n' for side in "ab")
        prims.append(f'def Xform "p{i}" {{\n {parts} }}')
    return "#usda 1.0\n" + "\n".join(prims)


def square(count):
    """A stage with one mesh of ``count`` squares at one position, with a hundred bytes each."""
    return f'#usda 1.0\ndef Mesh "m" {{ point3f[] points = [{", ".join(["(0,0,0)"] * count)}] }}'


def zip_bomb(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.usda", b"\0" * 30_000_000)


def repeated(count, names=False):
    """A ball of 320 faces, placed ``count`` times."""
    data = trimesh.creation.icosphere(subdivisions=2).export(file_type="glb")
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    places = ({"mesh": 0, "translation": [3.0 * (i % 300), 3.0 * (i // 300), 0.0]} for i in range(count))
    tree["nodes"] = [place | {"name": f"n{i}"} if names else place for i, place in enumerate(places)]
    tree["scenes"] = [{"nodes": list(range(count))}]
    tree["scene"] = 0
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + size :]
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk


HOSTILE = {
    "nested.usda": (nested(50_000), r"the reader process crashed \(SIG|not valid USD"),
    "usdz.usdz": (b"PK\x03\x04" + bytes(200), "not valid USD"),
    "text.usdz": ("#usda 1.0\n", "not valid USD"),
    "empty.usdc": (b"PXR-USDC" + bytes(80), "not valid USD"),
    "random.usd": (bytes(range(256)) * 8, "not valid USD"),
    "none.usda": ("#usda 1.0\n", "it has no vertices"),
    "zero.usda": ("", "not valid USD"),
    "huge.stl": (binary_stl([], 2**32 - 1), "announces 4294967295 triangles"),
    "solid.stl": ("solid a\n" + "facet\n" * 2, "line 3: a facet begins within another facet"),
    "huge.ply": (
        "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty double x\nproperty double y\n"
        "property double z\nend_header\n",
        "announces 4000000000 vertex rows, but the file ends earlier",
    ),
    "list.ply": (
        b"ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uint int vertex_indices\n"
        b"end_header\n\xff\xff\xff\xff" + bytes(40),
        "announces 1 face rows, but the file ends earlier",
    ),
    "huge.off": ("OFF\n4000000000 4000000000 0\n", "is the file cut short?"),
    "polygon.off": ("OFF\n1 1 0\n0 0 0\n999999999999 0 0 0\n", "face 0: 999999999999 or more numbers are needed"),
    "huge.glb": (glb(lambda t: t["accessors"][0].update(count=2**30)), "announces 1073741824 values"),
    "stride.glb": (glb(lambda t: t["bufferViews"][0].update(byteStride=-4)), "not valid GLB"),
    "cycle.glb": (glb(lambda t: t["nodes"][0].update(children=[0])), "node 0 is more than once in the scene"),
    "deep.glb": (glb(lambda t: t.update(extras=eval("[" * 90 + "]" * 90))), None),
    "passwd.glb": (glb(lambda t: t["buffers"][0].update(uri="../../etc/passwd")), "buffer 0 is in another file"),
}  # fmt: skip
# Cases that are similar to others, here or in test_mesh_files.
SIMILAR = (
    *("text.usdz", "empty.usdc", "zero.usda", "huge.stl", "huge.off", "polygon.off", "huge.glb", "deep.glb"),
    "passwd.glb",
)


@pytest.mark.parametrize("name", slow_except(HOSTILE, lambda name: name not in SIMILAR))
def test_malicious_mesh_file_is_refused_with_a_short_message(tmp_path, name):
    content, message = HOSTILE[name]
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    start = time.monotonic()
    if message is None:
        assert load_mesh(path).report.closed
    else:
        with pytest.raises(MeshError, match=message) as caught:
            load_mesh(path)
        assert len(str(caught.value).splitlines()) <= 3
    assert time.monotonic() - start < SECONDS


@pytest.mark.smoke
def test_zip_bomb_is_refused_as_usdz(tmp_path):
    zip_bomb(tmp_path / "a.usdz")
    with pytest.raises(MeshError, match="not valid USD"):
        load_mesh(tmp_path / "a.usdz")


TOO_LONG = r"reading and examining it takes more than {0} s of processor time; allowed: {0} s, see Limits"


def processor_time():
    """Processor time of ended child processes [s], which does not depend on the load of the machine."""
    times = os.times()
    return times.children_user + times.children_system


def test_endless_usd_composition_is_stopped_by_processor_time(tmp_path):
    (tmp_path / "a.usda").write_text(doubling(30))
    start = processor_time()
    with pytest.raises(MeshError, match=TOO_LONG.format(1.5)):
        load_mesh(tmp_path / "a.usda", limits=Limits(seconds=1.5))
    assert processor_time() - start < 3.0


@POSIX
def test_reader_that_waits_longer_than_its_processor_time_succeeds(tmp_path, monkeypatch):
    (tmp_path / "a.stl").write_bytes(STL)
    # As on a busy machine: the process exists for longer than the limit but uses less processor time.
    start = isolation._START.replace("main(request)", "import time; time.sleep(2.0); main(request)")
    monkeypatch.setattr(isolation, "_START", start)
    assert load_mesh(tmp_path / "a.stl", limits=Limits(seconds=2.0)).report.closed


@POSIX
def test_reader_that_computes_longer_than_its_processor_time_is_stopped(tmp_path, monkeypatch):
    (tmp_path / "a.stl").write_bytes(STL)
    busy = (
        "import signal; from warpcontact.meshes.reader_process import limit; limit(2**32, {seconds}); {first}\n"
        "while True: pass"
    )
    start = isolation._START.replace("main(request)", "")
    for first in ("", "signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGPROF])"):
        monkeypatch.setattr(isolation, "_START", start + busy.format(seconds=0.5, first=first))
        with pytest.raises(MeshError, match=TOO_LONG.format(0.5)):
            load_mesh(tmp_path / "a.stl", limits=Limits(seconds=0.5))


def test_blocked_reader_is_stopped_by_wall_clock(tmp_path, monkeypatch):
    (tmp_path / "a.stl").write_bytes(STL)
    assert isolation.max_wall_time(20.0) in (300.0, 20.0)  # 20 on Windows
    monkeypatch.setattr(isolation, "max_wall_time", lambda seconds: 0.5)
    monkeypatch.setattr(isolation, "_START", "import time; time.sleep(60)")
    with pytest.raises(MeshError, match=r"did not end within 0.5 s of wall-clock time|takes more than 0.5 s"):
        load_mesh(tmp_path / "a.stl")


LINUX = pytest.mark.skipif(sys.platform != "linux", reason="only Linux keeps the limit on address space")
MEMORY = (
    r"the file needs more memory than allowed|crashed \(SIG(ABRT|SEGV|BUS|KILL)\), .* or needs more, see Limits"
)


def cloud(size):
    """Returns a stage with ``size`` points and one face."""
    points = ",".join(f"({i},{i % 7},{i % 5})" for i in range(size))
    rows = f"point3f[] points = [{points}]", "int[] faceVertexCounts = [3]", "int[] faceVertexIndices = [1, 2, 3]"
    return "\n".join(("#usda 1.0", 'def Mesh "m" {', *rows, "}")).encode()


@LINUX
@pytest.mark.parametrize(
    ("name", "make"),
    [("a.usda", lambda: cloud(500_000)), ("a.glb", lambda: repeated(2000))],
    ids=["usda", "glb"],
)
def test_memory_is_limited_while_reading_and_examining(tmp_path, name, make):
    path = tmp_path / name
    path.write_bytes(make())
    assert examine_file(path).face_count > 0
    with pytest.raises(MeshError, match=MEMORY):
        load_mesh(path, limits=Limits(memory=400 * 2**20))


# Loads a file in a process: prints the processor time of its reader [s], its own size [bytes], and the result.
CALLER = """
import os, pathlib, sys
from warpcontact.meshes import MeshError, load_mesh
try:
    found = f"{len(load_mesh(sys.argv[1]).faces)} faces"
except MeshError as error:
    found = str(error)
seconds = os.times().children_user + os.times().children_system
# Since it began to run its program; resource.getrusage counts what who started it took, too.
told = dict(line.split(":", 1) for line in pathlib.Path("/proc/self/status").read_text().splitlines())
print(seconds, int(told["VmHWM"].split()[0]) * 1024, found)
"""


@LINUX
@pytest.mark.parametrize(
    ("count", "names", "message"),
    [
        (16_000, False, "the file has 5000320 triangles or more; allowed: 5000000, see Limits"),
        pytest.param(15_000, False, "takes more than 20 s|more memory|faces", marks=pytest.mark.slow),
        pytest.param(8_000, True, "takes more than 20 s|more memory|faces", marks=pytest.mark.slow),
    ],
)
def test_many_instances_are_bounded_in_time_and_memory(tmp_path, count, names, message):
    path = tmp_path / "a.glb"
    path.write_bytes(repeated(count, names))
    words = [sys.executable, "-c", CALLER, str(path)]
    result = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60)
    seconds, memory, found = result.stdout.split(maxsplit=2)
    assert re.search(message, found)
    assert float(seconds) < SECONDS + 1.0
    assert int(memory) < 2**30


def test_processor_time_limit_includes_examination_and_repair(tmp_path):
    path = tmp_path / "a.glb"
    path.write_bytes(repeated(10_000))
    for repair in (False, True):
        start = processor_time()
        with pytest.raises(MeshError, match=TOO_LONG.format(1.5)):
            load_mesh(path, repair=repair, limits=Limits(seconds=1.5))
        assert processor_time() - start < 3.0


@POSIX
def test_reader_without_system_limit_stops_itself():
    # As on macOS, which does not enforce the limit on address space.
    code = (
        "import sys, threading; from warpcontact.meshes.reader_process import watch;"
        "threading.Thread(target=watch, args=(2 * 10**8,), daemon=True).start();"
        "fill = [bytearray(10**7) for _ in range(10**6)]"
    )
    start = time.monotonic()
    result = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True)
    assert result.returncode == isolation.OUT_OF_MEMORY
    assert time.monotonic() - start < SECONDS
    assert "more memory" in isolation._reason(result.returncode, False, Limits(), [])


def test_too_many_triangles_are_refused_before_allocation(tmp_path):
    (tmp_path / "a.glb").write_bytes(repeated(5_000))
    for trusted in (False, True):
        with pytest.raises(MeshError, match="allowed: 1000, see Limits"):
            load_mesh(tmp_path / "a.glb", limits=Limits(faces=1000), trusted=trusted)
    (tmp_path / "a.stl").write_bytes(STL)
    with pytest.raises(MeshError, match="the file has 4 triangles or more; allowed: 3, see Limits"):
        load_mesh(tmp_path / "a.stl", limits=Limits(faces=3))


def test_limits_are_validated_and_read_from_environment_variables(monkeypatch, tmp_path):
    assert Limits() == Limits(memory=4 * 2**30, seconds=20.0, faces=5_000_000)
    for options in ({"memory": 0}, {"memory": 1e9}, {"seconds": -1.0}, {"seconds": np.inf}, {"faces": True}):
        with pytest.raises(ValueError, match=rf"Limits.{next(iter(options))} must be a positive finite"):
            Limits(**options)
    monkeypatch.setenv("WARPCONTACT_MESH_SECONDS", "7.5")
    monkeypatch.setenv("WARPCONTACT_MESH_GIB", "2")
    assert (Limits().seconds, Limits().memory) == (7.5, 2**31)
    monkeypatch.setenv("WARPCONTACT_MESH_SECONDS", "soon")
    (tmp_path / "a.stl").write_bytes(STL)
    with pytest.raises(ValueError, match=r"variable WARPCONTACT_MESH_SECONDS must be a positive .*, got 'soon'"):
        load_mesh(tmp_path / "a.stl")
    with pytest.raises(ValueError, match="limits must be a Limits, got 3"):
        load_mesh(tmp_path / "a.stl", limits=3)


@POSIX
def test_crashed_reader_is_reported_with_its_signal(tmp_path, monkeypatch):
    (tmp_path / "a.stl").write_bytes(STL)
    monkeypatch.setattr(isolation, "_START", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(MeshError, match=r"the reader process crashed \(SIGSEGV\), with a limit of"):
        load_mesh(tmp_path / "a.stl")
    monkeypatch.setattr(isolation, "_START", "raise RuntimeError('no luck')")
    with pytest.raises(MeshError, match="the reader process failed: RuntimeError: no luck"):
        load_mesh(tmp_path / "a.stl")
    monkeypatch.setattr(isolation, "_START", "import sys; sys.stdout.write('1234567')")
    with pytest.raises(MeshError, match="the reader process failed"):
        load_mesh(tmp_path / "a.stl")
    monkeypatch.setattr(sys, "executable", "")
    with pytest.raises(MeshError, match="no Python executable to start the reader process"):
        load_mesh(tmp_path / "a.stl")
    assert load_mesh(tmp_path / "a.stl", trusted=True).report.closed


def answer(header, *arrays):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)


REPORT = asdict(Mesh(TETRAHEDRON, OUTWARD).report)
SOUND = {"vertices": 4, "faces": 4, "groups": [], "report": REPORT}
FACES = OUTWARD.astype("<i8")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\xff" * 8, "a header that is too long"),
        (answer(b"no json"), "JSONDecodeError"),
        (answer(b'"\xff"'), "UnicodeDecodeError"),
        (answer(b"[" * 100_000), "RecursionError"),
        (answer([1]), "TypeError"),
        (answer({}), "KeyError: 'vertices'"),
        (answer({key: value for key, value in SOUND.items() if key != "report"}, TETRAHEDRON, FACES), "KeyError"),
        (answer(SOUND | {"report": {}}, TETRAHEDRON, FACES), "KeyError"),
        (answer(SOUND | {"report": REPORT | {"more": 1}}, TETRAHEDRON, FACES), "TypeError"),
        (answer(SOUND | {"vertices": -1}, TETRAHEDRON, FACES), "ValueError"),
        (answer(SOUND | {"vertices": "4"}, TETRAHEDRON, FACES), "TypeError"),
        (answer(SOUND | {"faces": 10**9}, TETRAHEDRON, FACES), "more than is allowed"),
        (answer(SOUND | {"groups": [["a", 10**12]]}, TETRAHEDRON, FACES), "more than is allowed"),
        (answer(SOUND | {"groups": [["a", 1]]}, TETRAHEDRON, FACES, np.array([9])), "an invalid mesh"),
        (answer(SOUND, TETRAHEDRON, FACES + 1), "an invalid mesh"),
        (answer(SOUND, TETRAHEDRON * np.nan, FACES), "an invalid mesh"),
        (answer(SOUND, TETRAHEDRON), "the reader process failed"),
    ],
)
def test_malformed_answer_of_reader_is_one_message(data, message):
    with pytest.raises((Unreadable, EOFError), match=message if "failed" not in message else None):
        isolation._answer(io.BytesIO(data), Limits())


def test_malformed_answer_of_reader_makes_the_file_unreadable(tmp_path, monkeypatch):
    (tmp_path / "a.stl").write_bytes(STL)
    for data in (answer(b"no json"), answer({})):
        monkeypatch.setattr(isolation, "_START", f"import sys; sys.stdout.buffer.write({data!r})")
        with pytest.raises(MeshError, match=r"a.stl': the reader process answered with"):
            load_mesh(tmp_path / "a.stl")
        assert examine_file(tmp_path / "a.stl").errors


def test_internal_error_of_the_reader_is_reported(tmp_path, monkeypatch):
    (tmp_path / "a.stl").write_bytes(STL)
    start = isolation._START.replace("main(request)", "request['task']['more'] = 1; main(request)")
    monkeypatch.setattr(isolation, "_START", start)
    with pytest.raises(MeshError, match=r"the reader process failed: TypeError: .*more"):
        load_mesh(tmp_path / "a.stl")


@pytest.mark.smoke
def test_mesh_loads_from_unguarded_script_deleted_folder_and_threads(tmp_path):
    (tmp_path / "a.stl").write_bytes(STL)
    folder = tmp_path / "gone"
    folder.mkdir()
    # The reader must not import modules next to the script or in the current folder.
    (tmp_path / "json.py").write_text("raise SystemExit('the wrong json')")
    script = tmp_path / "script.py"
    script.write_text(
        "import sys; sys.path.remove(sys.path[0])\n"
        "import os, shutil, threading, warpcontact as wc\n"
        f"os.chdir({str(folder)!r}); shutil.rmtree({str(folder)!r})\n"
        f"load = lambda: print(len(wc.load_mesh({str(tmp_path / 'a.stl')!r}).faces))\n"
        "load()\n"
        "thread = threading.Thread(target=load); thread.start(); thread.join()\n"
    )
    result = subprocess.run(
        [sys.executable, "-W", "error", script], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (result.stdout.split(), result.stderr) == (["4", "4"], "")


def test_mesh_files_can_be_read_concurrently(tmp_path):
    for i in range(6):
        (tmp_path / f"{i}.stl").write_bytes(binary_stl((TETRAHEDRON * (i + 1))[OUTWARD]))
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(load_mesh, sorted(tmp_path.glob("*.stl"))))
    assert [mesh.bounds[1, 0] for mesh in found] == [1, 2, 3, 4, 5, 6]


@pytest.mark.skipif(
    os.name != "posix" or not hasattr(os, "mkfifo"), reason="pipes in folders are a matter of POSIX"
)
def test_named_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "a.stl")
    with pytest.raises(MeshError, match="is not a regular file"):
        load_mesh(tmp_path / "a.stl")


def test_file_name_with_special_characters_is_read(tmp_path):
    path = tmp_path / "ümläut 'quoted' \n [x].usda"
    try:
        path.write_text("#usda 1.0\n")
    except OSError:
        pytest.skip("the file system has no such names")
    with pytest.raises(MeshError, match="it has no vertices"):
        load_mesh(path)


def test_mesh_reader_leaves_no_files_or_processes(tmp_path):
    (tmp_path / "a.stl").write_bytes(STL)
    before = set(os.listdir(tmp_path))
    load_mesh(tmp_path / "a.stl")
    assert set(os.listdir(tmp_path)) == before
    if shutil.which("pgrep"):
        words = ["pgrep", "-P", str(os.getpid()), "-f", "reader_process"]
        assert subprocess.run(words, capture_output=True, check=False).stdout == b""


def test_trusted_and_sandboxed_loading_give_the_same_mesh(shared_data):
    for name in ("Duck.glb", "featuretype.STL", "fandisk.obj", "ballA.off"):
        path = shared_data / "meshes" / name
        apart, here = load_mesh(path), load_mesh(path, trusted=True)
        assert isinstance(apart, Mesh)
        np.testing.assert_array_equal(apart.vertices, here.vertices)
        np.testing.assert_array_equal(apart.faces, here.faces)
        assert apart.report == here.report
        assert apart.groups.keys() == here.groups.keys()


def test_large_mesh_is_transferred_completely(tmp_path):
    corners = np.concatenate([box().vertices[box().faces] + (3.0 * i, 0, 0) for i in range(500)])
    (tmp_path / "a.stl").write_bytes(binary_stl(corners))
    mesh = load_mesh(tmp_path / "a.stl")
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], corners)
    assert mesh.report.component_count == 500
