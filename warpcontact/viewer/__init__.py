"""Looking at runs and at simulations that step, on a page in a browser of this machine; needs viser."""

from warpcontact.viewer.opening import Viewer, view

__all__ = ["Viewer", "view"]
