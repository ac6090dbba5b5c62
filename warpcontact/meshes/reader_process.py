"""What runs in the process that reads a file: limits first, then all that there is to do, then the answer.

Started by ``isolation``, never imported by the rest. The answer goes to what was standard output: eight bytes with
the length of a header, the header as JSON, and the bytes of the arrays that it announces.
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

#: Whether the system can end a process after a processor time.
LIMITS_PROCESSOR_TIME = hasattr(signal, "setitimer")
# Longer times do not fit into the types of the system [s].
_LONGEST = 1.0e9
#: Exit code of a process that watched its own memory and found it too large.
OUT_OF_MEMORY = 77


def main(request: dict[str, Any]) -> None:
    """Reads one file.

    Args:
        request: ``module`` with a function ``answer``, which returns the header and flat arrays; what that is
            given, ``task``; and the limits ``memory`` [bytes] and ``seconds`` of processor time.
    """
    limit(request["memory"], request["seconds"])
    answer = os.fdopen(os.dup(1), "wb")
    # What libraries print must neither mix with the answer nor fill a pipe that nobody empties.
    devnull = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(devnull, stream)
    try:
        header, arrays = importlib.import_module(request["module"]).answer(request["task"])
    except MemoryError:
        header, arrays = {"error": "it needs more memory than is allowed, see Limits"}, []
    except Exception as error:  # standard error leads nowhere now
        reason = " ".join(str(error).split())[:200]
        header, arrays = {"error": f"the process that reads it failed: {type(error).__name__}: {reason}"}, []
    text = json.dumps(header).encode()
    answer.write(len(text).to_bytes(8, "little") + text)
    for array in arrays:
        answer.write(array.data)
    answer.flush()
    os._exit(0)  # libraries have nothing to tidy up, and might crash at it


def limit(memory: int, seconds: float) -> None:
    """Limits this process: address space, processor time, and no files or core dumps written.

    Systems without these limits (Windows) leave it to the process that started this one to end it. If the system
    does not enforce the limit on memory (macOS), a thread checks the size of this process.

    Args:
        memory: Address space [bytes].
        seconds: Processor time of all threads, user and system [s].
    """
    seconds = min(seconds, _LONGEST)
    if LIMITS_PROCESSOR_TIME:
        # Ends the process to within a clock tick, also inside of a library, because Python installs no handler.
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
        (resource.RLIMIT_CPU, int(seconds) + 2),  # in whole seconds: for a reader that blocks the signal
        (resource.RLIMIT_AS, memory),
    ):
        with contextlib.suppress(ValueError, OSError):
            hard = resource.getrlimit(kind)[1]
            allowed = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(kind, (allowed, hard))
    if sys.platform != "linux":
        threading.Thread(target=watch, args=(memory,), daemon=True).start()


def watch(memory: int) -> None:
    """Ends this process once it has held more than ``memory`` bytes."""
    import resource

    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB elsewhere
    while resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit < memory:
        time.sleep(0.02)
    os._exit(OUT_OF_MEMORY)
