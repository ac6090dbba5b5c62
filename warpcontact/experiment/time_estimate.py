"""How long a run will take, from a few of its environments that are stepped for a moment."""

import time
from dataclasses import dataclass

from warpcontact.experiment.design import Design
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.shards import make_simulation
from warpcontact.model.plan import ModelPlan
from warpcontact.stepping.simulation import MIN_CHUNK
from warpcontact.stepping.step_counts import recorded_steps

# How long to step [s], and how many environments: enough for all threads of a machine, or for a GPU.
DURATION = 2.0
CPU_ENVS = 1024
GPU_ENVS = 32768


@dataclass(frozen=True)
class TimeEstimate:
    """What a few environments took.

    Attributes:
        envs: How many were stepped.
        steps: How many steps they took.
        total_steps: How many the run has.
        rate: Environment steps per second.
        total_env_steps: Environment steps of the run.
    """

    envs: int
    steps: int
    total_steps: int
    rate: float
    total_env_steps: int

    @property
    def seconds(self) -> float:
        """How long the run would take at this rate, without writing [s]."""
        return self.total_env_steps / self.rate

    def __str__(self) -> str:
        return (
            f"time: about {duration_text(self.seconds)} of stepping, at "
            f"{self.rate:.3g} environment steps per second "
            f"(measured with {self.envs} environments over the first {self.steps} of {self.total_steps} steps)"
        )


def estimate_time(draft: ModelPlan, settings: Settings, design: Design, max_envs: int) -> TimeEstimate:
    """Steps a few environments of an experiment for a moment.

    Args:
        draft: Its scene, ready to be built; used up.
        settings: The experiment, with all defaults.
        design: What varies.
        max_envs: How many environments fit.
    """
    on_gpu = any(part.device.is_cuda for part in draft.parts)
    envs = min(settings.envs, max_envs, GPU_ENVS if on_gpu else CPU_ENVS)
    model = draft.build(envs)
    for name, rows in design.rows(0, envs).items():
        model[name] = rows
    simulation = make_simulation(model, settings)
    simulation.warned_at_start = True
    steps, _ = recorded_steps(settings.duration, settings.record.every, settings.dt)
    simulation.step()  # compiles
    simulation.reset()
    done = 0
    start = time.perf_counter()
    while done < steps and time.perf_counter() - start < DURATION:
        count = min(max(MIN_CHUNK, done), steps - done)
        simulation.step(count)
        model.health()  # waits for a GPU
        done += count
    elapsed = time.perf_counter() - start
    return TimeEstimate(envs, done, steps, envs * done / elapsed, settings.envs * steps)


def duration_text(seconds: float) -> str:
    """Returns a time in words, such as ``2 h 5 min``."""
    if seconds < 60.0:
        return f"{seconds:.2g} s"
    minutes = round(seconds / 60.0)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    parts = [(days, "d"), (hours, "h"), (minutes, "min")]
    texts = [f"{count} {unit}" for count, unit in parts if count]
    return " ".join(texts[:2])
