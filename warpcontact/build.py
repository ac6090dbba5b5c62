"""Scene × environments → Model: the only place that allocates and uploads."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact import checks
from warpcontact import scene as limits_of
from warpcontact.checks import limits
from warpcontact.kernels import contact_force, types
from warpcontact.kernels.formula import Formula, coefficient_struct
from warpcontact.model import Group, Model
from warpcontact.parameters import Field, Parameter, Upload
from warpcontact.patches import Patch, make_patch
from warpcontact.readings import readings_of
from warpcontact.scene import Contact, Points, Scene

PRECISIONS = {"float32": wp.float32, "float64": wp.float64}


def build(scene: Scene, envs: int = 1, device: str = "auto", precision: str = "float32") -> Model:
    """Builds ``envs`` environments of ``scene``.

    Args:
        scene: What there is; changes to it after this have no effect on the model.
        envs: Number of environments, at least 1.
        device: ``"cpu"``, ``"cuda:0"``, …; ``"auto"``: a GPU if there is one.
        precision: ``"float32"`` or ``"float64"``.

    Raises:
        ValueError: If an argument is out of range or the scene has no body.
    """
    if isinstance(envs, bool) or not isinstance(envs, int | np.integer) or envs < 1:
        raise ValueError(f"envs must be a whole number of at least 1, got {envs!r}")
    checks.choice("precision", precision, tuple(PRECISIONS))
    if not scene.bodies:
        raise ValueError("the scene has no body; add_body adds one")
    return _Builder(scene, int(envs), find_device(device), precision).model()


def find_device(name: str) -> wp.Device:
    """Returns the Warp device called ``name``; ``"auto"``: a GPU if there is one, else the CPU.

    Raises:
        ValueError: If this machine has no such device.
    """
    wp.init()
    if name == "auto":
        return wp.get_device("cuda:0" if wp.is_cuda_available() else "cpu")
    present = [str(device) for device in wp.get_devices()]
    if name not in present and not (name == "cuda" and wp.is_cuda_available()):
        raise ValueError(f"device must be 'auto' or one of {', '.join(present)} on this machine, got {name!r}")
    return wp.get_device(name)


class _Builder:
    def __init__(self, scene: Scene, envs: int, device: wp.Device, precision: str) -> None:
        self.scene = scene
        self.envs = envs
        self.device = device
        self.precision = precision
        self.types = types.structs(PRECISIONS[precision])
        self.real = wp.dtype_to_numpy(self.types.real)
        self.parameters: dict[str, Parameter] = {}
        self.uploads: list[Upload] = []
        self.meshes: list[wp.Mesh] = []
        t = self.types
        self.arrays = SimpleNamespace(
            model=t.Model(),
            initial=t.State(),
            state=self._state(),
            history=t.History(),
            contacts=t.Contacts(),
            wrenches=t.Wrenches(),
            status=wp.zeros(envs, dtype=wp.int32, device=device),
            measures=None,  # allocated by the first reading that needs it
        )
        # Contacts in the order of the device: those that share the code of law and friction side by side.
        order: dict[tuple[type[Formula], type[Formula]], list[Contact]] = {}
        for contact in scene.contacts:
            order.setdefault(_code(contact), []).append(contact)
        self.runs = list(order.values())
        self.contacts = [contact for run in self.runs for contact in run]
        starts = np.cumsum([0] + [contact.count for contact in self.contacts]).tolist()
        self.start_of = dict(zip(self.contacts, starts, strict=False))

    def model(self) -> Model:
        self._world()
        self._bodies()
        self._points()
        self._surfaces()
        groups = self._contacts()
        return Model(
            scene=self.scene,
            envs=self.envs,
            device=self.device,
            precision=self.precision,
            types=self.types,
            arrays=self.arrays,
            parameters=self.parameters,
            uploads=self.uploads,
            groups=groups,
            readings=readings_of(self.scene, self.start_of),
            meshes=self.meshes,
        )

    # What follows goes stage by stage: world, bodies, points, surfaces, contacts.

    def _world(self) -> None:
        gravity = Field(self.scene.gravity[None])
        upload = self._upload(self.arrays.model, "gravity", self.types.vec3, lambda: gravity.values)
        self._parameter("scene.gravity", gravity, slice(0, 1), limits("m/s²"), [upload], tail=(3,))

    def _bodies(self) -> None:
        t, a, bodies = self.types, self.arrays, self.scene.bodies
        shape = (self.envs, len(bodies))
        a.wrenches.force = wp.zeros(shape, dtype=t.vec3, device=self.device)
        a.wrenches.torque = wp.zeros(shape, dtype=t.vec3, device=self.device)

        mass = Field(np.array([body.mass for body in bodies]))
        send_mass = self._upload(a.model, "body_mass", t.real, lambda: mass.values)
        inertia = Field(np.array([body.inertia for body in bodies]))
        send_inertia = [
            self._upload(a.model, "body_inertia", t.mat33, lambda: inertia.values),
            self._upload(a.model, "body_inverse_inertia", t.mat33, lambda: np.linalg.inv(inertia.values)),
        ]
        initial: dict[str, tuple[Field, Upload]] = {}
        for key, dtype in (
            ("position", t.vec3),
            ("orientation", t.quat),
            ("linear_velocity", t.vec3),
            ("angular_velocity", t.vec3),
        ):
            field = Field(np.array([getattr(body, key) for body in bodies]))
            initial[key] = field, self._upload(a.initial, f"body_{key}", dtype, _values_of(field))
        for body in bodies:
            items = slice(body.index, body.index + 1)
            self._parameter(f"{body.name}.mass", mass, items, limits_of.MASS, [send_mass])
            self._parameter(
                f"{body.name}.inertia",
                inertia,
                items,
                limits("kg·m²"),
                send_inertia,
                tail=(3, 3),
                convert=_inertia,
                given=((3, 3), (3,)),
            )
            for key, unit in (("position", "m"), ("linear_velocity", "m/s"), ("angular_velocity", "rad/s")):
                field, upload = initial[key]
                self._parameter(f"{body.name}.{key}", field, items, limits(unit), [upload], tail=(3,))
            field, upload = initial["orientation"]
            self._parameter(
                f"{body.name}.orientation",
                field,
                items,
                checks.FINITE,
                [upload],
                tail=(4,),
                convert=checks.unit_quaternions,
            )

    def _points(self) -> None:
        sets = self.scene.points
        body = [_body_index(points) for points in sets for _ in points.positions]
        self.arrays.model.point_body = self._indices(body)
        position = Field(np.concatenate([points.positions for points in sets] or [np.zeros((0, 3))]))
        upload = self._upload(self.arrays.model, "point_position", self.types.vec3, lambda: position.values)
        for points in sets:
            items = slice(points.start, points.start + len(points.positions))
            self._parameter(
                f"{points.name}.position",
                position,
                items,
                limits("m"),
                [upload],
                tail=(3,),
                single=points.single,
            )

    def _surfaces(self) -> None:
        t, a, surfaces = self.types, self.arrays, self.scene.surfaces
        a.model.surface_body = self._indices([_body_index(surface) for surface in surfaces])
        position = Field(np.array([s.position for s in surfaces]).reshape(-1, 3))
        orientation = Field(np.array([s.orientation for s in surfaces]).reshape(-1, 4))
        send_position = self._upload(a.model, "surface_position", t.vec3, lambda: position.values)
        send_orientation = self._upload(a.model, "surface_orientation", t.quat, lambda: orientation.values)
        for surface in surfaces:
            items = slice(surface.index, surface.index + 1)
            self._parameter(f"{surface.name}.position", position, items, limits("m"), [send_position], tail=(3,))
            self._parameter(
                f"{surface.name}.orientation",
                orientation,
                items,
                checks.FINITE,
                [send_orientation],
                tail=(4,),
                convert=checks.unit_quaternions,
            )

    def _contacts(self) -> list[Group]:
        t, a, contacts = self.types, self.arrays, self.contacts
        count = sum(contact.count for contact in contacts)
        shape = (self.envs, count)
        for struct, attributes in (
            (
                a.contacts,
                {
                    "gap": t.real,
                    "penetration": t.real,
                    "normal": t.vec3,
                    "point": t.vec3,
                    "face": wp.int32,
                    "status": wp.int32,
                    "armed": wp.int32,
                    "approach_speed": t.real,
                    "normal_force": t.real,
                    "friction_force": t.vec3,
                    "slip_speed": t.real,
                },
            ),
            (a.history, {"entry_speed": t.real, "armed": wp.int32}),
        ):
            for attribute, dtype in attributes.items():
                setattr(struct, attribute, wp.zeros(shape, dtype=dtype, device=self.device))

        patch_of = self._patches()
        a.model.contact_point = self._indices(
            [contact.points.start + i for contact in contacts for i in range(contact.count)]
        )
        a.model.contact_patch = self._indices(
            [patch_of[contact] for contact in contacts for _ in range(contact.count)]
        )
        a.model.contact_options = self._indices(
            [
                types.LATCHED * (contact.entry == "latched") + types.RIM_OUTER * (contact.rim == "outer")
                for contact in contacts
                for _ in range(contact.count)
            ]
        )
        self._contact_geometry()
        return self._groups()

    def _contact_geometry(self) -> None:
        ranges = {
            "radius": limits_of.RADIUS,
            "kappa": limits_of.KAPPA,
            "max_depth": limits_of.MAX_DEPTH,
            "search_radius": limits_of.SEARCH_RADIUS,
            "enabled": limits_of.ENABLED,
        }
        fields = {
            key: Field(np.concatenate([np.zeros(0), *(np.full(c.count, getattr(c, key)) for c in self.contacts)]))
            for key in ranges
        }
        struct = self.types.ContactGeometry
        upload = self._upload(
            self.arrays.model,
            "contact_geometry",
            struct,
            lambda: _pack(struct, {key: field.values for key, field in fields.items()}),
        )
        for contact in self.contacts:
            items = slice(self.start_of[contact], self.start_of[contact] + contact.count)
            for key, allowed in ranges.items():
                self._parameter(
                    f"{contact.name}.{key}",
                    fields[key],
                    items,
                    allowed,
                    [upload],
                    single=contact.points.single,
                )

    def _groups(self) -> list[Group]:
        groups = []
        for run in self.runs:
            law, friction = _code(run[0])
            coefficients = SimpleNamespace(law=None, friction=None)
            for part, formula in (("law", law), ("friction", friction)):
                self._formula(run, part, formula, coefficients)
            groups.append(
                Group(
                    kernel=contact_force.kernel(law, friction, self.types.real),
                    first=self.start_of[run[0]],
                    count=sum(contact.count for contact in run),
                    coefficients=coefficients,
                )
            )
        return groups

    def _formula(self, run: list[Contact], part: str, formula: type[Formula], target: SimpleNamespace) -> None:
        """Makes the parameters of a law or friction for a run of contacts, and its coefficient array."""
        fields: list[dict[str, Field]] = []
        struct = coefficient_struct(formula, self.types.real)

        def content() -> NDArray[Any]:
            columns: dict[str, list[NDArray[Any]]] = {name: [] for name in formula.device_names()}
            envs = max((len(f.values) for own in fields for f in own.values()), default=1)
            for contact, own in zip(run, fields, strict=True):
                values = dict(zip(own, np.broadcast_arrays(*(f.values for f in own.values())), strict=True))
                computed = formula.coefficients(values)
                for name, column in columns.items():
                    column.append(np.broadcast_to(computed[name], (envs, contact.count)))
            if not columns:
                columns["unused"] = [np.zeros((1, sum(contact.count for contact in run)))]
            return _pack(struct, {name: np.concatenate(parts, axis=1) for name, parts in columns.items()})

        upload = self._upload(target, part, struct, content)
        for contact in run:
            own = {}
            for name, value in getattr(contact.template, part).parameters().items():
                own[name] = Field(np.full(contact.count, value))
                self._parameter(
                    f"{contact.name}.{part}.{name}",
                    own[name],
                    slice(0, contact.count),
                    formula.limits(name),
                    [upload],
                    single=contact.points.single,
                )
            fields.append(own)

    def _patches(self) -> dict[Contact, int]:
        """Makes the meshes to search; contacts that search the same faces share one."""
        rows: dict[tuple[int, bool], int] = {}
        patches: list[Patch] = []
        surface_of: list[int] = []
        ids: list[int] = []
        patch_of = {}
        for contact in self.contacts:
            surface = contact.surface
            only_active = contact.search == "active" and not surface.active_faces.all()
            key = (surface.index, only_active)
            if key not in rows:
                rows[key] = len(patches)
                patch = make_patch(surface.mesh, surface.active_faces, only_active=only_active)
                mesh = _search_mesh(surface.name, patch, self.device)
                self.meshes.append(mesh)
                patches.append(patch)
                surface_of.append(surface.index)
                ids.append(mesh.id)
            patch_of[contact] = rows[key]
        m, t = self.arrays.model, self.types
        m.patch_mesh = wp.array(np.array(ids, dtype=np.uint64), dtype=wp.uint64, device=self.device)
        m.patch_surface = self._indices(surface_of)
        m.patch_face_start = self._indices(
            np.cumsum([0] + [len(patch.flags) for patch in patches])[: len(patches)].tolist()
        )
        if patches:
            m.face_corner = self._array(np.concatenate([p.corner for p in patches]), t.vec3)
            m.face_normal = self._array(np.concatenate([p.normal for p in patches]), t.vec3)
            m.face_flags = wp.array(np.concatenate([p.flags for p in patches]), dtype=wp.uint8, device=self.device)
        return patch_of

    # Small helpers.

    def _state(self) -> Any:
        return new_state(self.types, (self.envs, len(self.scene.bodies)), self.device)

    def _upload(self, struct: Any, attribute: str, dtype: Any, compute: Callable[[], NDArray[Any]]) -> Upload:
        def content() -> NDArray[Any]:
            values = compute()
            return values if values.dtype.names else values.astype(self.real)

        upload = Upload(struct, attribute, dtype, content, self.envs, self.device)
        self.uploads.append(upload)
        return upload

    def _parameter(
        self, name: str, field: Field, items: slice, allowed: Any, uploads: list[Upload], **options: Any
    ) -> None:
        self.parameters[name] = Parameter(name, field, items, allowed, uploads=uploads, **options)

    def _indices(self, values: list[int]) -> wp.array:
        return wp.array(np.array(values, dtype=np.int32), dtype=wp.int32, device=self.device)

    def _array(self, values: NDArray[Any], dtype: Any) -> wp.array:
        return wp.array(values.astype(self.real), dtype=dtype, device=self.device)


def new_state(t: SimpleNamespace, shape: tuple[int, int], device: wp.Device) -> Any:
    """Returns a state struct with arrays of ``shape`` (envs, bodies)."""
    state = t.State()
    for attribute, dtype in (
        ("body_position", t.vec3),
        ("body_orientation", t.quat),
        ("body_linear_velocity", t.vec3),
        ("body_angular_velocity", t.vec3),
    ):
        setattr(state, attribute, wp.zeros(shape, dtype=dtype, device=device))
    return state


def _search_mesh(name: str, patch: Patch, device: wp.Device) -> wp.Mesh:
    """Returns the mesh that queries search. The mesh is validated; only float32 can still spoil it."""
    corner = patch.corner.astype(np.float32).astype(np.float64)
    edges = np.roll(corner, -1, axis=1) - corner
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    # Warp skips slivers below 1e-6, as the mesh check does before rounding.
    lost = np.flatnonzero(area < 1.0e-6 * (edges**2).sum(axis=(1, 2)))
    if len(lost):
        raise ValueError(
            f"{name}: face {lost[0]} is too small for its distance from the origin of the mesh, "
            f"{np.abs(corner[lost[0]]).max():g} m: its corners {patch.corner[lost[0]].tolist()} coincide in "
            f"float32 ({len(lost)} such faces); move the mesh to its origin and place it with position"
        )
    return wp.Mesh(
        points=wp.array(patch.corner.reshape(-1, 3).astype(np.float32), dtype=wp.vec3f, device=device),
        indices=wp.array(np.arange(3 * len(corner), dtype=np.int32), dtype=wp.int32, device=device),
        bvh_constructor="sah",  # the same tree on every device
    )


def _values_of(field: Field) -> Callable[[], NDArray[Any]]:
    return lambda: field.values


def _pack(struct: Any, columns: dict[str, NDArray[Any]]) -> NDArray[Any]:
    """Returns a structured array from columns (1 or envs, items)."""
    envs = max(len(column) for column in columns.values())
    first = next(iter(columns.values()))
    packed = np.zeros((envs, first.shape[1]), dtype=struct.numpy_dtype())
    for name, column in columns.items():
        packed[name] = column
    return packed


def _inertia(name: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Takes principal moments (…, 3) or tensors (…, 3, 3) to checked tensors (envs, items, 3, 3)."""
    if values.ndim == 3:
        values = values[..., None] * np.eye(3)
    return checks.inertia_tensors(name, values)


def _code(contact: Contact) -> tuple[type[Formula], type[Formula]]:
    return type(contact.template.law), type(contact.template.friction)


def _body_index(element: Points | Any) -> int:
    return types.WORLD if element.body is None else element.body.index
