"""Nonsmooth contacts at all local minima of the distance: their slots among the stored impulses, and launches."""

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpcontact.forces.contact_groups import ContactGroup
from warpcontact.kernels.contact import minima_history
from warpcontact.kernels.nonsmooth import minima_rows
from warpcontact.storage.allocation_plan import AllocationPlan

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan


class NonsmoothMinima:
    """Nonsmooth contacts of a group with several minima per sphere. Each slot for a minimum has a stored impulse.

    Args:
        group: The group.
        items: Numbers of the nonsmooth contacts of the group.
        clusters: Numbers of their clusters.
        first_stored: Number of the stored impulse of the first slot of the group.
        layout: Allocation plan to which the lists are added.
        purpose: Their purpose, for memory estimates.
    """

    def __init__(
        self,
        group: ContactGroup,
        items: Collection[int],
        clusters: Collection[int],
        first_stored: int,
        layout: AllocationPlan,
        purpose: str,
    ) -> None:
        assert group.minima is not None
        self.group, self.minima = group, group.minima
        self.first_stored = first_stored
        self.items: Any = None
        self.clusters: Any = None
        self._count, self._cluster_count = len(items), len(clusters)
        layout.constant(purpose, self, "items", np.array(items, dtype=np.int32), wp.int32)
        layout.constant(purpose, self, "clusters", np.array(clusters, dtype=np.int32), wp.int32)

    @property
    def stored_count(self) -> int:
        """Number of stored impulses: one per slot of all contacts of the group."""
        return self.group.count * self.minima.slots

    @property
    def row_count(self) -> int:
        """Largest number of rows."""
        return self._count * self.minima.room

    def row_launches(self, plan: "ExecutionPlan", inputs: Mapping[str, Any]) -> list[wp.Launch]:
        """Returns the launch that adds the rows; ``inputs``: arguments that all kinds of rows have."""
        a = plan.model.arrays
        return plan.prepare(
            minima_rows.kernel(self.group.real, self.minima.room),
            1,
            model=a.model,
            contacts=a.contacts,
            active_contacts=a.active_contacts,
            clusters=self.clusters,
            block_count=self._cluster_count,
            first_contact=self.group.first,
            first_stored=self.first_stored,
            **self.minima.inputs,
            **inputs,
        )

    def show_launches(self, plan: "ExecutionPlan", inputs: Mapping[str, Any]) -> list[wp.Launch]:
        """Returns the launch that copies the last step to sensors; ``inputs``: arguments that all contacts have."""
        return plan.prepare(
            minima_rows.display(self.group.real, self.minima.room),
            self._count,
            model=plan.model.arrays.model,
            state=plan.model.arrays.state,
            items=self.items,
            first_contact=self.group.first,
            first_stored=self.first_stored,
            contacts=plan.model.arrays.contacts,
            results=self.minima.results,
            **inputs,
        )

    def reset(self, envs: int, device: wp.Device) -> None:
        """Removes all minima, whose laws were not evaluated meanwhile."""
        everywhere = wp.full(envs, True, dtype=wp.bool, device=device)
        wp.launch(
            minima_history.reset(self.group.real, self.minima.room),
            dim=(envs, self.group.count),
            inputs=[everywhere, self.minima.history, self.minima.results],
            device=device,
        )
