"""Progress bar; without tqdm a silent replacement, because engine environments may lack it."""

from typing import Any

try:
    from tqdm import tqdm as Bar
except ImportError:

    class Bar:  # type: ignore[no-redef]
        """Silent replacement with the methods of ``tqdm`` that are used."""

        def __init__(self, **options: Any) -> None:
            self.n = 0

        def __enter__(self) -> "Bar":
            return self

        def __exit__(self, *error: object) -> None:
            pass

        def set_description(self, text: str) -> None:
            """Does nothing; tqdm shows the text."""

        def update(self, count: float = 1) -> None:
            """Counts completed items."""
            self.n += count


__all__ = ["Bar"]
