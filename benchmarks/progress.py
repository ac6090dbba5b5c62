"""A progress bar, where there is one to be had: figures are also taken where only the engine is installed."""

from typing import Any

try:
    from tqdm import tqdm as Bar
except ImportError:

    class Bar:  # type: ignore[no-redef]
        """What is used of ``tqdm``, showing nothing."""

        def __init__(self, **options: Any) -> None:
            self.n = 0

        def __enter__(self) -> "Bar":
            return self

        def __exit__(self, *error: object) -> None:
            pass

        def set_description(self, text: str) -> None:
            """Says what is going on."""

        def update(self, count: float = 1) -> None:
            """Counts what was done."""
            self.n += count


__all__ = ["Bar"]
