"""FrameSchedule of a recorder, taken while a simulation steps."""

from typing import TYPE_CHECKING

from warpcontact.stepping.slice_stepper import FrameSchedule

if TYPE_CHECKING:
    from warpcontact.stepping.recorder import Recorder
    from warpcontact.stepping.simulation import Simulation


def record_first_frame(simulation: "Simulation", recorder: "Recorder", time: float) -> None:
    """Takes a frame of the state that there is, at ``time`` [s]."""
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
    """Takes ``count`` times ``every`` steps after the first ``done``, and a frame after each of these.

    ``follows_frame``: whether they follow a frame, see ``FrameSchedule``.
    """
    recorder.require(count)
    needs = frozenset(recorder.needs)
    frames = FrameSchedule(every, needs, recorder.take_part, recorder.copies, recorder.taken, follows_frame)
    simulation.step_to_frames(count, frames)
    recorder.count([start + (done + (number + 1) * every) * simulation.dt for number in range(count)])
