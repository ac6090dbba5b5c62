"""Collects the warnings of a run: those of mesh files, and Python warnings."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from warpcontact.meshes.report import MeshReport
from warpcontact.validation.warning_levels import RunWarning, WarningLevel, labeled


class WarningLog:
    """Collects warnings, without duplicates.

    Args:
        on_warning: Called with each warning; ``None``: Python warnings are also shown as usual.

    Attributes:
        lines: The warnings, each prefixed with its level: ``caution: …``.
    """

    def __init__(self, on_warning: Callable[[str], None] | None) -> None:
        self.lines: list[str] = []
        self.on_warning = on_warning

    def add(self, warning: Warning) -> None:
        """Adds a warning, unless it was added before."""
        line = labeled(warning)
        if line not in self.lines:
            self.lines.append(line)
            if self.on_warning is not None:
                self.on_warning(line)

    def add_mesh(self, file: str, report: MeshReport) -> None:
        """Adds the warnings of a mesh file, and the changes of a repair."""
        for step in report.repairs:
            if step.count:
                self.add(RunWarning(f"mesh file {file!r}: {step.text}", WarningLevel.NOTE))
        for text in report.warnings:
            self.add(RunWarning(f"mesh file {file!r}: {text}"))

    @contextmanager
    def collect_warnings(self) -> Iterator[None]:
        """Adds Python warnings that are given within the block; filters are unchanged."""
        with warnings.catch_warnings():
            show = warnings.showwarning

            def add_warning(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
                is_collected = issubclass(category, UserWarning | RuntimeWarning)
                if is_collected:
                    self.add(message)
                if not is_collected or self.on_warning is None:
                    show(message, category, *where, **more)

            warnings.showwarning = add_warning
            yield
