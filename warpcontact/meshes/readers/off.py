"""Reader of OFF, text."""

import re

from warpcontact.meshes.readers.content import Content, Unreadable, from_polygons, lists_as_arrays, numbers


def read_off(data: bytes) -> Content:
    """Returns vertices and faces of an OFF file; colors and normals are ignored."""
    lines = [line.partition(b"#")[0].split() for line in data.splitlines()]
    lines = [words for words in lines if words]
    if not lines or not re.fullmatch(rb"(ST)?C?N?OFF", lines[0][0]):
        raise Unreadable("no OFF header")
    # The counts may be on the header line.
    lines = [lines[0][1:], *lines[1:]] if len(lines[0]) > 1 else lines[1:]
    vertex_count, face_count = numbers(lines[0][:2] if lines else [], 2, "the line of counts", int)
    if min(vertex_count, face_count) < 0 or len(lines) < 1 + vertex_count + face_count:
        raise Unreadable(
            f"the header announces {vertex_count} vertices and {face_count} faces, but {len(lines) - 1} "
            "lines follow; is the file cut short?"
        )
    vertices = [numbers(words[:3], 3, f"vertex {i}", float) for i, words in enumerate(lines[1 : 1 + vertex_count])]
    polygons = []
    for i, words in enumerate(lines[1 + vertex_count : 1 + vertex_count + face_count]):
        corners = numbers(words[:1], 1, f"face {i}", int)[0]
        polygons.append(numbers(words[1 : 1 + max(corners, 0)], max(corners, 3), f"face {i}", int))
    return from_polygons(*lists_as_arrays(vertices, polygons))
