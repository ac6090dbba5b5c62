"""Benchmark of the stepping speed for users (``wc.bench``), and the scenes that ``benchmarks/`` uses as well.

Names are imported on first use, because other engines use the scenes in environments with NumPy only.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warpcontact.benchmark.measurement import bench
    from warpcontact.benchmark.report import BenchReport

__all__ = ["BenchReport", "bench"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'warpcontact.benchmark' has no attribute {name!r}")
    from warpcontact.benchmark import measurement, report

    return getattr(report if name == "BenchReport" else measurement, name)
