"""What follows from a scene alone, whatever the number of its environments: counts, and what is measured."""

from collections.abc import Callable, Collection
from functools import cached_property
from typing import Any

import warp as wp

from warpcontact.arrays import Layout, per_env
from warpcontact.footprint import Need
from warpcontact.kernels import coupling, measures
from warpcontact.scene import Scene


class OfScene:
    """What follows from a scene alone, whatever the number of its environments."""

    scene: Scene

    @cached_property
    def body_count(self) -> int:
        """Number of bodies of an environment."""
        return len(self.scene.bodies)

    @cached_property
    def contact_count(self) -> int:
        """Number of contacts of an environment."""
        return sum(contact.count for contact in self.scene.contacts)

    @cached_property
    def sweeps(self) -> bool:
        """Whether any contact looks for crossings."""
        return any(contact.swept for contact in self.scene.contacts)

    @cached_property
    def follows(self) -> bool:
        """Whether any contact stays with what it touched."""
        return self.sweeps or any(contact.entry == "latched" for contact in self.scene.contacts)

    def measures_needs(self, device: wp.Device, needs: Collection[str], envs: int) -> list[Need]:
        """Returns what ``envs`` environments take that readings with these ``needs`` are measured into."""
        layout = Layout(device)
        for name, declare in MEASURES.items():
            if name in needs:
                declare(layout, self)
        return layout.needs(envs)


def _bodies(layout: Layout, model: OfScene) -> Any:
    return layout.struct("measures", measures.Bodies, per_env(model.body_count))


def _points(layout: Layout, model: OfScene) -> Any:
    return layout.struct("measures", measures.Points, per_env(model.contact_count))


def _couplings(layout: Layout, model: OfScene) -> Any:
    return layout.struct("measures", coupling.Couplings, per_env(len(model.scene.contact_couplings)))


#: How to declare what readings are measured into, by what they need.
MEASURES: dict[str, Callable[[Layout, OfScene], Any]] = {
    "bodies": _bodies,
    "points": _points,
    "couplings": _couplings,
}
