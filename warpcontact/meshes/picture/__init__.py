"""Pictures of meshes: what is wrong with one, a painter for triangles, and the sheet that shows both."""

from warpcontact.meshes.picture.sheet import plot_arrays, plot_file

__all__ = ["plot_arrays", "plot_file"]
