"""Stills and films of recordings, by rays that Warp follows through the scene, on a CPU or a GPU."""

from warpcontact.visualize.rendering.filming import Film, film
from warpcontact.visualize.rendering.still import render

__all__ = ["Film", "film", "render"]
