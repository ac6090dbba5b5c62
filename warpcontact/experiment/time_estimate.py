"""Estimates the wall time of a run by stepping some of its environments for two seconds."""

import time
from dataclasses import dataclass

from warpcontact.building.plan import ModelPlan
from warpcontact.experiment.design import Design
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.shards import make_simulation
from warpcontact.stepping.simulation import MIN_CHUNK
from warpcontact.stepping.step_counts import recorded_steps

# Duration of the measurement [s], and numbers of environments: enough for all threads of a machine, or for a GPU.
DURATION = 2.0
CPU_ENVS = 1024
GPU_ENVS = 32768


@dataclass(frozen=True)
class TimeEstimate:
    """Estimated wall time of a run, and the measurement it is based on.

    Attributes:
        envs: Number of environments that were stepped.
        steps: Number of steps that were taken.
        total_steps: Number of steps of the run.
        rate: Environment steps per second.
        total_env_steps: Number of environment steps of the run.
    """

    envs: int
    steps: int
    total_steps: int
    rate: float
    total_env_steps: int

    @property
    def seconds(self) -> float:
        """Estimated wall time of stepping, without writing [s]."""
        return self.total_env_steps / self.rate

    def __str__(self) -> str:
        return (
            f"time: about {duration_text(self.seconds)} of stepping, at "
            f"{self.rate:.3g} environment steps per second "
            f"(measured with {self.envs} environments over the first {self.steps} of {self.total_steps} steps)"
        )


def estimate_time(draft: ModelPlan, settings: Settings, design: Design, max_envs: int) -> TimeEstimate:
    """Measures the stepping rate of some environments of an experiment.

    Args:
        draft: Plan of the model; cannot be used again.
        settings: The experiment, with all defaults.
        design: The varied parameters.
        max_envs: Maximum number of environments.
    """
    on_gpu = any(part.device.is_cuda for part in draft.parts)
    envs = min(settings.envs, max_envs, GPU_ENVS if on_gpu else CPU_ENVS)
    model = draft.build(envs)
    for name, rows in design.rows(0, envs).items():
        model[name] = rows
    simulation = make_simulation(model, settings)
    simulation.warned_at_start = True
    steps, _ = recorded_steps(settings.duration, settings.record.every, settings.dt)
    simulation.step()  # compiles the kernels
    simulation.reset()
    done = 0
    start = time.perf_counter()
    while done < steps and time.perf_counter() - start < DURATION:
        count = min(max(MIN_CHUNK, done), steps - done)
        simulation.step(count)
        model.health()  # synchronizes with a GPU
        done += count
    elapsed = time.perf_counter() - start
    return TimeEstimate(envs, done, steps, envs * done / elapsed, settings.envs * steps)


def duration_text(seconds: float) -> str:
    """Returns a time as text, such as ``2 h 5 min``."""
    if seconds < 60.0:
        return f"{seconds:.2g} s"
    minutes = round(seconds / 60.0)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    parts = [(days, "d"), (hours, "h"), (minutes, "min")]
    texts = [f"{count} {unit}" for count, unit in parts if count]
    return " ".join(texts[:2])
