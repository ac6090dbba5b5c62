"""Warnings about time steps that are too long for all body contacts of a body together.

Stiffness and damping of the contacts of a body add up: a brick between others is on springs at all of its sides. Each contact
acts at the center of the common part of two bounding boxes, along the axis along which they overlap least, on the common area.
With its Jacobian J and the stiffness k of each contact, the largest eigenvalue of M⁻¹ Σ k Jᵀ J is the square of the highest
frequency [1/s²], and with the damping c that of M⁻¹ Σ c Jᵀ J the highest rate [1/s]. Power iteration finds them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpcontact.algebra.vectors import transform_points
from warpcontact.forces.body_contact.step_warnings import STABLE_STEPS, PairEstimates, is_movable
from warpcontact.scene.body_contact import Solid
from warpcontact.scene.elements import Body
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.body_contact.solid_tables import SolidTables
    from warpcontact.model.environments import Environments

#: Largest number of pairs in all environments that are checked, the first ones.
MOST_PAIRS = 5000
#: Smallest number of steps in half a period of a body on all of its contacts: the period is then accurate to 0.4 %.
MIN_STEPS = 10.0
# Distance of bounding boxes in contact, relative to the size of the smaller one.
_NEAR = 1.0e-3
# Sine of the angle of two edges below which they count as parallel.
_PARALLEL = 1.0e-6
# Number of contacts that a message names.
_NAMED = 4
# Largest number of steps of power iteration, and relative change of the eigenvalue in a step at which it ends.
_ITERATIONS, _CHANGE = 200, 1.0e-4


def sum_warnings(
    model: "Environments", tables: "SolidTables", estimates: Sequence[PairEstimates], dt: float
) -> list[str]:
    """Returns the warning about a time step that is too long for the contacts of a body together: the one with the shortest limit.

    Args:
        model: The model. The current poses decide which solids are in contact.
        tables: The solids.
        estimates: Estimates of the pairs of all compliant body contacts.
        dt: Time step [s].
    """
    contacts = _near_contacts(model, tables, estimates, dt)
    if not contacts.near.any():
        return []
    normal, tangents = slice(0, 1), slice(1, 3)
    shortest, sentence = dt, ""
    for values, directions, effect, limit in (
        (contacts.stiffness, normal, f"less than {MIN_STEPS:g} steps in half a period", _half_period(MIN_STEPS)),
        (contacts.steep_stiffness, normal, "damping is unstable", _half_period(STABLE_STEPS)),
        (contacts.stepped_damping, normal, "damping is unstable", lambda rate: 2.0 / rate),
        (contacts.dashpot, tangents, "friction is unstable", lambda rate: 2.0 / rate),
        (contacts.spring, tangents, "friction is unstable", _half_period(STABLE_STEPS)),
    ):
        eigenvalue, body = _largest_eigenvalues(model, contacts, values, directions)
        env = int(np.argmax(eigenvalue))
        if eigenvalue[env] > 0.0 and limit(eigenvalue[env]) < dt:
            if values is contacts.stepped_damping:
                # A shorter step reduces the dashpots less.
                eigenvalue, _ = _largest_eigenvalues(model, contacts, contacts.damping, directions)
            longest = limit(eigenvalue[env])
            if longest < shortest:
                shortest, sentence = longest, _message(model, contacts, body[env], env, effect, longest, dt)
    return [sentence] if sentence else []


def _half_period(steps: float) -> Callable[[float], float]:
    """Returns a function of the square of a frequency [1/s²] that gives the time step for ``steps`` in half a period [s]."""
    return lambda square: np.pi / (steps * np.sqrt(square))


@dataclass(frozen=True)
class _NearContacts:
    """Pairs of solids of all contacts, in the first environments, (envs, pairs, …).

    Attributes:
        names: Name of the contact of each pair.
        bodies: Bodies of each pair; ``None``: the world.
        near: Whether the solids are in contact.
        place: Point of contact, world [m].
        axes: Normal, and two tangents, world (envs, pairs, 3, 3).
        stiffness: Along the normal [N/m]; 0 if the law has no elastic part.
        steep_stiffness: Likewise, with the slope at the expected speed.
        damping: Dashpot along the normal at any depth [N·s/m].
        stepped_damping: Likewise, as laws reduce it for the time step and their own contact.
        dashpot: Along a tangent [N·s/m].
        spring: Along a tangent [N/m].
    """

    names: list[str]
    bodies: list[tuple[Body | None, Body | None]]
    near: Array
    place: Array
    axes: Array
    stiffness: Array
    steep_stiffness: Array
    damping: Array
    stepped_damping: Array
    dashpot: Array
    spring: Array


def _near_contacts(
    model: "Environments", tables: "SolidTables", estimates: Sequence[PairEstimates], dt: float
) -> _NearContacts:
    pairs = [pair for one in estimates for pair in one.contact.pairs]
    gap, size, place, normal, area = _touch(model, tables, pairs)
    near, envs = gap < _NEAR * size, len(gap)
    # The tangents follow from the axis that is most across the normal.
    helper = np.eye(3)[np.argmin(np.abs(normal), axis=2)]
    tangent = np.cross(normal, helper)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    keys = ("stiffness", "steep", "damping", "stepped", "dashpot", "spring")
    columns: dict[str, list[Array]] = {key: [] for key in keys}
    start = 0
    for one in estimates:
        count = one.contact.count
        own = area[:, start : start + count]
        fraction = np.minimum(own / one.area[:envs], 1.0) if one.contact.per_area else np.ones_like(own)
        start += count
        zero = np.zeros_like(own)
        for key, duration in (("stiffness", one.duration), ("steep", one.steep_duration)):
            linear = zero if duration is None else one.mass[:envs] * (np.pi / duration[:envs]) ** 2 * fraction
            columns[key].append(linear)
        damping = zero if one.dashpot is None else np.broadcast_to(one.dashpot[:envs], own.shape)
        share = 0.25 * damping * dt / one.mass[:envs]
        columns["damping"].append(damping)
        columns["stepped"].append(damping * (np.sqrt(1.0 + share**2) - share))
        for key, slope in zip(("dashpot", "spring"), one.friction or (zero, zero), strict=True):
            columns[key].append(np.maximum(np.broadcast_to(slope[:envs], own.shape), 0.0))
    joined = {key: np.concatenate(values, axis=1) for key, values in columns.items()}
    return _NearContacts(
        [one.contact.name for one in estimates for _ in one.contact.pairs],
        [(first.body, second.body) for first, second in pairs],
        near.astype(np.float64),
        place,
        np.stack([normal, tangent, np.cross(normal, tangent)], axis=2),
        joined["stiffness"],
        joined["steep"],
        joined["damping"],
        joined["stepped"],
        joined["dashpot"],
        joined["spring"],
    )


@dataclass(frozen=True)
class _WorldBoxes:
    """Bounding boxes of solids in the world.

    Attributes:
        center: Their centers, (envs, solids, 3) [m]; for a half-space, a point of its surface.
        axes: Their axes as rows, (envs, solids, 3, 3).
        half: Half of their size along their axes, (envs, solids, 3) [m]; infinite for a half-space.
    """

    center: Array
    axes: Array
    half: Array

    @classmethod
    def of(cls, model: "Environments", tables: "SolidTables", solids: Sequence[Solid], envs: int) -> "_WorldBoxes":
        zero, columns = np.zeros((envs, 3)), []
        for solid in solids:
            center, half = (values[:envs] for values in tables.bounding_box(model, solid))
            axes = np.broadcast_to(np.eye(3), (envs, 3, 3))
            poses = [(model[f"{solid.name}.position"], model[f"{solid.name}.orientation"])]
            if solid.body is not None:
                name = solid.body.name
                poses.append((model.sensor(f"{name}.position"), model.sensor(f"{name}.orientation")))
            for position, orientation in poses:
                turn = np.asarray(orientation, dtype=np.float64)[:envs]
                axes = transform_points(axes, zero, turn)
                center = transform_points(center[:, None], zero, turn)[:, 0] + np.asarray(position)[:envs]
            columns.append((center, axes, half))
        return cls(*(np.stack(values, axis=1) for values in zip(*columns, strict=True)))


def touching_boxes(
    model: "Environments", tables: "SolidTables", estimates: Sequence[PairEstimates]
) -> tuple[Array, Array]:
    """Returns gaps and areas of contact of the bounding boxes of all pairs in the first environments, (envs, pairs) [m, m²]."""
    gap, _, _, _, area = _touch(model, tables, [pair for one in estimates for pair in one.contact.pairs])
    return gap, area


def _touch(
    model: "Environments", tables: "SolidTables", pairs: Sequence[tuple[Solid, Solid]]
) -> tuple[Array, Array, Array, Array, Array]:
    """Returns gaps, sizes, points of contact, normals and areas of the bounding boxes of pairs, (envs, pairs, …) [m, m²].

    Sizes are the largest edges of the smaller boxes. Environments are the first ones with up to ``MOST_PAIRS`` pairs.
    """
    envs = min(model.envs, max(1, MOST_PAIRS // len(pairs)))
    solids = list(dict.fromkeys(solid for pair in pairs for solid in pair))
    numbers = {solid: number for number, solid in enumerate(solids)}
    boxes = _WorldBoxes.of(model, tables, solids, envs)
    first, second = (np.array([numbers[pair[k]] for pair in pairs]) for k in (0, 1))
    sides = np.sort(boxes.half, axis=2)
    size = 2.0 * np.minimum(sides[:, first, 2], sides[:, second, 2])
    half_space = np.isinf(sides[:, second, 0])
    distance, axis, is_of_second = _separation(boxes, first, second)
    # The common part of both boxes in the axes of the one with the face.
    owner, other = np.where(is_of_second, second, first), np.where(is_of_second, first, second)
    env = np.arange(envs)[:, None]
    half = np.where(np.isinf(boxes.half), 0.0, boxes.half)
    frame = boxes.axes[env, owner]
    extents = np.einsum(
        "epac,epc->epa", np.abs(np.einsum("epak,epck->epac", frame, boxes.axes[env, other])), half[env, other]
    )
    offset = np.einsum("epak,epk->epa", frame, boxes.center[env, other] - boxes.center[env, owner])
    lower = np.maximum(offset - extents, -half[env, owner])
    upper = np.minimum(offset + extents, half[env, owner])
    across = np.sort(np.maximum(upper - lower, 0.0), axis=2)
    common = boxes.center[env, owner] + np.einsum("epa,epak->epk", 0.5 * (lower + upper), frame)
    # Half-spaces: the lowest point, and the largest side.
    plane_normal = boxes.axes[:, second, 2]
    along = np.abs(np.einsum("epki,epi->epk", boxes.axes[:, first], plane_normal))
    support = (along * boxes.half[:, first]).sum(axis=2)
    height = ((boxes.center[:, first] - boxes.center[:, second]) * plane_normal).sum(axis=2)
    gap = np.where(half_space, height - support, distance)
    lowest = boxes.center[:, first] - support[..., None] * plane_normal
    place = np.where(half_space[..., None], lowest, common)
    normal = np.where(half_space[..., None], plane_normal, axis)
    side = 4.0 * sides[:, first, 1] * sides[:, first, 2]
    area = np.where(half_space, side, across[..., 1] * across[..., 2])
    return gap, size, place, normal, area


def _separation(
    boxes: _WorldBoxes, first: NDArray[np.int_], second: NDArray[np.int_]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Returns the distance of two boxes along the axis along which it is largest, this axis, and whether a face of the second has it.

    The axes are the normals of faces and the common normals of edges. The distance is negative in overlap. (envs, pairs) [m],
    (envs, pairs, 3), (envs, pairs). Values of half-spaces have no meaning.
    """
    axes = [boxes.axes[:, number] for number in (first, second)]
    half = [np.where(np.isinf(boxes.half), 0.0, boxes.half)[:, number] for number in (first, second)]
    across = np.cross(axes[0][:, :, :, None], axes[1][:, :, None]).reshape(*axes[0].shape[:2], 9, 3)
    length = np.linalg.norm(across, axis=3, keepdims=True)
    # Parallel edges have no common normal.
    across = np.where(length > _PARALLEL, across / np.maximum(length, _PARALLEL), axes[0][:, :, :1])
    candidates = np.concatenate([*axes, across], axis=2)
    distance = np.abs(np.einsum("epk,epck->epc", boxes.center[:, first] - boxes.center[:, second], candidates))
    for frame, size in zip(axes, half, strict=True):
        distance -= np.einsum("epck,epk->epc", np.abs(np.einsum("epak,epck->epca", frame, candidates)), size)
    most = np.argmax(distance, axis=2)[..., None]
    chosen = np.take_along_axis(candidates, most[..., None], axis=2)[:, :, 0]
    is_of_second = (most[..., 0] >= 3) & (most[..., 0] < 6)
    return np.take_along_axis(distance, most, axis=2)[..., 0], chosen, is_of_second


def _largest_eigenvalues(
    model: "Environments", contacts: _NearContacts, values: Array, directions: slice
) -> tuple[Array, list[Body]]:
    """Returns the largest eigenvalue of M⁻¹ Σ k Jᵀ J, (envs,), and the body that moves most in its mode.

    Args:
        model: The model.
        contacts: All contacts. Those of two bodies that have no other one do not count.
        values: Stiffness or damping of each contact, (envs, pairs).
        directions: Range of the axes of the contact along which it acts.
    """
    envs = len(values)
    bodies = [one for one in dict.fromkeys(b for pair in contacts.bodies for b in pair) if one and is_movable(one)]
    numbers = {body: number for number, body in enumerate(bodies)}
    # The last one stands for all bodies that do not move.
    sides = [np.array([numbers.get(pair[k], len(bodies)) for pair in contacts.bodies]) for k in (0, 1)]  # type: ignore[arg-type]
    weights = values * contacts.near
    counts = np.zeros((len(bodies) + 1, envs))
    for side in sides:
        np.add.at(counts, side, weights.T > 0.0)
    counts[-1] = 0.0
    weights = weights * (np.maximum(counts[sides[0]], counts[sides[1]]).T > 1.0)
    used = np.flatnonzero(weights.any(axis=0))
    if not len(used):
        return np.zeros(envs), [bodies[0]] * envs
    weights, place, axes = weights[:, used], contacts.place[:, used], contacts.axes[:, used, directions]
    sides = [side[used] for side in sides]
    rows = []
    for sign, side in zip((1.0, -1.0), sides, strict=True):
        row = np.zeros((*axes.shape[:3], 6))
        for body, number in numbers.items():
            own = np.flatnonzero(side == number)
            if len(own):
                row[:, own] = sign * _scaled_rows(model, body, place[:, own], axes[:, own])
        rows.append(row)
    motion = np.random.default_rng(0).normal(size=(len(bodies) + 1, envs, 6))
    motion[-1] = 0.0
    eigenvalue = np.zeros(envs)
    for _ in range(_ITERATIONS):
        motion /= np.maximum(np.linalg.norm(motion, axis=(0, 2))[None, :, None], 1e-300)
        slip = sum(np.einsum("epai,pei->epa", row, motion[side]) for row, side in zip(rows, sides, strict=True))
        force = weights[:, :, None] * slip
        motion = np.zeros_like(motion)
        for row, side in zip(rows, sides, strict=True):
            np.add.at(motion, side, np.einsum("epai,epa->pei", row, force))
        motion[-1] = 0.0
        before, eigenvalue = eigenvalue, np.linalg.norm(motion, axis=(0, 2))
        if (eigenvalue - before <= _CHANGE * eigenvalue).all():
            break
    most = np.argmax(np.linalg.norm(motion[:-1], axis=2), axis=0)
    return eigenvalue, [bodies[number] for number in most]


def _scaled_rows(model: "Environments", body: Body, place: Array, axes: Array) -> Array:
    """Returns the rows of the Jacobian of points of a body, times the inverse square root of its mass matrix.

    Args:
        model: The model.
        body: The body.
        place: Points, world (envs, points, 3) [m].
        axes: Directions at each of them, world (envs, points, directions, 3).
    """
    envs = len(place)
    mass = np.asarray(model[f"{body.name}.mass"])[:envs]
    arm = place - np.asarray(model.sensor(f"{body.name}.position"), dtype=np.float64)[:envs, None]
    turn = np.asarray(model.sensor(f"{body.name}.orientation"), dtype=np.float64)[:envs]
    # Rows are the axes of the body in the world.
    frame = transform_points(np.broadcast_to(np.eye(3), (envs, 3, 3)), np.zeros((envs, 3)), turn)
    inertia = np.swapaxes(frame, 1, 2) @ model[f"{body.name}.inertia"][:envs] @ frame
    lever = np.cross(arm[:, :, None], axes)
    flat = lever.reshape(envs, -1, 3).swapaxes(1, 2)
    turning = np.linalg.solve(np.linalg.cholesky(inertia), flat).swapaxes(1, 2).reshape(lever.shape)
    return np.concatenate([axes / np.sqrt(mass)[:, None, None, None], turning], axis=3)


def _message(
    model: "Environments", contacts: _NearContacts, body: Body, env: int, effect: str, longest: float, dt: float
) -> str:
    own = [
        name
        for name, pair, near in zip(contacts.names, contacts.bodies, contacts.near[env], strict=True)
        if body in pair and near
    ]
    names = list(dict.fromkeys(own))
    listed = ", ".join(names[:_NAMED]) + (", …" if len(names) > _NAMED else "")
    return (
        f"{body.name}: dt = {dt:g} s is too long for its {len(own)} contacts together ({listed}) in environment "
        f"{model.first_env + env}: {effect}. Use dt ≤ {longest:.2g} s"
    )
