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
from multiprocessing import spawn
from weakref import WeakKeyDictionary, ref

import warp as wp

from warpcontact.system import compile_process
from warpcontact.system.capture_lock import (
    lock_captures_for_fork,
    shared_capture_lock,
    unlock_captures_after_fork,
)
from warpcontact.system.compilation import MAX_COMPILERS, compile_as_launched, forget_threads
from warpcontact.system.kernel_builds import CompileJob, codegen_lock, compile_job, has_files, is_compiled
from warpcontact.system.resources import available_threads

# Number of characters of compiler messages in an error.
_MESSAGE_LENGTH = 1000


class CompileRequest:
    """Release builds that are compiled in the background. Kernels that no living request contains are not compiled.

    Attributes:
        count: Number of kernels, without those that were compiled before.
    """

    def __init__(self, kernels: Iterable[wp.Kernel]) -> None:
        self.remaining = dict.fromkeys(kernels)
        self._errors: list[str] = []
        self.count = len(self.remaining)

    @property
    def compiled(self) -> int:
        """Number of kernels that are compiled and loaded."""
        return self.count - len(self.remaining) - len(self._errors)

    @property
    def is_done(self) -> bool:
        """Whether all kernels are compiled and loaded, or failed."""
        return not self.remaining

    @property
    def error(self) -> str:
        """Kernels that could not be compiled, with reasons; empty if there are none."""
        return "; ".join(self._errors)

    def finish(self, kernel: wp.Kernel, error: str) -> None:
        """Marks ``kernel`` as compiled, or as failed if there is an error."""
        if kernel in self.remaining:
            if error:
                self._errors.append(error)
            del self.remaining[kernel]


class BackgroundCompiler:
    """Queue of kernels, and the threads that have them compiled."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # Held while a thread loads a build: the process must not exit or fork meanwhile.
        self._loading = threading.Lock()
        self._queue: deque[wp.Kernel] = deque()
        # In the order of the requests.
        self._requests: list[ref[CompileRequest]] = []
        # Answers of the compiler for kernels that it rejected.
        self._errors: WeakKeyDictionary[wp.Kernel, str] = WeakKeyDictionary()
        self._in_progress: set[wp.Kernel] = set()
        self._threads: set[threading.Thread] = set()
        self._processes: set[_Process] = set()
        self._closed = False
        # Whether ``lock_for_fork`` acquired the lock of loading.
        self._has_loading_lock = False

    def request(self, kernels: Iterable[wp.Kernel]) -> CompileRequest:
        """Requests the release builds of ``kernels``, in this order, after those requested before."""
        missing = [kernel for kernel in dict.fromkeys(kernels) if not is_compiled(kernel)]
        request = CompileRequest(missing)
        self._adopt([request])
        return request

    def _adopt(self, requests: Iterable[CompileRequest]) -> None:
        """Queues the kernels of requests, and starts threads that compile them."""
        with self._lock:
            for request in requests:
                self._requests.append(ref(request))
                for kernel in list(request.remaining):
                    if kernel in self._errors:
                        request.finish(kernel, self._errors[kernel])
                    elif kernel not in self._in_progress:
                        self._in_progress.add(kernel)
                        self._queue.append(kernel)
            most = min(len(self._queue), MAX_COMPILERS, max(1, available_threads() // 2))
            while len(self._threads) < most and not self._closed:
                # A daemon thread does not delay the exit of this process.
                thread = threading.Thread(target=self._work, name="warpcontact compiler", daemon=True)
                try:
                    thread.start()
                except RuntimeError as raised:  # the system, or the end of this process, allows no further thread
                    if not self._threads:
                        self._fail_all(str(raised))
                    break
                # It waits for the lock before it takes a kernel.
                self._threads.add(thread)

    def _fail_all(self, error: str) -> None:
        """Finishes all queued kernels with an error; the lock is held."""
        for kernel in self._queue:
            self._in_progress.discard(kernel)
            for request in self._living_requests():
                request.finish(kernel, f"{_name(kernel)}: {error}")
        self._queue.clear()

    def _living_requests(self) -> list[CompileRequest]:
        """Returns the requests that have kernels left and an owner, in their order; the lock is held."""
        living = [request for one in self._requests if (request := one()) is not None and not request.is_done]
        self._requests = [ref(request) for request in living]
        return living

    def _work(self) -> None:
        """Compiles kernels of the queue, in one process, until the queue is empty."""
        process: _Process | None = None
        while (kernel := self._next()) is not None:
            error, rejected = "", False
            try:
                # Another process may have compiled it in the meantime.
                if not is_compiled(kernel):
                    if process is None:
                        process = _Process()
                        self._processes.add(process)
                    process.compile(compile_job(kernel))
                # It must not be compiled while other threads wait for the locks.
                if not has_files(kernel):
                    raise FileNotFoundError("its build was removed from the kernel cache")
                with self._loading, shared_capture_lock():
                    compile_as_launched(kernel, wp.get_device("cpu"))
            except Exception as raised:
                error, rejected = f"{_name(kernel)}: {raised}", isinstance(raised, CompilerError)
                if process is not None and process.has_ended:
                    self._end(process)
                    process = None
            self._finish(kernel, error, rejected=rejected)
            del kernel
        if process is not None:
            self._end(process)

    def _end(self, process: "_Process") -> None:
        process.end()
        self._processes.discard(process)

    def _next(self) -> wp.Kernel | None:
        with self._lock:
            wanted = {kernel for request in self._living_requests() for kernel in request.remaining}
            while self._queue and not self._closed:
                kernel = self._queue.popleft()
                if kernel in wanted:
                    return kernel
                self._in_progress.discard(kernel)
            self._threads.discard(threading.current_thread())
            return None

    def _finish(self, kernel: wp.Kernel, error: str, *, rejected: bool) -> None:
        with self._lock:
            self._in_progress.discard(kernel)
            if rejected:
                self._errors[kernel] = error
            for request in self._living_requests():
                request.finish(kernel, error)

    def close(self) -> None:
        """Takes no further kernel, and lets the processes end after those in progress."""
        self._closed = True
        for process in list(self._processes):
            process.close_input()
        self._loading.acquire()

    def lock_for_fork(self) -> None:
        """Waits until no thread loads a build or changes the queue, so that a fork gets a consistent state."""
        waits = not self._closed  # ``close`` keeps the lock
        if waits:
            self._loading.acquire()
        self._lock.acquire()
        self._has_loading_lock = waits

    def unlock_after_fork(self) -> None:
        """Ends ``lock_for_fork`` in the parent process."""
        releases = self._has_loading_lock
        self._lock.release()
        if releases:
            self._loading.release()

    def abandon(self) -> list[CompileRequest]:
        """Closes the pipes to processes of the parent process, in a forked process; returns unfinished requests."""
        for process in self._processes:
            process.abandon()
        return self._living_requests()


class CompilerError(RuntimeError):
    """The compiler rejects the source of a kernel."""


def _name(kernel: wp.Kernel) -> str:
    return str(kernel.key).rpartition("__")[2]


class _Process:
    """A process that runs ``compile_process.py``."""

    def __init__(self) -> None:
        executable = spawn.get_executable()
        if not executable or getattr(sys, "frozen", False):
            raise OSError("there is no Python executable")
        self._messages = tempfile.TemporaryFile()  # noqa: SIM115  closed with the process
        cache = wp.config.kernel_cache_dir
        start = {"path": [str(folder) for folder in sys.path], "cache": cache}
        try:
            self._process = subprocess.Popen(
                [os.fsdecode(executable), "-I", "-B", compile_process.__file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._messages,
                # Without buffers, whose locks a thread may hold during a fork.
                bufsize=0,
                # Without a GPU, Warp starts faster.
                env=os.environ | {"CUDA_VISIBLE_DEVICES": "-1"},
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except BaseException:
            self._messages.close()
            raise
        with contextlib.suppress(OSError):  # ``compile`` reports that it ended
            self._write(start)

    @property
    def has_ended(self) -> bool:
        """Whether the process ended."""
        return self._process.poll() is not None

    def compile(self, job: CompileJob) -> None:
        """Compiles a job and waits for it.

        Raises:
            CompilerError: If the compiler rejects it.
            RuntimeError: If the process ended.
        """
        before = self._messages.seek(0, os.SEEK_END)
        try:
            self._write(asdict(job))
            assert self._process.stdout is not None
            answer = self._process.stdout.readline()
        except (OSError, ValueError):  # the pipe is broken, or was closed
            answer = b""
        if not answer:
            job.discard()
            # Messages of the start may state why it ended.
            ended = f"the compiler process ended with code {self._process.wait()}"
            raise RuntimeError(f"{ended}{self._messages_since(0)}")
        if error := json.loads(answer)["error"]:
            raise CompilerError(f"{error}{self._messages_since(before)}")

    def _write(self, content: object) -> None:
        assert self._process.stdin is not None
        text = memoryview(json.dumps(content).encode() + b"\n")
        while text:
            text = text[self._process.stdin.write(text) :]

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
# Requests of the parent process that were unfinished at a fork.
_inherited: list[CompileRequest] = []


def request(kernels: Iterable[wp.Kernel]) -> CompileRequest:
    """Requests the release builds of ``kernels`` for the CPU, in this order, after those requested before."""
    return _compiler.request(kernels)


def resume_after_fork() -> None:
    """Continues with the requests of the parent process, in a forked process that takes steps."""
    if _inherited:
        unfinished = list(_inherited)
        _inherited.clear()
        _compiler._adopt(unfinished)


def _lock_before_fork() -> None:
    """Acquires all locks that threads of this module hold, because these threads do not exist in the child process."""
    _compiler.lock_for_fork()
    lock_captures_for_fork()
    if codegen_lock is not None:
        codegen_lock.acquire()


def _unlock_after_fork(*, in_child: bool) -> None:
    if codegen_lock is not None:
        codegen_lock.release()
    unlock_captures_after_fork(in_child=in_child)


def _continue_in_parent() -> None:
    _unlock_after_fork(in_child=False)
    _compiler.unlock_after_fork()


def _restart_in_child() -> None:
    """Replaces the compiler, whose threads do not exist in the child process."""
    global _compiler  # noqa: PLW0603
    _unlock_after_fork(in_child=True)
    forget_threads()
    _inherited[:] = _compiler.abandon()
    _compiler = BackgroundCompiler()


atexit.register(lambda: _compiler.close())  # noqa: PLW0108  another compiler after a fork
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_lock_before_fork, after_in_parent=_continue_in_parent, after_in_child=_restart_in_child
    )
