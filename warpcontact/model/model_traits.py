"""Properties of a model that are independent of the number of environments: counts, flags and needs of sensors."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import warp as wp

from warpcontact.forces.force_element import ForceElement, ForceTarget, Need
from warpcontact.kernels.outcomes import body_measures
from warpcontact.kernels.types import FREE, Structs
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.allocation_plan import SENSOR_PURPOSE, AllocationPlan, per_env
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.storage.model_arrays import ModelArrays

#: Needs of contacts and wrenches, including contacts that are far.
CONTACT_NEEDS = frozenset(("wrenches", "all_distances"))
#: Needs without arrays of their own.
_FORCE_NEEDS = {
    # Contacts that can touch, and their forces.
    "contacts": Need(by_slice=True),
    # Wrenches on bodies.
    "wrenches": Need(by_slice=True),
    # Gaps, normals and points of all contacts, including those that are far.
    "all_distances": Need(by_slice=True, all_distances=True),
}


def splits_orientation(scene: SceneData, real: type) -> bool:
    """Returns whether the state has rounding remainders of orientations: in float32 with body contacts.

    A body at rest on a face has a torque that depends on tilts below the rounding of a float32 quaternion. Without the
    remainder, rotations of a step below this rounding are lost, and the body keeps an angular velocity.
    """
    return real is wp.float32 and bool(scene.body_contacts)


class ModelTraits:
    """Counts, flags and needs of a model, independent of the number of environments.

    Attributes:
        scene: The scene.
        types: Structs of the precision.
        arrays: The arrays of the model.
        force_elements: All force elements, in launch order.
    """

    scene: SceneData
    types: Structs
    arrays: ModelArrays
    force_elements: Sequence[ForceElement]

    def of_family(self, name: str) -> list[Any]:
        """Returns the force elements of a family."""
        return [element for element in self.force_elements if element.family == name]

    @cached_property
    def body_count(self) -> int:
        """Number of bodies per environment."""
        return sum(body.count for body in self.scene.bodies)

    @cached_property
    def contact_count(self) -> int:
        """Number of contacts of points with meshes, per environment."""
        return sum(contact.count for contact in self.scene.contacts)

    @cached_property
    def has_swept_contacts(self) -> bool:
        """Whether any contact is swept."""
        return any(contact.swept for contact in self.scene.contacts)

    @cached_property
    def tracks_faces(self) -> bool:
        """Whether any contact tracks its closest point from step to step: latched or swept."""
        return self.has_swept_contacts or any(contact.entry == "latched" for contact in self.scene.contacts)

    @cached_property
    def has_external_forces(self) -> bool:
        """Whether any external force or torque is nonzero."""
        return any(body.external_force.any() or body.external_torque.any() for body in self.scene.bodies)

    @cached_property
    def has_joints(self) -> bool:
        """Whether any body has a joint or prescribed motion."""
        return any(body.motion.kind != FREE for body in self.scene.bodies)

    @cached_property
    def splits_orientation(self) -> bool:
        """Whether the state has rounding remainders of orientations, see ``splits_orientation``."""
        return splits_orientation(self.scene, self.types.real)

    @cached_property
    def has_ends(self) -> bool:
        """Whether any force element has forces at its ends."""
        return any(element.target is ForceTarget.ENDS for element in self.force_elements)

    @cached_property
    def elements_added_to_bodies(self) -> list[ForceElement]:
        """Force elements that add wrenches to the sums of ends, clusters and external forces."""
        return [element for element in self.force_elements if element.target is ForceTarget.BODIES]

    @cached_property
    def _needs_with_arrays(self) -> list[tuple[Mapping[str, Need], dict[str, Any]]]:
        """Needs of bodies and of each force element, with the table of their allocated arrays."""
        owners: list[tuple[Mapping[str, Need], dict[str, Any]]] = [
            (_body_needs(self.body_count), vars(self.arrays))
        ]
        return owners + [(element.needs(), element.measures) for element in self.force_elements]

    @cached_property
    def needs(self) -> Mapping[str, Need]:
        """Quantities that sensors can need, by name; see ``Sensor.needs``."""
        found = dict(_FORCE_NEEDS)
        for needs, _ in self._needs_with_arrays:
            found |= needs
        return found

    def check_needs(self, needs: Iterable[str]) -> frozenset[str]:
        """Returns ``needs`` as a set; raises ``ValueError`` if one does not exist."""
        requested = frozenset(needs)
        if unknown := requested - self.needs.keys():
            raise ValueError(f"unknown needs {sorted(unknown)}; possible needs: {sorted(self.needs)}")
        return requested

    def needs_all_distances(self, needs: Collection[str]) -> bool:
        """Returns whether ``needs`` require the evaluation of all contacts, including those that are far."""
        return any(self.needs[name].all_distances for name in needs)

    def needs_contacts(self, needs: Collection[str]) -> bool:
        """Returns whether ``needs`` require contacts and forces."""
        return not {"contacts", "wrenches"}.isdisjoint(needs) or self.needs_all_distances(needs)

    def are_by_slice(self, needs: Collection[str]) -> bool:
        """Returns whether launches compute ``needs`` for any range of environments, and in every step."""
        return all(self.needs[name].by_slice for name in needs)

    def unallocated(self, needs: Collection[str]) -> list[str]:
        """Returns those of ``needs`` whose arrays are not allocated."""
        missing = [
            name
            for table, allocated in self._needs_with_arrays
            for name, need in table.items()
            if name in needs and need.declare is not None and allocated.get(name) is None
        ]
        return list(dict.fromkeys(missing))

    def declare_sensor_arrays(
        self, layout: AllocationPlan, needs: Collection[str]
    ) -> list[tuple[dict[str, Any], str, Any]]:
        """Declares the arrays of ``needs``.

        Returns:
            For each struct of arrays: the table that gets it after allocation, its name and the struct.
        """
        return [
            (allocated, name, need.declare(layout))
            for table, allocated in self._needs_with_arrays
            for name, need in table.items()
            if name in needs and need.declare is not None
        ]

    def sensor_memory(self, device: wp.Device, needs: Collection[str], envs: int) -> list[MemoryItem]:
        """Returns the memory of the arrays of sensors with ``needs``, for ``envs`` environments."""
        layout = AllocationPlan(device)
        self.declare_sensor_arrays(layout, needs)
        return layout.memory_items(envs)


def _body_needs(count: int) -> dict[str, Need]:
    """Returns the needs of the sensors of ``count`` bodies, computed in float64."""

    def declare(struct: Any) -> Callable[[AllocationPlan], Any]:
        return lambda layout: layout.struct(SENSOR_PURPOSE, struct, per_env(count))

    return {
        name: Need(declare(struct), by_slice=True) for name, (struct, _) in body_measures.BODY_MEASURES.items()
    }
