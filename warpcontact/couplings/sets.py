"""All couplings of a scene on a device, sorted by kind and code."""

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.couplings.bushings import BushingSet
from warpcontact.couplings.catenaries import CatenarySet
from warpcontact.couplings.coupling_set import CouplingSet, ends_by_body
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
    scene: "Scene", arrays: SimpleNamespace, layout: "Layout", parameters: "Parameters", types: SimpleNamespace
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
    couplings = [coupling for own in sorted_.values() for coupling in own]
    points = [point.start for coupling in couplings for point in (coupling.point_a, coupling.point_b)]
    starts, ends = ends_by_body(couplings, sum(body.count for body in scene.bodies))
    for name, values in (("end_point", points), ("body_end_start", starts), ("body_end", ends)):
        layout.content("couplings", arrays.model, name, values, wp.int32)
    return sets
