"""How long a run will take, from a few of its environments that are stepped for a moment."""

import time
from dataclasses import dataclass

from warpcontact.draft import Draft
from warpcontact.experiment.design import Design
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.shards import make_simulation
from warpcontact.simulation import SHORTEST_PIECE
from warpcontact.whole_steps import recorded_steps

# How long to step [s], and how many environments: enough for all threads of a machine, or for a GPU.
SECONDS = 2.0
ON_CPU = 1024
ON_GPU = 32768


@dataclass(frozen=True)
class Probe:
    """What a few environments took.

    Attributes:
        envs: How many were stepped.
        steps: How many steps they took.
        of_steps: How many the run has.
        rate: Environment steps per second.
        total: Environment steps of the run.
    """

    envs: int
    steps: int
    of_steps: int
    rate: float
    total: int

    @property
    def seconds(self) -> float:
        """How long the run would take at this rate, without writing [s]."""
        return self.total / self.rate

    def __str__(self) -> str:
        return (
            f"time: about {spoken(self.seconds)} of stepping, at {self.rate:.3g} environment steps per second "
            f"(measured with {self.envs} environments over the first {self.steps} of {self.of_steps} steps)"
        )


def probe(draft: Draft, settings: Settings, design: Design, most: int) -> Probe:
    """Steps a few environments of an experiment for a moment.

    Args:
        draft: Its scene, ready to be built; used up.
        settings: The experiment, with all defaults.
        design: What varies.
        most: How many environments fit.
    """
    on_gpu = any(part.device.is_cuda for part in draft.parts)
    envs = min(settings.envs, most, ON_GPU if on_gpu else ON_CPU)
    model = draft.build(envs)
    for name, rows in design.rows(0, envs).items():
        model[name] = rows
    simulation = make_simulation(model, settings)
    simulation.advised = True
    steps, _ = recorded_steps(settings.duration, settings.record.every, settings.dt)
    simulation.step()  # compiles
    simulation.reset()
    done = 0
    start = time.perf_counter()
    while done < steps and time.perf_counter() - start < SECONDS:
        some = min(max(SHORTEST_PIECE, done), steps - done)
        simulation.step(some)
        model.health()  # waits for a GPU
        done += some
    took = time.perf_counter() - start
    return Probe(envs, done, steps, envs * done / took, settings.envs * steps)


def spoken(seconds: float) -> str:
    """Returns a time in words, such as ``2 h 5 min``."""
    if seconds < 60.0:
        return f"{seconds:.2g} s"
    minutes = round(seconds / 60.0)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    parts = [(days, "d"), (hours, "h"), (minutes, "min")]
    told = [f"{count} {unit}" for count, unit in parts if count]
    return " ".join(told[:2])
