"""Looking at runs and at simulations that step, on a page in a browser of this machine; needs viser."""

from warpcontact.visualize.viewer.opening import Viewer, view

__all__ = ["Viewer", "view"]
