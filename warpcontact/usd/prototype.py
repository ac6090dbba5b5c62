"""Prototype of the environments: the class prim with everything that they have in common."""

from typing import Any

import numpy as np

from warpcontact.drawing.content import POINT, Content
from warpcontact.drawing.ranges import body_reach
from warpcontact.drawing.spheres import body_size
from warpcontact.scene.elements import Body
from warpcontact.usd import geometry, physics
from warpcontact.usd.arrows import define_arrows
from warpcontact.usd.author import add_pose_operations, store_element_name, write_box
from warpcontact.usd.body_sets import define_body_set
from warpcontact.usd.curves import WIDTH, define_curves
from warpcontact.usd.joints import define_joint, is_joint
from warpcontact.usd.layout import PROTOTYPE, SHAPES, WORLD, Layout
from warpcontact.usd.materials import UsdMaterials, bind_material, define_material, material_path
from warpcontact.usd.sensors import Sensors
from warpcontact.usd.shapes import define_shape_set, write_shape
from warpcontact.usd.surfaces import define_shapes, define_surfaces, write_surface


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
        elements: list[Any] = [*scene.contacts, *scene.shape_contacts, *scene.particle_contacts]
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
