"""Runs of more environments than fit at once: batch after batch on one model, into one data set."""

import contextlib
import re
import time
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from warpcontact.advice import ContactWarning
from warpcontact.checks import Array
from warpcontact.contact_coupling_report import CouplingReport, first_of
from warpcontact.experiment import result
from warpcontact.experiment.plan import Plan, kept
from warpcontact.experiment.schema import Settings
from warpcontact.health import Health
from warpcontact.recorder import Recording
from warpcontact.scene import Scene
from warpcontact.simulation import Simulation, recorded_steps


class Batches:
    """The batches of an experiment, on one model that takes the values of one after the other.

    Environments have the same values as if all ran at once. The last batch is filled up with copies of the last
    environment, whose results are dropped.

    Args:
        simulation: Steps a model of ``plan.batch`` environments.
        plan: How many there are.
        settings: The experiment, with all defaults.
        varied: Values of the parameters that vary, of all environments.
    """

    def __init__(
        self, simulation: Simulation, plan: Plan, settings: Settings, varied: Mapping[str, Array]
    ) -> None:
        self.simulation = simulation
        self.plan = plan
        self.settings = settings
        model = simulation.model
        # As all environments take them: for a few, a shape may mean something else.
        self.values = {
            name: model.find_parameter(name).parse(values, plan.envs) for name, values in varied.items()
        }
        self._healths: list[tuple[int, Health]] = []  # batch by batch, with the number of its first environment
        self.reports: list[list[CouplingReport]] = []  # of the contact couplings, batch by batch
        self.wall_time = 0.0
        self._said: set[str] = set()

    @property
    def health(self) -> Health:
        """Which environments failed or were stopped, of those that ran so far, by their numbers among all."""
        return Health.joined(self.plan.envs, self._healths)

    def take(self, number: int) -> None:
        """Gives the model the values of batch ``number``, and puts it at the start."""
        model, first = self.simulation.model, number * self.plan.batch
        rows = np.minimum(np.arange(first, first + self.plan.batch), self.plan.envs - 1)
        for name, values in self.values.items():
            model.assign(name, values[rows])
        model.first_env = first
        self.simulation.reset()

    def run(self, path: Path, progress: bool | None) -> None:
        """Runs all batches and writes their recordings into the store ``path``, environment by environment.

        Args:
            path: The Zarr group to make.
            progress: Whether to show a progress bar, over all; ``None``: on runs of over a second, in a terminal.
        """
        from tqdm import tqdm

        steps, _ = recorded_steps(self.settings.duration, self.settings.record.every, self.settings.dt)
        with tqdm(
            total=steps * self.plan.batches,
            unit="step",
            desc=f"{self.plan.envs} environments in {self.plan.batches} batches",
            delay=1.0,
            disable=None if progress is None else not progress,
        ) as bar:
            for number in range(self.plan.batches):
                self.take(number)
                self._advise()
                result.add_to_recording(self._record(bar), path, new=number == 0)
        health = self.health
        result.complete_recording(path, {"frozen_environments": health.frozen.tolist()})
        if not health.good:
            warnings.warn(str(health), RuntimeWarning, stacklevel=2)

    def _record(self, bar: object) -> Recording:
        """Runs the batch that was taken; returns the recording of its own environments."""
        model, settings = self.simulation.model, self.settings
        own = min(self.plan.batch, self.plan.envs - model.first_env)
        start = time.perf_counter()
        with _without_local_numbers():
            recording = self.simulation.run(
                settings.duration,
                settings.record.readings or (),
                settings.record.every,
                parameters=kept(model, list(self.values), self.plan.envs),
                progress=bar,
            )
        self.wall_time += time.perf_counter() - start
        self._healths.append((model.first_env, model.health().of_first(own)))
        couplings = model.scene.contact_couplings
        self.reports.append([first_of(coupling.report(model), own) for coupling in couplings])
        recording.attrs |= {"name": settings.name, "seed": settings.seed}
        return recording.isel(env=slice(0, own))

    def _advise(self) -> None:
        """Warns as the first step of a simulation does, of what is not known from earlier batches."""
        for sentence in self.simulation.advice():
            kind = re.sub(r"[\d.,+-]+(e[+-]?\d+)?", "", sentence)
            # The simulation itself has warned about the first batch.
            if kind not in self._said and self.simulation.model.first_env:
                warnings.warn(sentence, ContactWarning, stacklevel=3)
            self._said.add(kind)


@contextlib.contextmanager
def _without_local_numbers() -> Iterator[None]:
    """Keeps a run from reporting frozen environments by their numbers within the batch."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".* frozen at the last state before", category=RuntimeWarning)
        yield


def opened(path: Path, scene: Scene) -> Recording:
    """Returns the recording in a store; values are read where they are asked for."""
    data = xr.open_zarr(path, consolidated=False, chunks=None)
    variables = {name: array.variable for name, array in data.data_vars.items()}
    recording = Recording(variables, coords=data.coords, attrs=data.attrs)
    recording.scene = scene
    return recording
