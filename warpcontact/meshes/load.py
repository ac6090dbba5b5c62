"""Meshes from files: STL, OBJ, PLY, OFF and GLB.

Files come from anywhere, and the readers of trimesh guess where they should refuse: they wrap OBJ index 0,
count negative OBJ indices from the wrong end, sort faces by material, and drop what is missing at the end
of a file that was cut short. What can be told from the bytes is therefore checked before or after trimesh
reads them; OBJ and OFF, in which most of this happens and which are simple, are read here. No other file
is opened, whatever the mesh file refers to. Nothing is repaired: face i of the mesh is face i of the file
(unless the file has polygons, which the report then says).
"""

import json
import re
import struct
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.mesh import Mesh, MeshError, positive
from warpcontact.meshes.report import MeshReport, examine

# Vertices (V, 3), faces (F, 3), and what the reader wants to have said about them.
_Content = tuple[npt.NDArray[Any], npt.NDArray[Any], list[str]]


class _Unreadable(ValueError):
    """What is wrong with the content of a file, as one sentence without the name of the file."""


def load_mesh(path: str | PathLike[str], *, scale: float = 1.0, name: str | None = None) -> Mesh:
    """Load a triangle mesh from a file.

    Args:
        path: An .stl (binary or text), .obj, .ply, .off or .glb file, in upper or lower case. The parts of a
            GLB scene, and the solids of a text STL, are joined, each in its place.
        scale: Factor from the unit of the file to m, for instance 0.001 for millimetres; positive.
        name: Name of the mesh; by default that of the file without its extension.

    Returns:
        The mesh. Its ``report.warnings`` say what to know before using it.

    Raises:
        MeshError: If the file cannot be read, is damaged, or is no usable mesh; names the file and every
            problem found.
        ValueError: If ``scale`` is not positive and finite, or ``name`` is empty.
    """
    if name is not None and (not isinstance(name, str) or not name):
        raise ValueError(f"name must be a non-empty string, got {name!r}")
    return Mesh._examined(*_examined(Path(path), scale, name), f"mesh file {str(path)!r}")


def examine_file(path: str | PathLike[str], *, scale: float = 1.0) -> MeshReport:
    """Report on a mesh file, usable or not.

    Args:
        path: The file, as for :func:`load_mesh`.
        scale: Factor from the unit of the file to m; positive.

    Returns:
        The report. If :func:`load_mesh` would refuse the content, ``errors`` says why.

    Raises:
        MeshError: If there is nothing to report on: the file is missing, not a file, or may not be read.
        ValueError: If ``scale`` is not positive and finite.
    """
    return _examined(Path(path), scale, None)[2]


def _examined(path: Path, scale: float, name: str | None) -> tuple[npt.NDArray[Any], npt.NDArray[Any], MeshReport]:
    """Vertices [m] and faces of a file, empty if it is not readable, and the report on them."""
    factor, title = positive("scale", scale), path.stem if name is None else name
    data = _bytes(path)
    try:
        if path.suffix.lower() not in _READERS:
            raise _Unreadable(f"the extension {path.suffix!r} is not one of {', '.join(_READERS)}")
        if not data:
            raise _Unreadable("the file is empty")
        vertices, faces, notes = _parse(data, path.suffix.lower())
    except _Unreadable as error:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), MeshReport(title, errors=(str(error),))
    with np.errstate(over="ignore"):  # infinity is refused by the examination
        vertices = np.asarray(vertices, dtype=np.float64) * factor
    report = examine(vertices, faces, title)
    return vertices, faces, replace(report, warnings=(*notes, *report.warnings))


def _bytes(path: Path) -> bytes:
    if not path.exists():
        raise MeshError(f"mesh file {str(path)!r} does not exist")
    if not path.is_file():  # a directory, or a pipe, which would be waited for
        raise MeshError(f"mesh file {str(path)!r} is not a regular file")
    try:
        return path.read_bytes()
    except OSError as error:
        raise MeshError(f"mesh file {str(path)!r} cannot be read: {error.strerror or error}") from error


def _parse(data: bytes, suffix: str) -> _Content:
    """Run the reader for ``suffix``; whatever stops it becomes one sentence."""
    try:
        with warnings.catch_warnings():
            # Older NumPy only warns that it stopped at a word that is no number; newer raises.
            warnings.filterwarnings("error", message="string or file could not be read to its end")
            return _READERS[suffix](data)
    except _Unreadable:
        raise
    # Readers of damaged files stop with anything: KeyError, AssertionError, RecursionError, MemoryError.
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise _Unreadable(
            f"the content is not valid {suffix[1:].upper()} ({type(error).__name__}: {reason})"
        ) from error


def _read_stl(data: bytes) -> _Content:
    announced = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else None
    # The size decides and not the first word, which is "solid" in many binary files too.
    if announced is not None and len(data) == 84 + 50 * announced:
        return _trimesh(data, "stl")
    text = data.lstrip().lower()
    if not text.startswith(b"solid") or b"\0" in text:
        if announced is None:
            raise _Unreadable(f"{len(data)} bytes are too few for a binary STL, and it is no text STL")
        raise _Unreadable(
            f"the header announces {announced} triangles, so {84 + 50 * announced} bytes of binary STL, but "
            f"the file has {len(data)} bytes"
        )
    # A name in an old encoding must not stop the reader, which takes UTF-8 only.
    vertices, faces, notes = _trimesh(data.decode(errors="replace").encode(), "stl")
    announced = len(re.findall(rb"\bvertex\b", text))
    if announced != 3 * len(faces):
        raise _Unreadable(
            f"{announced} vertices are in the text, but only {len(faces)} triangles in complete solids; "
            "is the file cut short?"
        )
    return vertices, faces, notes


def _read_ply(data: bytes) -> _Content:
    head, end, body = data.partition(b"end_header")
    counts = {kind: int(count) for kind, count in re.findall(rb"(?m)^\s*element\s+(\S+)\s+(\d+)", head)}
    if not head.startswith(b"ply") or not end:
        raise _Unreadable("there is no PLY header")
    if re.search(rb"(?m)^\s*format\s+ascii", head):
        lines, announced = len(body.split(b"\n", 1)[-1].splitlines()), sum(counts.values())
        if lines < announced:
            raise _Unreadable(
                f"the header announces {announced} lines, but there are {lines}; is the file cut short?"
            )
    # Without textures there is nothing to split vertices for.
    vertices, faces, notes = _trimesh(data, "ply", fix_texture=False)
    announced = counts.get(b"face", 0)
    if len(faces) < announced:
        raise _Unreadable(f"the header announces {announced} faces, but only {len(faces)} could be read")
    if len(faces) > announced:
        notes.append(_split_note(announced, len(faces)))
    return vertices, faces, notes


def _read_glb(data: bytes) -> _Content:
    if len(data) < 20 or data[:4] != b"glTF":
        raise _Unreadable("there is no GLB header")
    length, header = struct.unpack_from("<II", data, 8)
    if length != len(data):
        raise _Unreadable(f"the header announces {length} bytes, but the file has {len(data)}")
    tree = json.loads(data[20 : 20 + header])
    for i, buffer in enumerate(tree.get("buffers", [])):
        if not buffer.get("uri", "data:").startswith("data:"):
            raise _Unreadable(f"buffer {i} is in another file, {buffer['uri'][:80]!r}")
    for i, accessor in enumerate(tree.get("accessors", [])):
        # trimesh fills such an accessor with as many zeros as it asks for, whatever the memory.
        if "bufferView" not in accessor or "sparse" in accessor:
            raise _Unreadable(f"accessor {i} is compressed or sparse, which is not supported")
    modes = [part.get("mode", 4) for mesh in tree.get("meshes", []) for part in mesh["primitives"]]
    if 6 in modes:
        raise _Unreadable("it has a triangle fan, which is not supported")
    left_out = sum(mode not in (4, 5) for mode in modes)  # 4: triangles, 5: triangle strip
    vertices, faces, notes = _trimesh(data, "glb")
    if left_out:
        notes.append(f"{left_out} of {len(modes)} parts are points or lines and were left out")
    return vertices, faces, notes


def _read_obj(data: bytes) -> _Content:
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for number, line in enumerate(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines(), 1):
        kind, *words = line.partition(b"#")[0].split() or [b""]
        if kind == b"v":
            vertices.append(_numbers(words[:3], 3, f"line {number}", float))
        elif kind == b"f":
            corners = _numbers([word.partition(b"/")[0] for word in words], 3, f"line {number}", int)
            # 1 is the first vertex of the file, −1 the last one before this line.
            polygon = [corner - 1 if corner > 0 else len(vertices) + corner for corner in corners]
            if 0 in corners or min(polygon) < 0:
                raise _Unreadable(
                    f"line {number}: a vertex number must be from 1, or from -{len(vertices)} to -1, got {corners}"
                )
            polygons.append(polygon)
    return _triangles(vertices, polygons)


def _read_off(data: bytes) -> _Content:
    lines = [line.partition(b"#")[0].split() for line in data.splitlines()]
    lines = [words for words in lines if words]
    if not lines or not re.fullmatch(rb"(ST)?C?N?OFF", lines[0][0]):
        raise _Unreadable("there is no OFF header")
    # The counts may follow on the line of the header.
    lines = [lines[0][1:], *lines[1:]] if len(lines[0]) > 1 else lines[1:]
    vertex_count, face_count = _numbers(lines[0][:2] if lines else [], 2, "the line of counts", int)
    if min(vertex_count, face_count) < 0 or len(lines) < 1 + vertex_count + face_count:
        raise _Unreadable(
            f"the header announces {vertex_count} vertices and {face_count} faces, but {len(lines) - 1} "
            "lines follow; is the file cut short?"
        )
    vertices = [
        _numbers(words[:3], 3, f"vertex {i}", float) for i, words in enumerate(lines[1 : 1 + vertex_count])
    ]
    polygons = []
    for i, words in enumerate(lines[1 + vertex_count : 1 + vertex_count + face_count]):
        corners = _numbers(words[:1], 1, f"face {i}", int)[0]
        polygons.append(_numbers(words[1 : 1 + max(corners, 0)], max(corners, 3), f"face {i}", int))
    return _triangles(vertices, polygons)


_READERS: dict[str, Callable[[bytes], _Content]] = {
    ".stl": _read_stl,
    ".obj": _read_obj,
    ".ply": _read_ply,
    ".off": _read_off,
    ".glb": _read_glb,
}


def _numbers(words: Sequence[bytes], least: int, where: str, kind: Callable[[bytes], Any]) -> list[Any]:
    """At least ``least`` numbers from words."""
    try:
        values = [kind(word) for word in words]
    except ValueError:
        values = []
    if len(values) < least:
        text = b" ".join(words)[:80].decode(errors="replace")
        raise _Unreadable(f"{where}: {least} or more numbers are needed, got {text!r}")
    return values


def _triangles(vertices: list[list[float]], polygons: list[list[int]]) -> _Content:
    """Arrays of vertices and of the triangles of polygons, in their order, as fans from the first corner."""
    faces = [(polygon[0], polygon[i], polygon[i + 1]) for polygon in polygons for i in range(1, len(polygon) - 1)]
    notes = [_split_note(len(polygons), len(faces))] if len(faces) != len(polygons) else []
    return np.array(vertices).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3), notes


def _split_note(polygons: int, triangles: int) -> str:
    return (
        f"{polygons} faces of the file, some with more than three corners, became {triangles} triangles "
        "(right for convex ones); face numbers are those of the triangles"
    )


def _trimesh(data: bytes, kind: str, **options: Any) -> _Content:
    """Let trimesh read ``data``, and join the parts of the scene in the order of the file."""
    import trimesh

    # Bytes instead of a path: trimesh cannot look for other files. Nothing is merged or dropped.
    scene = trimesh.load_scene(
        BytesIO(data), file_type=kind, process=False, maintain_order=True, skip_materials=True, **options
    )
    order = {name: i for i, name in enumerate(scene.geometry)}
    nodes = [scene.graph[node] for node in scene.graph.nodes_geometry]
    vertices, faces, start = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0
    for placement, name in sorted(nodes, key=lambda node: order[node[1]]):
        geometry = scene.geometry[name]
        if kind == "glb" and not hasattr(geometry, "faces"):
            continue  # points and lines
        points = np.asarray(geometry.vertices)
        corners = np.asarray(getattr(geometry, "faces", faces[0]), dtype=np.int64).reshape(-1, 3)
        if len(nodes) > 1 and ((corners < 0) | (corners >= len(points))).any():
            # Joined, these would silently be vertices of another part.
            raise _Unreadable(f"part {name!r} has a face with an index outside its {len(points)} vertices")
        if not np.array_equal(placement, np.eye(4)):
            with np.errstate(all="ignore"):  # what overflows is refused by the examination
                points = points @ placement[:3, :3].T + placement[:3, 3]
                mirrored = np.linalg.det(placement[:3, :3]) < 0.0
            # A placement that mirrors turns the part inside out, which reversed corners undo.
            corners = corners[:, ::-1] if mirrored else corners
        vertices.append(points)
        faces.append(corners + start)
        start += len(points)
    return np.concatenate(vertices), np.concatenate(faces), []
