"""Device data of the manifolds of nonsmooth body contacts. Kernels: ``kernels/manifolds``."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.nonsmooth.materials import CONTACT_GAP
from warpcontact.forces.sensor import Sensor
from warpcontact.geometry.polyhedron_features import MAX_OUTLINE
from warpcontact.kernels.lowlevel import task_lists
from warpcontact.kernels.manifolds import acceptance, manifold
from warpcontact.kernels.manifolds.candidates import POINTS
from warpcontact.kernels.manifolds.records import ManifoldHistory, ManifoldPairs, manifold_structs
from warpcontact.kernels.nonsmooth import manifold_rows
from warpcontact.kernels.types import WORLD
from warpcontact.storage.allocation_plan import per_env
from warpcontact.storage.state_storage import SWITCH, Allowed
from warpcontact.system.launches import launch_kernel

if TYPE_CHECKING:
    from warpcontact.forces.body_contact.body_contact_set import BodyContactSet
    from warpcontact.forces.execution_plan import ExecutionPlan
    from warpcontact.scene.body_contact import BodyContact
    from warpcontact.storage.allocation_plan import AllocationPlan

_PURPOSE = "body contacts"
# Sizes of the search kernels for outlines: faces only, and any convex part of a plane.
_OUTLINE_CORNERS = (4, MAX_OUTLINE)
# name: (array of the points, unit, meaning, shape)
_POINT_SENSORS: dict[str, tuple[str, str, str, tuple[int, ...]]] = {
    "point": ("position", "m", "point of contact, world; NaN without a point", (3,)),
    "point_gap": ("gap", "m", "gap of a point of contact, negative in overlap; NaN without a point", ()),
    "point_force": ("force", "N", "force of a point on the first body, mean over the last step, world", (3,)),
}


class ManifoldSet:
    """Manifolds of some body contacts of a set.

    Args:
        body_contacts: The set.
        contacts: The nonsmooth body contacts, with the numbers of their pairs in the set.
        layout: Allocation plan to which the arrays are added.

    Attributes:
        body_contacts: The set.
        count: Number of pairs.
        slot_count: Largest number of points of all pairs.
        patch_count: Largest number of patches of a pair.
        contacts: The body contacts, with their ranges of pairs and of points.
    """

    def __init__(
        self,
        body_contacts: "BodyContactSet",
        contacts: "Mapping[BodyContact, slice]",
        layout: "AllocationPlan",
    ) -> None:
        self.body_contacts = body_contacts
        self.real = body_contacts.real
        tables = body_contacts.tables
        numbers: list[int] = []
        starts = [0]
        patch_counts = {pair: tables.patch_count(*pair) for contact in contacts for pair in contact.pairs}
        self.patch_count = max(patch_counts.values())
        self.contacts: dict[BodyContact, tuple[slice, slice]] = {}
        for contact, items in contacts.items():
            first_pair, first_slot = len(numbers), starts[-1]
            numbers += range(items.start, items.stop)
            for pair in contact.pairs:
                # The kernel searches all pairs with several patches for the same number of them.
                patches = 1 if patch_counts[pair] == 1 else self.patch_count
                starts.append(starts[-1] + patches * POINTS)
            self.contacts[contact] = slice(first_pair, len(numbers)), slice(first_slot, starts[-1])
        self.count, self.slot_count = len(numbers), starts[-1]
        # Whether there are pairs of convex polyhedra, of other polyhedra, and with curved solids on half-spaces and elsewhere.
        self._kinds = tables.pair_kinds([pair for contact in contacts for pair in contact.pairs])
        self.pairs = ManifoldPairs()
        layout.constant(_PURPOSE, self.pairs, "item", numbers, wp.int32)
        layout.constant(_PURPOSE, self.pairs, "slot_start", starts, wp.int32)
        self.features, corners = tables.declare_features(layout)
        self._outline_corners = next(limit for limit in _OUTLINE_CORNERS if corners <= limit)
        slots, pairs = per_env(self.slot_count), per_env(self.count)
        layout.array(_PURPOSE, self.pairs, "results", wp.int32, pairs, transient=True)
        ranges: dict[str, Allowed] = {
            "feature_1": (0, np.iinfo(np.int32).max),
            "feature_2": (0, np.iinfo(np.int32).max),
            "is_closed": (0, 1),
            "count": (0, self.patch_count * POINTS),
            "reference": (-1, np.iinfo(np.int32).max),
            "overflow": (0, np.iinfo(np.int32).max),
            "likely": (np.iinfo(np.int32).min, np.iinfo(np.int32).max),
            "search.geometry_1": (0, np.iinfo(np.int32).max),
            "search.geometry_2": (0, np.iinfo(np.int32).max),
            "search.normal_on_first": SWITCH,
            "search.is_nearest": SWITCH,
            "search.is_valid": SWITCH,
        }
        of_pairs: dict[str, Any] = dict.fromkeys(("count", "reference", "overflow", "likely", "search"), pairs)
        self.history = layout.struct(_PURPOSE, ManifoldHistory, slots, ranges=ranges, **of_pairs)
        self.history_out = layout.struct(_PURPOSE, ManifoldHistory, slots, transient=True, **of_pairs)
        ManifoldPoints = manifold_structs(self.real).ManifoldPoints
        self.points = layout.struct(_PURPOSE, ManifoldPoints, slots, transient=True)
        self.load_ratio: Any = None
        layout.array(_PURPOSE, self, "load_ratio", self.real, pairs, transient=True)

    def body_pairs(self) -> "np.ndarray[Any, Any]":
        """Returns the bodies of each pair, (pairs, 2)."""
        bodies = [
            [WORLD if solid.body is None else solid.body.index for solid in pair]
            for contact in self.contacts
            for pair in contact.pairs
        ]
        return np.array(bodies, dtype=np.int64)

    def find_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array
    ) -> list[wp.Launch]:
        """Returns the launch that finds the manifolds in ``state``, for a step of length ``step`` [env, 0] [s]."""
        one = self.body_contacts
        return plan.prepare(
            manifold.find_manifolds(self.real, *self._kinds, self.patch_count, self._outline_corners),
            self.count,
            threads=task_lists.thread_count(plan.count * self.count),
            status=status,
            model=plan.model.arrays.model,
            state=state,
            step=step,
            geometries=one.tables.geometries,
            features=self.features,
            solids=one.tables.solids,
            boxes=one.tables.boxes,
            pairs=one.pairs,
            settings=one.settings,
            manifold_pairs=self.pairs,
            contact_gap=CONTACT_GAP[self.real],
            history_in=self.history,
            history_out=self.history_out,
            manifold_points=self.points,
            body_contacts=one.body_contacts,
        )

    def row_launches(
        self, plan: "ExecutionPlan", step: wp.array, first: int, first_material: int, inputs: Mapping[str, Any]
    ) -> list[wp.Launch]:
        """Returns the launch that adds the points as rows of the contact problem.

        Args:
            plan: Execution plan of the environments.
            step: Step length [env, 0] [s].
            first: Number of the first point among all nonsmooth contacts.
            first_material: Number of the material of the first pair.
            inputs: Arguments that kernels of all kinds of contacts have.
        """
        return plan.prepare(
            manifold_rows.manifold_rows(self.real),
            1,
            step=step,
            solids=self.body_contacts.tables.solids,
            pairs=self.body_contacts.pairs,
            manifold_pairs=self.pairs,
            pair_count=self.count,
            contact_gap=CONTACT_GAP[self.real],
            history=self.history,
            history_out=self.history_out,
            manifold_points=self.points,
            first=first,
            first_material=first_material,
            **inputs,
        )

    def show_launches(
        self, plan: "ExecutionPlan", status: wp.array, step: wp.array, first: int, inputs: Mapping[str, Any]
    ) -> list[wp.Launch]:
        """Returns the launch that writes the impulses of the last step to sensors."""
        return plan.prepare(
            manifold_rows.display_manifolds(self.real),
            self.count,
            status=status,
            step=step,
            manifold_pairs=self.pairs,
            manifold_points=self.points,
            first=first,
            contact_gap=CONTACT_GAP[self.real],
            body_contacts=self.body_contacts.body_contacts,
            load_ratio=self.load_ratio,
            **inputs,
        )

    def accept_launches(self, plan: "ExecutionPlan") -> list[wp.Launch]:
        """Returns the launch that stores the points of an accepted step."""
        return plan.prepare(
            acceptance.accept_manifolds(),
            self.count,
            status=plan.model.arrays.status,
            manifold_pairs=self.pairs,
            history_out=self.history_out,
            history=self.history,
        )

    def reset_state(self, chosen: wp.array) -> None:
        """Removes the points in the environments of the mask ``chosen`` [env]."""
        launch_kernel(
            acceptance.reset_manifolds(self.real),
            (len(chosen), self.count),
            device=chosen.device,
            mask=chosen,
            manifold_pairs=self.pairs,
            history=self.history,
            history_out=self.history_out,
            manifold_points=self.points,
        )

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of points, and of the distribution of loads."""
        for contact, (pairs, slots) in self.contacts.items():
            for key, (attribute, unit, meaning, shape) in _POINT_SENSORS.items():
                yield Sensor(
                    f"{contact.name}.{key}",
                    unit,
                    meaning,
                    _column(self.points, attribute, slots),
                    needs=("contacts",),
                    items=slots.stop - slots.start,
                    shape=shape,
                    items_of="point",
                )
            yield Sensor(
                f"{contact.name}.load_ratio",
                "-",
                "largest normal force of a closed point over the mean of all closed points of the pair, 0 without load",
                _column(self, "load_ratio", pairs.start if contact.single else pairs),
                needs=("contacts",),
                items=0 if contact.single else contact.count,
            )
            yield Sensor(
                f"{contact.name}.overflow",
                "-",
                f"number of steps since reset in which areas in contact had none of the {self.patch_count} patches of a pair",
                _column(self.history, "overflow", pairs.start if contact.single else pairs),
                items=0 if contact.single else contact.count,
            )

    def failures(self) -> dict[str, NDArray[np.int32]]:
        """Returns the number of steps since reset with more patches than room, (envs,) by contact; the maximum of its pairs."""
        if self.history.overflow is None:
            return {}
        values = self.history.overflow.numpy()
        return {contact.name: values[:, pairs].max(axis=1) for contact, (pairs, _) in self.contacts.items()}


def _column(owner: Any, attribute: str, items: int | slice) -> Any:
    return lambda _: getattr(owner, attribute)[:, items]


def nonsmooth_contacts(
    body_contacts: "BodyContactSet", compliant: Sequence[str] | frozenset[str]
) -> "dict[BodyContact, slice]":
    """Returns the body contacts of a set that are not compliant, with the numbers of their pairs."""
    return {contact: items for contact, items in body_contacts.items.items() if contact.name not in compliant}
