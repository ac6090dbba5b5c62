"""Process of one engine with one benchmark scene, which runs on request."""

import json
import os
import queue
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

MEASURE = Path(__file__).with_name("measure.py")


class Failure(Exception):
    """Raised if the process ended or timed out; the text is the last line of its error output."""


class Worker:
    """Runs ``measure.py`` with the interpreter of an engine.

    Args:
        python: The interpreter.
        arguments: Command line of ``measure.py`` without ``--turns``.
        environment: Additional environment variables.
        patience: Timeout for a response [s].

    Attributes:
        start_s: Time from the start of the process until the engine was ready [s].
    """

    def __init__(self, python: Path, arguments: list[str], environment: dict[str, str], patience: float) -> None:
        self._begin = self._came = time.perf_counter()
        self._patience = patience
        self._log = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(
            [python, MEASURE, *arguments, "--turns"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env={**os.environ, **environment},
        )
        self._lines: queue.Queue[tuple[str, float]] = queue.Queue()  # line and time of arrival
        threading.Thread(target=self._read, daemon=True).start()
        self.start_s = 0.0

    def _read(self) -> None:
        assert self._process.stdout
        for line in self._process.stdout:
            self._lines.put((line, time.perf_counter()))
        self._lines.put(("", time.perf_counter()))

    def answer(self) -> dict[str, Any]:
        """Returns the next response of the process."""
        try:
            line, self._came = self._lines.get(timeout=self._patience)
        except queue.Empty:
            self.end()
            raise Failure(f"no answer within {self._patience:g} s") from None
        if not line:
            self._process.wait()
            raise Failure(self.last_output() or f"ended with exit code {self._process.returncode}")
        return json.loads(line)

    def wait_until_ready(self) -> None:
        """Waits until the engine is ready."""
        self.answer()
        self.start_s = round(self._came - self._begin, 2)

    def run(self) -> float:
        """Runs once; returns environment-steps per second."""
        assert self._process.stdin
        try:
            self._process.stdin.write("run\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise Failure(self.last_output()) from None
        return self.answer()["env_steps_per_s"]

    def result(self) -> dict[str, Any]:
        """Ends the process; returns its result."""
        assert self._process.stdin
        self._process.stdin.close()
        result = self.answer()
        self._process.wait()
        overflows = sum("overflow" in line.lower() for line in self._all().splitlines())
        if overflows:
            result["notes"]["overflow"] = overflows
        return result

    def last_output(self) -> str:
        """Returns the last line of the error output of the process."""
        lines = self._all().strip().splitlines()
        return lines[-1][:300] if lines else ""

    def _all(self) -> str:
        self._log.seek(0)
        return self._log.read()

    def end(self) -> None:
        """Ends the process, if necessary by force."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
