"""Staged start: steps use quick builds of staged kernels until release builds are compiled in the background.

Quick builds of staged kernels compile several times faster than release builds of fused kernels, and give bitwise the
same results. ``Simulation`` replaces its launches between two chunks of steps, when the release builds are loaded.
"""

import warnings
from collections.abc import Callable, Iterable

import warp as wp

from warpcontact.forces.launch_shape import AUTO, STAGED
from warpcontact.system.background_compiler import CompileRequest, request, resume_after_fork
from warpcontact.system.compilation import load_all
from warpcontact.system.kernel_builds import is_compiled, starts_quick
from warpcontact.validation.warning_levels import RunWarning, caller_stacklevel

#: Returns kernels on the CPU by the fastest launch shape to choose: those of a step, and all of steps and frames.
KernelLists = Callable[[str], tuple[list[wp.Kernel], list[wp.Kernel]]]


# Number of chunks of steps before release builds are requested.
_FIRST_CHUNKS = 2


class StagedStart:
    """Loads the kernels of a simulation, and chooses its launch shape until all release builds are compiled.

    Args:
        launch_shape: As for ``Simulation``. There is no staged start unless it is ``AUTO``.
        threads: Maximum number of threads that compile.

    Attributes:
        fastest_shape: Fastest launch shape to choose at present, see ``ExecutionPlan``.
        is_over: Whether steps use release builds of all their kernels.
        errors: Kernels that could not be compiled in the background, with reasons; empty if there are none.
    """

    def __init__(self, launch_shape: str, threads: int) -> None:
        self.fastest_shape = self._selected = launch_shape
        self.is_over = self._is_loaded = False
        self._threads = threads
        # Kernels whose release builds are missing: those of steps, and those of steps and frames.
        self._missing: tuple[list[wp.Kernel], list[wp.Kernel]] = ([], [])
        self._chunks = 0
        # Requests for release builds: that of the kernels of a step, and those of others.
        self._for_steps: CompileRequest | None = None
        self._for_others: list[CompileRequest] = []
        # Why release builds of the last requests are missing.
        self.errors = ""

    @property
    def uses_quick_builds(self) -> bool:
        """Whether present steps use quick builds of kernels."""
        return self._is_loaded and not self.is_over

    @property
    def requested(self) -> int:
        """Number of release builds that are requested, with those compiled since."""
        return max((one.count for one in self._requests()), default=0)

    @property
    def compiled(self) -> int:
        """Number of requested release builds that are compiled."""
        return max((one.compiled for one in self._requests()), default=0)

    def load(self, kernels: KernelLists) -> None:
        """Loads builds of all kernels of steps and frames, and requests the release builds that are missing."""
        cpu = wp.get_device("cpu")
        self._is_loaded = True
        steps, every = kernels(self._selected)
        waits = self._selected != AUTO or not starts_quick(cpu)
        if waits or all(map(is_compiled, every)):
            load_all(every, cpu, self._threads, release=waits)
            self.is_over = not self._for_steps_unfinished
            return
        missing = [kernel for kernel in steps if not is_compiled(kernel)]
        if missing and not self.is_over:
            self.fastest_shape = STAGED
        load_all(kernels(self.fastest_shape)[1], cpu, self._threads)
        self.is_over = not missing and not self._for_steps_unfinished
        self._missing = missing, [*self._missing[1], *every]
        self._chunks = 0

    def load_release_builds(self, kernels: Iterable[wp.Kernel]) -> None:
        """Compiles release builds of all kernels of steps now, in this process."""
        load_all(kernels, wp.get_device("cpu"), self._threads, release=True)
        self.fastest_shape, self.is_over, self._for_steps, self.errors = self._selected, True, None, ""
        self._missing = [], self._missing[1]

    def take_compiled(self) -> bool:
        """Takes release builds that were loaded; returns whether steps must be prepared again.

        It must be called before each chunk of steps. The missing builds are requested after the first chunks, because
        generating their sources would delay these chunks, which capture graphs.
        """
        if self._chunks >= _FIRST_CHUNKS and self._missing[1]:
            for_steps, others = self._missing
            if for_steps and self._for_steps is None:
                self._for_steps = request(for_steps)
            self._for_others.append(request(others))
            self._missing = [], []
        self._chunks += 1
        if self._for_steps is not None or self._for_others:
            resume_after_fork()
        done = [one for one in self._requests() if one.is_done]
        if not done:
            return False
        if self._for_steps is not None and self._for_steps.is_done:
            if not self._for_steps.error:
                self.fastest_shape, self.is_over = self._selected, True
            self._for_steps = None
        self._for_others = [one for one in self._for_others if not one.is_done]
        self.errors = "; ".join(dict.fromkeys(one.error for one in done if one.error))
        if self.errors:
            text = (
                f"kernels could not be compiled in the background: {self.errors}. Steps continue with quick builds, which "
                "are several times slower. Simulation.compile() compiles the kernels in this process"
            )
            warnings.warn(RunWarning(text), stacklevel=caller_stacklevel())
        return True

    @property
    def _for_steps_unfinished(self) -> bool:
        """Whether present steps do not use the release builds yet, which may be compiled already."""
        return self._for_steps is not None or self.fastest_shape != self._selected

    def _requests(self) -> list[CompileRequest]:
        return [*([] if self._for_steps is None else [self._for_steps]), *self._for_others]
