"""Warnings of a run: those of its mesh files, and what Python code warns of on the way."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from warpcontact.meshes.report import MeshReport


class Notices:
    """Collects warnings, each once.

    Args:
        tell: Called with each; ``None``: what Python code warns of takes its usual way as well.

    Attributes:
        lines: The warnings.
    """

    def __init__(self, tell: Callable[[str], None] | None) -> None:
        self.lines: list[str] = []
        self.tell = tell

    def add(self, text: str) -> None:
        """Adds a warning, unless it is known."""
        if text not in self.lines:
            self.lines.append(text)
            if self.tell is not None:
                self.tell(text)

    def add_mesh(self, file: str, report: MeshReport) -> None:
        """Adds what is to be known of a mesh file: its warnings, and what a repair changed."""
        changes = [step.text for step in report.repairs if step.count]
        for text in (*changes, *report.warnings):
            self.add(f"mesh file {file!r}: {text}")

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Adds what is warned of meanwhile; filters stay as they are."""
        with warnings.catch_warnings():
            pass_on = warnings.showwarning

            def hear(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
                heard = issubclass(category, UserWarning | RuntimeWarning)
                if heard:
                    self.add(str(message))
                if not heard or self.tell is None:
                    pass_on(message, category, *where, **more)

            warnings.showwarning = hear
            yield
