"""Pictures of meshes with their defects marked."""

from warpcontact.meshes.picture.sheet import plot_arrays, plot_file

__all__ = ["plot_arrays", "plot_file"]
