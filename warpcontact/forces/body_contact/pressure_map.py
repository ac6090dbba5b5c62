"""Pressure maps of body contacts: the area of contact as triangles with pressures. Kernels: ``pressure_map*.py``."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.body_contact.curved_shapes import is_curved
from warpcontact.forces.body_contact.map_triangles import MapTriangles, hide_layers, refine
from warpcontact.kernels.body_contact import pressure_maps as kernels
from warpcontact.kernels.body_contact.pressure_map_faces import face_maps
from warpcontact.kernels.body_contact.pressure_map_planes import plane_maps
from warpcontact.kernels.body_contact.pressure_map_sections import section_maps
from warpcontact.kernels.shapes.base import Plane
from warpcontact.system.kernel_builds import current_build
from warpcontact.system.launches import launch_kernel
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.body_contact.body_contact_set import BodyContactSet
    from warpcontact.model.model import DeviceModel

# By number of curved solids of a pair.
_MAPS = (face_maps, section_maps, plane_maps)


@dataclass(frozen=True, eq=False)
class PressureMap:
    """Areas of contact of all pairs of a set in the current state of a model: triangles, [triangle].

    Columns on both solids have triangles, with the weights α and 1 − α of their solids. Sums over all of them are the sensors of
    the pair. Those on the solid with the larger weight cover the area once; they are the ones to draw.

    Attributes:
        env: Environments.
        pair: Pairs, numbered as in the set.
        positions: Vertices on the reference surface, (n, 3, 3), counter-clockwise around the normals, world [m].
        normals: Mean unit normals out of the second solid, (n, 3), world.
        pressures: Force per area at the vertices, (n, 3) [Pa].
        areas: Areas, projected along the columns [m²].
        fractions: Mean part of the pressure that acts, 0 to 1.
        weights: Weights of the solids on which the columns stand.
        is_main: Whether that is the solid with the larger weight.
    """

    env: NDArray[np.int32]
    pair: NDArray[np.int32]
    positions: Array
    normals: Array
    pressures: Array
    areas: Array
    fractions: Array
    weights: Array
    is_main: NDArray[np.bool_]

    def area(self, shape: tuple[int, int]) -> Array:
        """Returns the areas of contact, ``shape`` (env, pair) [m²]."""
        return _sums(self.env, self.pair, self.weights * self.fractions * self.areas, shape)

    def normal_force(self, shape: tuple[int, int]) -> Array:
        """Returns the integrals of the pressure, ``shape`` (env, pair) [N]; exact if it is affine on each triangle."""
        return _sums(self.env, self.pair, self.weights * self.areas * self.pressures.mean(axis=1), shape)


def pressure_map(body_contacts: "BodyContactSet", model: "DeviceModel", envs: int | None = None) -> PressureMap:
    """Returns the pressure map of a set of compliant body contacts in the current state of a model.

    ``envs``: number of environments, from the first; ``None``: all.

    The pressure is that of the law at the poses and velocities of the state. Contacts are taken as new: a law with an impact
    speed has the present approach speed.
    """
    one, device = body_contacts, model.device
    pairs, triangles = _triangles(one, model, model.envs if envs is None else envs)
    half_spaces = np.array(
        [getattr(pair[1], "kind", None) is Plane for contact in one.items for pair in contact.pairs], dtype=bool
    )
    triangles = refine(hide_layers(triangles, half_spaces))
    count = len(triangles)
    owner = np.repeat(np.stack([triangles.env, triangles.pair], axis=1), 3, axis=0)
    vertices = kernels.MapVertices()
    for name, values in (("position", triangles.positions), ("normal", triangles.normals)):
        setattr(vertices, name, wp.array(values.reshape(-1, 3), dtype=wp.vec3d, device=device))
    for name, values in (("depth", triangles.depths), ("entry", triangles.entries), ("factor", triangles.factors)):
        setattr(vertices, name, wp.array(values.reshape(-1), dtype=wp.float64, device=device))
    origin = wp.zeros(3 * count, dtype=wp.vec3d, device=device)
    pressure, fraction = (wp.zeros(3 * count, dtype=wp.float64, device=device) for _ in range(2))
    if count:
        has_joints = bool(model.has_joints) and one.parts.law.needs_mass
        launch_kernel(
            current_build(
                kernels.pressures(one.parts, one.real, next(iter(one.items)).per_area, has_joints), device
            ),
            3 * count,
            device=device,
            model=model.arrays.model,
            state=model.arrays.state,
            step=model.zero_step,
            geometries=one.tables.geometries,
            solids=one.tables.solids,
            pairs=one.pairs,
            coefficients=one.coefficients,
            history_in=one.memory,
            history_out=one.history_out,
            body_contacts=one.body_contacts,
            map_pairs=pairs,
            owner=wp.array(owner, dtype=wp.vec2i, device=device),
            vertices=vertices,
            origin=origin,
            pressure=pressure,
            weight=fraction,
        )
    edges = triangles.edges(triangles.positions)
    vectors = 0.5 * np.cross(edges[:, 0], edges[:, 1])
    axes = triangles.normals.sum(axis=1)
    axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1.0e-300)
    signed = (vectors * axes).sum(axis=1)
    # Counter-clockwise around the normal.
    corners = np.where((signed < 0.0)[:, None], [0, 2, 1], [0, 1, 2])
    rows = np.arange(count)[:, None]
    share = pairs.share.numpy()[triangles.env, triangles.pair]
    found = PressureMap(
        env=triangles.env,
        pair=triangles.pair,
        positions=(triangles.positions + origin.numpy().reshape(count, 3, 3))[rows, corners],
        normals=axes,
        pressures=pressure.numpy().reshape(count, 3)[rows, corners],
        areas=np.abs(signed),
        fractions=fraction.numpy().reshape(count, 3).mean(axis=1),
        weights=triangles.weight,
        is_main=(triangles.side == 0) == (share >= 0.5),
    )
    return _scaled(found, one, model)


def _scaled(found: PressureMap, body_contacts: "BodyContactSet", model: "DeviceModel") -> PressureMap:
    """Returns the map with forces per area also for a law per contact, and with the scale of forces."""
    scales = body_contacts.settings.numpy()["force_scale"]
    scale = np.broadcast_to(scales, (model.envs, body_contacts.count))[found.env, found.pair]
    if not next(iter(body_contacts.items)).per_area:
        # The force is the mean of the law over the area.
        area = found.area((model.envs, body_contacts.count))[found.env, found.pair]
        scale = np.where(area > 0.0, scale / np.where(area > 0.0, area, 1.0), 0.0)
    return replace(found, pressures=scale[:, None] * found.pressures)


def _triangles(body_contacts: "BodyContactSet", model: "DeviceModel", envs: int) -> tuple[Any, MapTriangles]:
    """Returns the overlaps of all pairs in some environments, a struct ``MapPairs``, and the triangles of the kernels."""
    one, device = body_contacts, model.device
    shape = (envs, one.count)
    pairs = kernels.MapPairs()
    for name in ("depth", "share"):
        setattr(pairs, name, wp.zeros(shape, dtype=wp.float64, device=device))
    for name in ("vertex_count", "triangle_count", "vertex_start", "triangle_start"):
        setattr(pairs, name, wp.zeros(shape, dtype=wp.int32, device=device))
    vertices, triangles = _storage(0, 0, device)
    curved = sorted({sum(map(is_curved, pair)) for contact in one.items for pair in contact.pairs})

    def launch() -> None:
        for number in curved:
            launch_kernel(
                current_build(_MAPS[number](one.real), device),
                shape,
                device=device,
                state=model.arrays.state,
                geometries=one.tables.geometries,
                solids=one.tables.solids,
                pairs=one.pairs,
                settings=one.settings,
                map_pairs=pairs,
                vertices=vertices,
                triangles=triangles,
            )

    launch()
    totals = []
    for kind in ("vertex", "triangle"):
        counts = getattr(pairs, f"{kind}_count").numpy().astype(np.int64)
        ends = np.cumsum(counts).reshape(shape)
        total = int(ends[-1, -1])
        if total > np.iinfo(np.int32).max:
            raise ValueError(f"the areas of contact have too many triangles to draw: {total}")
        getattr(pairs, f"{kind}_start").assign((ends - counts).astype(np.int32))
        totals.append(total)
    vertices, triangles = _storage(totals[0], totals[1], device)
    launch()
    numbers = triangles.vertices.numpy()
    each = pairs.triangle_count.numpy().reshape(-1)
    owner = np.repeat(np.arange(len(each), dtype=np.int32), each)
    return pairs, MapTriangles(
        env=owner // one.count,
        pair=owner % one.count,
        side=triangles.side.numpy(),
        face=triangles.face.numpy(),
        weight=triangles.weight.numpy(),
        positions=vertices.position.numpy()[numbers],
        normals=vertices.normal.numpy()[numbers],
        depths=vertices.depth.numpy()[numbers],
        entries=vertices.entry.numpy()[numbers],
        factors=vertices.factor.numpy()[numbers],
    )


def _storage(vertex_count: int, triangle_count: int, device: wp.Device) -> tuple[Any, Any]:
    """Returns structs ``MapVertices`` and ``MapTriangles`` with room for some vertices and triangles."""
    made = []
    for kind, count in ((kernels.MapVertices, vertex_count), (kernels.MapTriangles, triangle_count)):
        struct = kind()
        for name, variable in kind.vars.items():
            setattr(struct, name, wp.zeros(count, dtype=variable.type.dtype, device=device))
        made.append(struct)
    return made[0], made[1]


def _sums(env: NDArray[np.int32], pair: NDArray[np.int32], values: Array, shape: tuple[int, int]) -> Array:
    """Returns the sums of values of triangles, ``shape`` (env, pair)."""
    numbers = env.astype(np.int64) * shape[1] + pair
    return np.bincount(numbers, values, minlength=shape[0] * shape[1]).astype(np.float64).reshape(shape)
