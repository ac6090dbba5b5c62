"""Compiles kernels, concurrently on a CPU."""

import threading
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from weakref import WeakKeyDictionary

import warp as wp

from warpcontact.system.initialization import explaining, require_room
from warpcontact.system.kernel_builds import current_build, require_unchanged

# Largest number of compiler threads: each also compiles a header, and few kernels take long.
MAX_COMPILERS = 4

# A kernel is compiled by one thread at a time.
_locks: WeakKeyDictionary[wp.Kernel, threading.Lock] = WeakKeyDictionary()
_locks_lock = threading.Lock()


def load(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compiles ``kernel`` if it is not in the cache, so that errors in user-defined code are raised here."""
    compile_as_launched(current_build(kernel, device), device)


def compile_as_launched(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compiles ``kernel`` if it is not in the cache, for the block size of launches: one thread on a CPU."""
    block_dim = None if device.is_cuda else 1
    with _lock_of(kernel), explaining():
        if not device.is_cuda:
            require_unchanged(kernel)
        require_room(lambda: kernel.module.get_module_identifier(block_dim))
        kernel.module.load(device, block_dim=block_dim)


def load_all(
    kernels: Iterable[wp.Kernel],
    device: wp.Device,
    threads: int,
    on_loaded: Callable[[wp.Kernel], None] | None = None,
    *,
    release: bool = False,
) -> None:
    """Compiles kernels for a CPU concurrently, except those in the cache.

    Args:
        kernels: The kernels, those with long compilation first.
        device: The CPU. Kernels for a GPU cannot be compiled in advance, because the block size depends on the launch.
        threads: Maximum number of threads.
        on_loaded: Called by the thread that loaded a kernel, with the kernel.
        release: Whether to load release builds, instead of quick builds while release builds are missing.
    """
    load_build = compile_as_launched if release else load

    def is_in_progress(kernel: wp.Kernel) -> bool:
        return _lock_of(kernel if release else current_build(kernel, device)).locked()

    # Kernels that another thread compiles come last, so that no thread waits for one while others are queued.
    ordered = sorted(dict.fromkeys(kernels), key=is_in_progress)

    def load_one(kernel: wp.Kernel) -> None:
        load_build(kernel, device)
        if on_loaded is not None:
            on_loaded(kernel)

    _threads.run([partial(load_one, kernel) for kernel in ordered], threads)


def load_ahead(kernels: Iterable[wp.Kernel], device: wp.Device) -> None:
    """Begins to compile kernels for a CPU in another thread. Errors are raised when the kernels are loaded again."""

    def load_one(kernel: wp.Kernel) -> None:
        with suppress(Exception):
            load(kernel, device)

    _threads.start([partial(load_one, kernel) for kernel in kernels])


def _lock_of(kernel: wp.Kernel) -> threading.Lock:
    """Returns the lock of the thread that compiles ``kernel``."""
    with _locks_lock:
        return _locks.setdefault(kernel, threading.Lock())


def forget_threads() -> None:
    """Replaces threads and locks, in a forked process that has no copy of these threads."""
    global _threads, _locks_lock
    _threads, _locks_lock = _CompilerThreads(), threading.Lock()
    _locks.clear()


class _CompilerThreads:
    """Threads that run tasks of one queue. Each keeps its precompiled header until the process ends."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._queue: deque[tuple[Callable[[], None], Future[None]]] = deque()
        self._running = 0
        self._executor: ThreadPoolExecutor | None = None

    def start(self, tasks: Iterable[Callable[[], None]], others: int = 1) -> list[Future[None]]:
        """Queues tasks, and starts at most ``others`` threads that run them."""
        queued: list[tuple[Callable[[], None], Future[None]]] = [(task, Future()) for task in tasks]
        with self._lock, suppress(RuntimeError):  # no thread can be started while the process exits
            self._queue.extend(queued)
            for _ in range(min(len(self._queue), MAX_COMPILERS - 1, others) - self._running):
                if self._executor is None:
                    self._executor = ThreadPoolExecutor(
                        MAX_COMPILERS - 1, thread_name_prefix="warpcontact compiler"
                    )
                self._executor.submit(self._work)
                self._running += 1
        return [future for _, future in queued]

    def run(self, tasks: Iterable[Callable[[], None]], threads: int) -> None:
        """Runs tasks in this thread and others. After an error, no further task is begun, and the error is raised."""
        failed = threading.Event()

        def run_unless_failed(task: Callable[[], None]) -> None:
            if failed.is_set():
                return
            try:
                task()
            except BaseException:
                failed.set()
                raise

        guarded = [partial(run_unless_failed, task) for task in tasks]
        futures = self.start(guarded, min(len(guarded), threads) - 1)
        while self._run_next():
            pass
        try:
            wait(futures)
        except BaseException:
            failed.set()
            wait(futures)
            raise
        for future in futures:
            future.result()

    def _work(self) -> None:
        while True:
            self._run_next()
            with self._lock:
                if not self._queue:
                    self._running -= 1
                    return

    def _run_next(self) -> bool:
        """Runs a task of the queue; returns whether there was one."""
        try:
            task, future = self._queue.popleft()
        except IndexError:
            return False
        try:
            task()
        except BaseException as error:
            future.set_exception(error)
        else:
            future.set_result(None)
        return True


_threads = _CompilerThreads()
