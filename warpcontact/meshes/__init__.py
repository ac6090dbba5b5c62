"""Oriented triangle meshes: validated, loaded from files, repaired on request, reported on, generated.

Host code only: neither Warp nor SciPy nor the readers of USD are imported before they are needed.
"""

from warpcontact.meshes.generate import box, grid, icosphere, sinusoidal_terrain
from warpcontact.meshes.isolation import Limits
from warpcontact.meshes.load import examine_file, load_mesh
from warpcontact.meshes.mesh import Mesh, MeshError
from warpcontact.meshes.picture import plot_file
from warpcontact.meshes.repair import REPAIRS, repaired
from warpcontact.meshes.report import MeshReport, RepairStep
from warpcontact.meshes.sample import SurfaceSamples, sample_surface
from warpcontact.meshes.topology import Component
from warpcontact.meshes.units import UNITS

__all__ = [
    "REPAIRS",
    "UNITS",
    "Component",
    "Limits",
    "Mesh",
    "MeshError",
    "MeshReport",
    "RepairStep",
    "SurfaceSamples",
    "box",
    "examine_file",
    "grid",
    "icosphere",
    "load_mesh",
    "plot_file",
    "repaired",
    "sample_surface",
    "sinusoidal_terrain",
]
