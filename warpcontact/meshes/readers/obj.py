"""OBJ (Wavefront). Names of ``g``, ``o`` and ``usemtl`` are groups."""

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
    """Returns vertices and faces of an OBJ file; normals, texture, lines, points and curves are passed over."""
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
            # Several groups may be named at once, by words; names of objects and materials may have blanks.
            named = words if kind == b"g" else [b" ".join(words)]
            current[kind] = tuple(word.decode(errors="replace") for word in named)
            groups.set(len(polygons), [name for names in current.values() for name in names])
    return from_polygons(*lists_as_arrays(vertices, polygons), groups)


def _lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines with their numbers; those that a backslash continues are one, with the number of the first."""
    begun: list[bytes] = []
    for number, line in enumerate([*data.splitlines(), b""], 1):
        if line.endswith(b"\\"):
            begun.append(line[:-1])
        else:
            yield number - len(begun), b" ".join((*begun, line))
            begun = []


def _polygon(words: list[bytes], count: int, number: int) -> list[int]:
    """Vertex numbers from 0 of the face on line ``number``, which follows ``count`` vertices."""
    corners = numbers([word.partition(b"/")[0] for word in words], 3, f"line {number}", int)
    # 1 is the first vertex of the file, −1 the last one before this line.
    polygon = [corner - 1 if corner > 0 else count + corner for corner in corners]
    if 0 in corners or min(polygon) < 0:
        raise Unreadable(
            f"line {number}: a vertex number must be from 1, or from -{count} to -1, got {corners[:20]}"
        )
    return polygon
