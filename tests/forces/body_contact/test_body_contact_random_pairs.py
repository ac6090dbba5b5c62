"""Body contact of random pairs of closed meshes against rays from a fine subdivision of their surfaces."""

import numpy as np
import pytest
import trimesh
from column_reference import body_contact, triangles_of
from scipy.spatial.transform import Rotation

import warpcontact as wc

MATERIAL = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1.0))
SHAPES = {
    "ball": lambda: trimesh.creation.icosphere(subdivisions=2),
    "box": lambda: trimesh.creation.box((1.0, 1.5, 0.7)),
    "torus": lambda: trimesh.creation.torus(1.0, 0.35, 24, 12),
    "cylinder": lambda: trimesh.creation.cylinder(0.6, 1.2, sections=20),
    "cone": lambda: trimesh.creation.cone(0.7, 1.1, sections=16),
    "capsule": lambda: trimesh.creation.capsule(1.0, 0.5, count=(10, 10)),
}
GIVEN = ("angle_block.STL", "idler_riser.STL", "20mm-xyz-cube.stl")

# The reference counts parts of its subdivision as wholly inside or outside. Its depth is exact within the size of a part.
TOLERANCE = (0.02, 0.01, 0.004, 0.02)


def unit_mesh(shape):
    """Returns a mesh with its center of bounds at the origin and a diagonal of 1 m."""
    shape.apply_translation(-shape.bounds.mean(axis=0))
    shape.apply_scale(1.0 / np.linalg.norm(shape.extents))
    return wc.Mesh(shape.vertices, shape.faces)


def random_pair(rng, meshes):
    """Returns two meshes, their orientations, the position of the first and the size, such that they may overlap a little."""
    first, second = (meshes[name] for name in rng.choice(list(meshes), 2))
    turns = Rotation.random(2, random_state=rng)
    points = [turn.apply(np.array(mesh.vertices)) for turn, mesh in zip(turns, (first, second), strict=True)]
    direction = Rotation.random(random_state=rng).apply([0.0, 0.0, 1.0])
    # The supports touch when the first is moved along the direction by this distance; then they overlap by up to 5 % of their size.
    touching = (points[1] @ direction).max() - (points[0] @ direction).min()
    position = (touching - rng.uniform(0.015, 0.05)) * direction
    # Aligns the supporting vertices, so that overlap is likely.
    lowest, highest = points[0][(points[0] @ direction).argmin()], points[1][(points[1] @ direction).argmax()]
    across = highest - lowest
    position += across - (across @ direction) * direction + rng.uniform(-0.01, 0.01, 3)
    return first, second, turns, position, 10.0 ** rng.uniform(-3.0, 3.0)


def differences(pair, part, device):
    """Returns relative differences of force, torque, depth and share from the reference, or ``None`` without overlap.

    Args:
        pair: The pair, from ``random_pair``.
        part: Sizes of the parts of the subdivision relative to the size of the meshes.
        device: Device of the model.
    """
    first, second, turns, position, size = pair
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(
        mass=1.0, inertia=(1, 1, 1), position=size * position, orientation=turns[0].as_quat(), name="body"
    )
    upper = scene.add_surface(first, body=body, scale=size, name="upper")
    lower = scene.add_surface(second, orientation=turns[1].as_quat(), scale=size, name="lower")
    scene.add_body_contact(upper, lower, MATERIAL, name="press")
    model = scene.build(envs=1, device=device, precision="float64")
    force, torque, depth, share = (
        model.sensor(f"press.{key}")[0] for key in ("force", "torque", "depth", "reference")
    )
    surfaces = [
        size * turn.apply(triangles_of(mesh).reshape(-1, 3)).reshape(-1, 3, 3)
        for turn, mesh in zip(turns, (first, second), strict=True)
    ]
    surfaces[0] = surfaces[0] + size * position
    found = []
    for h in part:
        reference = body_contact(*surfaces, h * size)
        if reference.depth == 0.0:
            return None
        moment = reference.torque - np.cross(size * position, reference.force)
        found.append(
            (
                np.linalg.norm(force - reference.force) / reference.scale,
                np.linalg.norm(torque - moment) / (reference.scale * size),
                # D is evaluated at corners, midpoints and centers only, so it may miss the deepest point of a coarse face.
                max(depth - reference.depth, 0.7 * reference.depth - depth, 0.0) / size,
                abs(share - reference.share),
            )
        )
    return np.array(found)


def check_pairs(meshes, seed, count, part, device):
    rng = np.random.default_rng(seed)
    found = [differences(random_pair(rng, meshes), part, device) for _ in range(count)]
    overlaps = np.array([one for one in found if one is not None])
    assert len(overlaps) >= 0.7 * count
    assert (overlaps[:, -1] <= TOLERANCE).all(), overlaps[:, -1].max(axis=0)
    return overlaps


def test_force_of_random_pairs_equals_that_of_rays(device):
    meshes = {name: unit_mesh(make()) for name, make in SHAPES.items()}
    check_pairs(meshes, 1, 6, [0.004], device)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_reference_of_random_pairs_converges_to_their_force(seed, shared, times, device):
    meshes = {name: unit_mesh(make()) for name, make in SHAPES.items()}
    for name in GIVEN:
        meshes[name] = unit_mesh(trimesh.load(shared / "data" / "meshes" / name, force="mesh"))
    found = check_pairs(meshes, 10 + seed, 10 * times, [0.016, 0.008, 0.004], device)
    # Halving the parts halves the difference at least on average over the pairs.
    mean = found.mean(axis=0)
    assert (mean[2, [0, 1, 3]] <= 0.6 * mean[0, [0, 1, 3]]).all(), mean
