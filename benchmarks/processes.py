"""A simulation in several processes of one thread: what cores give to steps that share nothing but the machine.

Virtual cores may share a cache, or be threads of one core, and one core alone may run faster: then no number of
threads is as many times as fast as one, whatever steps them.
"""

import multiprocessing
import statistics
import warnings
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from series import Case


class Processes:
    """The environments of a case, in as many processes as it has threads.

    Args:
        case: The case, on the CPU.
        steps: Steps of a run.

    Attributes:
        envs: How many environments they step together: all, but for what cannot be shared out evenly.
    """

    def __init__(self, case: Case, steps: int) -> None:
        context = multiprocessing.get_context("spawn")
        each = replace(case, envs=max(1, case.envs // case.threads), threads=1)
        self.envs = each.envs * case.threads
        self._lines: list[Connection[Any, Any]] = []
        self._running = []
        for _ in range(case.threads):
            here, there = context.Pipe()
            # Nothing is left behind where what started them ends before it could say so.
            process = context.Process(target=_run_on_request, args=(each, steps, there), daemon=True)
            process.start()
            there.close()
            self._lines.append(here)
            self._running.append(process)
        for line in self._lines:
            line.recv()

    def seconds_of_runs(self, at_least: float) -> float:
        """Returns how long a run takes where all run at once, each for ``at_least`` seconds: the mean [s]."""
        for line in self._lines:
            line.send(at_least)
        return statistics.mean(line.recv() for line in self._lines)

    def close(self) -> None:
        """Ends the processes."""
        for line, process in zip(self._lines, self._running, strict=True):
            line.close()
            process.join()


def _run_on_request(case: Case, steps: int, line: "Connection[Any, Any]") -> None:
    """Says that a simulation is ready, and then how long its runs take, for as long as anybody asks."""
    import warp as wp

    import warpcontact as wc
    from warpcontact.benchmark.simulation import run_seconds, seconds_of_runs

    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore", wc.ContactWarning)
    sim = case.simulation("cpu")
    run_seconds(sim, steps)
    line.send("ready")
    while True:
        try:
            at_least = line.recv()
        except EOFError:
            return
        line.send(seconds_of_runs(sim, steps, at_least))
