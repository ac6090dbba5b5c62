"""Oriented triangle meshes: validated, loaded from files, reported on, generated.

Host code only: neither Warp nor the readers of mesh files are imported before they are needed.
"""

from warpcontact.meshes.generate import box, grid, icosphere, sinusoidal_terrain
from warpcontact.meshes.load import examine_file, load_mesh
from warpcontact.meshes.mesh import Mesh, MeshError
from warpcontact.meshes.picture import plot_file
from warpcontact.meshes.report import MeshReport
from warpcontact.meshes.sample import SurfaceSamples, sample_surface

__all__ = [
    "Mesh",
    "MeshError",
    "MeshReport",
    "SurfaceSamples",
    "box",
    "examine_file",
    "grid",
    "icosphere",
    "load_mesh",
    "plot_file",
    "sample_surface",
    "sinusoidal_terrain",
]
