"""Random pairs of shapes and parametric surfaces: all are solved, all are correct, none is wrongly outside."""

import pytest
from convex_pairs import solved
from parametric_pairs import PATCHES, Bore, Quadric, Tube, Waves, check_points, classify_contacts, random_pairs
from parametric_reference import SIZES
from warpcontact.kernels import shapes as S
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.kernels.types import MET

COMBINATIONS = [(A, P) for A in SIZES for P in PATCHES if A not in (S.Plane, S.Superellipsoid)]
names = {"ids": lambda pair: "-".join(kind.__name__ for kind in pair)}


def check(A, P, count, seed, device):
    pairs = random_pairs(A, P, count, seed)
    contacts = solved(A, P, *pairs[:4], device=device)
    verdict = classify_contacts(A, P, pairs, contacts, device)
    counts = {name: mask.sum() for name, mask in verdict.items()}
    assert counts["wrong"] == counts["lost"] == counts["missed"] == 0, counts
    check_points(A, P, pairs, contacts)
    return counts


@pytest.mark.slow
@pytest.mark.parametrize(
    "pair", [(S.RoundedBox, Quadric), (S.Cylinder, Bore), (Torus, Waves), (S.Cone, Tube)], **names
)
def test_parametric_surface_contact_is_the_deepest_or_nearest(pair, device):
    counts = check(*pair, 2000, 7, device)
    assert counts["met"] > 1900
    assert counts["deep"] > 800
    # Most have a penetration beyond their center.
    assert counts["lowered"] > 600


@pytest.mark.slow
@pytest.mark.parametrize(("P", "row"), [(Quadric, 1096), (Quadric, 14853), (Waves, 3301), (Bore, 16094)])
def test_superellipsoid_normal_on_parametric_surface_is_exact_below_distance_rounding(P, row):
    """If a step changes the distance by less than rounding, normals were off by 6e-10 to 9e-8."""
    a, b, x, q, _ = random_pairs(S.Superellipsoid, P, 25_000, 100)
    own = slice(row, row + 1)
    a, b = ({name: value[own] for name, value in sizes.items()} for sizes in (a, b))
    contacts = solved(S.Superellipsoid, P, a, b, x[own], q[own])
    assert contacts["status"] == MET
    # Cosine with the tangents: rounding of the point over the distance.
    assert contacts["residual"] < 1e-13
    check_points(S.Superellipsoid, P, (a, b), contacts)


@pytest.mark.parametrize(
    "P", [Quadric, pytest.param(Waves, marks=pytest.mark.slow)], ids=lambda kind: kind.__name__
)
def test_plane_contact_with_parametric_surface_is_at_the_deepest_point_or_edge(P, device):
    counts = check(S.Plane, P, 2000, 7, device)
    assert counts["met"] > 100


@pytest.mark.slow
@pytest.mark.parametrize("pair", COMBINATIONS, **names)
def test_many_random_shape_and_parametric_surface_pairs_match_reference(pair, times, device):
    """20 000 of each shape on four surfaces, or 100 000 with --thorough."""
    count = 5000 * times
    counts = check(*pair, count, 100, device)
    assert counts["met"] > 0.96 * count
    # Few have a penetration above half the radius of curvature of the surface.
    assert counts["too deep"] < 0.03 * count


@pytest.mark.slow
@pytest.mark.parametrize("P", [Quadric, Waves], ids=lambda kind: kind.__name__)
def test_many_random_planes_on_parametric_surfaces_match_reference(P, times, device):
    check(S.Plane, P, 10_000 * times, 100, device)


@pytest.mark.slow
@pytest.mark.parametrize("P", PATCHES, ids=lambda kind: kind.__name__)
def test_superellipsoids_on_parametric_surfaces_match_reference(P, device):
    """The reference takes 0.4 s per pair, 20 times the solver. A separate run of 25 000 pairs had no error."""
    counts = check(S.Superellipsoid, P, 100, 100, device)
    assert counts["met"] > 95
    assert counts["deep"] > 30
    assert counts["lowered"] > 25
