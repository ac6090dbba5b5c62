"""Reader of STL, binary and text. The solids of a text file are joined; their names become groups."""

import struct

import numpy as np

from warpcontact.meshes.readers.content import Content, Groups, Unreadable, numbers

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(data: bytes) -> Content:
    """Returns the triangles of an STL file, each with three vertices of its own."""
    header_count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else None
    # Decide by the size, because many binary files begin with "solid" too.
    if header_count is not None and len(data) == 84 + 50 * header_count:
        return _separate_triangles(np.frombuffer(data, dtype=_RECORD, offset=84)["corners"].astype(np.float64))
    text = data.lstrip()
    if text[:5].lower() != b"solid" or b"\0" in text:
        if header_count is None:
            raise Unreadable(f"{len(data)} bytes are too few for a binary STL, and the file is not a text STL")
        raise Unreadable(
            f"the header announces {header_count} triangles, so {84 + 50 * header_count} bytes of binary STL, but "
            f"the file has {len(data)} bytes"
        )
    return _read_text(text)


def _separate_triangles(corners: np.ndarray) -> Content:
    return Content(corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int64).reshape(-1, 3))


def _read_text(text: bytes) -> Content:
    vertices: list[list[float]] = []
    groups, complete = Groups(), 0
    solid: str | None = None
    facet = False
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        kind = words[0].lower() if words else b""
        if kind == b"vertex":
            vertices.append(numbers(words[1:4], 3, f"line {number}", float))
        elif kind == b"facet":
            if facet:
                raise Unreadable(f"line {number}: a facet begins within another facet")
            facet = True
        elif kind == b"endfacet":
            facet, complete = False, complete + 1
            if len(vertices) != 3 * complete:
                corners = len(vertices) - 3 * (complete - 1)
                raise Unreadable(f"line {number}: a facet must have 3 vertices, got {corners}")
        elif kind == b"solid":
            if solid is not None:
                raise Unreadable(f"line {number}: a solid begins within solid {solid!r}")
            solid = b" ".join(words[1:]).decode(errors="replace")
            groups.set(complete, [solid])
        elif kind == b"endsolid":
            if facet:
                raise Unreadable(f"line {number}: solid {solid!r} ends within a facet")
            solid = None
        elif kind not in (b"outer", b"endloop", b"", b"end"):
            word = kind[:40].decode(errors="replace")
            raise Unreadable(f"line {number}: not valid STL, unknown keyword {word!r}")
    if facet or solid is not None or len(vertices) != 3 * complete:
        within = "a facet" if facet else "vertices" if solid is None else f"solid {solid!r}"
        raise Unreadable(f"the text ends within {within}, after {complete} triangles; is the file cut short?")
    content = _separate_triangles(np.asarray(vertices, dtype=np.float64).reshape(-1, 3, 3))
    content.groups = groups.members(complete, np.arange(complete))
    return content
