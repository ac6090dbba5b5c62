"""USD: exports recordings as animated stages and checks stages. ``pxr`` is imported on first use only."""

from warpcontact.usd.check import check_usd
from warpcontact.usd.export import export_usd

__all__ = ["check_usd", "export_usd"]
