"""Records the frames of a recorder while a simulation steps."""

from typing import TYPE_CHECKING

from warpcontact.stepping.slice_stepper import FrameSchedule

if TYPE_CHECKING:
    from warpcontact.stepping.recorder import Recorder
    from warpcontact.stepping.simulation import Simulation


def record_first_frame(simulation: "Simulation", recorder: "Recorder", time: float) -> None:
    """Records a frame of the current state, at ``time`` [s]."""
    recorder.require(1)
    needs = frozenset(recorder.needs)
    if not simulation.evaluates_by_slice(needs):
        recorder.take(time)
        return
    simulation.worker_pool().record_frame(
        FrameSchedule(1, needs, recorder.take_part, recorder.copies, recorder.taken)
    )
    recorder.count([time])


def record_frames(
    simulation: "Simulation",
    recorder: "Recorder",
    count: int,
    every: int,
    start: float,
    done: int,
    follows_frame: bool,
) -> None:
    """Takes ``count`` × ``every`` steps and records a frame after every ``every`` steps.

    Args:
        simulation: The simulation.
        recorder: Records the frames.
        count: Number of frames.
        every: Number of steps between frames.
        start: Simulated time at step 0 of the run [s].
        done: Number of steps taken before.
        follows_frame: Whether the steps follow a frame, see ``FrameSchedule``.
    """
    recorder.require(count)
    needs = frozenset(recorder.needs)
    frames = FrameSchedule(every, needs, recorder.take_part, recorder.copies, recorder.taken, follows_frame)
    simulation.step_to_frames(count, frames)
    recorder.count([start + (done + (number + 1) * every) * simulation.dt for number in range(count)])
