"""Creates the device data of all couplings of a scene, grouped by kind and kernel."""

from typing import TYPE_CHECKING, Any

from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.kernels.types import Structs
from warpcontact.scene.couplings import Bushing, Catenary, Coupling, SpringDamper

if TYPE_CHECKING:
    from warpcontact.scene.scene_data import SceneData
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters


def set_of(kind: type[Coupling]) -> type[CouplingSet]:
    """Returns the set class for a kind of coupling; imported on demand, because Warp then parses its kernels."""
    if kind is SpringDamper:
        from warpcontact.forces.couplings.springs import SpringSet

        return SpringSet
    if kind is Bushing:
        from warpcontact.forces.couplings.bushings import BushingSet

        return BushingSet
    from warpcontact.forces.couplings.catenaries import CatenarySet

    assert kind is Catenary  # there are no others
    return CatenarySet


def make_sets(
    scene: "SceneData", layout: "AllocationPlan", parameters: "Parameters", types: Structs
) -> list[CouplingSet]:
    """Declares the arrays of all couplings and adds their parameters."""
    sorted_: dict[tuple[type[Coupling], Any], list[Coupling]] = {}
    for coupling in scene.couplings:
        kind = type(coupling)
        sorted_.setdefault((kind, set_of(kind).key(coupling)), []).append(coupling)
    sets: list[CouplingSet] = []
    first = 0
    for (kind, _), own in sorted_.items():
        sets.append(set_of(kind)(own, first, layout, parameters, types))
        first += len(own)
    return sets
