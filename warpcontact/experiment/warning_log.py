"""Warnings of a run: those of its mesh files, and what Python code warns of on the way."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from warpcontact.meshes.report import MeshReport
from warpcontact.validation.warning_levels import RunWarning, WarningLevel, labeled


class WarningLog:
    """Collects warnings, each once.

    Args:
        on_warning: Called with each; ``None``: what Python code warns of takes its usual way as well.

    Attributes:
        lines: The warnings, each behind its level: ``caution: …``.
    """

    def __init__(self, on_warning: Callable[[str], None] | None) -> None:
        self.lines: list[str] = []
        self.on_warning = on_warning

    def add(self, warning: Warning) -> None:
        """Adds a warning, unless it is known."""
        line = labeled(warning)
        if line not in self.lines:
            self.lines.append(line)
            if self.on_warning is not None:
                self.on_warning(line)

    def add_mesh(self, file: str, report: MeshReport) -> None:
        """Adds what is to be known of a mesh file: its warnings, and what a repair changed."""
        for step in report.repairs:
            if step.count:
                self.add(RunWarning(f"mesh file {file!r}: {step.text}", WarningLevel.NOTE))
        for text in report.warnings:
            self.add(RunWarning(f"mesh file {file!r}: {text}"))

    @contextmanager
    def collect_warnings(self) -> Iterator[None]:
        """Adds what is warned of meanwhile; filters stay as they are."""
        with warnings.catch_warnings():
            pass_on = warnings.showwarning

            def add_warning(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
                is_collected = issubclass(category, UserWarning | RuntimeWarning)
                if is_collected:
                    self.add(message)
                if not is_collected or self.on_warning is None:
                    pass_on(message, category, *where, **more)

            warnings.showwarning = add_warning
            yield
