"""Time stepping: takes a model forward and records what is asked for."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpcontact import checks
from warpcontact.advice import ContactWarning, advice
from warpcontact.build import allocate
from warpcontact.integrators import Integrator, SemiImplicitEuler
from warpcontact.kernels import integrate, sweep
from warpcontact.model import Model
from warpcontact.parameters import broadcast, rounded
from warpcontact.recorder import Recorder, Recording
from warpcontact.schedule import accept_stages, change_stages, step_stages

# Steps between two looks at the progress bar; a step of a large model takes milliseconds.
STEPS_PER_UPDATE = 50


@dataclass(frozen=True)
class _Step:
    """The launches of a step from one buffer to the other, and those of a part of it."""

    state_in: Any
    state_out: Any
    whole: list[wp.Launch]
    part: list[wp.Launch]
    divide: list[wp.Launch]  # before a first part from the first buffer
    resume: list[wp.Launch]  # after a last part into the second


class Simulation:
    """Steps a model through time.

    Args:
        model: The model; its state is the state of the simulation.
        dt: Time step [s].
        integrator: Scheme, semi-implicit Euler if not given.
        crossing_steps: Parts into which a step is divided, in environments in which a swept point crosses a
            surface in that step. 1: such a step is taken as it is, and the contact begins as deep as it led.

    """

    def __init__(
        self, model: Model, dt: float, integrator: Integrator | None = None, *, crossing_steps: int = 1
    ) -> None:
        integrator = SemiImplicitEuler() if integrator is None else integrator
        if not isinstance(model, Model):
            raise TypeError(f"model must come from Scene.build, got {model!r}")
        if not isinstance(integrator, Integrator):
            raise TypeError(
                f"integrator must be an object of wc.integrators, such as SemiImplicitEuler(), got {integrator!r}"
            )
        self.model = model
        self.integrator = integrator
        self.dt = float(checks.numbers("dt", dt, (), checks.limits("s", above=0.0)))
        rounded("dt", np.array(self.dt), wp.dtype_to_numpy(model.types.real))
        if (
            isinstance(crossing_steps, bool)
            or not isinstance(crossing_steps, int | np.integer)
            or crossing_steps < 1
        ):
            raise ValueError(f"crossing_steps must be a whole number of at least 1, got {crossing_steps!r}")
        self.crossing_steps = int(crossing_steps)
        self._advised = False
        part = self.dt / self.crossing_steps
        self._dt_memory = [
            wp.full((1, 1), value, dtype=model.types.real, device=model.device)
            for value in (self.dt, part, part - self.dt, self.dt - part)
        ]
        self._dt, self._part, self._shorter, self._longer = (
            broadcast(memory, model.envs) for memory in self._dt_memory
        )
        divides = model.sweeps and self.crossing_steps > 1
        self._mark = wp.zeros(1, dtype=wp.int32, device=model.device) if divides else None
        # Steps go from one buffer to the other and back; between calls the state is always in the model's.
        self._other = allocate(model.types.State, (model.envs, model.body_count), model.device)
        self._prepared: tuple[int, list[_Step]] = (-1, [])

    @property
    def state(self) -> Any:
        """The current state; see ``Model``."""
        return self.model.state

    @property
    def time(self) -> float:
        """Simulated time since the last complete reset of the model [s]."""
        return self.model.time

    @property
    def steps(self) -> int:
        """That time in steps of this simulation."""
        return round(self.model.time / self.dt)

    def reset(self, env_mask: ArrayLike | None = None) -> None:
        """Puts environments back to their initial state, with empty history.

        Args:
            env_mask: Booleans (envs,) of the environments to reset; ``None``: all, and the clock too.
        """
        self.model.reset(env_mask)

    def step(self, count: int = 1) -> None:
        """Takes ``count`` steps without recording."""
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 0:
            raise ValueError(f"count must be a whole number of at least 0, got {count!r}")
        if count == 0:
            return
        model = self.model
        if model.at_start and not self._advised:
            self._advised = True
            for sentence in advice(model, self.dt):
                warnings.warn(sentence, ContactWarning, stacklevel=2)
        model.at_start = False
        if self._prepared[0] != model.revision:
            own, other = model.arrays.state, self._other
            self._prepared = (model.revision, [self._prepare(own, other), self._prepare(other, own)])
        _, steps = self._prepared
        done = 0
        try:
            while done < count:
                self._take(steps, done % 2)
                done += 1
        except BaseException:
            # Whoever was waiting for the others would wait for ever.
            if self._mark is not None:
                self._turn(back=True)
            raise
        finally:
            # Also after an interruption: the state is in the model's buffer, and the clock tells its time.
            if done % 2:
                self._adopt(self._other, model.arrays.state)
            self.model.time += done * self.dt

    def _prepare(self, state_in: Any, state_out: Any) -> "_Step":
        model, integrator, mark = self.model, self.integrator, self._mark
        part, divide, resume = [], [], []
        if mark is not None:
            part = step_stages(model, integrator, self._part, state_in, state_out, None)
            part += accept_stages(model, self._part, state_in, state_out)
            divide = change_stages(model, integrator, self._shorter, state_in)
            resume = change_stages(model, integrator, self._longer, state_out)
        return _Step(
            state_in,
            state_out,
            whole=step_stages(model, integrator, self._dt, state_in, state_out, mark)
            + accept_stages(model, self._dt, state_in, state_out),
            part=part,
            divide=divide,
            resume=resume,
        )

    def _take(self, steps: "list[_Step]", way: int) -> None:
        """Takes one step from one buffer to the other, and again in parts where a surface was crossed."""
        if self._mark is not None:
            self._mark.zero_()
        for launch in steps[way].whole:
            launch.launch()
        if self._mark is None or not self._mark.numpy()[0]:
            return
        # Environments with a crossing have not moved on. The others wait.
        self._turn(back=False)
        for launch in steps[way].divide:
            launch.launch()
        for part in range(self.crossing_steps):
            for launch in steps[(way + part) % 2].part:
                launch.launch()
        if self.crossing_steps % 2 == 0:
            self._adopt(steps[way].state_in, steps[way].state_out)
        for launch in steps[way].resume:
            launch.launch()
        self._turn(back=True)

    def _turn(self, *, back: bool) -> None:
        model = self.model
        wp.launch(sweep.turn(), dim=model.envs, inputs=[model.arrays.status, int(back)], device=model.device)

    def run(
        self,
        duration: float,
        record: Sequence[str] = (),
        every: float | None = None,
        *,
        poses: bool = True,
        parameters: Sequence[str] = (),
        progress: bool | None = None,
    ) -> Recording:
        """Simulates for ``duration`` and returns what was recorded, the state at the start included.

        Args:
            duration: Simulated time [s]; rounded up to whole steps.
            record: Names of readings, see ``model.reading_names``.
            every: Time between records [s], a multiple of the step; ``None``: every step.
            poses: Whether to record the position and orientation of every body as well, and the parameters
                that differ between environments, so that the recording can be replayed and exported.
            parameters: Names of further parameters to keep with the recording, whether or not they differ.
            progress: Whether to show a progress bar; ``None``: on runs of over a second, in a terminal.

        Returns:
            A data set with dimensions (time, env), then ``item`` for sets of points and ``axis`` or
            ``component`` for vectors and quaternions; units are in the attributes.

        Raises:
            ValueError: If a time is not allowed.
            KeyError: If there is no such reading.
        """
        from tqdm import tqdm

        steps = whole_steps("duration", duration, self.dt, exact=False)
        stride = 1 if every is None else whole_steps("every", every, self.dt, exact=True)
        if isinstance(record, str):
            raise TypeError(f"record must be a list of readings, got the string {record!r}")
        recorder = Recorder(self.model, record, frames=steps // stride + 1, poses=poses, parameters=parameters)
        start = self.time
        recorder.take(start)
        frozen = len(self.model.health().frozen)
        done = 0
        with tqdm(
            total=steps,
            unit="step",
            desc=f"{self.model.envs} environments",
            delay=1.0,
            disable=None if progress is None else not progress,
        ) as bar:
            while done < steps:
                ahead = min(stride - done % stride, STEPS_PER_UPDATE, steps - done)
                self.step(ahead)
                done += ahead
                bar.update(ahead)
                if done % stride == 0:
                    recorder.take(start + done * self.dt)
        health = self.model.health()
        if len(health.frozen) > frozen:
            warnings.warn(str(health), RuntimeWarning, stacklevel=2)
        return recorder.finish(
            {
                "dt": self.dt,
                "integrator": type(self.integrator).__name__,
                "frozen_environments": health.frozen.tolist(),
            }
        )

    def _adopt(self, source: Any, target: Any) -> None:
        """Copies the state of the active environments; a frozen one is left as it is."""
        wp.launch(
            integrate.adopt(self.model.types.real),
            dim=(self.model.envs, self.model.body_count),
            inputs=[self.model.arrays.status, source, target],
            device=self.model.device,
        )

    def __repr__(self) -> str:
        return f"<Simulation of {self.model!r}, dt = {self.dt:g} s, at {self.time:g} s>"


def whole_steps(name: str, time: float, dt: float, *, exact: bool) -> int:
    """Returns the number of steps in a time.

    Args:
        name: What to call it in a message.
        time: The time [s], positive.
        dt: The step [s].
        exact: Whether the time must be a multiple of the step; if not, it is rounded up.

    Raises:
        ValueError: If ``time`` is not positive, or not a multiple of the step.
    """
    value = float(checks.numbers(name, time, (), checks.limits("s", above=0.0)))
    steps = value / dt
    nearest = round(steps)
    # Decimal fractions of a second are not exact; a millionth of a step is far below what anyone means.
    if nearest >= 1 and abs(steps - nearest) <= 1.0e-6:
        return nearest
    if exact:
        below, above = max(int(steps), 1), int(steps) + 1
        raise ValueError(
            f"{name} must be a multiple of dt = {dt:g} s, got {value:g} s; "
            f"the nearest are {below * dt:g} s and {above * dt:g} s"
        )
    return int(steps) + 1
