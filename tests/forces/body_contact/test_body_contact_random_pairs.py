"""Body contact of random pairs of closed meshes: against rays from a subdivision of their surfaces, balance, and continuity."""

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
    "ring": lambda: trimesh.creation.annulus(0.5, 0.9, 0.4, sections=24),
}
# Closed, and without self-intersections.
GIVEN = (
    "angle_block.STL",
    "idler_riser.STL",
    "20mm-xyz-cube.stl",
    "featuretype.STL",
    "fandisk.obj",
    "ballA.off",
)

# The reference counts parts of its subdivision as wholly inside or outside. Its depth is exact within the size of a part.
TOLERANCE = (0.02, 0.01, 0.004, 0.02)
# Sizes of its parts relative to the size of the meshes, until it has changed by less than a fifth of the tolerance.
PARTS = 0.016 * 0.5 ** np.arange(7)


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


def overlapping(pair, device, *, envs=1, free=False):
    """Returns a model of the pair ``press``: the first mesh on a body, the second one on the world or on a body, ``free``."""
    first, second, turns, position, size = pair
    scene = wc.Scene(gravity=(0, 0, 0))
    poses = ((size * position, turns[0].as_quat()), (np.zeros(3), turns[1].as_quat()))
    solids = []
    for mesh, name, (place, turn) in zip((first, second), ("upper", "lower"), poses, strict=True):
        if free or name == "upper":
            body = scene.add_body(
                mass=1.0, inertia=(1, 1, 1), position=place, orientation=turn, name=f"{name}_body"
            )
            solids.append(scene.add_surface(mesh, body=body, scale=size, name=name))
        else:
            solids.append(scene.add_surface(mesh, orientation=turn, scale=size, name=name))
    scene.add_body_contact(*solids, MATERIAL, name="press")
    return scene.build(envs=envs, device=device, precision="float64")


def differences(pair, parts, device):
    """Returns relative differences of force, torque, depth and share from the reference for each size of parts, (parts, 4).

    The last ones are those of the first reference that has changed by less than a fifth of the tolerance, or of the finest one.
    ``None`` without overlap.

    Args:
        pair: The pair, from ``random_pair``.
        parts: Sizes of the parts of the subdivision relative to the size of the meshes.
        device: Device of the model.
    """
    first, second, turns, position, size = pair
    model = overlapping(pair, device)
    force, torque, depth, share = (
        model.sensor(f"press.{key}")[0] for key in ("force", "torque", "depth", "reference")
    )
    surfaces = [
        size * turn.apply(triangles_of(mesh).reshape(-1, 3)).reshape(-1, 3, 3)
        for turn, mesh in zip(turns, (first, second), strict=True)
    ]
    surfaces[0] = surfaces[0] + size * position
    found, last = [], None
    for h in parts:
        # Weights are those of its own D, which is compared too.
        reference = body_contact(*surfaces, h * size, depth_of_weights=depth)
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
        if last is not None:
            change = (
                np.linalg.norm(reference.force - last.force) / reference.scale,
                np.linalg.norm(reference.torque - last.torque) / (reference.scale * size),
                abs(reference.depth - last.depth) / size,
                abs(reference.share - last.share),
            )
            if (np.array(change) < 0.2 * np.array(TOLERANCE)).all():
                break
        last = reference
    return np.array(found)


def check_pairs(meshes, seed, count, parts, device):
    """Checks random pairs; returns the mean differences with the coarsest and with the finest parts, (2, 4)."""
    rng = np.random.default_rng(seed)
    found = [differences(random_pair(rng, meshes), parts, device) for _ in range(count)]
    overlaps = [one for one in found if one is not None]
    assert len(overlaps) >= 0.7 * count
    coarse, fine = (np.array([one[k] for one in overlaps]) for k in (0, -1))
    assert (fine <= TOLERANCE).all(), fine.max(axis=0)
    return coarse.mean(axis=0), fine.mean(axis=0)


def all_meshes(shared):
    meshes = {name: unit_mesh(make()) for name, make in SHAPES.items()}
    for name in GIVEN:
        meshes[name] = unit_mesh(trimesh.load(shared / "data" / "meshes" / name, force="mesh"))
    return meshes


def test_force_of_random_pairs_equals_that_of_rays(device):
    meshes = {name: unit_mesh(make()) for name, make in SHAPES.items()}
    check_pairs(meshes, 1, 6, [0.004], device)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_reference_of_random_pairs_converges_to_their_force(seed, shared, times, device):
    coarse, fine = check_pairs(all_meshes(shared), 10 + seed, 10 * times, PARTS, device)
    # At least half of the size of parts, and the difference is that at least on average over the pairs.
    assert (fine[[0, 1, 3]] <= 0.6 * coarse[[0, 1, 3]]).all(), (coarse, fine)


def along_a_path(model, pair, path, x):
    """Moves both bodies of free pairs along a path, and returns the forces (envs, 3).

    Args:
        model: Model of as many environments as ``x`` has values.
        pair: The pair.
        path: Shift of the first body [m], and its rotation vector [rad], for x from −1 to 1.
        x: Places on the path.
    """
    _, _, turns, position, size = pair
    model["upper_body.position"] = size * position + x[:, None] * path[0]
    model["upper_body.orientation"] = (Rotation.from_rotvec(x[:, None] * path[1]) * turns[0]).as_quat()
    return model.sensor("press.force")


#: Steps of a sweep, and the number of its parts, of two steps each, that are divided: those with the sharpest bends. This is done twice.
STEPS, PARTS_OF_SWEEP = 400, 4
DIVISION = STEPS // PARTS_OF_SWEEP
#: Largest change of force in a step after both divisions, relative to that in a step h of the sweep. Each division makes steps shorter by
#: q = 2 / (DIVISION - 1). Where the force has a derivative, or different ones on both sides, the ratio is about q² = 4e-4. Next to a place from
#: which on the force grows by c √distance, the last steps change it by up to c q √h, and at least one of two steps h by c √(h/3): the
#: ratio is q √3 = 0.035. A jump does not become smaller: one of 4 % of the largest change in a step is found.
NO_JUMP = 0.04


def changes_on_a_path(model, pair, path):
    """Returns the largest changes of force in a step of a sweep, and of its parts with the sharpest bends, (3,) [N]."""
    x, found = np.linspace(-1.0, 1.0, STEPS + 1)[None], []
    for _ in range(3):
        # Environments that are left over have the last place.
        places = np.append(x.ravel(), np.full(STEPS + 1 - x.size, x[-1, -1]))
        force = along_a_path(model, pair, path, places)[: x.size].reshape(*x.shape, 3)
        found.append(np.linalg.norm(np.diff(force, axis=1), axis=2).max())
        bends = np.linalg.norm(np.diff(force, 2, axis=1), axis=2)
        parts, starts = np.unravel_index(np.argsort(-bends, axis=None)[:PARTS_OF_SWEEP], bends.shape)
        x = np.linspace(x[parts, starts], x[parts, starts + 2], DIVISION, axis=1)
    return np.array(found)


def random_sweep(rng, meshes, device):
    """Returns a random pair, a path, and a model with an environment for each place of a sweep."""
    pair = random_pair(rng, meshes)
    path = 0.03 * pair[-1] * rng.uniform(-1, 1, 3), rng.uniform(-0.1, 0.1, 3)
    return pair, path, overlapping(pair, device, envs=STEPS + 1, free=True)


def test_force_of_columns_that_enter_a_mesh_does_not_jump(device):
    """A torus and a ring, in whose overlap columns enter a solid, and leave it through several faces that hide each other."""
    meshes = {name: unit_mesh(make()) for name, make in SHAPES.items()}
    pair, path, model = random_sweep(np.random.default_rng(9), meshes, device)
    changes = changes_on_a_path(model, pair, path)
    assert 0.0 < changes[2] < NO_JUMP * changes[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_forces_of_random_pairs_balance_and_do_not_jump(seed, shared, times, device):
    meshes, rng, touching = all_meshes(shared), np.random.default_rng(20 + seed), 0
    for number in range(10 * times):
        pair, path, model = random_sweep(rng, meshes, device)
        size = pair[-1]
        changes = changes_on_a_path(model, pair, path)
        if changes[0] == 0.0:
            continue
        touching += 1
        assert changes[2] < NO_JUMP * changes[0], (number, changes)
        # Masses and inertias are 1: velocities are impulses.
        x = np.linspace(-1.0, 1.0, STEPS + 1)
        scale = np.linalg.norm(along_a_path(model, pair, path, x), axis=1).max()
        dt = 1e-6 / max(1.0, np.sqrt(scale))
        wc.Simulation(model, dt=dt).step()
        momentum = sum(model.sensor(f"{name}_body.linear_velocity") for name in ("upper", "lower"))
        place = size * pair[3] + x[:, None] * path[0]
        turn = sum(model.sensor(f"{name}_body.angular_velocity") for name in ("upper", "lower"))
        turn += np.cross(place, model.sensor("upper_body.linear_velocity"))
        assert np.abs(momentum).max() < 1e-14 * dt * scale
        assert np.abs(turn).max() < 1e-14 * dt * scale * size
    assert touching >= 7 * times
