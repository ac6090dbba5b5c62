"""All couplings of a scene on a device, sorted by kind and code."""

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from warpcontact.couplings.bushings import BushingSet
from warpcontact.couplings.catenaries import CatenarySet
from warpcontact.couplings.coupling_set import CouplingSet
from warpcontact.couplings.elements import Bushing, Catenary, Coupling, SpringDamper
from warpcontact.couplings.springs import SpringSet

if TYPE_CHECKING:
    from warpcontact.arrays import Layout
    from warpcontact.parameters import Parameters
    from warpcontact.scene import Scene

#: What couplings of a kind are on a device.
SETS: dict[type[Coupling], type[CouplingSet]] = {
    SpringDamper: SpringSet,
    Bushing: BushingSet,
    Catenary: CatenarySet,
}


def make_sets(
    scene: "Scene", layout: "Layout", parameters: "Parameters", types: SimpleNamespace
) -> list[CouplingSet]:
    """Declares the arrays of all couplings, and adds their parameters."""
    sorted_: dict[tuple[type[Coupling], Any], list[Coupling]] = {}
    for coupling in scene.couplings:
        kind = type(coupling)
        sorted_.setdefault((kind, SETS[kind].key(coupling)), []).append(coupling)
    sets: list[CouplingSet] = []
    first = 0
    for (kind, _), own in sorted_.items():
        sets.append(SETS[kind](own, first, layout, parameters, types))
        first += len(own)
    return sets
