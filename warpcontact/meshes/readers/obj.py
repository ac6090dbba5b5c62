"""Reader of OBJ (Wavefront). Names of ``g``, ``o`` and ``usemtl`` become groups."""

from collections.abc import Iterator

from warpcontact.meshes.readers.content import (
    Content,
    Groups,
    Unreadable,
    from_polygons,
    lists_as_arrays,
    numbers,
)

_NAMES = (b"o", b"g", b"usemtl")


def read_obj(data: bytes) -> Content:
    """Returns vertices and faces of an OBJ file; normals, textures, lines, points and curves are ignored."""
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    groups, current = Groups(), dict[bytes, tuple[str, ...]]()
    for number, line in _lines(data):
        kind, *words = line.partition(b"#")[0].split() or [b""]
        if kind == b"v":
            vertices.append(numbers(words[:3], 3, f"line {number}", float))
        elif kind == b"f":
            polygons.append(_polygon(words, len(vertices), number))
        elif kind in _NAMES:
            # ``g`` can name several groups, separated by blanks; names of objects and materials may contain blanks.
            named = words if kind == b"g" else [b" ".join(words)]
            current[kind] = tuple(word.decode(errors="replace") for word in named)
            groups.set(len(polygons), [name for names in current.values() for name in names])
    return from_polygons(*lists_as_arrays(vertices, polygons), groups)


def _lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Iterates over lines and their numbers; lines continued by a backslash are joined, with the first number."""
    pending: list[bytes] = []
    for number, line in enumerate([*data.splitlines(), b""], 1):
        if line.endswith(b"\\"):
            pending.append(line[:-1])
        else:
            yield number - len(pending), b" ".join((*pending, line))
            pending = []


def _polygon(words: list[bytes], count: int, number: int) -> list[int]:
    """Returns the 0-based vertex indices of the face on line ``number``, which follows ``count`` vertices."""
    corners = numbers([word.partition(b"/")[0] for word in words], 3, f"line {number}", int)
    # 1 is the first vertex of the file, −1 the last one before this line.
    polygon = [corner - 1 if corner > 0 else count + corner for corner in corners]
    if 0 in corners or min(polygon) < 0:
        raise Unreadable(
            f"line {number}: a vertex number must be from 1, or from -{count} to -1, got {corners[:20]}"
        )
    return polygon
