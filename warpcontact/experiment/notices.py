"""Warnings of a run: those of its mesh files, and what Python code warns of on the way."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from warpcontact.meshes.report import MeshReport

# An STL file has every vertex once for each face: that its copies are joined is how it has to be.
_FACT = "are taken as one with it"


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
        """Adds what is to be known of a mesh file."""
        for warning in report.warnings:
            if _FACT not in warning:
                self.add(f"mesh file {file!r}: {warning}")

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
