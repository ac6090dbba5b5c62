"""Reads files in a process of their own, which cannot take this one with it.

No reader is safe on files from anywhere: those of USD can end the process, compose for hours, or fill the memory;
and a small file may place one part many times, which takes as much to repair and to examine. The process imports
what it needs and nothing else, neither the caller's script nor Warp, so that it starts in a fraction of a second
from wherever it is called.
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
# The packages are there by name only: what they import on their own is not needed here.
for name, folder in request["packages"].items():
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = [folder]
from warpcontact.meshes.reader_process import main
main(request)
"""
# One thread is enough, and each reserves address space; what plug-ins of USD do is not known.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "PXR_WORK_THREAD_LIMIT")
# A header holds names, numbers and sentences; as Python objects they take several times its length.
_MOST_HEADER = 2**28
# A reader that does not use its processor time, such as one that is blocked on a file system, is ended after this
# multiple of it, but not before this time [s]: other processes can take most of a busy machine.
_WALL_FACTOR, _LEAST_WALL = 15.0, 60.0
_ANYWHERE_ELSE = ("PXR_", "USD_", "PYTHON")


def _default(name: str, value: float) -> float:
    """Returns ``value``, or what the environment variable ``name`` says."""
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
    """What the process that reads a mesh file may use, with repair and examination.

    Attributes:
        memory: Address space of the process that reads [bytes]; 4 GiB, or ``WARPCONTACT_MESH_GIB`` in GiB.
        seconds: Processor time for all of it [s]; 20, or ``WARPCONTACT_MESH_SECONDS``. The time on the clock is
            limited to 15 times that, and at least 60 s. On Windows ``seconds`` limits the time on the clock.
        faces: Number of triangles; 5 million, or ``WARPCONTACT_MESH_FACES``.
    """

    memory: int = field(default_factory=lambda: int(_default("WARPCONTACT_MESH_GIB", 4.0) * 2**30))
    seconds: float = field(default_factory=lambda: _default("WARPCONTACT_MESH_SECONDS", 20.0))
    faces: int = field(default_factory=lambda: int(_default("WARPCONTACT_MESH_FACES", 5e6)))

    def __post_init__(self) -> None:
        for name in ("memory", "seconds", "faces"):
            value = getattr(self, name)
            whole = isinstance(value, int) or (name == "seconds" and isinstance(value, float))
            if isinstance(value, bool) or not whole or not 0 < value < inf:
                kind = "number" if name == "seconds" else "whole number"
                raise ValueError(f"Limits.{name} must be a positive finite {kind}, got {value!r}")


def examine_task_sandboxed(task: Task, limits: Limits) -> ExaminedMesh:
    """Reads, repairs and examines a mesh file in a process of its own.

    Args:
        task: What to do.
        limits: What it may take.

    Raises:
        Unreadable: If doing so crashes or passes a limit.
    """
    return read_sandboxed("warpcontact.meshes.intake", asdict(task), limits, partial(_answer, limits=limits))


def read_sandboxed(
    module: str, task: dict[str, Any], limits: Limits, take: Callable[[IO[bytes]], _Answer]
) -> _Answer:
    """Has a file read in a process of its own.

    Args:
        module: Its function ``answer`` is given the task there, and returns a header and flat arrays.
        task: What to do, in plain values.
        limits: What it may take.
        take: Makes the answer of what the process writes, see ``header_of`` and ``array_of``.

    Raises:
        Unreadable: If doing so crashes or passes a limit.
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
            # Nothing was read, or not all of it: how the process ended says why.
            output.close()
            messages = errors.read(2000).decode(errors="replace").split("\n")
            code = process.wait()
            raise Unreadable(_reason(code, expired.is_set(), limits, messages)) from None


def max_wall_time(seconds: float) -> float:
    """Returns the time on the clock after which a reader is ended [s]; ``seconds``: its processor time."""
    if not LIMITS_PROCESSOR_TIME:
        return min(seconds, threading.TIMEOUT_MAX)
    return min(max(_LEAST_WALL, _WALL_FACTOR * seconds), threading.TIMEOUT_MAX)


@contextmanager
def _process(seconds: float) -> Iterator[tuple[subprocess.Popen[bytes], threading.Event]]:
    """Starts a process that reads, yields it with whether it was ended on the clock, and ends it."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(_ANYWHERE_ELSE)}
    environment |= dict.fromkeys(_THREADS, "1") | {"MALLOC_ARENA_MAX": "2"}
    if not sys.executable or getattr(sys, "frozen", False):
        raise Unreadable("there is no Python to read it apart from this process; allowed: trusted=True")
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
        raise Unreadable(f"the process that reads it cannot be started: {error}") from error
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
    """Takes the answer apart; sizes are checked before memory is taken for them.

    Raises:
        EOFError: If it ends early.
        Unreadable: If it is a reason instead of arrays, or makes no sense.
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
    # A process that was taken over may say that it has examined what it has not.
    groups = all(0 <= members.min() <= members.max() < faces for members in answer.groups.values() if len(members))
    if not groups or (answer.report.usable and not is_repairable(answer.vertices, answer.faces)):
        raise unexpected_answer("what is no mesh")
    return answer


def header_of(output: IO[bytes], limits: Limits) -> dict[str, Any]:
    """Returns the header of an answer.

    Raises:
        EOFError: If it ends early.
        ValueError: If it is none; ``Unreadable`` if it is a reason instead.
    """
    length = int.from_bytes(_bytes(output, 8), "little")
    if length > min(limits.memory, _MOST_HEADER):
        raise unexpected_answer("a header that is too long")
    header: dict[str, Any] = json.loads(_bytes(output, length))
    if "error" in header:
        raise Unreadable(str(header["error"]))
    return header


def unexpected_answer(what: str) -> Unreadable:
    """Returns what is said of a process that answers with what it cannot have been told to."""
    return Unreadable(f"the process that reads it answered with {' '.join(what.split())[:200]}")


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
    """Why a process ended with ``code`` before it had answered."""
    allowed, waited = f"{limits.seconds:g} s", f"{max_wall_time(limits.seconds):g} s"
    if expired and LIMITS_PROCESSOR_TIME:
        return (
            f"reading and examining it did not end within {waited} on the clock, with less than {allowed} of "
            "processor time; the machine is overloaded, or the disk of the file does not answer; see Limits"
        )
    if expired:
        return f"reading and examining it takes more than {waited}; allowed: {allowed}, see Limits"
    if LIMITS_PROCESSOR_TIME and code in (-signal.SIGPROF, -signal.SIGXCPU):
        taken = f"{allowed} of processor time"
        return f"reading and examining it takes more than {taken}; allowed: {allowed}, see Limits"
    if code == OUT_OF_MEMORY:
        return "it needs more memory than is allowed, see Limits"
    if code < 0 or code > 255:  # a signal, or what stands for one on Windows
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"{code:#x}"
        return (
            f"the reader crashed on it ({name}), in a process of its own with {limits.memory / 2**30:.3g} GiB of "
            "memory; the file is damaged or hostile, or needs more, see Limits"
        )
    last = next((line.strip() for line in reversed(messages) if line.strip()), "no message")
    return f"the process that reads it failed: {last[:200]}"
