"""How fast this machine steps: the short form for a user, and the works that ``benchmarks/`` does as well.

Names are loaded on first use: other engines do the same works where there is NumPy and nothing else.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warpcontact.benchmark.report import BenchReport
    from warpcontact.benchmark.short_form import bench

__all__ = ["BenchReport", "bench"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'warpcontact.benchmark' has no attribute {name!r}")
    from warpcontact.benchmark import report, short_form

    return getattr(report if name == "BenchReport" else short_form, name)
