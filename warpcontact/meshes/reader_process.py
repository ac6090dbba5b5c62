"""Entry point of the process that reads a file: sets limits, executes the task, writes the answer.

Started by ``isolation.py``. The answer is written to the original standard output: eight bytes with the length of a
header, the header as JSON, and the bytes of the arrays that it announces.
"""

import contextlib
import importlib
import json
import os
import signal
import sys
import threading
import time
from typing import Any

#: Whether the system can limit the processor time of a process.
LIMITS_PROCESSOR_TIME = hasattr(signal, "setitimer")
# Larger times exceed the range of system types [s].
_LONGEST = 1.0e9
#: Exit code of a process that exceeded its memory limit, if the process has to check it itself.
OUT_OF_MEMORY = 77


def main(request: dict[str, Any]) -> None:
    """Reads one file.

    Args:
        request: ``module``, whose function ``answer`` returns the header and flat arrays; its argument ``task``; and
            the limits ``memory`` [bytes] and ``seconds`` of processor time.
    """
    limit(request["memory"], request["seconds"])
    answer = os.fdopen(os.dup(1), "wb")
    # Output printed by libraries must neither mix with the answer nor fill a pipe that is not read.
    devnull = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(devnull, stream)
    try:
        header, arrays = importlib.import_module(request["module"]).answer(request["task"])
    except MemoryError:
        header, arrays = {"error": "the file needs more memory than allowed, see Limits"}, []
    except Exception as error:  # standard error is closed
        reason = " ".join(str(error).split())[:200]
        header, arrays = {"error": f"the reader process failed: {type(error).__name__}: {reason}"}, []
    text = json.dumps(header).encode()
    answer.write(len(text).to_bytes(8, "little") + text)
    for array in arrays:
        answer.write(array.data)
    answer.flush()
    os._exit(0)  # skip the cleanup of libraries, which might crash


def limit(memory: int, seconds: float) -> None:
    """Limits this process: address space, processor time, no file or core dump output.

    On systems without these limits (Windows), the parent process must end this one. On systems that do not enforce the
    memory limit (macOS), a thread checks the size of this process.

    Args:
        memory: Address space [bytes].
        seconds: Processor time of all threads, user and system [s].
    """
    seconds = min(seconds, _LONGEST)
    if LIMITS_PROCESSOR_TIME:
        # With the default handler, the signal ends the process within a clock tick, even inside library code.
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGPROF])
        signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        import resource
    except ImportError:
        return
    for kind, value in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CPU, int(seconds) + 2),  # whole seconds; in case a reader blocks the signal
        (resource.RLIMIT_AS, memory),
    ):
        with contextlib.suppress(ValueError, OSError):
            hard = resource.getrlimit(kind)[1]
            allowed = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(kind, (allowed, hard))
    if sys.platform != "linux":
        threading.Thread(target=watch, args=(memory,), daemon=True).start()


def watch(memory: int) -> None:
    """Ends this process when its size exceeds ``memory`` bytes."""
    import resource

    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB elsewhere
    while resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit < memory:
        time.sleep(0.02)
    os._exit(OUT_OF_MEMORY)
