"""Stages with very many colliders: memory grows with their number and not with their pairs, or they are rejected."""

import tracemalloc
from itertools import combinations, islice

import numpy as np
import pytest
from physics_stages import BODY, COLLIDER, moved, prim, stage

import warpcontact as wc
from warpcontact.usd.importing import physics
from warpcontact.usd.importing.contacts import group_particles, other_pairs, pairs_within_groups
from warpcontact.usd.importing.scene_from_stage import element_names

FREE = BODY.replace("PhysicsMassAPI", "PhysicsCollisionAPI")


def many(kind, size, count):
    return "".join(prim(kind, f"part_{i}", FREE, size + "\n" + moved(3 * i, 0, 0)) for i in range(count))


@pytest.mark.slow
def test_memory_to_import_many_spheres_is_linear(tmp_path):
    count = 2000
    path = stage(tmp_path, many("Sphere", "double radius = 1", count))
    tracemalloc.start()
    try:
        scene = wc.Scene.from_usd(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    (contact,) = scene.particle_contacts
    assert (contact.count, len(scene.shape_contacts), len(scene.contacts)) == (count, 0, 0)
    # A body and a shape with all attributes need some kilobytes; all pairs would need 200 kB each.
    assert peak < 30_000 * count


def test_too_many_pairs_outside_particle_contacts_are_refused(tmp_path):
    path = stage(tmp_path, many("Cube", "double size = 1", 150))  # 11 175 pairs
    with pytest.raises(wc.UsdError, match="more than 10000 pairs of colliders can be in contact") as raised:
        wc.Scene.from_usd(path)
    assert len(raised.value.problems) == 1


def test_pair_count_stops_at_the_limit_without_a_list_of_pairs(monkeypatch):
    count = 3000  # 4.5 million pairs
    mask_sizes = []
    find = np.flatnonzero
    monkeypatch.setattr(np, "flatnonzero", lambda mask: mask_sizes.append(len(mask)) or find(mask))
    free = np.arange(count), np.ones(count, dtype=bool), np.full(count, -1), np.empty((0, 2), dtype=np.int64)
    assert len(list(islice(other_pairs(*free), 10_001))) == 10_001
    # Each evaluation of the row of one collider finds almost 3000 pairs.
    assert len(mask_sizes) == 4


def test_generated_pairs_equal_a_filtered_list_of_all_pairs():
    random = np.random.default_rng(3)
    for _ in range(20):
        count = int(random.integers(1, 25))
        bodies, keys = random.integers(0, 12, count), random.integers(0, 4, count)
        moves = random.random(12)[bodies] < 0.7
        groups = group_particles([None if key == 0 else int(key) for key in keys], 4)
        every = list(combinations(range(count), 2))
        chosen = sorted(pair for pair in every if random.random() < 0.2)
        apart = np.array(chosen, dtype=np.int64).reshape(-1, 2)
        same = {(i, j) for i, j in every if groups[i] == groups[j] >= 0}
        expected = [
            (i, j)
            for i, j in every
            if (moves[i] or moves[j]) and bodies[i] != bodies[j] and (i, j) not in same | set(chosen)
        ]
        assert list(other_pairs(bodies, moves, groups, apart)) == expected
        held = [
            {pair for pair in chosen if groups[pair[0]] == groups[pair[1]] == k} for k in range(groups.max() + 1)
        ]
        assert [set(map(tuple, one.tolist())) for one in pairs_within_groups(groups, apart)] == held


def test_particle_groups_exceed_the_minimum_size_and_are_numbered_in_order():
    keys = ["b", "a", None, "b", "c", "a", "b", None, None]
    assert group_particles(keys, 1).tolist() == [0, 1, -1, 0, -1, 1, 0, -1, -1]
    assert group_particles([], 1).tolist() == []


def test_filtered_pair_is_excluded_within_its_particle_contact_only(tmp_path):
    apis = FREE.replace('API"]', 'API", "PhysicsFilteredPairsAPI"]')
    filtered = "rel physics:filteredPairs = [</part_3>, </wall>]\n"
    first = prim("Sphere", "first", apis, "double radius = 1\n" + filtered + moved(0, 9, 0))
    wall = prim("Cube", "wall", COLLIDER, "double size = 1")
    scene = wc.Scene.from_usd(stage(tmp_path, wall + first + many("Sphere", "double radius = 1", 40)))
    (contact,) = scene.particle_contacts
    assert [(one.name, other.name) for one, other in contact.excluded] == [("first_2", "part_3_2")]
    assert len(scene.shape_contacts) == 40


@pytest.mark.parametrize(("apis", "what"), [(FREE, "rigid bodies"), (COLLIDER, "colliders")])
def test_number_of_bodies_and_colliders_is_limited(tmp_path, monkeypatch, apis, what):
    monkeypatch.setattr(physics, "MOST", 2)
    content = "".join(prim("Sphere", f"part_{i}", apis) for i in range(3))
    with pytest.raises(wc.UsdError, match=rf"the stage has 3 {what}; allowed: 2"):
        wc.Scene.from_usd(stage(tmp_path, content), trusted=True)


def test_many_equal_names_are_made_unique_by_numbers():
    names = element_names([f"/{i}/ball" for i in range(20_000)] + ["/ball_7", "/ball"])
    assert names[:2] + names[-3:] == ["ball", "ball_2", "ball_20000", "ball_7_2", "ball_20001"]
    assert len(set(names)) == len(names)
