"""Recordings as animated USD stages."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import xarray as xr
from numpy.typing import ArrayLike

from warpcontact import checks
from warpcontact._version import __version__
from warpcontact.checks import Array, limits
from warpcontact.scene import Body, Scene
from warpcontact.usd import geometry, physics
from warpcontact.usd.author import identifiers, mark, pose_attributes, series, write_samples
from warpcontact.usd.contacts import WIDTH, ForceLines, Readings, length_scale
from warpcontact.usd.couplings import CouplingCurve
from warpcontact.usd.description import write_description
from warpcontact.usd.forms import FormPlacement, FormSwarm
from warpcontact.usd.replay import Replay
from warpcontact.usd.surfaces import Placement, define_shapes, define_surfaces
from warpcontact.usd.swarms import Swarm, swarms_of

SUFFIXES = (".usd", ".usda", ".usdc")
# Width of what has no size, in sizes of its body.
POINT = 0.03
# Children of an environment that no element may take the name of.
_RESERVED = ("contacts", "couplings", "FixedPoints", "Surfaces")
_PROTOTYPE = "/World/Prototype"
_SHAPES = "/World/Shapes"


def export_usd(
    recording: xr.Dataset,
    path: str | Path,
    *,
    envs: int | Iterable[int] | None = None,
    scene: Scene | None = None,
    spacing: ArrayLike = (0.0, 0.0),
    force_scale: float | None = None,
) -> Path:
    """Writes a recording as an animated USD stage: Z up, metres, kilograms, one time code per record.

    ``/World/Surfaces/<surface>`` are the meshes fixed to the world; ``/World/env_<number>/<body>`` moves and
    carries the spheres, points and meshes of the body; ``/World/env_<number>/contacts/<contact>`` has what
    was recorded of a contact as attributes ``warpcontact:<reading>``, such as ``warpcontact:normalForce``, in
    SI units and world axes, and draws its force if ``normal_force``, ``normal`` and ``point`` were recorded;
    ``/World/env_<number>/couplings/<coupling>`` likewise, with the shape of the coupling as a curve.
    A surface whose pose, scale or mesh differs between environments is in each of them instead, as
    ``/World/env_<number>/Surfaces/<surface>`` or with its body; points move with their surface.
    What environments have in common is written once, in the class ``/World/Prototype`` that they refer to.
    Bodies and surfaces carry the schemas of UsdPhysics. Velocities are those recorded as
    ``<body>.linear_velocity`` and ``<body>.angular_velocity``; radius, mass and inertia of each environment
    are read from ``<contact>.radius``, ``<body>.mass`` (env) and ``<body>.inertia`` (env, 3, 3). Without
    them the radius is that of the scene, while mass and inertia are left out, as they may differ from the
    scene's. A set of bodies is ``/World/env_<number>/<set>``, with the spheres or points of a contact of it as one
    ``UsdGeom.PointInstancer`` or ``UsdGeom.Points`` that moves, or its centres of mass; it has its readings and no
    schema of UsdPhysics. Places and sizes of surfaces and points are those recorded, such as ``<surface>.scale``,
    or else, as gravity always, those of the scene. Points and spheres that several contacts share are drawn once,
    under the name of the first.

    Args:
        recording: What ``Simulation.run`` returned, or the same data set loaded from a file.
        path: File to write, ``.usda`` (text), ``.usdc`` or ``.usd`` (binary); replaced if it exists.
        envs: Numbers of the environments to export, as in the coordinate ``env``; ``None``: the first 16.
        scene: What was simulated; ``None``: what the recording remembers.
        spacing: Distance along x and y between neighbouring environments on a grid [m], each with surfaces
            of its own; 0 along both: all in place, with common surfaces.
        force_scale: Length of force lines [m/N]; ``None``: the largest is 1.5 times the largest body.

    Returns:
        The path.

    Raises:
        ValueError: If the suffix, an environment, the spacing or the scale is not allowed, the recording lacks
            its scene or the pose of a body, or a pose is not finite; the message names it.
        TypeError: If an argument is of another type.
        OSError: If the file cannot be written.
    """
    from pxr import Usd

    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise ValueError(f"path must end in {', '.join(SUFFIXES)}, got {str(path)!r}")
    distance = checks.numbers("spacing", spacing, (2,), limits("m", at_least=0.0))
    if force_scale is not None:
        force_scale = float(checks.numbers("force_scale", force_scale, (), limits("m/N", above=0.0)))
    replay = Replay.of(recording, scene, envs)
    stage = Usd.Stage.CreateInMemory()
    _Export(stage, replay, distance, force_scale).write()
    _save(stage, path)
    return path


class _Export:
    """One export: the prototype of an environment, then each environment.

    Args:
        stage: An empty stage.
        replay: What to write.
        spacing: Distances of the grid [m].
        force_scale: Length of force lines [m/N] or ``None``.
    """

    def __init__(self, stage: Any, replay: Replay, spacing: Array, force_scale: float | None) -> None:
        scene = replay.scene
        self.stage = stage
        self.replay = replay
        self.spacing = spacing
        self.names = identifiers(scene.element_names(), _RESERVED)
        self.spheres = geometry.spheres_of(replay)
        self.placements = {surface.name: Placement.of(replay, surface) for surface in scene.surfaces}
        self.size = geometry.scene_size(replay, list(self.placements.values()), self.spheres)
        self.poses = {body.name: replay.pose(body) for body in scene.bodies}
        forms = [FormPlacement.of(replay, shape) for shape in scene.shapes]
        self.forms = [form for form in forms if form.shape.single]
        self.form_swarms = [
            FormSwarm(form, self.poses[form.shape.body.name])
            for form in forms
            if form.shape.body is not None and not form.shape.single
        ]
        self.size = max([self.size, *(2.0 * form.reach for form in forms if form.shape.body is not None)])
        named: list[Any] = [
            *scene.bodies,
            *scene.contacts,
            *scene.contact_couplings,
            *scene.couplings,
            *scene.smooth_contacts,
        ]
        self.swarms = swarms_of(scene, self.spheres, self.poses)
        self.readings = {name: Readings(replay, name) for name in ("scene", *(element.name for element in named))}
        pushing: list[Any] = [*scene.contacts, *scene.smooth_contacts]
        self.lines = [line for contact in pushing if (line := ForceLines.of(replay, contact))]
        self.curves = [CouplingCurve(replay, coupling) for coupling in scene.couplings]
        self.force_scale = length_scale(self.lines, self.size) if force_scale is None else force_scale

    def write(self) -> None:
        """Writes the stage."""
        from pxr import Kind, Usd, UsdGeom

        self._metadata()
        world = UsdGeom.Xform.Define(self.stage, "/World").GetPrim()
        Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
        self.stage.SetDefaultPrim(world)
        geometry.define_look(self.stage, "/World/Looks", world)
        physics.define_gravity(self.stage, "/World/PhysicsScene", self.replay.scene.gravity)
        apart = bool(self.spacing.any())
        surfaces = f"{_PROTOTYPE if apart else '/World'}/Surfaces"
        prototype = self.stage.CreateClassPrim(_PROTOTYPE)
        prototype.SetTypeName("Xform")
        self.readings["scene"].declare(prototype)
        define_surfaces(self.stage, surfaces, self.placements, self.names)
        for form in self.forms:
            if form.shape.body is None and form.shared:
                form.write(self.stage, f"{surfaces}/{self.names[form.shape.name]}", 0, self.size)
        define_shapes(self.stage, _SHAPES, self.placements, self.names)
        self._prototype()
        paths = [self._environment(row) for row in range(len(self.replay.envs))]
        if len(paths) > 1:
            shared = None if apart else surfaces
            physics.define_collision_groups(self.stage, "/World/CollisionGroups", paths, shared)
        write_description(self.stage, self.replay.scene, self.names)

    def _forces(self) -> list[str]:
        """Returns the names of the contacts and of their couplings."""
        scene = self.replay.scene
        forces: list[Any] = [*scene.contacts, *scene.contact_couplings, *scene.smooth_contacts]
        return [one.name for one in forces]

    def _metadata(self) -> None:
        from pxr import UsdGeom, UsdPhysics, Vt

        stage, replay = self.stage, self.replay
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        stage.SetStartTimeCode(replay.codes[0])
        stage.SetEndTimeCode(replay.codes[-1])
        stage.SetTimeCodesPerSecond(replay.rate)
        stage.SetFramesPerSecond(replay.rate)
        notes: dict[str, Any] = {
            "version": __version__,
            "environments": Vt.IntArray(replay.envs),
            "startTime": float(replay.times[0]),
            "forceScale": self.force_scale,
        }
        for key in ("source", "device", "precision", "integrator"):
            if key in replay.data.attrs:
                notes[key] = str(replay.data.attrs[key])
        if "frozen_environments" in replay.data.attrs:
            frozen = set(replay.data.attrs["frozen_environments"])
            notes["frozenEnvironments"] = Vt.IntArray([env for env in replay.envs if env in frozen])
        if "dt" in replay.data.attrs:
            notes["dt"] = float(replay.data.attrs["dt"])
        stage.GetRootLayer().customLayerData = {"warpcontact": notes}

    def _prototype(self) -> None:
        """Writes what all environments have in common."""
        from pxr import Kind, Usd, UsdGeom

        scene = self.replay.scene
        for body in scene.bodies:
            prim = UsdGeom.Xform.Define(self.stage, self._path(_PROTOTYPE, body)).GetPrim()
            Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
            mark(prim, body.name)
            if body.single:
                physics.apply_rigid_body(prim, body)
            self.readings[body.name].declare(prim)
        for name, placement in self.placements.items():
            if placement.surface.body is not None and placement.shared:
                placement.write(self.stage, self._surface_path(_PROTOTYPE, name), 0)
        for group in self.spheres:
            own = 0.0
            if group.body is not None:
                own = geometry.body_size(group.body, self.placements.values(), self.spheres)
            path = self._path(_PROTOTYPE, group.body)
            if group.body is None:
                UsdGeom.Xform.Define(self.stage, path)
            width = POINT * (own or self.size)
            if group.contacts[0].points.spread:
                continue
            geometry.define_spheres(self.stage, f"{path}/{self.names[group.name]}", group, width)
        for swarm in self.swarms:
            swarm.declare(self.stage, self._swarm_path(_PROTOTYPE, swarm), POINT * self.size)
        for form in self.forms:
            if form.shape.body is not None and form.shared:
                form.write(self.stage, self._form_path(_PROTOTYPE, form), 0, self.size)
        for moving in self.form_swarms:
            moving.declare(self.stage, self._form_path(_PROTOTYPE, moving.placement), self.size)
        if scene.contacts or scene.smooth_contacts:
            UsdGeom.Scope.Define(self.stage, f"{_PROTOTYPE}/contacts")
        touching: list[Any] = [*scene.contacts, *scene.smooth_contacts]
        for contact in touching:
            prim = UsdGeom.Scope.Define(self.stage, self._contact_path(_PROTOTYPE, contact.name)).GetPrim()
            mark(prim, contact.name)
            self.readings[contact.name].declare(prim)
            if not contact.visible:
                UsdGeom.Imageable(prim).MakeInvisible()
        for coupling in scene.contact_couplings:
            path = self._contact_path(_PROTOTYPE, coupling.name)
            prim = UsdGeom.Scope.Define(self.stage, path).GetPrim()
            mark(prim, coupling.name)
            self.readings[coupling.name].declare(prim)
        for lines in self.lines:
            path = self._contact_path(_PROTOTYPE, lines.contact.name)
            lines.declare(self.stage, f"{path}/force", WIDTH * self.size)
        if scene.couplings:
            UsdGeom.Scope.Define(self.stage, f"{_PROTOTYPE}/couplings")
        for curve in self.curves:
            path = self._coupling_path(_PROTOTYPE, curve.coupling.name)
            prim = UsdGeom.Scope.Define(self.stage, path).GetPrim()
            mark(prim, curve.coupling.name)
            self.readings[curve.coupling.name].declare(prim)
            if not curve.coupling.visible:
                UsdGeom.Imageable(prim).MakeInvisible()
            curve.declare(self.stage, f"{path}/shape", WIDTH * self.size)

    def _environment(self, row: int) -> str:
        """Writes environment number ``row`` of the export and returns its path."""
        from pxr import Gf, Kind, Usd, UsdGeom

        stage, replay = self.stage, self.replay
        path = f"/World/env_{replay.envs[row]}"
        env = UsdGeom.Xform.Define(stage, path)
        env.GetPrim().GetReferences().AddInternalReference(_PROTOTYPE)
        Usd.ModelAPI(env).SetKind(Kind.Tokens.group)
        self.readings["scene"].write(env.GetPrim(), row)
        if self.spacing.any():
            env.AddTranslateOp().Set(Gf.Vec3d(*self._place(row)))
        for body in replay.scene.bodies:
            prim = stage.GetPrimAtPath(self._path(path, body))
            if body.single:
                self._move(UsdGeom.Xformable(prim), body, row)
                physics.write_mass(prim, replay, body, row)
                physics.write_velocity(prim, replay, body, row)
            self.readings[body.name].write(prim, row)
        for name, placement in self.placements.items():
            if not placement.shared:
                if placement.surface.body is None:
                    UsdGeom.Scope.Define(stage, f"{path}/Surfaces")
                shape = f"{_SHAPES}/{self.names[name]}_{int(placement.mesh[row])}"
                placement.write(stage, self._surface_path(path, name), row, shape)
        for form in self.forms:
            if not form.shared:
                if form.shape.body is None:
                    UsdGeom.Scope.Define(stage, f"{path}/Surfaces")
                form.write(stage, self._form_path(path, form), row, self.size)
        for moving in self.form_swarms:
            moving.write(stage.GetPrimAtPath(self._form_path(path, moving.placement)), replay.codes, row)
        for swarm in self.swarms:
            swarm.write(stage.GetPrimAtPath(self._swarm_path(path, swarm)), replay.codes, row)
        for group in self.spheres:
            if not group.contacts[0].points.spread and group.differs(row):
                geometry.set_spheres(stage, f"{self._path(path, group.body)}/{self.names[group.name]}", group, row)
        for name in self._forces():
            self.readings[name].write(stage.GetPrimAtPath(self._contact_path(path, name)), row)
        for lines in self.lines:
            prim = stage.GetPrimAtPath(f"{self._contact_path(path, lines.contact.name)}/force")
            lines.write(prim, replay, row, self.force_scale, WIDTH * self.size)
        for curve in self.curves:
            own = self._coupling_path(path, curve.coupling.name)
            self.readings[curve.coupling.name].write(stage.GetPrimAtPath(own), row)
            curve.write(stage.GetPrimAtPath(f"{own}/shape"), replay, row, WIDTH * self.size)
        return path

    def _move(self, xformable: Any, body: Body, row: int) -> None:
        positions, orientations = self.poses[body.name]
        codes = self.replay.codes
        turn, move = pose_attributes(xformable)
        write_samples(move, codes, series(positions[:, row], "vector", False))
        write_samples(turn, codes, series(orientations[:, row], "quaternion", False))

    def _place(self, row: int) -> tuple[float, float, float]:
        """Returns where on the grid an environment is; the first is at the origin."""
        x, y = self.spacing.tolist()
        count = len(self.replay.envs)
        columns = count if y == 0.0 else 1 if x == 0.0 else math.ceil(math.sqrt(count))
        return row % columns * x, row // columns * y, 0.0

    def _path(self, env: str, body: Body | None) -> str:
        return f"{env}/{'FixedPoints' if body is None else self.names[body.name]}"

    def _swarm_path(self, env: str, swarm: Swarm) -> str:
        return f"{self._path(env, swarm.body)}/{self.names.get(swarm.name, swarm.name)}"

    def _surface_path(self, env: str, name: str) -> str:
        body = self.placements[name].surface.body
        return f"{f'{env}/Surfaces' if body is None else self._path(env, body)}/{self.names[name]}"

    def _form_path(self, env: str, form: FormPlacement) -> str:
        body, name = form.shape.body, self.names[form.shape.name]
        return f"{f'{env}/Surfaces' if body is None else self._path(env, body)}/{name}"

    def _contact_path(self, env: str, contact: str) -> str:
        return f"{env}/contacts/{self.names[contact]}"

    def _coupling_path(self, env: str, coupling: str) -> str:
        return f"{env}/couplings/{self.names[coupling]}"


def _save(stage: Any, path: Path) -> None:
    from pxr import Sdf, Tf

    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        stage.GetRootLayer().Export(str(path))
    except Tf.ErrorException as error:
        raise OSError(f"cannot write {path}: {str(error).strip()}") from error
    # Who has an earlier version of the file open sees the new one: USD keeps open files by name.
    opened = Sdf.Layer.Find(str(path.resolve()))
    if opened:
        opened.Reload(force=True)
