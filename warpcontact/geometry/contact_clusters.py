"""Clusters: groups of at most 16 neighboring contacts that are culled together and processed by one thread."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.types import WORLD
from warpcontact.scene.elements import Contact
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.parameters import Parameters
from warpcontact.validation.checks import Array

# Maximum number of contacts per cluster. More contacts cost more if one is active; fewer gain less by culling.
MAX_CLUSTER_SIZE = 16


@dataclass(frozen=True)
class ContactClusters:
    """The clusters of all contacts. A point set moves rigidly and has one or several clusters.

    Attributes:
        set_contact: First contact of each set, and the end, (sets + 1,).
        set_start: First cluster of each set, and the end, (sets + 1,).
        start: First entry of each cluster in ``contact``, and the end, (clusters + 1,).
        contact: Contacts, ordered by cluster, (contacts,).
        body_cluster_start: First entry of each body in ``body_clusters``, and the end, (bodies + 1,).
        body_clusters: Clusters of each body, as 2 × cluster + side; side 0: body of the points, 1: of the surface.
    """

    set_contact: NDArray[np.int32]
    set_start: NDArray[np.int32]
    start: NDArray[np.int32]
    contact: NDArray[np.int32]
    body_cluster_start: NDArray[np.int32]
    body_clusters: NDArray[np.intp]

    @property
    def count(self) -> int:
        """Number of clusters."""
        return len(self.start) - 1

    @property
    def width(self) -> int:
        """Size of the largest cluster, rounded up to a power of two."""
        return 1 << int(np.diff(self.start).max(initial=1) - 1).bit_length()

    @property
    def max_per_body(self) -> int:
        """Maximum number of clusters of a body."""
        return int(np.diff(self.body_cluster_start).max(initial=0))

    @property
    def set_count(self) -> int:
        """Number of point sets."""
        return len(self.set_start) - 1

    @property
    def set_of_cluster(self) -> NDArray[np.int32]:
        """Set of each cluster, (clusters,)."""
        return np.repeat(np.arange(self.set_count, dtype=np.int32), np.diff(self.set_start))

    def range_of_contacts(self, first: int, count: int) -> tuple[int, int]:
        """Returns the first cluster and the number of clusters of consecutive contacts that form complete sets."""
        return _between(self.start, first, count)

    def set_range_of_contacts(self, first: int, count: int) -> tuple[int, int]:
        """Returns the first set and the number of sets of consecutive contacts that form complete sets."""
        return _between(self.set_contact, first, count)


def make_clusters(contacts: list[Contact], body_count: int) -> ContactClusters:
    """Returns the clusters of ``contacts``, which are in device order, for ``body_count`` bodies."""
    empty = [np.zeros(0, dtype=np.intp)]
    members, sizes, clusters_of_sets, sets = list(empty), list(empty), list(empty), list(empty)
    first = 0
    for contact in contacts:
        if contact.points.spread:  # a set for each body
            ones = np.ones(contact.count, dtype=np.intp)
            members.append(first + np.arange(contact.count))
            sizes.append(ones)
            clusters_of_sets.append(ones)
            sets.append(ones)
        else:
            neighborhoods = _split_spatially(contact.points.places)
            members += [first + cluster for cluster in neighborhoods]
            sizes.append(np.array([len(cluster) for cluster in neighborhoods]))
            clusters_of_sets.append(np.array([len(neighborhoods)]))
            sets.append(np.array([contact.count]))
        first += contact.count
    cluster_counts = np.concatenate(clusters_of_sets)
    body_cluster_start, body_clusters = _clusters_by_body(cluster_counts, contacts, body_count)
    return ContactClusters(
        set_contact=_starts(np.concatenate(sets)),
        set_start=_starts(cluster_counts),
        start=_starts(np.concatenate(sizes)),
        contact=np.concatenate(members).astype(np.int32),
        body_cluster_start=body_cluster_start,
        body_clusters=body_clusters,
    )


def _between(starts: NDArray[np.int32], first: int, count: int) -> tuple[int, int]:
    begin, end = np.searchsorted(starts, [first, first + count])
    return int(begin), int(end - begin)


def _starts(counts: NDArray[np.integer]) -> NDArray[np.int32]:
    """Returns the start of each of several consecutive lists, and the end of the last one."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)


def _split_spatially(positions: Array) -> list[NDArray[np.intp]]:
    """Splits points across their longest extent into clusters; indices ascend in each."""
    pending = [np.arange(len(positions))]
    finished: list[NDArray[np.intp]] = []
    while pending:
        indices = pending.pop()
        if len(indices) <= MAX_CLUSTER_SIZE:
            finished.append(np.sort(indices))
            continue
        along = int(np.ptp(positions[indices], axis=0).argmax())
        order = indices[np.argsort(positions[indices, along], kind="stable")]
        # Split at a multiple of the cluster size, so that most clusters are full.
        center = MAX_CLUSTER_SIZE * -(-len(order) // (2 * MAX_CLUSTER_SIZE))
        pending += [order[center:], order[:center]]
    return finished


def upload_clusters(
    clusters: ContactClusters,
    contacts: list[Contact],
    model: Any,
    layout: AllocationPlan,
    parameters: Parameters,
    t: Any,
    point_positions: Callable[[], Array],
) -> list[Any]:
    """Declares the arrays of sets and clusters of ``model``.

    Args:
        clusters: Clusters of ``contacts``.
        contacts: The contacts in device order.
        model: Struct that gets the arrays.
        layout: Allocation plan for the index arrays.
        parameters: Gets the device fields of centers and extents, which depend on the points.
        t: Warp structs of the precision.
        point_positions: Returns the positions of all points in their bodies, (1 or envs, points, 3).

    Returns:
        The device fields to upload when points are moved.
    """

    def add_constant(name: str, values: Any) -> None:
        layout.constant("contacts", model, name, values, wp.int32)

    firsts, sizes = clusters.set_contact[:-1], np.diff(clusters.set_contact)
    add_constant("set_contact", firsts)
    add_constant("contact_set", np.repeat(np.arange(clusters.set_count), sizes))
    add_constant("set_cluster_start", clusters.set_start)
    add_constant("cluster_set", clusters.set_of_cluster)
    add_constant("cluster_start", clusters.start)
    add_constant("cluster_contact", clusters.contact)
    add_constant("body_cluster_start", clusters.body_cluster_start)
    add_constant("body_cluster", clusters.body_clusters)
    empty = np.zeros(0, dtype=np.intp)
    points = [contact.points.start + np.arange(contact.count) for contact in contacts]
    by_set = np.concatenate([empty, *points])
    by_cluster = by_set[clusters.contact]

    def centers(points: NDArray[np.intp], starts: NDArray[np.int32]) -> Array:
        if not len(points):
            return np.zeros((1, 0, 3))
        values = point_positions()[:, points]
        low, high = (end.reduceat(values, starts, axis=1) for end in (np.minimum, np.maximum))
        return np.asarray(0.5 * (low + high), dtype=np.float64)

    def extents() -> Array:
        if not len(by_set):
            return np.zeros((1, 0))
        center = np.repeat(centers(by_set, firsts), sizes, axis=1)
        distances = np.linalg.norm(point_positions()[:, by_set] - center, axis=2)
        # Enlarged for rounding of points and centers.
        return np.asarray((1.0 + 1.0e-5) * np.maximum.reduceat(distances, firsts, axis=1), dtype=np.float64)

    return [
        parameters.device_field(model, "set_center", t.vec3, lambda: centers(by_set, firsts)),
        parameters.device_field(model, "set_extent", t.real, extents),
        parameters.device_field(model, "cluster_center", t.vec3, lambda: centers(by_cluster, clusters.start[:-1])),
    ]


def _clusters_by_body(
    cluster_counts: NDArray[np.intp], contacts: list[Contact], body_count: int
) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    """Returns ``body_cluster_start`` and ``body_clusters``, see ``ContactClusters``.

    ``cluster_counts`` is the number of clusters of each set.
    """
    empty = np.zeros(0, dtype=np.int32)
    on_points = [
        contact.points.body_numbers[:: 1 if contact.points.spread else contact.count] for contact in contacts
    ]
    on_surface = [
        np.full(contact.set_count, WORLD if contact.surface.body is None else contact.surface.body.index)
        for contact in contacts
    ]
    set_of_cluster = np.stack([np.concatenate([empty, *on_points]), np.concatenate([empty, *on_surface])], axis=1)
    bodies = np.repeat(set_of_cluster, cluster_counts, axis=0).ravel()
    entries = np.argsort(bodies, kind="stable")
    return _starts(np.bincount(bodies[bodies >= 0], minlength=body_count)), entries[(bodies < 0).sum() :]
