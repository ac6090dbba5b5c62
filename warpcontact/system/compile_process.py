"""Entry point of the process that compiles kernels in the background; started by ``background_compiler.py``.

The first line of standard input has the folders of Python packages and the kernel cache. Each further line is a
``CompileJob`` as JSON. Each line of the original standard output answers one: an empty error, or its text. If the other
process ends, the job in progress is completed at low priority, so that the next process finds the build.
"""

import contextlib
import json
import os
import queue
import shutil
import signal
import sys
import threading
from pathlib import Path
from typing import Any

# Priority of the compilation after the end of the other process; the lowest one.
_LOWEST_PRIORITY = 19


def main() -> None:
    """Compiles jobs until standard input ends."""
    # Ctrl-C in a terminal reaches all processes. The other process handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    # Compiler and Warp write to standard output and error.
    os.dup2(2, 1)
    start = json.loads(sys.stdin.readline())
    sys.path[:] = start["path"]
    jobs: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(jobs, threading.get_native_id()), daemon=True).start()
    with contextlib.suppress(BrokenPipeError):
        while line := jobs.get():
            error = ""
            try:
                build(json.loads(line), Path(start["cache"]))
            except Exception as raised:
                error = f"{type(raised).__name__}: {raised}"
            print(json.dumps({"error": error}), file=answers)


def build(job: dict[str, Any], cache: Path) -> None:
    """Compiles a job and moves its files into the kernel cache."""
    import warp as wp
    from warp._src import build as warp_build
    from warp._src import context

    wp.config.log_level = wp.LOG_ERROR
    # Warp appends its version to the folder.
    wp.config.kernel_cache_dir = str(cache.parent if cache.name == wp.config.version else cache)
    wp.init()
    folder, build_folder = Path(job["folder"]), Path(job["build_folder"])
    options = job["options"]
    if options["use_precompiled_headers"]:
        options["pch_dir"] = context.runtime.get_clang_pch_dir()
    try:
        warp_build.build_cpu(str(build_folder / job["binary"]), str(build_folder / job["source"]), **options)
        try:
            build_folder.rename(folder)
        except OSError:  # another process compiled the kernel, or the folder has builds for other machines
            folder.mkdir(exist_ok=True)
            for file in build_folder.iterdir():
                os.replace(file, folder / file.name)
    finally:
        shutil.rmtree(build_folder, ignore_errors=True)


def _read(jobs: "queue.SimpleQueue[str | None]", compiling_thread: int) -> None:
    """Passes lines of standard input on. At its end, lowers the priority of the compilation."""
    try:
        for line in sys.stdin:
            jobs.put(line)
        # Only Linux has priorities of threads; those of the process would also apply to this thread.
        who = compiling_thread if sys.platform == "linux" else 0
        with contextlib.suppress(AttributeError, OSError):
            os.setpriority(os.PRIO_PROCESS, who, _LOWEST_PRIORITY)
    finally:
        jobs.put(None)


if __name__ == "__main__":
    main()
