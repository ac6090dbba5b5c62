"""Package attributes that are loaded on first use.

Few classes of a catalogue are used, and Warp parses the functions of each when it is defined. Modules for files,
plots and runs are not needed for a step.
"""

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from warpcontact.kernels.catalogue.names import suggestion


def lazy_names(
    module: str, homes: Mapping[str, str], catalogues: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Returns the ``__getattr__`` and ``__dir__`` of a module.

    Args:
        module: Name of the module.
        homes: Module of each name, relative to the package; with a leading dot, relative to its parent package.
        catalogues: Names of tuples, and the names of the classes in each.
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
