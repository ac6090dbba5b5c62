"""Stills and films of recordings, by rays that Warp follows through the scene, on a CPU or a GPU."""
