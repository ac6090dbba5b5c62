"""USD: recordings written as animated stages. ``pxr`` is imported on first use, never on import."""

from warpcontact.usd.export import export_usd

__all__ = ["export_usd"]
