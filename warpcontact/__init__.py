"""Contact dynamics on oriented triangle meshes, thousands of environments at once, on NVIDIA Warp.

    import warpcontact as wc

Names are loaded on first use, so that ``import warpcontact`` and the command line answer at once.
"""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any

from warpcontact import collecting
from warpcontact._version import __version__

if TYPE_CHECKING:
    from warpcontact import compare, integrators, meshes, outcomes, unilateral
    from warpcontact.analysis import convergence, quantile_fan, sensitivity, write_fan
    from warpcontact.benchmark import BenchReport, bench
    from warpcontact.checkpoint_values import CheckpointError
    from warpcontact.contact_coupling import ContactCoupling
    from warpcontact.contact_range import ContactRange
    from warpcontact.contact_warning import ContactWarning, RunWarning, WarningLevel
    from warpcontact.couplings.elements import Bushing, Catenary, SpringDamper
    from warpcontact.elements import Body, Contact, ContactMaterial, Points, Surface
    from warpcontact.experiment import Experiment, ExperimentError, Run, RunDataError, open_run
    from warpcontact.health import Health
    from warpcontact.kernels import friction, laws, motions, springs
    from warpcontact.kernels.formula import history, parameter, table
    from warpcontact.kernels.friction.base import Friction
    from warpcontact.kernels.laws.base import Law
    from warpcontact.kernels.motions.base import Motion
    from warpcontact.kernels.outcomes.base import Outcome
    from warpcontact.kernels.smooth import shapes
    from warpcontact.kernels.smooth.patch import ParametricSurface
    from warpcontact.kernels.springs.base import Damper, Spring
    from warpcontact.meshes import Mesh, MeshError, MeshReport, SurfaceSamples, load_mesh, sample_surface
    from warpcontact.model import Model
    from warpcontact.outcomes.watch import ContactEvents, StopCondition
    from warpcontact.quarantine import QuarantineError
    from warpcontact.recording import Recording
    from warpcontact.regular_files import UnsafeFileError
    from warpcontact.rendering import film, render
    from warpcontact.run_report import report
    from warpcontact.scene import Scene
    from warpcontact.simulation import Simulation
    from warpcontact.smooth.elements import Shape, ShapeContact
    from warpcontact.split_model import SplitModel
    from warpcontact.status import (
        CatenaryStatus,
        ContactMode,
        ContactStatus,
        CouplingStatus,
        EnvironmentStatus,
        FailureCause,
    )
    from warpcontact.usd import check_usd, export_usd
    from warpcontact.usd.importing.errors import UsdError
    from warpcontact.viewer import view

# Where each public name lives; a module stands for itself.
_HOME = {
    "BenchReport": "warpcontact.benchmark",
    "Body": "warpcontact.elements",
    "Bushing": "warpcontact.couplings.elements",
    "Catenary": "warpcontact.couplings.elements",
    "CheckpointError": "warpcontact.checkpoint_values",
    "FailureCause": "warpcontact.status",
    "Contact": "warpcontact.elements",
    "ContactCoupling": "warpcontact.contact_coupling",
    "ContactMode": "warpcontact.status",
    "ContactRange": "warpcontact.contact_range",
    "ContactWarning": "warpcontact.contact_warning",
    "CouplingStatus": "warpcontact.status",
    "Damper": "warpcontact.kernels.springs.base",
    "EnvironmentStatus": "warpcontact.status",
    "ContactEvents": "warpcontact.outcomes.watch",
    "Experiment": "warpcontact.experiment",
    "ExperimentError": "warpcontact.experiment",
    "Friction": "warpcontact.kernels.friction.base",
    "Health": "warpcontact.health",
    "Law": "warpcontact.kernels.laws.base",
    "CatenaryStatus": "warpcontact.status",
    "Mesh": "warpcontact.meshes",
    "MeshError": "warpcontact.meshes",
    "MeshReport": "warpcontact.meshes",
    "Model": "warpcontact.model",
    "Motion": "warpcontact.kernels.motions.base",
    "Outcome": "warpcontact.kernels.outcomes.base",
    "ParametricSurface": "warpcontact.kernels.smooth.patch",
    "Points": "warpcontact.elements",
    "QuarantineError": "warpcontact.quarantine",
    "Recording": "warpcontact.recording",
    "Run": "warpcontact.experiment",
    "RunWarning": "warpcontact.contact_warning",
    "Scene": "warpcontact.scene",
    "Shape": "warpcontact.smooth.elements",
    "Simulation": "warpcontact.simulation",
    "ShapeContact": "warpcontact.smooth.elements",
    "SplitModel": "warpcontact.split_model",
    "Spring": "warpcontact.kernels.springs.base",
    "SpringDamper": "warpcontact.couplings.elements",
    "UsdError": "warpcontact.usd.importing.errors",
    "ContactStatus": "warpcontact.status",
    "RunDataError": "warpcontact.experiment",
    "StopCondition": "warpcontact.outcomes.watch",
    "Surface": "warpcontact.elements",
    "SurfaceSamples": "warpcontact.meshes",
    "ContactMaterial": "warpcontact.elements",
    "WarningLevel": "warpcontact.contact_warning",
    "UnsafeFileError": "warpcontact.regular_files",
    "bench": "warpcontact.benchmark",
    "compare": "warpcontact.compare",
    "convergence": "warpcontact.analysis",
    "check_usd": "warpcontact.usd",
    "export_usd": "warpcontact.usd",
    "film": "warpcontact.rendering",
    "friction": "warpcontact.kernels.friction",
    "integrators": "warpcontact.integrators",
    "laws": "warpcontact.kernels.laws",
    "load_mesh": "warpcontact.meshes",
    "history": "warpcontact.kernels.formula",
    "meshes": "warpcontact.meshes",
    "motions": "warpcontact.kernels.motions",
    "open_run": "warpcontact.experiment",
    "outcomes": "warpcontact.outcomes",
    "parameter": "warpcontact.kernels.formula",
    "quantile_fan": "warpcontact.analysis",
    "render": "warpcontact.rendering",
    "report": "warpcontact.run_report",
    "sample_surface": "warpcontact.meshes",
    "sensitivity": "warpcontact.analysis",
    "shapes": "warpcontact.kernels.smooth.shapes",
    "springs": "warpcontact.kernels.springs",
    "table": "warpcontact.kernels.formula",
    "unilateral": "warpcontact.unilateral",
    "view": "warpcontact.viewer",
    "write_fan": "warpcontact.analysis",
}

__all__ = [
    "BenchReport",
    "Body",
    "Bushing",
    "Catenary",
    "CatenaryStatus",
    "CheckpointError",
    "Contact",
    "ContactCoupling",
    "ContactEvents",
    "ContactMaterial",
    "ContactMode",
    "ContactRange",
    "ContactStatus",
    "ContactWarning",
    "CouplingStatus",
    "Damper",
    "EnvironmentStatus",
    "Experiment",
    "ExperimentError",
    "FailureCause",
    "Friction",
    "Health",
    "Law",
    "Mesh",
    "MeshError",
    "MeshReport",
    "Model",
    "Motion",
    "Outcome",
    "ParametricSurface",
    "Points",
    "QuarantineError",
    "Recording",
    "Run",
    "RunDataError",
    "RunWarning",
    "Scene",
    "Shape",
    "ShapeContact",
    "Simulation",
    "SplitModel",
    "Spring",
    "SpringDamper",
    "StopCondition",
    "Surface",
    "SurfaceSamples",
    "UnsafeFileError",
    "UsdError",
    "WarningLevel",
    "__version__",
    "bench",
    "check_usd",
    "compare",
    "convergence",
    "export_usd",
    "film",
    "friction",
    "history",
    "integrators",
    "laws",
    "load_mesh",
    "meshes",
    "motions",
    "open_run",
    "outcomes",
    "parameter",
    "quantile_fan",
    "render",
    "report",
    "sample_surface",
    "sensitivity",
    "shapes",
    "springs",
    "table",
    "unilateral",
    "view",
    "write_fan",
]


def _load(name: str) -> ModuleType:
    """Imports a module. What it makes stays: to look for garbage in it would take a fifth of the time."""
    with collecting.gc_paused():
        return importlib.import_module(name)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        from warpcontact.kernels.names import suggestion
        from warpcontact.kernels.renamed import present_name

        if (new := present_name(name, _HOME)) is not None:
            raise AttributeError(f"warpcontact.{name} is now warpcontact.{new}")
        hint = "" if name.startswith("_") else suggestion(name, _HOME)
        raise AttributeError(f"module 'warpcontact' has no attribute {name!r}{hint}")
    module = _load(_HOME[name])
    value = module if _HOME[name].rpartition(".")[2] == name else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
