"""All environments of a recording for display: selection, distinct appearances and poses over time."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.drawing.geometry import Placement, ShapePlacement, Spheres, find_spheres
from warpcontact.drawing.replay import Replay
from warpcontact.scene.elements import Body
from warpcontact.scene.scene_data import SceneData
from warpcontact.validation.checks import Array

# Limits for ``"auto"``: number of poses over all bodies and records, and number of distinct appearances of a body.
# Larger ensembles are reduced to evenly spaced environments.
MAX_POSES = 2_000_000
MAX_APPEARANCES = 256


@dataclass(frozen=True, eq=False)
class BodyAppearance:
    """Appearances of the bodies of an element: a few distinct ones, and the scale of each body.

    Attributes:
        body: Body element.
        examples: Environment index and item of an example of each distinct appearance, (k, 2).
        numbers: Index of the appearance of each body, (env, item).
        scales: Size of each body as a multiple of its example, (env, item).
        reach: Largest distance of the geometry from the center of mass at scale 1 [m].
        surfaces: Surfaces on the bodies.
        spheres: Spheres and points on the bodies.
        forms: Shapes on the bodies.
    """

    body: Body
    examples: NDArray[np.intp]
    numbers: NDArray[np.intp]
    scales: Array
    reach: float
    surfaces: list[Placement]
    spheres: list[Spheres]
    forms: list[ShapePlacement]


class Ensemble:
    """Environments for display and their appearance.

    Args:
        replay: Replay of the environments; poses may still be in a file.

    Attributes:
        replay: Replay of the environments shown.
        appearances: Appearances of each body element.
        left_out: Numbers of the environments omitted because of a non-finite pose.
    """

    def __init__(self, replay: Replay) -> None:
        self.replay = replay
        self.appearances = body_appearances(replay)
        self.left_out: list[int] = []
        self._good = np.ones(len(replay.envs), dtype=bool)

    @classmethod
    def of(
        cls, recording: xr.Dataset, scene: SceneData, chosen: Iterable[int], ensemble: Any
    ) -> "Ensemble | None":
        """Returns the environments that an export shows, or ``None``; ``ensemble`` as for ``export_usd``."""
        labels = recording["env"].values
        if ensemble is False or (ensemble == "auto" and set(labels.tolist()) <= set(chosen)):
            return None
        if ensemble is True:
            return cls(Replay.of(recording, scene, labels.tolist()))
        each = recording.sizes["time"] * sum(body.count for body in scene.bodies)
        found = cls(Replay.of(recording, scene, _evenly(labels, MAX_POSES // max(1, each))))
        if max(len(appearance.examples) for appearance in found.appearances) > MAX_APPEARANCES:
            fewer = _evenly(np.array(found.replay.envs), MAX_APPEARANCES)
            found = cls(Replay.of(recording, scene, fewer))
        return found

    def poses(self, body: Body, first: int, stop: int) -> tuple[Array, Array]:
        """Returns positions and orientations of a body in a range of records, (time, env, item, …)."""
        data = self.replay.data.isel(time=slice(first, stop))
        found = []
        for key in ("position", "orientation"):
            values = data[f"{body.name}.{key}"].transpose("time", "env", ...).values.astype(np.float64)
            found.append(values[:, :, None] if body.single else values)
        with np.errstate(invalid="ignore", divide="ignore"):
            length = np.linalg.norm(found[1], axis=-1, keepdims=True)
            return found[0], found[1] / length

    def scan_records(self, first: int, stop: int) -> None:
        """Marks the environments with non-finite poses in a range of records."""
        for body in self.replay.scene.bodies:
            for values in self.poses(body, first, stop):
                self._good &= np.isfinite(values).all(axis=(0, 2, 3))

    def drop(self) -> "Ensemble":
        """Returns the ensemble without the marked environments."""
        if self._good.all():
            return self
        numbers = np.array(self.replay.envs)
        replay = self.replay.select(np.flatnonzero(self._good))
        dropped = Ensemble(replay)
        dropped.left_out = numbers[~self._good].tolist()
        return dropped


def body_appearances(replay: Replay) -> list[BodyAppearance]:
    """Returns the appearances of each body element."""
    placements = [Placement.of(replay, surface) for surface in replay.scene.surfaces]
    spheres = find_spheres(replay)
    forms = [ShapePlacement.of(replay, shape) for shape in replay.scene.shapes]
    found = []
    for body in replay.scene.bodies:
        carried = [one for one in placements if one.surface.body is body and one.surface.visible]
        round_ones = [one for one in spheres if one.body is body]
        shapes = [one for one in forms if one.shape.body is body and one.shape.visible]
        solid = [one for one in round_ones if not one.are_points]
        if carried or shapes or solid:
            # Omit points if there is other geometry, because they are small.
            round_ones = solid
        found.append(_body_appearance(replay, body, carried, round_ones, shapes))
    return found


def _body_appearance(
    replay: Replay, body: Body, surfaces: list[Placement], spheres: list[Spheres], forms: list[ShapePlacement]
) -> BodyAppearance:
    envs, items = len(replay.envs), body.count

    def rows(values: Array, each: bool) -> Array:
        """Returns one row per body, (env · item, …), of values (env, …), or (env, item, …) if ``each``."""
        flat = values.reshape(envs, items if each else 1, -1)
        return np.broadcast_to(flat, (envs, items, flat.shape[2])).reshape(envs * items, -1)

    lengths, others = [], []
    for placement in surfaces:
        lengths += [rows(placement.position, False), rows(placement.scale, False)]
        others += [rows(placement.orientation, False), rows(placement.mesh, False)]
    for group in spheres:
        lengths += [rows(group.radii, not body.single), rows(group.places, not body.single)]
    for form in forms:
        several = not form.shape.single
        lengths.append(rows(form.positions, several))
        others.append(rows(form.orientations, several))
        for key, values in form.sizes.items():
            is_length = form.shape.kind.limits(key)["unit"] == "m"
            (lengths if is_length else others).append(rows(values, several))
    none = np.zeros((envs * items, 1))
    length, other = np.concatenate([none, *lengths], axis=1), np.concatenate([none, *others], axis=1)
    size = np.linalg.norm(length, axis=1)
    scales = np.where(size > 0.0, size / (size[0] or 1.0), 1.0)
    # To nine digits, do all bodies equal the first one up to a scale?
    alike = np.concatenate([length / np.where(size > 0.0, size, 1.0)[:, None], other], axis=1)
    if np.abs(alike - alike[:1]).max() <= 1.0e-9:
        first, numbers = np.zeros(1, dtype=np.intp), np.zeros(envs * items, dtype=np.intp)
    else:
        _, first, numbers = np.unique(
            np.concatenate([length, other], axis=1), axis=0, return_index=True, return_inverse=True
        )
        scales = np.ones(envs * items)
    examples = np.stack([first // items, first % items], axis=1)
    reaches = [placement.reach for placement in surfaces] + [form.reach for form in forms]
    reaches += [float((np.linalg.norm(group.places, axis=-1) + group.radii).max()) for group in spheres]
    largest = max(reaches, default=0.0) / float(scales.max())
    return BodyAppearance(
        body,
        examples,
        numbers.reshape(envs, items),
        scales.reshape(envs, items),
        largest,
        surfaces,
        spheres,
        forms,
    )


def _evenly(numbers: NDArray[Any], most: int) -> list[int]:
    """Returns at most ``most`` of the numbers, evenly spaced, and at least one."""
    rows = np.unique(np.linspace(0, len(numbers) - 1, max(1, min(len(numbers), most))).astype(int))
    chosen: list[int] = numbers[rows].tolist()
    return chosen
