"""The report of a run: one HTML file that opens anywhere, without network."""

from warpcontact.visualize.report.write import report

__all__ = ["report"]
