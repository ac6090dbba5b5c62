"""Nesting of closed components, for any number of components, closed or open."""

import time
import tracemalloc

import numpy as np
from test_meshes import OUTWARD, TETRAHEDRON

from warpcontact.meshes import Mesh, box


def joined(*parts):
    """Vertices and faces of parts (vertices, faces)."""
    starts = np.cumsum([0] + [len(v) for v, _ in parts])
    faces = [np.asarray(f) + start for (_, f), start in zip(parts, starts, strict=False)]
    return np.concatenate([v for v, _ in parts]), np.concatenate(faces)


def test_many_open_components_need_no_pairwise_nesting_test():
    count = 100_000
    place = np.random.default_rng(0).uniform(-40.0, 40.0, (count, 1, 3))
    loose = place + np.array([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)])
    triangles = (loose.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    outer = box((3.0, 3.0, 3.0))
    vertices, faces = joined((outer.vertices, outer.faces), triangles, (box().vertices, box().faces))
    tracemalloc.start()
    report = Mesh(vertices, faces).report
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert report.component_count == count + 2
    assert peak < 2**29
    # The inner box is last, after the first hundred components, which are described individually.
    vertices, faces = joined((box().vertices, box().faces), (outer.vertices, outer.faces), triangles)
    assert Mesh(vertices, faces).report.components[0].inside == 1


def test_nested_shells_are_found_or_skipped_quickly():
    def onion(count):
        shells = [(TETRAHEDRON * (i + 1) - 0.2 * (i + 1), OUTWARD) for i in range(count)]
        return Mesh(*joined(*shells)).report.components

    assert [part.inside for part in onion(50)] == [*range(1, 50), None]
    start = time.monotonic()
    onion(900)  # 400 000 pairs
    assert time.monotonic() - start < 3.0
