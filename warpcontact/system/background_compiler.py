"""Compiles release builds of kernels for a CPU in other processes, while this process takes steps.

``request`` returns immediately. Threads of this process generate the source of each kernel, pass it to a process that runs
``compile_process.py``, and load the result. Processes run at normal priority, because steps with quick builds take
several times longer. They end with their jobs. At the exit of this process, kernels being compiled are completed by
their processes, at low priority, so that the next process finds them.
"""

import atexit
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import asdict

import warp as wp

from warpcontact.system import compile_process
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.compilation import MAX_COMPILERS, compile_as_launched
from warpcontact.system.kernel_builds import CompileJob, compile_job, is_compiled
from warpcontact.system.resources import available_threads

# Number of characters of compiler messages in an error.
_MESSAGE_LENGTH = 1000


class CompileRequest:
    """Release builds that are compiled in the background.

    Attributes:
        count: Number of kernels, without those that were compiled before.
    """

    def __init__(self, kernels: Iterable[wp.Kernel]) -> None:
        self._remaining = set(kernels)
        self._errors: list[str] = []
        self.count = len(self._remaining)

    @property
    def compiled(self) -> int:
        """Number of kernels that are compiled and loaded, or failed."""
        return self.count - len(self._remaining)

    @property
    def is_done(self) -> bool:
        """Whether all kernels are compiled and loaded, or failed."""
        return not self._remaining

    @property
    def error(self) -> str:
        """Kernels that could not be compiled, with reasons; empty if there are none."""
        return "; ".join(self._errors)

    def finish(self, kernel: wp.Kernel, error: str) -> None:
        """Marks ``kernel`` as compiled, or as failed if there is an error."""
        if kernel in self._remaining:
            if error:
                self._errors.append(error)
            self._remaining.remove(kernel)


class BackgroundCompiler:
    """Queue of kernels, and the threads that have them compiled."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # Held while a thread loads a build: the process must not exit meanwhile.
        self._loading = threading.Lock()
        self._queue: deque[wp.Kernel] = deque()
        self._requests: list[CompileRequest] = []
        self._errors: dict[wp.Kernel, str] = {}
        self._in_progress: set[wp.Kernel] = set()
        self._threads: set[threading.Thread] = set()
        self._processes: set[_Process] = set()
        self._closed = False

    def request(self, kernels: Iterable[wp.Kernel]) -> CompileRequest:
        """Requests the release builds of ``kernels``, in this order, after those requested before."""
        missing = [kernel for kernel in dict.fromkeys(kernels) if not is_compiled(kernel)]
        request = CompileRequest(missing)
        with self._lock:
            self._requests.append(request)
            for kernel in missing:
                if kernel in self._errors:
                    request.finish(kernel, self._errors[kernel])
                elif kernel not in self._in_progress:
                    self._in_progress.add(kernel)
                    self._queue.append(kernel)
            most = min(len(self._queue), MAX_COMPILERS, max(1, available_threads() // 2))
            while len(self._threads) < most and not self._closed:
                # A daemon thread does not delay the exit of this process.
                thread = threading.Thread(target=self._work, name="warpcontact compiler", daemon=True)
                self._threads.add(thread)
                thread.start()
        return request

    def _work(self) -> None:
        """Compiles kernels of the queue, in one process, until the queue is empty."""
        process: _Process | None = None
        while (kernel := self._next()) is not None:
            error = ""
            try:
                # Another process may have compiled it in the meantime.
                if not is_compiled(kernel):
                    if process is None:
                        process = _Process()
                        self._processes.add(process)
                    process.compile(compile_job(kernel))
                with shared_capture_lock(), self._loading:
                    compile_as_launched(kernel, wp.get_device("cpu"))
            except Exception as raised:
                error = f"{kernel.key.split('__')[-1]}: {raised}"
                if process is not None and process.has_ended:
                    self._end(process)
                    process = None
            self._finish(kernel, error)
        if process is not None:
            self._end(process)

    def _end(self, process: "_Process") -> None:
        process.end()
        self._processes.discard(process)

    def _next(self) -> wp.Kernel | None:
        with self._lock:
            if self._queue and not self._closed:
                return self._queue.popleft()
            self._threads.discard(threading.current_thread())
            return None

    def _finish(self, kernel: wp.Kernel, error: str) -> None:
        with self._lock:
            self._in_progress.discard(kernel)
            if error:
                self._errors[kernel] = error
            for request in self._requests:
                request.finish(kernel, error)
            self._requests = [request for request in self._requests if not request.is_done]

    def close(self) -> None:
        """Takes no further kernel, and lets the processes end after those in progress."""
        self._closed = True
        for process in list(self._processes):
            process.close_input()
        self._loading.acquire()

    def abandon(self) -> None:
        """Closes the pipes to processes of the parent process, in a process that was forked."""
        for process in self._processes:
            process.abandon()


class _Process:
    """A process that runs ``compile_process.py``."""

    def __init__(self) -> None:
        if not sys.executable or getattr(sys, "frozen", False):
            raise OSError("there is no Python executable")
        self._messages = tempfile.TemporaryFile()  # noqa: SIM115  closed with the process
        cache = wp.config.kernel_cache_dir
        start = {"path": [str(folder) for folder in sys.path], "cache": cache}
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-B", compile_process.__file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._messages,
                # Without a GPU, Warp starts faster.
                env=os.environ | {"CUDA_VISIBLE_DEVICES": "-1"},
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except BaseException:
            self._messages.close()
            raise
        self._write(start)

    @property
    def has_ended(self) -> bool:
        """Whether the process ended."""
        return self._process.poll() is not None

    def compile(self, job: CompileJob) -> None:
        """Compiles a job and waits for it.

        Raises:
            RuntimeError: If it cannot be compiled.
        """
        before = self._messages.seek(0, os.SEEK_END)
        try:
            self._write(asdict(job))
            assert self._process.stdout is not None
            answer = self._process.stdout.readline()
        except OSError:
            answer = b""
        if answer:
            error = json.loads(answer)["error"]
        else:
            job.discard()
            error = f"the compiler process ended with code {self._process.wait()}"
        if error:
            raise RuntimeError(f"{error}{self._messages_since(before)}")

    def _write(self, content: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(content).encode() + b"\n")
        self._process.stdin.flush()

    def _messages_since(self, position: int) -> str:
        """Returns the messages of the compiler since a position in their file, after a colon; empty if none."""
        end = self._messages.seek(0, os.SEEK_END)
        self._messages.seek(max(position, end - _MESSAGE_LENGTH))
        text = self._messages.read().decode(errors="replace").strip()
        return f": {text}" if text else ""

    def close_input(self) -> None:
        """Lets the process end after its job."""
        with contextlib.suppress(OSError, ValueError):
            self._process.stdin.close()  # type: ignore[union-attr]

    def end(self) -> None:
        """Lets the process end after its job, and waits for it."""
        self.close_input()
        self._process.wait()
        self._process.stdout.close()  # type: ignore[union-attr]
        self._messages.close()

    def abandon(self) -> None:
        """Closes the pipes to a process that belongs to the parent of this process."""
        self.close_input()
        self._process.stdout.close()  # type: ignore[union-attr]
        # The process is no child of this one, so its end cannot be observed.
        self._process.returncode = 0


_compiler = BackgroundCompiler()


def request(kernels: Iterable[wp.Kernel]) -> CompileRequest:
    """Requests the release builds of ``kernels`` for the CPU, in this order, after those requested before."""
    return _compiler.request(kernels)


def _restart_after_fork() -> None:
    """Replaces the compiler in a forked process, which has no copy of its threads."""
    global _compiler  # noqa: PLW0603  its lock may be held by a thread that does not exist here
    _compiler.abandon()
    _compiler = BackgroundCompiler()


atexit.register(lambda: _compiler.close())  # noqa: PLW0108  another compiler after a fork
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_restart_after_fork)
