"""USD: recordings written as animated stages. ``pxr`` is imported on first use, never on import."""

from warpcontact.usd.check import check_usd
from warpcontact.usd.export import export_usd

__all__ = ["check_usd", "export_usd"]
