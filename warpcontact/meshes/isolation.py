"""Reads files in a sandboxed process, with limits on memory and time.

No reader is safe with untrusted files: USD readers can crash the process, run for hours or exhaust the memory, and a
small file can instance one part many times, which is as expensive to repair and examine. The process imports only what
it needs, neither the caller's script nor Warp, so it starts in a fraction of a second. Protocol: ``reader_process.py``.
"""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from math import inf
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.meshes.intake import ExaminedMesh, Task
from warpcontact.meshes.mesh import MeshError
from warpcontact.meshes.reader_process import LIMITS_PROCESSOR_TIME, OUT_OF_MEMORY
from warpcontact.meshes.readers import Unreadable
from warpcontact.meshes.repair import is_repairable
from warpcontact.meshes.report import restored

_Answer = TypeVar("_Answer")

_START = """
import json, sys, types
request = json.loads(sys.stdin.buffer.read())
sys.path[:] = request["path"]
# Register the packages by name only, which skips the imports of their __init__ modules.
for name, folder in request["packages"].items():
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = [folder]
from warpcontact.meshes.reader_process import main
main(request)
"""
# One thread suffices, and each thread reserves address space. USD plug-ins from the environment are excluded.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "PXR_WORK_THREAD_LIMIT")
# Largest header [bytes]. It holds names, numbers and sentences, which take several times its size as Python objects.
_MOST_HEADER = 2**28
# A reader that does not use its processor time, for example because a file system blocks, is ended after this multiple
# of it, but not before this time [s], because other processes may load the machine.
_WALL_FACTOR, _LEAST_WALL = 15.0, 60.0
_ANYWHERE_ELSE = ("PXR_", "USD_", "PYTHON")


def _default(name: str, value: float) -> float:
    """Returns the value of the environment variable ``name``, or ``value`` if it is not set."""
    text = os.environ.get(name, "")
    try:
        number = float(text) if text else value
    except ValueError:
        number = -1.0
    if not 0.0 < number < inf:
        raise MeshError(f"the environment variable {name} must be a positive finite number, got {text!r}")
    return number


@explain_keywords_of
@dataclass(frozen=True)
class Limits:
    """Limits of the process that reads, repairs and examines a mesh file.

    Attributes:
        memory: Address space of the process [bytes]; default 4 GiB, or ``WARPCONTACT_MESH_GIB`` in GiB.
        seconds: Processor time in total [s]; default 20, or ``WARPCONTACT_MESH_SECONDS``. The wall-clock time is
            limited to 15 times this value, and at least 60 s. On Windows, ``seconds`` limits the wall-clock time.
        faces: Number of triangles; default 5 million, or ``WARPCONTACT_MESH_FACES``.
    """

    memory: int = field(default_factory=lambda: int(_default("WARPCONTACT_MESH_GIB", 4.0) * 2**30))
    seconds: float = field(default_factory=lambda: _default("WARPCONTACT_MESH_SECONDS", 20.0))
    faces: int = field(default_factory=lambda: int(_default("WARPCONTACT_MESH_FACES", 5e6)))

    def __post_init__(self) -> None:
        for name in ("memory", "seconds", "faces"):
            value = getattr(self, name)
            is_number = isinstance(value, int) or (name == "seconds" and isinstance(value, float))
            if isinstance(value, bool) or not is_number or not 0 < value < inf:
                kind = "number" if name == "seconds" else "whole number"
                raise ValueError(f"Limits.{name} must be a positive finite {kind}, got {value!r}")


def examine_task_sandboxed(task: Task, limits: Limits) -> ExaminedMesh:
    """Reads, repairs and examines a mesh file in a sandboxed process.

    Args:
        task: Task to execute.
        limits: Limits of the process.

    Raises:
        Unreadable: If the process crashes or exceeds a limit.
    """
    return read_sandboxed("warpcontact.meshes.intake", asdict(task), limits, partial(_answer, limits=limits))


def read_sandboxed(
    module: str, task: dict[str, Any], limits: Limits, take: Callable[[IO[bytes]], _Answer]
) -> _Answer:
    """Reads a file in a sandboxed process.

    Args:
        module: Module whose function ``answer`` the process calls with the task; returns a header and flat arrays.
        task: Keyword arguments of the task, in plain values.
        limits: Limits of the process.
        take: Converts the output of the process to the result; see ``header_of`` and ``array_of``.

    Raises:
        Unreadable: If the process crashes or exceeds a limit.
    """
    meshes = Path(__file__).resolve().parent
    folders = {"": meshes.parent, ".meshes": meshes, ".usd": meshes.parent / "usd"}
    request = {
        "module": module,
        "task": task,
        "memory": limits.memory,
        "seconds": limits.seconds,
        "path": [os.path.abspath(entry) for entry in sys.path if entry],
        "packages": {f"warpcontact{name}": str(folder) for name, folder in folders.items()},
    }
    with _process(limits.seconds) as (process, expired):
        output, errors = process.stdout, process.stderr
        assert process.stdin is not None
        assert output is not None
        assert errors is not None
        try:
            process.stdin.write(json.dumps(request).encode())
            process.stdin.close()
            return take(output)
        except (EOFError, BrokenPipeError):
            # The output is missing or incomplete; the exit code gives the reason.
            output.close()
            messages = errors.read(2000).decode(errors="replace").split("\n")
            code = process.wait()
            raise Unreadable(_reason(code, expired.is_set(), limits, messages)) from None


def max_wall_time(seconds: float) -> float:
    """Returns the wall-clock limit of a reader [s]; ``seconds``: limit of its processor time."""
    if not LIMITS_PROCESSOR_TIME:
        return min(seconds, threading.TIMEOUT_MAX)
    return min(max(_LEAST_WALL, _WALL_FACTOR * seconds), threading.TIMEOUT_MAX)


@contextmanager
def _process(seconds: float) -> Iterator[tuple[subprocess.Popen[bytes], threading.Event]]:
    """Starts a reader process, yields it with an event that is set if the wall-clock limit expired, and ends it."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(_ANYWHERE_ELSE)}
    environment |= dict.fromkeys(_THREADS, "1") | {"MALLOC_ARENA_MAX": "2"}
    if not sys.executable or getattr(sys, "frozen", False):
        raise Unreadable("no Python executable to start the reader process; allowed: trusted=True")
    try:
        process = subprocess.Popen(
            [sys.executable, "-I", "-B", "-c", _START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError as error:
        raise Unreadable(f"the reader process cannot be started: {error}") from error
    expired = threading.Event()

    def expire() -> None:
        expired.set()
        process.kill()

    timer = threading.Timer(max_wall_time(seconds), expire)
    timer.daemon = True
    timer.start()
    try:
        yield process, expired
    finally:
        timer.cancel()
        process.kill()
        with process:  # closes the pipes and waits
            pass


def _answer(output: IO[bytes], limits: Limits) -> ExaminedMesh:
    """Decodes the answer of a process; checks sizes before allocating memory.

    Raises:
        EOFError: If the answer ends early.
        Unreadable: If the answer is an error report, or invalid.
    """
    try:
        header = header_of(output, limits)
        vertices, faces = header["vertices"], header["faces"]
        sizes = {str(name): size for name, size in header["groups"]}
        if max(faces, vertices / 3) > limits.faces or 8 * (sum(sizes.values()) + 3 * faces) > limits.memory:
            raise unexpected_answer("more than is allowed")
        answer = ExaminedMesh(
            array_of(output, vertices * 3, "<f8").reshape(-1, 3),
            array_of(output, faces * 3, "<i8").reshape(-1, 3),
            {name: array_of(output, size, "<i8") for name, size in sizes.items()},
            restored(header["report"]),
        )
    except Unreadable:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise unexpected_answer(f"{type(error).__name__}: {error}") from error
    # A compromised process may report results that do not match its arrays.
    groups = all(0 <= members.min() <= members.max() < faces for members in answer.groups.values() if len(members))
    if not groups or (answer.report.usable and not is_repairable(answer.vertices, answer.faces)):
        raise unexpected_answer("an invalid mesh")
    return answer


def header_of(output: IO[bytes], limits: Limits) -> dict[str, Any]:
    """Returns the header of an answer.

    Raises:
        EOFError: If the answer ends early.
        ValueError: If the header is invalid; ``Unreadable`` if the answer is an error report.
    """
    length = int.from_bytes(_bytes(output, 8), "little")
    if length > min(limits.memory, _MOST_HEADER):
        raise unexpected_answer("a header that is too long")
    header: dict[str, Any] = json.loads(_bytes(output, length))
    if "error" in header:
        raise Unreadable(str(header["error"]))
    return header


def unexpected_answer(what: str) -> Unreadable:
    """Returns the error for an answer that a correct process cannot give."""
    return Unreadable(f"the reader process answered with {' '.join(what.split())[:200]}")


def _bytes(output: IO[bytes], count: int) -> bytes:
    data = output.read(count)
    if len(data) < count:
        raise EOFError
    return data


def array_of(output: Any, count: int, dtype: str) -> Any:
    """Returns the next array of an answer, flat; its size must have been checked.

    Raises:
        EOFError: If the answer ends early.
    """
    array = np.empty(count, dtype)
    if count and output.readinto(array.view(np.uint8)) < array.nbytes:
        raise EOFError
    return array


def _reason(code: int, expired: bool, limits: Limits, messages: list[str]) -> str:
    """Returns the reason why a process ended with ``code`` before it had answered."""
    allowed, wall_time = f"{limits.seconds:g} s", f"{max_wall_time(limits.seconds):g} s"
    if expired and LIMITS_PROCESSOR_TIME:
        return (
            f"reading and examining it did not end within {wall_time} of wall-clock time, with less than {allowed} of "
            "processor time; the machine is overloaded, or the disk of the file does not answer; see Limits"
        )
    if expired:
        return f"reading and examining it takes more than {wall_time}; allowed: {allowed}, see Limits"
    if LIMITS_PROCESSOR_TIME and code in (-signal.SIGPROF, -signal.SIGXCPU):
        taken = f"{allowed} of processor time"
        return f"reading and examining it takes more than {taken}; allowed: {allowed}, see Limits"
    if code == OUT_OF_MEMORY:
        return "the file needs more memory than allowed, see Limits"
    if code < 0 or code > 255:  # a signal, or an exception code on Windows
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"{code:#x}"
        return (
            f"the reader process crashed ({name}), with a limit of {limits.memory / 2**30:.3g} GiB of "
            "memory; the file is damaged or malicious, or needs more, see Limits"
        )
    last = next((line.strip() for line in reversed(messages) if line.strip()), "no message")
    return f"the reader process failed: {last[:200]}"
