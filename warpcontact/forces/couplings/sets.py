"""Creates the device data of all couplings of a scene, grouped by kind and kernel."""

from collections.abc import Sequence
from typing import Any

from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.force_element import BuildContext, ForceElement
from warpcontact.scene.couplings import Bushing, Catenary, Coupling, SpringDamper


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


def declare(context: BuildContext, elements: Sequence[Coupling]) -> list[ForceElement]:
    """Declares the couplings of a model, in the order in which a kind or kernel first occurs."""
    sorted_: dict[tuple[type[Coupling], Any], list[Coupling]] = {}
    for coupling in elements:
        kind = type(coupling)
        sorted_.setdefault((kind, set_of(kind).key(coupling)), []).append(coupling)
    return [set_of(kind)(own, context) for (kind, _), own in sorted_.items()]
