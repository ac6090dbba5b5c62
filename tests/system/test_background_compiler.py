"""Release builds of kernels are compiled by other processes, which end with their work."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel

from warpcontact.system import background_compiler, compile_process
from warpcontact.system.background_compiler import BackgroundCompiler
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


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    """An empty kernel cache."""
    folder = tmp_path / "cache" / wp.config.version
    folder.mkdir(parents=True)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(folder))
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
    # The error is stored; the kernel is not compiled again.
    assert compiler.request([faulty]).error == request.error
    assert len(list(empty_cache.iterdir())) == 1


@pytest.mark.parametrize("code", ["raise SystemExit(7)", "import sys; sys.stdin.readline(); raise SystemExit(7)"])
def test_end_of_the_compiler_process_is_reported(code, tmp_path, monkeypatch, empty_cache):
    script = tmp_path / "ends.py"
    script.write_text(code)
    monkeypatch.setattr(compile_process, "__file__", str(script))
    request = BackgroundCompiler().request([small_kernel(4), small_kernel(5)])
    wait_for(lambda: request.is_done)
    assert request.error.count("add: the compiler process ended with code 7") == 2
    assert not list(empty_cache.iterdir())


def test_missing_python_executable_is_reported(monkeypatch, empty_cache):
    monkeypatch.setattr(sys, "executable", None)
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


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_forked_process_has_its_own_compiler():
    before = background_compiler._compiler
    child = os.fork()
    if child == 0:
        fresh = background_compiler._compiler is not before and not background_compiler._compiler._threads
        os._exit(0 if fresh else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert background_compiler._compiler is before


def test_compiler_threads_do_not_delay_the_exit():
    compiler = BackgroundCompiler()
    request = compiler.request([small_kernel(8)])
    assert all(thread.daemon for thread in threading.enumerate() if thread.name == "warpcontact compiler")
    wait_for(lambda: request.is_done)
