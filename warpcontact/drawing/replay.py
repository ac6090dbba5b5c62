"""Replay: the selected environments of a recording as validated arrays."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.algebra.vectors import transform_points
from warpcontact.scene.elements import Body, Contact, Points, Surface
from warpcontact.scene.scene_data import SceneData
from warpcontact.stepping.recorder import UNCHANGED
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

DEFAULT_ENVIRONMENTS = 16
# Time codes per second for a single record, which has no interval; the default of USD.
STATIC_RATE = 24.0


@dataclass(frozen=True)
class Replay:
    """Selected environments of a recording; arrays are (time, env, …), in the order of ``envs``.

    Attributes:
        scene: Scene of the recording.
        data: Recording of the selected environments.
        envs: Numbers of the environments.
        times: Simulated time of each record [s].
        codes: USD time code of each record.
        rate: Time codes per second.
    """

    scene: SceneData
    data: xr.Dataset
    envs: list[int]
    times: Array
    codes: list[float]
    rate: float

    @classmethod
    def of(cls, recording: xr.Dataset, scene: SceneData | None, envs: int | Iterable[int] | None) -> "Replay":
        """Selects environments of a recording; arguments and errors as for ``export_usd``.

        If the recording is in a file, variables are read on first use; ``part`` reads all variables of some records.
        """
        if not isinstance(recording, xr.Dataset):
            raise TypeError(f"recording must be a data set from Simulation.run, got {type(recording).__name__}")
        if scene is None:
            # xarray operations return the class without the content of this slot.
            scene = getattr(recording, "scene", None)
            if scene is None:
                raise ValueError("the recording has no scene (xarray operations drop it): pass scene=")
        if not isinstance(scene, SceneData):
            raise TypeError(f"scene must be a wc.Scene, got {scene!r}")
        needed = [f"{body.name}.{key}" for body in scene.bodies for key in ("position", "orientation")]
        missing = [name for name in needed if name not in recording]
        if missing:
            raise ValueError(
                f"the recording lacks {', '.join(missing)}: record the poses with Simulation.run(..., poses=True)"
            )
        absent = [dim for dim in ("time", "env") if dim not in recording.dims]
        if absent:
            raise ValueError(f"the recording lacks the dimension {absent[0]!r}; select with a list, as in env=[3]")
        labels = recording["env"].values
        rows = _chosen(envs, labels)
        times = _seconds(recording["time"].values)
        codes, rate = _time_codes(times)
        return cls(
            scene=scene,
            data=recording.isel(env=rows),
            envs=[int(labels[row]) for row in rows],
            times=times,
            codes=codes,
            rate=rate,
        )

    def part(self, first: int, stop: int) -> "Replay":
        """Returns the records from ``first`` up to, excluding, ``stop``, in memory."""
        records = slice(first, stop)
        data = self.data.isel(time=records).load()
        return replace(self, data=data, times=self.times[records], codes=self.codes[records])

    def select(self, rows: NDArray[np.intp]) -> "Replay":
        """Returns the replay of the environments at indices ``rows``."""
        return replace(self, data=self.data.isel(env=rows), envs=[self.envs[row] for row in rows])

    def variable(self, name: str) -> xr.DataArray:
        """Returns a variable of the recording, in memory."""
        self.data.variables[name].load()
        return self.data[name]

    def pose(self, body: Body) -> tuple[Array, Array]:
        """Returns positions (time, env, 3) [m] and unit quaternions (time, env, 4), x, y, z, w, of a body.

        For a set of bodies: (time, env, item, …).

        Raises:
            ValueError: If a pose is not finite, or a quaternion is zero.
        """
        found = []
        for key in ("position", "orientation"):
            values = self.variable(f"{body.name}.{key}").transpose("time", "env", ...).values.astype(np.float64)
            kind, shortest = ("position", -1.0) if key == "position" else ("rotation", 0.0)
            length = np.linalg.norm(values, axis=-1)
            invalid = np.argwhere(~(np.isfinite(length) & (length > shortest)))
            if len(invalid):
                record, row, *item = invalid[0].tolist()
                entry, got = f"{body.name}.{key}{item or ''}", values[tuple(invalid[0])].tolist()
                raise ValueError(
                    f"{entry} of environment {self.envs[row]} at {self.times[record]:g} s is not a "
                    f"{kind}: {got}; export other environments, or the records before it"
                )
            found.append(values if key == "position" else values / length[..., None])
        return found[0], found[1]

    def radii(self, contact: Contact) -> Array:
        """Returns the radius of each sphere of a contact, (env, item) [m].

        Recorded in ``<contact>.radius``, or that of the scene. Zero for contact couplings, whose range is not a size.
        """
        if contact.facing is not None:
            return np.zeros((len(self.envs), contact.count))
        name, shape = f"{contact.name}.radius", (len(self.envs), contact.count)
        if name not in self.data:
            return np.array(np.broadcast_to(contact.radius, shape))
        values = self.variable(name).transpose("env", ...).values.astype(np.float64)
        if values.shape not in (shape, shape[:1]):
            raise ValueError(f"{name} must have shape {shape[:1]} or {shape}, got {values.shape}")
        invalid = values[~(np.isfinite(values) & (values >= 0.0))]
        if len(invalid):
            raise ValueError(f"{name} must be finite and at least 0 m, got {invalid[0]}")
        return np.broadcast_to(values.reshape(shape[0], -1), shape)

    def static(self, name: str, shape: tuple[int, ...]) -> Array | None:
        """Returns variable ``name``, (env, *shape), or ``None`` if it was not recorded."""
        if name not in self.data:
            return None
        values = self.variable(name).transpose("env", ...).values.astype(np.float64)
        if values.shape != (len(self.envs), *shape):
            raise ValueError(f"{name} must have shape {(len(self.envs), *shape)}, got {values.shape}")
        return values

    def setting(self, name: str, default: Array) -> Array:
        """Returns parameter ``name``, (env, …), as recorded, or ``default`` in all environments."""
        recorded = self.static(name, default.shape)
        return np.repeat(default[None], len(self.envs), axis=0) if recorded is None else recorded

    def value_or_default(self, name: str, default: Array) -> Array | None:
        """Returns parameter ``name``, (env, …), as recorded, or ``default`` if the recording marks it as unchanged.

        ``None`` if the recording does not indicate whether it varied.
        """
        if name in self.data or name not in set(self.data.attrs.get(UNCHANGED, ())):
            return self.static(name, default.shape)
        return np.repeat(default[None], len(self.envs), axis=0)

    def pose_of(self, surface: Surface) -> tuple[Array, Array, Array]:
        """Returns position (env, 3) [m], orientation (env, 4) and scale (env,) of a surface on its carrier."""
        return (
            self.setting(f"{surface.name}.position", surface.position),
            self.setting(f"{surface.name}.orientation", surface.orientation),
            self.setting(f"{surface.name}.scale", surface.scale),
        )

    def places(self, points: Points) -> Array:
        """Returns positions of points in the frame of their body, or of the world, (env, item, 3) [m]."""
        default = points.positions[0] if points.single else points.positions
        local = self.setting(f"{points.name}.position", default).reshape(len(self.envs), -1, 3)
        if points.surface is None:
            return local
        position, orientation, scale = self.pose_of(points.surface)
        return transform_points(scale[:, None, None] * local, position, orientation)

    def series(self, name: str) -> NDArray[Any] | None:
        """Returns sensor ``name``, (time, env, …), or ``None`` if it was not recorded."""
        return self.variable(name).transpose("time", "env", ...).values if name in self.data else None

    def of_element(self, element: str) -> Iterator[tuple[str, xr.DataArray]]:
        """Iterates over the recorded variables of an element as (quantity, values)."""
        for name in map(str, self.data.data_vars):
            owner, _, quantity = name.partition(".")
            if owner == element and quantity:
                yield quantity, self.variable(name)


def _chosen(envs: int | Iterable[int] | None, labels: NDArray[Any]) -> list[int]:
    """Returns the indices of the selected environments in ``labels``."""
    if not np.issubdtype(labels.dtype, np.integer):
        raise ValueError(f"the env coordinate of the recording must be environment numbers, got {labels.dtype}")
    requested = labels[:DEFAULT_ENVIRONMENTS].tolist() if envs is None else checks.entries(envs)
    row_of = {int(label): row for row, label in enumerate(labels)}
    rows: dict[int, None] = {}
    for env in requested:
        if isinstance(env, bool) or not isinstance(env, int | np.integer):
            raise TypeError(f"envs must be environment numbers, got {env!r}")
        if int(env) not in row_of:
            raise ValueError(f"environment {env} is not in the recording, which has {_span(labels)}")
        rows[row_of[int(env)]] = None
    if not rows:
        raise ValueError("envs must name at least one environment, got none")
    return list(rows)


def _span(labels: NDArray[Any]) -> str:
    if len(labels) == 0:
        return "none"
    low, high = int(labels.min()), int(labels.max())
    if high - low + 1 == len(labels):
        return f"{low} to {high}"
    return f"{len(labels)} of the numbers from {low} to {high}"


def _seconds(times: NDArray[Any]) -> Array:
    if times.dtype.kind not in "fiu":
        raise ValueError(f"the time coordinate of the recording must be numbers [s], got {times.dtype}")
    seconds = times.astype(np.float64)
    if len(seconds) == 0:
        raise ValueError("the recording has no records")
    if not np.isfinite(seconds).all() or (np.diff(seconds) <= 0.0).any():
        raise ValueError("the time coordinate of the recording must be finite and increase from record to record")
    return seconds


def _time_codes(times: Array) -> tuple[list[float], float]:
    """Returns a time code per record and the time codes per second.

    Evenly spaced records have codes 0, 1, 2, …; otherwise the shortest interval is one code.
    """
    if len(times) == 1:
        return [0.0], STATIC_RATE
    intervals = np.diff(times)
    mean = float(times[-1] - times[0]) / len(intervals)
    # Times are multiples of the step in double precision; smaller differences are rounding.
    if np.abs(intervals - mean).max() <= 1.0e-6 * mean:
        rate = 1.0 / mean
        integer_rate = float(round(rate))
        codes = [float(i) for i in range(len(times))]
        return codes, integer_rate if abs(rate - integer_rate) <= 1.0e-9 * rate else rate
    rate = 1.0 / float(intervals.min())
    return ((times - times[0]) * rate).tolist(), rate
