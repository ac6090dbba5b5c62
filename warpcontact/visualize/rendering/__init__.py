"""Stills and films of recordings by ray tracing with Warp, on a CPU or a GPU."""

from warpcontact.visualize.rendering.filming import Film, film
from warpcontact.visualize.rendering.still import render

__all__ = ["Film", "film", "render"]
