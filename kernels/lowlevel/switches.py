"""Switches for code that depends on the compiler. Results do not depend on them.

The environment variable ``WARPCONTACT_DISABLE`` names the techniques that are replaced by plain code, separated by
commas, or ``all``. It is read when the package is imported. ``docs/lowlevel.md`` describes the techniques.
"""

import os

TECHNIQUES = ("assumptions", "strides", "simd", "vector_loads", "registers")

DISABLED = frozenset(name.strip() for name in os.environ.get("WARPCONTACT_DISABLE", "").split(",") if name.strip())
if not {*TECHNIQUES, "all"} >= DISABLED:
    raise ImportError(
        f"WARPCONTACT_DISABLE must name some of {', '.join(TECHNIQUES)}, or all, "
        f"got {os.environ['WARPCONTACT_DISABLE']!r}"
    )


def is_enabled(technique: str) -> bool:
    """Returns whether kernels use one of ``TECHNIQUES``."""
    if technique not in TECHNIQUES:
        raise KeyError(technique)
    return DISABLED.isdisjoint((technique, "all"))
