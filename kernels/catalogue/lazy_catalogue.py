"""Names of packages that are loaded on first use.

Of a catalogue few classes are used, and Warp parses the functions of each as they are made. What reads files,
draws or runs is not needed to take a step.
"""

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from warpcontact.kernels.catalogue.names import suggestion


def lazy_names(
    module: str, homes: Mapping[str, str], catalogues: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Returns the ``__getattr__`` of a module, and its ``__dir__``.

    Args:
        module: Its name.
        homes: Where each name lives: a module of the package, or with a dot before it of that about it.
        catalogues: Names of tuples, and of the classes that these have.
    """

    def find(name: str) -> Any:
        itself = sys.modules[module]
        value: Any
        if name in homes:
            value = getattr(importlib.import_module(f".{homes[name]}", itself.__package__), name)
        elif name in catalogues:
            value = tuple(getattr(itself, one) for one in catalogues[name])
        else:
            hint = "" if name.startswith("_") else suggestion(name, [*homes, *catalogues])
            raise AttributeError(f"module {module!r} has no attribute {name!r}{hint}")
        setattr(itself, name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[module]), *homes, *catalogues})

    return find, names
