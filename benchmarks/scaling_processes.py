"""Runs a simulation in several single-threaded processes: the speedup of steps without shared data.

Virtual cores may share a cache or a physical core, and a single core may run at a higher clock rate. This measures
the speedup that the machine allows, independent of the implementation of threads.
"""

import multiprocessing
import statistics
import warnings
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from scaling_cases import Case


class Processes:
    """Environments of a case, distributed over as many processes as it has threads.

    Args:
        case: The case, on the CPU.
        steps: Number of steps of a run.

    Attributes:
        envs: Number of environments of all processes: that of the case, rounded to an equal number per process.
    """

    def __init__(self, case: Case, steps: int) -> None:
        context = multiprocessing.get_context("spawn")
        each = replace(case, envs=max(1, case.envs // case.threads), threads=1)
        self.envs = each.envs * case.threads
        self._lines: list[Connection[Any, Any]] = []
        self._running = []
        for _ in range(case.threads):
            here, there = context.Pipe()
            # Daemon processes end if the parent process ends without closing the pipe.
            process = context.Process(target=_run_on_request, args=(each, steps, there), daemon=True)
            process.start()
            there.close()
            self._lines.append(here)
            self._running.append(process)
        for line in self._lines:
            line.recv()

    def seconds_of_runs(self, at_least: float) -> float:
        """Returns the mean time of a run [s] while all processes run simultaneously for ``at_least`` seconds each."""
        for line in self._lines:
            line.send(at_least)
        return statistics.mean(line.recv() for line in self._lines)

    def close(self) -> None:
        """Ends the processes."""
        for line, process in zip(self._lines, self._running, strict=True):
            line.close()
            process.join()


def _run_on_request(case: Case, steps: int, line: "Connection[Any, Any]") -> None:
    """Reports that a simulation is ready, then the time of its runs for each request."""
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
