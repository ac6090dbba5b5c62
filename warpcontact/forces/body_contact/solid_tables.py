"""Device tables of the solids of body contacts: geometries, and their poses in each environment."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.body_contact.curved_shapes import CURVED_KINDS, curved_scale, is_curved, size_names
from warpcontact.forces.body_contact.feature_tables import declare_features
from warpcontact.geometry.polyhedron import Polyhedron
from warpcontact.geometry.polyhedron_features import has_convex_features
from warpcontact.kernels.body_contact.solids import (
    CONVEX,
    FEW_PLANES,
    HALF_SPACE,
    HAS_BOUNDARY,
    MAX_PLANES,
    Geometries,
    SolidPose,
    Solids,
)
from warpcontact.kernels.body_contact.surface_queries import SolidBoxes
from warpcontact.kernels.manifolds.candidates import CURVED_PATCHES, MAX_PATCHES
from warpcontact.kernels.manifolds.features import Features
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.rounded_box import RoundedBox
from warpcontact.kernels.types import WORLD
from warpcontact.scene.body_contact import Solid
from warpcontact.scene.elements import Surface
from warpcontact.scene.shapes import Shape
from warpcontact.storage.allocation_plan import per_env
from warpcontact.storage.parameters import Parameter, Parameters, pack
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.storage.allocation_plan import AllocationPlan

_PURPOSE = "body contacts"


class SolidTables:
    """Geometries and poses of solids.

    Args:
        solids: The solids.
        layout: Allocation plan to which the tables are added.
        parameters: Parameters of the model, from which poses follow.

    Attributes:
        geometries: Struct ``Geometries``.
        solids: Struct ``Solids``.
        boxes: Struct ``SolidBoxes``.
    """

    def __init__(self, solids: Sequence[Solid], layout: "AllocationPlan", parameters: Parameters) -> None:
        self._numbers = {solid: number for number, solid in enumerate(solids)}
        self._geometries: list[Polyhedron | type[Form]] = []  # shapes: half-space, or curved
        self._known: dict[Any, int] = {}
        # First geometry of each solid; those of the meshes of a surface are consecutive.
        self._first = [self._add_geometries(solid) for solid in solids]
        self.geometries, self.solids = Geometries(), Solids()
        self._declare_geometries(layout)
        bodies = [WORLD if solid.body is None else solid.body.index for solid in solids]
        layout.constant(_PURPOSE, self.solids, "body", bodies, wp.int32)
        self.boxes = layout.struct(_PURPOSE, SolidBoxes, per_env(len(bodies)), transient=True)
        self.bodies = np.array(bodies, dtype=np.int32)
        columns = [self._pose_parameters(solid, parameters) for solid in solids]
        indices = [parameters.by_name.get(f"{solid.name}.mesh") for solid in solids]

        # Boxes have sharp edges, also after a change of parameters.
        boxes = [solid for solid in solids if isinstance(solid, Shape) and solid.kind is RoundedBox]
        radii = [parameters.by_name[f"{box.name}.radius"] for box in boxes]

        def content() -> NDArray[Any]:
            for radius in radii:
                if radius.values.any():
                    raise ValueError(
                        f"{radius.name} must be 0 m, because the box is in body contact, got {radius.values.max():g} m"
                    )
            used = [one for position, orientation, sizes in columns for one in (position, orientation, *sizes)]
            used += [one for one in indices if one is not None]
            envs = max(len(one.values) for one in used)
            packed: dict[str, list[NDArray[Any]]] = {
                "position": [],
                "orientation": [],
                "scale": [],
                "geometry": [],
            }
            for solid, (position, orientation, sizes), start, index in zip(
                solids, columns, self._first, indices, strict=True
            ):
                scale = _scale_of(solid, sizes)
                numbers = np.full(1, start) if index is None else start + index.values[:, 0]
                values: dict[str, NDArray[Any]] = {
                    "position": position.values[:, 0],
                    "orientation": orientation.values[:, 0],
                    "scale": np.broadcast_to(scale, (len(scale), 3)),
                    "geometry": numbers.astype(np.int32),
                }
                for key, column in packed.items():
                    column.append(np.broadcast_to(values[key], (envs, *values[key].shape[1:])))
            return pack(SolidPose, {key: np.stack(values, axis=1) for key, values in packed.items()})

        device_field = parameters.device_field(self.solids, "pose", SolidPose, content)
        used = [one for position, orientation, sizes in columns for one in (position, orientation, *sizes)]
        for parameter in {id(one): one for one in (*used, *indices, *radii) if one is not None}.values():
            parameter.device_fields.append(device_field)

    @property
    def count(self) -> int:
        """Number of solids."""
        return len(self.bodies)

    def number(self, solid: Solid) -> int:
        """Returns the index of a solid."""
        return self._numbers[solid]

    def bounding_box(self, model: "Environments", solid: Solid) -> tuple[Array, Array]:
        """Returns center and half of the size of the bounding box of a solid in its own frame, (envs, 3) each [m].

        The size of a half-space is infinite.
        """
        if isinstance(solid, Surface):
            first = self._first[self._numbers[solid]]
            bounds = np.array([one.bounds for one in self._geometries[first : first + len(solid.meshes)]])
            number = np.zeros(model.envs, dtype=int)
            if len(solid.meshes) > 1:
                number = np.asarray(model[f"{solid.name}.mesh"], dtype=int)
            scale = np.asarray(model[f"{solid.name}.scale"]).reshape(model.envs, 1)
            center, half = 0.5 * (bounds[:, 1] + bounds[:, 0]), 0.5 * (bounds[:, 1] - bounds[:, 0])
            return np.asarray(center[number] * scale), np.asarray(half[number] * scale)
        if solid.kind is Plane:
            return np.zeros((model.envs, 3)), np.full((model.envs, 3), np.inf)
        sizes = [
            np.asarray(model[f"{solid.name}.{key}"]).reshape(model.envs, -1) for key in size_names(solid.kind)
        ]
        if not is_curved(solid):
            return np.zeros((model.envs, 3)), sizes[0]
        kind, scale = CURVED_KINDS[solid.kind], curved_scale(solid.kind, sizes)
        return 0.5 * (kind.upper + kind.lower) * scale, 0.5 * (kind.upper - kind.lower) * scale

    def patch_count(self, first: Solid, second: Solid) -> int:
        """Returns the largest number of patches of a pair: one on half-spaces, of convex polyhedra, and of two curved solids."""
        geometries = [self._geometries_of(solid) for solid in (first, second)]
        polyhedra = [one for own in geometries for one in own if isinstance(one, Polyhedron)]
        if geometries[1] == [Plane] or not polyhedra:
            return 1
        if not all(has_convex_features(one) for one in polyhedra):
            return MAX_PATCHES
        is_curved_pair = any(one in CURVED_KINDS for own in geometries for one in own)
        return CURVED_PATCHES if is_curved_pair else 1

    def pair_kinds(self, pairs: Sequence[tuple[Solid, Solid]]) -> tuple[bool, bool, bool, bool]:
        """Returns whether there are pairs of convex polyhedra, of other polyhedra, and two kinds of pairs with curved solids.

        The latter are curved solids on half-spaces, and in other pairs. Solids with several meshes may be of both kinds of
        polyhedra; polyhedra on half-spaces do not count.
        """
        convex = meshes = on_half_space = curved = False
        for pair in pairs:
            geometries = [self._geometries_of(solid) for solid in pair]
            if any(one in CURVED_KINDS for own in geometries for one in own):
                on_half_space = on_half_space or geometries[1] == [Plane]
                curved = curved or geometries[1] != [Plane]
            elif geometries[1] != [Plane]:
                every = [
                    isinstance(one, Polyhedron) and has_convex_features(one) for own in geometries for one in own
                ]
                convex = convex or any(every)
                meshes = meshes or not all(every)
        return convex, meshes, on_half_space, curved

    def _geometries_of(self, solid: Solid) -> list[Polyhedron | type[Form]]:
        first = self._first[self._numbers[solid]]
        return self._geometries[first : first + (len(solid.meshes) if isinstance(solid, Surface) else 1)]

    def declare_features(self, layout: "AllocationPlan") -> tuple[Features, int]:
        """Declares the features of the geometries, for manifolds.

        Returns:
            The features, and the largest number of corners of an outline.
        """
        polyhedra = [one if isinstance(one, Polyhedron) else None for one in self._geometries]
        faces = [0 if one in CURVED_KINDS else 1 for one in self._geometries]
        return declare_features(polyhedra, faces, layout, _PURPOSE)

    def _add_geometries(self, solid: Solid) -> int:
        """Adds the geometries of a solid, unless they are there; returns the number of the first."""
        key: Any = tuple(map(id, solid.meshes)) if isinstance(solid, Surface) else solid.kind
        if key not in self._known:
            self._known[key] = len(self._geometries)
            if isinstance(solid, Surface):
                self._geometries += [Polyhedron.from_mesh(mesh) for mesh in solid.meshes]
            else:
                self._geometries.append(Polyhedron.unit_box() if solid.kind is RoundedBox else solid.kind)
        return self._known[key]

    def _declare_geometries(self, layout: "AllocationPlan") -> None:
        tables: dict[str, Any] = {"vertex": [np.zeros((1, 3))], "face_start": [0], "plane_start": [0], "flags": []}
        tables |= {
            name: [] for name in ("face", "normal", "u_axis", "offset", "plane_face", "center", "half_extents")
        }
        tables |= {name: [] for name in ("node", "node_lower", "node_upper", "root")}
        vertex_count, node_count = 1, 0
        for geometry in self._geometries:
            if geometry is Plane:
                tables["face"].append(np.zeros((1, 4), dtype=np.int32))
                for name, row in (("normal", [[0.0, 0.0, 1.0]]), ("u_axis", [[1.0, 0.0, 0.0]]), ("offset", [0.0])):
                    tables[name].append(np.array(row))
                tables["flags"].append(HALF_SPACE)
                planes, lower, upper = np.zeros(1, dtype=np.int32), np.zeros(3), np.zeros(3)
                nodes, boxes = np.array([[-1, 0, 1]]), (np.zeros((1, 3)), np.zeros((1, 3)))
            elif isinstance(geometry, Polyhedron):
                tables["vertex"].append(geometry.vertices)
                own = geometry.faces
                tables["face"].append(np.where(own >= 0, own + vertex_count, -1))
                vertex_count += len(geometry.vertices)
                for name, values in zip(("normal", "u_axis", "offset"), geometry.planes(), strict=True):
                    tables[name].append(values)
                few = len(geometry.plane_faces) <= MAX_PLANES and geometry.is_convex
                flags = HAS_BOUNDARY * (not geometry.is_closed) | FEW_PLANES * few | CONVEX * geometry.is_convex
                tables["flags"].append(flags)
                planes = geometry.plane_faces
                lower, upper = geometry.bounds
                nodes, boxes = geometry.tree.nodes, (geometry.tree.lower, geometry.tree.upper)
            else:
                for name, shape in (("face", (0, 4)), ("normal", (0, 3)), ("u_axis", (0, 3)), ("offset", (0,))):
                    tables[name].append(np.zeros(shape, dtype=np.int32 if name == "face" else np.float64))
                kind = CURVED_KINDS[geometry]
                tables["flags"].append(kind.flag)
                planes, lower, upper = np.zeros(0, dtype=np.int32), kind.lower, kind.upper
                nodes, boxes = np.array([[-1, 0, 0]]), (np.zeros((1, 3)), np.zeros((1, 3)))
            start = tables["face_start"][-1]
            tables["node"].append(nodes + np.where(nodes >= 0, [[node_count, start, start]], 0))
            tables["node_lower"].append(boxes[0])
            tables["node_upper"].append(boxes[1])
            tables["root"].append(node_count)
            node_count += len(nodes)
            tables["center"].append(0.5 * (lower + upper))
            tables["half_extents"].append(0.5 * (upper - lower))
            tables["plane_face"].append(planes + tables["face_start"][-1])
            tables["face_start"].append(tables["face_start"][-1] + len(tables["face"][-1]))
            tables["plane_start"].append(tables["plane_start"][-1] + len(planes))
        for name in (
            "vertex",
            "face",
            "normal",
            "u_axis",
            "offset",
            "plane_face",
            "node",
            "node_lower",
            "node_upper",
        ):
            tables[name] = np.concatenate(tables[name])
        for name, variable in Geometries.vars.items():
            layout.constant(_PURPOSE, self.geometries, name, tables[name], variable.type.dtype)

    def _pose_parameters(
        self, solid: Solid, parameters: Parameters
    ) -> tuple[Parameter, Parameter, list[Parameter]]:
        """Returns the parameters of position, orientation and sizes of a solid."""
        position, orientation = (parameters.by_name[f"{solid.name}.{key}"] for key in ("position", "orientation"))
        names = ["scale"] if isinstance(solid, Surface) else size_names(solid.kind)
        return position, orientation, [parameters.by_name[f"{solid.name}.{name}"] for name in names]


def _scale_of(solid: Solid, sizes: Sequence[Parameter]) -> NDArray[np.float64]:
    """Returns the scale of a solid, (env, 1 or 3), with one row if all environments share its sizes [m per unit]."""
    values = [size.values[:, 0].reshape(len(size.values), -1) for size in sizes]
    if isinstance(solid, Shape) and solid.kind in CURVED_KINDS:
        return curved_scale(solid.kind, values)
    return values[0] if values else np.ones((1, 1))
