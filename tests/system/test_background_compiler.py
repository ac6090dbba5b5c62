"""Release builds of kernels are compiled by other processes, which end with their work."""

import os
import subprocess
import sys
import threading
import time
from multiprocessing import spawn
from pathlib import Path
from weakref import WeakSet

import pytest
import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel

from warpcontact.system import background_compiler, compile_process, kernel_builds
from warpcontact.system.background_compiler import BackgroundCompiler
from warpcontact.system.compilation import compile_as_launched
from warpcontact.system.kernel_builds import is_compiled

# Longest compilation on a busy machine [s].
LONG = 120.0


def small_kernel(number):
    """Returns a kernel that adds ``number``."""

    @unique_kernel()
    def add(values: wp.array(dtype=int)):
        values[wp.tid()] += wp.static(number)

    return add


def faulty_kernel():
    """Returns a kernel that the compiler rejects."""

    @wp.func_native("return no_such_name;")
    def fault(number: int) -> int: ...

    @unique_kernel()
    def call_fault(values: wp.array(dtype=int)):
        values[0] = fault(1)

    return call_fault


ADDED = wp.constant(5)


def kernel_with_constant():
    """Returns a kernel that adds ``ADDED``."""

    @unique_kernel()
    def add_constant(values: wp.array(dtype=int)):
        values[wp.tid()] += ADDED

    return add_constant


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    """An empty kernel cache."""
    folder = tmp_path / "cache" / wp.config.version
    folder.mkdir(parents=True)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(folder))
    # Kernels that an earlier test found in its cache.
    monkeypatch.setattr(kernel_builds, "_found", WeakSet())
    return folder


def wait_for(condition):
    end = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_requested_kernels_are_compiled_and_loaded(empty_cache):
    compiler = BackgroundCompiler()
    kernels = [small_kernel(1), small_kernel(2)]
    request = compiler.request([*kernels, kernels[0]])
    again = compiler.request(kernels[:1])
    assert (request.count, again.count) == (2, 1)
    wait_for(lambda: request.is_done and again.is_done)
    assert (request.error, request.compiled) == ("", 2)
    assert all(map(is_compiled, kernels))
    assert all(kernel.module.execs for kernel in kernels)
    assert len(list(empty_cache.iterdir())) == 2
    values = wp.zeros(1, dtype=int, device="cpu")
    for kernel in kernels:
        wp.launch(kernel, 1, [values], device="cpu")
    assert values.numpy() == [3]
    # Compiled kernels need no process, and the process ends with its work.
    assert compiler.request(kernels).is_done
    wait_for(lambda: not compiler._threads and not compiler._processes)


def test_compiler_error_is_reported_with_its_message(empty_cache):
    compiler = BackgroundCompiler()
    faulty, valid = faulty_kernel(), small_kernel(3)
    request = compiler.request([faulty, valid])
    wait_for(lambda: request.is_done)
    assert request.error.startswith("call_fault: ")
    assert "no_such_name" in request.error
    assert is_compiled(valid)
    assert not is_compiled(faulty)
    assert (request.count, request.compiled) == (2, 1)
    # The error is stored; the kernel is not compiled again.
    assert compiler.request([faulty]).error == request.error
    assert len(list(empty_cache.iterdir())) == 1


@pytest.mark.parametrize("code", ["raise SystemExit(7)", "import sys; sys.stdin.readline(); raise SystemExit(7)"])
def test_end_of_the_compiler_process_is_reported(code, tmp_path, monkeypatch, empty_cache):
    script = tmp_path / "ends.py"
    script.write_text(code)
    compiler, kernels = BackgroundCompiler(), [small_kernel(4), small_kernel(5)]
    with monkeypatch.context() as patch:
        patch.setattr(compile_process, "__file__", str(script))
        request = compiler.request(kernels)
        wait_for(lambda: request.is_done)
    assert request.error.count("add: the compiler process ended with code 7") == 2
    assert not list(empty_cache.iterdir())
    again = compiler.request(kernels)
    wait_for(lambda: again.is_done)
    assert again.error == ""


def test_missing_python_executable_is_reported(monkeypatch, empty_cache):
    monkeypatch.setattr(spawn, "get_executable", lambda: None)
    request = BackgroundCompiler().request([small_kernel(6)])
    wait_for(lambda: request.is_done)
    assert request.error == "add: there is no Python executable"
    assert not list(empty_cache.iterdir())


def test_closed_compiler_takes_no_kernel():
    compiler = BackgroundCompiler()
    compiler.close()
    assert not compiler.request([small_kernel(7)]).is_done
    assert not compiler._threads


EXIT = """
import sys, time
sys.path.insert(0, sys.argv[1])
import warp as wp
wp.config.kernel_cache_dir = sys.argv[2]
import test_background_compiler as tests
from warpcontact.system import background_compiler
wp.init()
request = background_compiler.request([tests.small_kernel(number) for number in range(20)])
tests.wait_for(lambda: background_compiler._compiler._processes)
print("started", background_compiler._compiler._processes.pop()._process.pid, flush=True)
"""


def test_process_exits_while_kernels_are_compiled(tmp_path):
    """The compiler process completes its kernel, so that the next process finds it, and ends."""
    started = time.monotonic()
    folder = Path(__file__).parent
    process = subprocess.run(
        [sys.executable, "-c", EXIT, str(folder), str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    assert process.stderr.count("Error") == 0
    number = int(process.stdout.split()[-1])
    builds = tmp_path / wp.config.version
    # Twenty kernels and the header take longer than the exit.
    finished = [path for path in builds.iterdir() if "_p" not in path.name.removeprefix("wp_")]
    assert len(finished) < 20, time.monotonic() - started
    if sys.platform.startswith("linux"):
        wait_for(lambda: not Path(f"/proc/{number}").exists() or "Z" in Path(f"/proc/{number}/stat").read_text())
    wait_for(lambda: list(builds.glob("wp_*/*.o")))
    assert not list(builds.glob("wp_*_p*_t*"))


def test_build_of_a_changed_constant_is_refused(monkeypatch, empty_cache):
    """The identifier of a build is computed at the first launch, its source later."""
    kernel = kernel_with_constant()
    assert not is_compiled(kernel)
    message = "a constant or function that kernel add_constant uses was changed"
    with monkeypatch.context() as patch:
        patch.setattr(sys.modules[__name__], "ADDED", wp.constant(7))
        request = BackgroundCompiler().request([kernel])
        wait_for(lambda: request.is_done)
        assert request.error.startswith(f"add_constant: {message}")
        with pytest.raises(RuntimeError, match=message):
            compile_as_launched(kernel, wp.get_device("cpu"))
    assert not list(empty_cache.iterdir())
    values = wp.zeros(1, dtype=int, device="cpu")
    wp.launch(kernel, 1, [values], device="cpu")
    assert values.numpy() == [5]


def test_code_generation_restores_the_switch_interval(monkeypatch):
    kernel, intervals = small_kernel(24), []
    generate = type(kernel.module)._run_codegen
    monkeypatch.setattr(
        type(kernel.module),
        "_run_codegen",
        lambda *arguments: intervals.append(sys.getswitchinterval()) or generate(*arguments),
    )
    before = sys.getswitchinterval()
    request = BackgroundCompiler().request([kernel])
    wait_for(lambda: request.is_done)
    assert intervals == [pytest.approx(1e-3)]
    assert sys.getswitchinterval() == before
    assert request.error == ""


def test_kernels_of_deleted_requests_are_not_compiled():
    compiler, kernels = BackgroundCompiler(), [small_kernel(number) for number in range(10, 22)]
    request = compiler.request(kernels)
    wait_for(lambda: compiler._processes)
    del request
    kept = compiler.request([small_kernel(22)])
    wait_for(lambda: kept.is_done and not compiler._threads)
    assert sum(map(is_compiled, kernels)) < len(kernels)
    assert not compiler._in_progress


def test_request_fails_if_no_thread_can_be_started(monkeypatch):
    def refuse(self):
        raise RuntimeError("can't start new thread")

    compiler, kernel = BackgroundCompiler(), small_kernel(23)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", refuse)
        assert compiler.request([kernel]).error == "add: can't start new thread"
    again = compiler.request([kernel])
    wait_for(lambda: again.is_done)
    assert again.error == ""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_forked_process_completes_requests_with_its_own_compiler(monkeypatch):
    """A thread of the parent process waits for an answer of a compiler process during the fork."""
    monkeypatch.setattr(background_compiler, "_compiler", BackgroundCompiler())
    before = background_compiler._compiler
    request = background_compiler.request([small_kernel(number) for number in range(30, 34)])
    wait_for(lambda: before._processes)
    child = os.fork()
    if child == 0:
        code = 1
        try:
            assert background_compiler._compiler is not before
            background_compiler.resume_after_fork()
            wait_for(lambda: request.is_done)
            code = 0 if request.error == "" else 2
        finally:
            os._exit(code)
    wait_for(lambda: request.is_done)
    assert request.error == ""
    answers = []
    wait_for(lambda: answers.append(os.waitpid(child, os.WNOHANG)) or answers[-1][0])
    assert os.waitstatus_to_exitcode(answers[-1][1]) == 0
    assert background_compiler._compiler is before


def test_compiler_threads_do_not_delay_the_exit():
    compiler = BackgroundCompiler()
    request = compiler.request([small_kernel(8)])
    assert all(thread.daemon for thread in threading.enumerate() if thread.name == "warpcontact compiler")
    wait_for(lambda: request.is_done)
