"""Frames of a recorder, taken while a simulation steps."""

from typing import TYPE_CHECKING

from warpcontact.slices import Frames

if TYPE_CHECKING:
    from warpcontact.recorder import Recorder
    from warpcontact.simulation import Simulation


def take_first(simulation: "Simulation", recorder: "Recorder", time: float) -> None:
    """Takes a frame of the state that there is, at ``time`` [s]."""
    recorder.require(1)
    needs = frozenset(recorder.needs)
    if not simulation.looks_by_slice(needs):
        recorder.take(time)
        return
    simulation.crew().look(Frames(1, needs, recorder.take_of, recorder.copies, recorder.taken))
    recorder.count([time])


def take_after(
    simulation: "Simulation",
    recorder: "Recorder",
    count: int,
    every: int,
    start: float,
    done: int,
    follows: bool,
) -> None:
    """Takes ``count`` times ``every`` steps after the first ``done``, and a frame after each of these.

    ``follows``: whether they follow a frame, see ``Frames``.
    """
    recorder.require(count)
    needs = frozenset(recorder.needs)
    frames = Frames(every, needs, recorder.take_of, recorder.copies, recorder.taken, follows)
    simulation.step_to_frames(count, frames)
    recorder.count([start + (done + (number + 1) * every) * simulation.dt for number in range(count)])
