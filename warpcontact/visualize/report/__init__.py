"""Report of a run: a single HTML file without network access."""

from warpcontact.visualize.report.write import report

__all__ = ["report"]
