"""Environments of a stage with full physics: a prototype with their common parts, and the animation of each."""

from collections.abc import Callable
from typing import Any

import numpy as np

from warpcontact.drawing.content import POINT, Content, SceneRanges, body_reach
from warpcontact.drawing.geometry import body_size
from warpcontact.drawing.replay import Replay
from warpcontact.scene.elements import Body
from warpcontact.usd import geometry, physics
from warpcontact.usd.animation import (
    WIDTH,
    Sensors,
    define_arrows,
    define_body_set,
    define_curves,
    write_arrows,
    write_body_set,
    write_curves,
)
from warpcontact.usd.author import (
    PROTOTYPE,
    RESERVED,
    SHAPES,
    WORLD,
    Layout,
    Samples,
    add_pose_operations,
    identifiers,
    series,
    store_element_name,
    write_box,
)
from warpcontact.usd.geometry import (
    define_shape_set,
    define_shapes,
    define_surfaces,
    write_shape,
    write_shape_set,
    write_surface,
)
from warpcontact.usd.materials import (
    UsdMaterial,
    UsdMaterials,
    bind_material,
    define_material,
    material_path,
    set_material,
)
from warpcontact.usd.physics import define_joint, is_joint, write_joint
from warpcontact.usd.pressure import NAME as PRESSURE
from warpcontact.usd.pressure import define_patches, write_patches
from warpcontact.validation.checks import Array


class Prototype:
    """Writes the prototype.

    Args:
        stage: Stage to write to.
        content: Content of the export.
        layout: Layout of the stage.
        materials: Physics materials of the colliders.
        sensors: Recorded sensors by element name.
        physics_scene: Path of the physics scene of an environment; ``None``: all environments share one.
    """

    def __init__(
        self,
        stage: Any,
        content: Content,
        layout: Layout,
        materials: UsdMaterials,
        sensors: dict[str, Sensors],
        physics_scene: str | None,
    ) -> None:
        self.stage = stage
        self.content = content
        self.layout = layout
        self.materials = materials
        self.sensors = sensors
        self.physics_scene = physics_scene

    def write(self) -> None:
        """Writes the complete prototype."""
        prim = self.stage.CreateClassPrim(PROTOTYPE)
        prim.SetTypeName("Xform")
        self.sensors["scene"].declare(prim)
        for material in self.materials.all:
            define_material(self.stage, material_path(material, self.layout.names, PROTOTYPE), material, 0)
        self._surfaces()
        for body in self.content.replay.scene.bodies:
            self._body(body)
        self._points()
        self._shapes()
        self._contacts()
        self._couplings()

    def bind(self, path: str, kind: str, name: str, env: str) -> None:
        """Binds the material of a collider, if it has one, to its prim at ``path``."""
        material = self.materials.of(kind, name)
        if material is not None:
            where = material_path(material, self.layout.names, env)
            bind_material(self.stage.GetPrimAtPath(path), where)

    def _surfaces(self) -> None:
        """Writes surfaces and shapes on the world that are the same in all environments, and shared meshes."""
        from pxr import Kind, Usd, UsdGeom

        layout, placements = self.layout, self.content.placements
        names = layout.names
        env = PROTOTYPE if layout.apart else WORLD
        scope = UsdGeom.Scope.Define(self.stage, layout.surfaces)
        Usd.ModelAPI(scope).SetKind(Kind.Tokens.group)
        common = {name: one for name, one in placements.items() if name not in layout.own_surfaces}
        fixed = {name: one for name, one in common.items() if one.surface.body is None}
        define_surfaces(self.stage, layout.surfaces, fixed, names)
        for name in fixed:
            self.bind(f"{layout.surfaces}/{names[name]}", "surface", name, env)
        for form in self.content.forms:
            name = form.shape.name
            if form.shape.body is None and name not in layout.own_surfaces:
                write_shape(self.stage, f"{layout.surfaces}/{names[name]}", form, 0, layout.size)
                self.bind(f"{layout.surfaces}/{names[name]}", "shape", name, env)
        define_shapes(self.stage, SHAPES, placements, names, layout.own_surfaces & placements.keys())

    def _body(self, body: Body) -> None:
        from pxr import Kind, Usd, UsdGeom

        layout, content = self.layout, self.content
        path = layout.body(PROTOTYPE, body)
        xform = UsdGeom.Xform.Define(self.stage, path)
        prim = xform.GetPrim()
        Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
        store_element_name(prim, body.name)
        if body.single:
            physics.apply_rigid_body(prim, body, self.physics_scene)
            add_pose_operations(xform)
            reach = np.full(3, max(body_reach(content, body), 0.5 * POINT * layout.size))
            write_box(prim, -reach, reach)
        self.sensors[body.name].declare(prim)
        for name, placement in content.placements.items():
            if placement.surface.body is body and name not in layout.own_surfaces:
                own = layout.surface(PROTOTYPE, placement)
                write_surface(self.stage, own, placement, 0)
                self.bind(own, "surface", name, PROTOTYPE)
        if is_joint(body):
            UsdGeom.Scope.Define(self.stage, f"{PROTOTYPE}/joints")
            define_joint(self.stage, layout.joint(PROTOTYPE, body), body, path)

    def _points(self) -> None:
        from pxr import UsdGeom

        layout, content = self.layout, self.content
        for group in content.spheres:
            own = 0.0
            if group.body is not None:
                own = body_size(group.body, content.placements.values(), content.spheres)
            path = layout.body(PROTOTYPE, group.body)
            if group.body is None:
                UsdGeom.Xform.Define(self.stage, path)
            if group.contacts[0].points.spread:
                continue
            path = f"{path}/{layout.names[group.name]}"
            geometry.define_spheres(self.stage, path, group, POINT * (own or layout.size))
            if not group.are_points:
                self.bind(path, "points", group.contacts[0].points.name, PROTOTYPE)
        for body_set in content.body_sets:
            define_body_set(self.stage, layout.body_set(PROTOTYPE, body_set), body_set, POINT * layout.size)

    def _shapes(self) -> None:
        layout = self.layout
        for form in self.content.forms:
            name = form.shape.name
            if form.shape.body is not None and name not in layout.own_surfaces:
                path = layout.form(PROTOTYPE, form)
                write_shape(self.stage, path, form, 0, layout.size)
                self.bind(path, "shape", name, PROTOTYPE)
        for moving in self.content.shape_sets:
            path = layout.form(PROTOTYPE, moving.placement)
            define_shape_set(self.stage, path, moving, layout.size)

    def _contacts(self) -> None:
        from pxr import UsdGeom

        scene, layout = self.content.replay.scene, self.layout
        elements: list[Any] = [
            *scene.contacts,
            *scene.shape_contacts,
            *scene.particle_contacts,
            *scene.body_contacts,
        ]
        shown = {one.name: one.visible for one in elements}
        shown |= {one.name: any(part.visible for part in one.contacts) for one in scene.contact_couplings}
        if shown:
            UsdGeom.Scope.Define(self.stage, f"{PROTOTYPE}/contacts")
        for name, visible in shown.items():
            prim = UsdGeom.Scope.Define(self.stage, layout.contact(PROTOTYPE, name)).GetPrim()
            store_element_name(prim, name)
            self.sensors[name].declare(prim)
            if not visible:
                UsdGeom.Imageable(prim).MakeInvisible()
        for lines in (*self.content.lines, *self.content.resultants):
            path = f"{layout.contact(PROTOTYPE, lines.name)}/force"
            count = lines.force.shape[2]
            define_arrows(self.stage, path, count, lines.color, lines.meaning, layout.force_scale)
        for contact in self.content.pressure.contacts:
            path = f"{layout.contact(PROTOTYPE, contact.name)}/{PRESSURE}"
            define_patches(self.stage, path, layout.peak_pressure)

    def _couplings(self) -> None:
        from pxr import UsdGeom

        layout = self.layout
        if self.content.curves:
            UsdGeom.Scope.Define(self.stage, f"{PROTOTYPE}/couplings")
        for curve in self.content.curves:
            path = layout.coupling(PROTOTYPE, curve.coupling.name)
            prim = UsdGeom.Scope.Define(self.stage, path).GetPrim()
            store_element_name(prim, curve.coupling.name)
            self.sensors[curve.coupling.name].declare(prim)
            if not curve.coupling.visible:
                UsdGeom.Imageable(prim).MakeInvisible()
            count, width = curve.points.shape[2], WIDTH * layout.size
            meaning = "From one end of the coupling to the other."
            define_curves(self.stage, f"{path}/shape", [count], width, curve.color, meaning)


def layout_of(
    content: Content, ranges: SceneRanges, spacing: Array, force_scale: float, materials: UsdMaterials
) -> Layout:
    """Returns the layout of the stage; elements that differ between environments get one prim in each."""
    spaced = bool(spacing.any())

    def differs(kind: str, element: Any, shared: bool) -> bool:
        # An element on the world with a different material per environment cannot be one shared prim.
        return not shared or (element.body is None and not spaced and materials.differ(kind, element.name))

    surfaces = content.placements.values()
    found = [one.surface.name for one in surfaces if differs("surface", one.surface, one.shared)]
    found += [form.shape.name for form in content.forms if differs("shape", form.shape, form.shared)]
    return Layout(
        names=identifiers(content.replay.scene.element_names(), RESERVED),
        envs=content.replay.envs,
        spacing=spacing,
        size=ranges.size,
        force_scale=force_scale,
        peak_pressure=ranges.peak_pressure,
        own_surfaces=frozenset(found),
    )


class Environments:
    """Writes the environments that have full physics.

    Args:
        stage: Stage with its root prim.
        content: Some records, including the first.
        layout: Layout of the stage.
        materials: Physics materials of the colliders.
    """

    def __init__(self, stage: Any, content: Content, layout: Layout, materials: UsdMaterials) -> None:
        self.stage = stage
        self.layout = layout
        self.materials = materials
        replay = content.replay
        self.gravity = replay.setting("scene.gravity", replay.scene.gravity)
        self.one_gravity = bool((self.gravity == self.gravity[0]).all())

    def define(self, content: Content, ranges: SceneRanges) -> None:
        """Writes what is constant over time; ``content`` begins with the first record."""
        layout = self.layout
        scene_path = f"{WORLD if self.one_gravity else PROTOTYPE}/PhysicsScene"
        sensors = sensors_of(content.replay)
        prototype = Prototype(
            self.stage, content, layout, self.materials, sensors, None if self.one_gravity else scene_path
        )
        prototype.write()
        physics.define_gravity(self.stage, scene_path, self.gravity[0])
        self._write_stepping(content.replay, scene_path)
        space, masses = self._space(content, ranges), physics.Masses(content.replay)
        for row in range(len(layout.envs)):
            self._define_environment(prototype, content, masses, row)
            write_box(self.stage.GetPrimAtPath(layout.env(row)), *space[row])
        paths = [layout.env(row) for row in range(len(layout.envs))]
        if len(paths) > 1:
            shared = None if layout.apart else layout.surfaces
            physics.define_collision_groups(self.stage, f"{WORLD}/CollisionGroups", paths, shared)

    def _write_stepping(self, replay: Replay, scene_path: str) -> None:
        attrs = replay.data.attrs
        if "dt" in attrs:
            iterations = int(attrs["iterations"]) if "iterations" in attrs else None
            physics.write_stepping(self.stage.GetPrimAtPath(scene_path), float(attrs["dt"]), iterations)

    def _define_environment(
        self, prototype: Prototype, content: Content, masses: physics.Masses, row: int
    ) -> None:
        from pxr import Gf, Kind, Usd, UsdGeom

        stage, layout, replay = self.stage, self.layout, content.replay
        path = layout.env(row)
        env = UsdGeom.Xform.Define(stage, path)
        env.GetPrim().GetReferences().AddInternalReference(PROTOTYPE)
        Usd.ModelAPI(env).SetKind(Kind.Tokens.group)
        if layout.apart:
            env.AddTranslateOp().Set(Gf.Vec3d(*layout.place(row)))
        for material in self.materials.all:
            self._set_material(material, path, row)
        if not self.one_gravity:
            physics.define_gravity(stage, f"{path}/PhysicsScene", self.gravity[row])
        for body in replay.scene.bodies:
            if body.single:
                masses.write(stage.GetPrimAtPath(layout.body(path, body)), body, row)
            if is_joint(body):
                pose = tuple(values[0, row] for values in content.poses[body.name])
                joint = stage.GetPrimAtPath(layout.joint(path, body))
                write_joint(joint, replay, body, pose, row, layout.place(row))
        for name, placement in content.placements.items():
            if name in layout.own_surfaces:
                if placement.surface.body is None:
                    UsdGeom.Scope.Define(stage, f"{path}/Surfaces")
                shape = f"{SHAPES}/{layout.names[name]}_{int(placement.mesh[row])}"
                own = layout.surface(path, placement)
                write_surface(stage, own, placement, row, shape)
                prototype.bind(own, "surface", name, path)
        for form in content.forms:
            if form.shape.name in layout.own_surfaces:
                if form.shape.body is None:
                    UsdGeom.Scope.Define(stage, f"{path}/Surfaces")
                own = layout.form(path, form)
                write_shape(stage, own, form, row, layout.size)
                prototype.bind(own, "shape", form.shape.name, path)
        for group in content.spheres:
            if not group.contacts[0].points.spread and group.differs(row):
                own = f"{layout.body(path, group.body)}/{layout.names[group.name]}"
                geometry.set_spheres(stage, own, group, row)

    def _set_material(self, material: UsdMaterial, env: str, row: int) -> None:
        if not material.shared:
            path = material_path(material, self.layout.names, env)
            set_material(self.stage.GetPrimAtPath(path), material, row)

    def _space(self, content: Content, ranges: SceneRanges) -> Array:
        """Returns bounding boxes of the environments in their frames, with arrows, (env, 2, 3) [m]."""
        longest = ranges.peak * self.layout.force_scale + self.layout.size
        low, high = ranges.low - longest, ranges.high + longest
        fixed = [one.corners for one in content.placements.values() if one.surface.body is None]
        if fixed and (self.layout.apart or self.layout.own_surfaces):
            corners = np.concatenate(fixed)
            low, high = np.minimum(low, corners.min(axis=0)), np.maximum(high, corners.max(axis=0))
        return np.stack([low, high], axis=1)

    def animate(self, content: Content, samples: Samples, report_progress: Callable[[int], None]) -> None:
        """Writes what changes over the records in ``content``; calls ``report_progress(1)`` per environment."""
        sensors = sensors_of(content.replay)
        for row in range(len(self.layout.envs)):
            self._animate_environment(content, sensors, samples, row)
            report_progress(1)

    def _animate_environment(
        self, content: Content, sensors: dict[str, Sensors], samples: Samples, row: int
    ) -> None:
        stage, layout, replay = self.stage, self.layout, content.replay
        path = layout.env(row)
        scene = replay.scene
        sensors["scene"].write(stage.GetPrimAtPath(path), samples, row)
        for body in scene.bodies:
            prim = stage.GetPrimAtPath(layout.body(path, body))
            if body.single:
                self._move(prim, content, body, samples, row)
                physics.write_velocity(prim, samples, replay, body, row)
            sensors[body.name].write(prim, samples, row)
        for moving in content.shape_sets:
            own = stage.GetPrimAtPath(layout.form(path, moving.placement))
            write_shape_set(own, samples, moving, row)
        for body_set in content.body_sets:
            write_body_set(stage.GetPrimAtPath(layout.body_set(path, body_set)), samples, body_set, row)
        for name in (one.name for one in _contact_elements(replay)):
            sensors[name].write(stage.GetPrimAtPath(layout.contact(path, name)), samples, row)
        for lines in (*content.lines, *content.resultants):
            prim = stage.GetPrimAtPath(f"{layout.contact(path, lines.name)}/force")
            write_arrows(prim, samples, lines, row, layout.force_scale, layout.size)
        patches = {
            one.name: stage.GetPrimAtPath(f"{layout.contact(path, one.name)}/{PRESSURE}")
            for one in content.pressure.contacts
        }
        if patches:
            write_patches(patches, samples, content, row, layout.peak_pressure, layout.size)
        for curve in content.curves:
            name = curve.coupling.name
            own = layout.coupling(path, name)
            sensors[name].write(stage.GetPrimAtPath(own), samples, row)
            shape, shown = stage.GetPrimAtPath(f"{own}/shape"), curve.shown[:, row].tolist()
            write_curves(shape, samples, curve.points[:, row], shown, WIDTH * layout.size)

    def _move(self, prim: Any, content: Content, body: Body, samples: Samples, row: int) -> None:
        positions, orientations = content.poses[body.name]
        translate, orient = prim.GetAttribute("xformOp:translate"), prim.GetAttribute("xformOp:orient")
        samples.write(translate, series(positions[:, row], "vector", False))
        samples.write(orient, series(orientations[:, row], "quaternion", False))


def _contact_elements(replay: Replay) -> list[Any]:
    scene = replay.scene
    return [
        *scene.contacts,
        *scene.contact_couplings,
        *scene.shape_contacts,
        *scene.particle_contacts,
        *scene.body_contacts,
    ]


def sensors_of(replay: Replay) -> dict[str, Sensors]:
    """Returns the recorded sensors of the scene and its elements, by element name."""
    scene = replay.scene
    named: list[Any] = [*scene.bodies, *scene.couplings, *_contact_elements(replay)]
    return {name: Sensors(replay, name) for name in ("scene", *(element.name for element in named))}
