"""Oriented triangle meshes: validation, loading, repair on request, reports, generation of simple shapes.

Host code only. Warp, SciPy and file readers are imported on first use.
"""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names
from warpcontact.meshes.generate import box, grid, icosphere, sinusoidal_terrain
from warpcontact.meshes.mesh import UNITS, Mesh, MeshError
from warpcontact.meshes.repair import REPAIRS, repaired
from warpcontact.meshes.report import MeshReport, RepairStep
from warpcontact.meshes.sample import SurfaceSamples, sample_surface
from warpcontact.meshes.topology import Component

if TYPE_CHECKING:
    from warpcontact.meshes.isolation import Limits
    from warpcontact.meshes.load import examine_file, load_mesh, plot_file

# Modules of rarely used names, imported on first access.
_HOME = {"Limits": "isolation", "examine_file": "load", "load_mesh": "load", "plot_file": "load"}

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

if not TYPE_CHECKING:  # a type checker would accept any name
    __getattr__, __dir__ = lazy_names(__name__, _HOME, {})
