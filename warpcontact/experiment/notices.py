"""Warnings of a run: those of its mesh files, and what Python code warns of on the way."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from warpcontact.contact_warning import RunWarning, WarningLevel, labeled
from warpcontact.meshes.report import MeshReport


class Notices:
    """Collects warnings, each once.

    Args:
        tell: Called with each; ``None``: what Python code warns of takes its usual way as well.

    Attributes:
        lines: The warnings, each behind its level: ``caution: …``.
    """

    def __init__(self, tell: Callable[[str], None] | None) -> None:
        self.lines: list[str] = []
        self.tell = tell

    def add(self, warning: Warning) -> None:
        """Adds a warning, unless it is known."""
        line = labeled(warning)
        if line not in self.lines:
            self.lines.append(line)
            if self.tell is not None:
                self.tell(line)

    def add_mesh(self, file: str, report: MeshReport) -> None:
        """Adds what is to be known of a mesh file: its warnings, and what a repair changed."""
        for step in report.repairs:
            if step.count:
                self.add(RunWarning(f"mesh file {file!r}: {step.text}", WarningLevel.NOTE))
        for text in report.warnings:
            self.add(RunWarning(f"mesh file {file!r}: {text}"))

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Adds what is warned of meanwhile; filters stay as they are."""
        with warnings.catch_warnings():
            pass_on = warnings.showwarning

            def hear(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
                heard = issubclass(category, UserWarning | RuntimeWarning)
                if heard:
                    self.add(message)
                if not heard or self.tell is None:
                    pass_on(message, category, *where, **more)

            warnings.showwarning = hear
            yield
