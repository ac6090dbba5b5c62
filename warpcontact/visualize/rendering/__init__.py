"""Stills and films of recordings by ray tracing with Warp, on a CPU or a GPU."""

from warpcontact.visualize.rendering.pictures import Film, film, render

__all__ = ["Film", "film", "render"]
