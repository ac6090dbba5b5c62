"""Source of pictures: a recording or run with its environments, and access to records by time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from warpcontact.building.scene import Scene
from warpcontact.drawing.colors import per_environment_number
from warpcontact.drawing.drawing import Drawing
from warpcontact.experiment.run import Run
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.render_style import environment_numbers

# Number of records of an overview: that with about this number of poses, within limits.
_POSES = 500_000
_FEWEST, _MOST = 2, 48


@dataclass(frozen=True, eq=False)
class Source:
    """Recording with its scene, and its run, if there is one.

    Attributes:
        recording: Data set up to the last record that all selected environments have.
        scene: Scene of the recording.
        run: Run with outcomes; ``None`` for a recording alone.
        envs: Numbers of the selected environments.
        partial: Whether later records are missing, because the run is not finished.
    """

    recording: xr.Dataset
    scene: Scene
    run: Run | None
    envs: list[int]
    partial: bool

    @classmethod
    def of(cls, recording: Any, scene: Scene | None, env: Any = None) -> "Source":
        """Returns the source for a recording or run; arguments and errors as for ``render``."""
        run = recording if isinstance(recording, Run) else None
        if run is not None:
            recording = run.recording
            run.check_series()
        if not isinstance(recording, xr.Dataset):
            raise TypeError(
                f"recording must be the result of Simulation.run or wc.open_run, got {type(recording).__name__}"
            )
        if scene is None:
            scene = getattr(recording, "scene", None)  # operations of xarray drop it
        if scene is None:
            raise ValueError("the recording has no scene (xarray operations drop it): pass scene=")
        for dim in ("time", "env"):
            if not recording.sizes.get(dim):
                raise ValueError(f"the recording must have at least one entry along {dim!r}")
        labels, count = recording["env"].values, recording.sizes["time"]
        envs = environment_numbers(env)
        if envs is None:
            envs = (labels if run is None else labels[run.frames > 0])[:1].tolist()
        # Missing environments are reported later, by ``Replay.of``.
        numbers = [one for one in envs if isinstance(one, int | np.integer)]
        last = count if run is None else run.records_of(numbers)
        return cls(recording.isel(time=slice(0, last)), scene, run, envs, last < count)

    @property
    def times(self) -> Array:
        """Simulated time of each record [s]."""
        return np.asarray(self.recording["time"].values, dtype=np.float64)

    def nearest(self, wanted: Array, name: str = "time") -> Any:
        """Returns the indices of the records nearest to times [s].

        Raises:
            ValueError: If a time is NaN, or outside the recording.
        """
        times = self.times
        allowed = 1.0e-9 * max(abs(times[0]), abs(times[-1]))
        for time in np.atleast_1d(wanted).tolist():
            if not times[0] - allowed <= time <= times[-1] + allowed:
                raise ValueError(
                    f"{name} must be within the recording, {times[0]:g} to {times[-1]:g} s, got {time:g}"
                )
        after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1) if len(times) > 1 else np.array(0)
        before = np.maximum(after - 1, 0)
        return np.where(np.abs(wanted - times[before]) <= np.abs(times[after] - wanted), before, after)

    def drawing(self, records: Sequence[int]) -> Drawing:
        """Returns the drawing of some records of the selected environments."""
        return Drawing.of(self.recording.isel(time=list(records)), self.scene, self.envs)

    def overview(self) -> list[int]:
        """Returns evenly spaced records that determine camera and arrow length."""
        poses = sum(body.count for body in self.scene.bodies) * len(self.envs)
        count = int(np.clip(_POSES // max(poses, 1), _FEWEST, _MOST))
        return sorted(set(np.linspace(0, len(self.times) - 1, count).round().astype(int).tolist()))

    def numbers(self, name: str, envs: Sequence[int]) -> Array:
        """Returns a parameter or outcome of environments, (env,); NaN for unfinished ones.

        Raises:
            ValueError: If there is no such quantity with one number per environment.
        """
        tables = [self.recording] if self.run is None else [self.recording, self.run.outcome]
        named = [table.data_vars[name] for table in reversed(tables) if name in table.data_vars]
        found = next((one for one in map(_number_of_each, named) if one is not None), None)
        if found is None:
            variables = [(str(key), one) for table in tables for key, one in table.data_vars.items()]
            available = sorted({key for key, one in variables if _number_of_each(one) is not None})
            hint = suggestion(name, available) or f"; there are: {', '.join(available) or 'none'}"
            raise ValueError(f"color_by must be one number for each environment, got {name!r}{hint}")
        return found.reindex(env=list(envs)).values.astype(np.float64)


def _number_of_each(array: xr.DataArray) -> xr.DataArray | None:
    return None if "time" in array.dims else per_environment_number(array)
