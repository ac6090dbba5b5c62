"""Browser page on this machine that shows runs and steps simulations; needs viser."""

from warpcontact.visualize.viewer.opening import Viewer, view

__all__ = ["Viewer", "view"]
