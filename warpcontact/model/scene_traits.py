"""Properties of a scene that are independent of the number of environments: counts, flags and sensor arrays."""

from collections.abc import Callable, Collection
from functools import cached_property
from typing import Any

import warp as wp

from warpcontact.kernels.couplings import contact_coupling
from warpcontact.kernels.joints.measures import Coordinates, Reactions
from warpcontact.kernels.outcomes import body_measures
from warpcontact.kernels.types import FREE, TIME_FUNCTION
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.allocation_plan import SENSOR_PURPOSE as PURPOSE
from warpcontact.storage.allocation_plan import AllocationPlan, per_env
from warpcontact.storage.memory_estimate import MemoryItem


class SceneTraits:
    """Counts and flags of a scene, independent of the number of environments."""

    scene: SceneData

    @cached_property
    def body_count(self) -> int:
        """Number of bodies per environment."""
        return sum(body.count for body in self.scene.bodies)

    @cached_property
    def contact_count(self) -> int:
        """Number of point contacts per environment."""
        return sum(contact.count for contact in self.scene.contacts)

    @cached_property
    def shape_contact_count(self) -> int:
        """Number of shape contacts per environment."""
        return sum(contact.count for contact in self.scene.shape_contacts)

    @cached_property
    def has_swept_contacts(self) -> bool:
        """Whether any contact is swept."""
        return any(contact.swept for contact in self.scene.contacts)

    @cached_property
    def has_latched_contacts(self) -> bool:
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
    def constrained_count(self) -> int:
        """Number of bodies that are neither free nor follow a function of time, per environment."""
        return sum(body.count for body in self.scene.bodies if body.motion.kind not in (FREE, TIME_FUNCTION))

    def sensor_memory(self, device: wp.Device, needs: Collection[str], envs: int) -> list[MemoryItem]:
        """Returns the memory of the arrays of sensors with ``needs``, for ``envs`` environments."""
        layout = AllocationPlan(device)
        for name, declare in SENSOR_ARRAYS.items():
            if name in needs:
                declare(layout, self)
        return layout.memory_items(envs)


def _per_body(struct: Any) -> Callable[[AllocationPlan, SceneTraits], Any]:
    return lambda layout, model: layout.struct(PURPOSE, struct, per_env(model.body_count))


def _points(layout: AllocationPlan, model: SceneTraits) -> Any:
    return layout.struct(PURPOSE, body_measures.Points, per_env(model.contact_count))


def _reactions(layout: AllocationPlan, model: SceneTraits) -> Any:
    return layout.struct(PURPOSE, Reactions, per_env(model.body_count))


def _coordinates(layout: AllocationPlan, model: SceneTraits) -> Any:
    return layout.struct(PURPOSE, Coordinates, per_env(model.body_count))


def _contact_couplings(layout: AllocationPlan, model: SceneTraits) -> Any:
    shape = per_env(len(model.scene.contact_couplings))
    return layout.struct(PURPOSE, contact_coupling.ContactCouplings, shape)


def _shape_points(layout: AllocationPlan, model: SceneTraits) -> Any:
    from warpcontact.kernels.shapes.measures import Points

    return layout.struct(PURPOSE, Points, per_env(model.shape_contact_count))


def _shape_curvatures(layout: AllocationPlan, model: SceneTraits) -> Any:
    from warpcontact.kernels.shapes.measures import Curvatures

    return layout.struct(PURPOSE, Curvatures, per_env(model.shape_contact_count))


def _shape_gradients(layout: AllocationPlan, model: SceneTraits) -> Any:
    from warpcontact.kernels.shapes.measures import Gradients

    return layout.struct(PURPOSE, Gradients, per_env(model.shape_contact_count))


#: Functions that declare the arrays of sensors, by need.
SENSOR_ARRAYS: dict[str, Callable[[AllocationPlan, SceneTraits], Any]] = {
    **{name: _per_body(struct) for name, (struct, _) in body_measures.BODY_MEASURES.items()},
    "points": _points,
    "reactions": _reactions,
    "coordinates": _coordinates,
    "contact_couplings": _contact_couplings,
    "shape_points": _shape_points,
    "shape_curvatures": _shape_curvatures,
    "shape_gradients": _shape_gradients,
}
#: Needs of shape contacts that are computed on request from the last evaluated contacts.
SHAPE_CONTACT_MEASURES = ("shape_points", "shape_curvatures", "shape_gradients")
