"""Reads UsdPhysics from a stage: gravity, rigid bodies, colliders, materials and solver settings, in SI units, Z up.

Everything that is invalid, unsupported or read with a change is recorded in ``Findings``.
"""

from dataclasses import asdict
from math import inf, isfinite
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.readers.unreadable import Unreadable
from warpcontact.usd.importing.findings import (
    Findings,
    InvalidValue,
    Unsupported,
    is_authored,
    number,
    path_of,
    value_of,
    vector,
)
from warpcontact.usd.importing.prims import excluded_pairs, find_prims
from warpcontact.usd.importing.properties import is_material, read_mass, read_material, shape_of

Array = npt.NDArray[np.float64]

#: Default gravity, used if a stage gives none or a negative magnitude [m/s²].
GRAVITY = 9.81
#: Largest number of rigid bodies, and of colliders, of a stage.
MOST = 50_000
# Rotates Y up to Z up.
_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


class Stepping(TypedDict):
    """Requested solver settings; ``None``: not authored.

    Attributes:
        dt: Time step [s].
        iterations: Maximum number of solver iterations per step.
    """

    dt: float | None
    iterations: int | None


#: Settings of a stage that has none.
NOTHING: Stepping = {"dt": None, "iterations": None}


def read_stepping(scene: Any, time: Any) -> Stepping:
    """Returns the authored settings of the prim of a PhysicsScene.

    Raises:
        InvalidValue: If a value is out of range.
    """
    rate, iterations = (
        scene.GetAttribute(f"newton:{name}") for name in ("timeStepsPerSecond", "maxSolverIterations")
    )
    found = NOTHING.copy()
    if is_authored(rate):
        found["dt"] = 1.0 / number(rate, time, least=1.0)
    if is_authored(iterations):
        count = int(number(iterations, time, least=-1.0))
        # -1 requests the default of the solver.
        found["iterations"] = count if count > 0 else None
    return found


def stepping_of(stage: Any) -> Stepping:
    """Returns the settings of the first PhysicsScene of a stage.

    Raises:
        InvalidValue: If a value is out of range.
    """
    from pxr import Usd, UsdPhysics

    scene = next((prim for prim in stage.Traverse() if prim.IsA(UsdPhysics.Scene)), None)
    return NOTHING if scene is None else read_stepping(scene, Usd.TimeCode.EarliestTime())


def has_gravity(scene: Any, time: Any) -> bool:
    """Returns ``newton:gravityEnabled`` of the prim of a PhysicsScene; true if not authored."""
    return bool(value_of(scene.GetAttribute("newton:gravityEnabled"), time, True))


def read_physics(stage: Any, most_faces: int) -> dict[str, Any]:
    """Returns the physics of a stage.

    Args:
        stage: Stage to read.
        most_faces: Largest number of triangles per mesh.

    Returns:
        ``gravity`` (3,) [m/s²]; ``stepping``, see ``Stepping``; ``bodies`` and ``colliders``, see ``_Reader``;
        ``apart``, index pairs of colliders without contact (n, 2); and ``findings``, the fields of ``Findings``.

    Raises:
        Unreadable: If the stage has too many rigid bodies or colliders.
    """
    return _Reader(stage, most_faces).read()


def read_gravity(stage: Any, scene: Any) -> Array:
    """Returns the gravity (3,) of the prim of a physics scene [m/s²]; NaN if it is invalid."""
    reader = _Reader(stage, 0)
    reader.metres, reader.kilograms, reader.up = reader._units()
    gravity = reader._gravity([scene])
    return np.full(3, np.nan) if reader.findings.wrong else gravity


class _Reader:
    """Reads one stage.

    Record of a body: ``path``; ``placement``, matrix (4, 4) from prim to world [m], for column vectors; ``turn``
    (3, 3), its rotation without scale; ``kinematic``; ``velocity`` and ``angular_velocity``, world [m/s, rad/s]; and
    the values of MassAPI, 0 or ``None`` if not given: ``mass`` [kg], ``density`` [kg/m³], ``moments`` (3,) [kg·m²],
    ``axes`` (4,), quaternion (x, y, z, w) from principal axes to prim, and ``centre`` (3,), world [m].

    Record of a collider: ``path``; ``body``, index of its body, −1: none; ``placement``; ``shape``; ``mass``,
    ``density``, ``moments``, ``axes`` and ``centre`` as for a body; ``material``, ``None`` or the result of
    ``read_material``; ``visible``.
    """

    def __init__(self, stage: Any, most_faces: int) -> None:
        from pxr import Usd, UsdGeom

        self.stage = stage
        self.most_faces = most_faces
        self.findings = Findings()
        self.time = Usd.TimeCode.EarliestTime()
        self.places = UsdGeom.XformCache(self.time)
        self.rigid: set[Any] = set()  # paths of all rigid bodies
        self.numbers: dict[Any, int] = {}  # indices of the bodies that were read, by path
        self.wrong: set[Any] = set()  # paths of invalid prims
        # Bodies whose transform includes that of another body, with the outer body.
        self.nested: list[tuple[Any, Any]] = []
        self.materials: dict[Any, Any] = {}
        self.moving: dict[Any, bool] = {}  # whether a prim, or an ancestor, is animated

    def read(self) -> dict[str, Any]:
        self.metres, self.kilograms, self.up = self._units()
        prims = find_prims(self.stage, self.findings)
        for what, count in (("rigid bodies", len(prims.bodies)), ("colliders", len(prims.colliders))):
            if count > MOST:
                raise Unreadable(f"the stage has {count} {what}; allowed: {MOST}")
        self.rigid = {prim.GetPath() for prim in prims.bodies}
        bodies = [found for prim in prims.bodies if (found := self._collect_errors(prim, self._body)) is not None]
        colliders = [
            found for prim in prims.colliders if (found := self._collect_errors(prim, self._collider)) is not None
        ]
        gravity, stepping = self._gravity(prims.scenes), self._stepping(prims.scenes)
        owners = [bodies[one["body"]]["path"] if one["body"] >= 0 else None for one in colliders]
        paths = [one["path"] for one in colliders]
        pairs = self._collect_errors(
            self.stage.GetPseudoRoot(), lambda root: excluded_pairs(self.stage, paths, owners, self.rigid)
        )
        self._remark_nested()
        if not prims.bodies and not prims.colliders and not self.findings.unsupported:
            self.findings.wrong.append(
                "there is no rigid body and no collider of UsdPhysics; load_mesh reads meshes"
            )
        return {
            "gravity": gravity,
            "stepping": stepping,
            "bodies": bodies,
            "colliders": colliders,
            "apart": np.empty((0, 2), dtype=np.int64) if pairs is None else pairs,
            "findings": asdict(self.findings),
        }

    def _collect_errors(self, prim: Any, read: Any) -> Any:
        try:
            return read(prim)
        except (InvalidValue, Unreadable) as error:
            self.findings.add_invalid(prim, error)
            self.wrong.add(prim.GetPath())
        except Unsupported as error:
            self.findings.add_unsupported(prim, error)
        return None

    def _units(self) -> tuple[float, float, Array]:
        """Returns length unit [m], mass unit [kg], and the rotation (3, 3) to Z up."""
        from pxr import UsdGeom, UsdPhysics

        found = []
        for name, value in (
            ("metersPerUnit", UsdGeom.GetStageMetersPerUnit(self.stage)),
            ("kilogramsPerUnit", UsdPhysics.GetStageKilogramsPerUnit(self.stage)),
        ):
            positive = isfinite(value) and value > 0.0
            if not positive:
                self.findings.wrong.append(f"{name} must be positive and finite, got {value:g}")
            found.append(float(value) if positive else 1.0)
        if not UsdGeom.StageHasAuthoredMetersPerUnit(self.stage):
            self.findings.remarks.append("metersPerUnit is not authored: the unit is 0.01 m, the default of USD")
        up = str(UsdGeom.GetStageUpAxis(self.stage))
        if up not in ("Y", "Z"):
            self.findings.wrong.append(f"upAxis must be Y or Z, got {up!r}")
        if up == "Y":
            self.findings.remarks.append("the up axis is Y: everything was rotated to Z up")
        return found[0], found[1], _Z_UP if up == "Y" else np.eye(3)

    def _gravity(self, scenes: list[Any]) -> Array:
        from pxr import UsdPhysics

        down = np.array([0.0, 0.0, -1.0])
        if not scenes:
            self.findings.remarks.append(f"no PhysicsScene: gravity is {GRAVITY} m/s² down")
            return GRAVITY * down
        for other in scenes[1:]:
            self.findings.add_unsupported(
                other, f"a scene in addition to {path_of(scenes[0])}; a file must have one scene"
            )
        scene = UsdPhysics.Scene(scenes[0])
        found = self._collect_errors(scenes[0], lambda prim: vector(scene.GetGravityDirectionAttr(), self.time))
        direction = np.zeros(3) if found is None else self.up @ found
        length = float(np.linalg.norm(direction))
        if not has_gravity(scenes[0], self.time):
            self.findings.remark(scenes[0], "newton:gravityEnabled is off: there is no gravity")
            return np.zeros(3)
        magnitude = value_of(scene.GetGravityMagnitudeAttr(), self.time, -inf)
        if not magnitude < inf:  # rejects NaN as well
            self.findings.add_invalid(scenes[0], f"physics:gravityMagnitude must be a number, got {magnitude:g}")
            return down
        acceleration = GRAVITY if magnitude < 0.0 else float(magnitude) * self.metres
        return acceleration * (direction / length if length > 0.0 else down)

    def _stepping(self, scenes: list[Any]) -> Stepping:
        found: Stepping | None = None
        if scenes:
            found = self._collect_errors(scenes[0], lambda prim: read_stepping(prim, self.time))
        return NOTHING if found is None else found

    def _remark_nested(self) -> None:
        """Adds one remark for all nested rigid bodies; converters create one for each link of a robot."""
        if self.nested:
            prim, carrier = self.nested[0]
            more = f" and {len(self.nested) - 1} more" if len(self.nested) > 1 else ""
            self.findings.remark(
                prim,
                f"the rigid body is nested in the rigid body {path_of(carrier)} without !resetXformStack!{more}: "
                "each becomes a separate body at its composed pose and does not follow the outer one",
            )

    def _placement(self, prim: Any) -> Array:
        """Returns the matrix (4, 4) from a prim to the world [m], for column vectors."""
        # Gf uses row vectors.
        placement = np.array(self.places.GetLocalToWorldTransform(prim)).T
        placement[:3] = self.metres * self.up @ placement[:3]
        if not np.isfinite(placement).all():
            raise InvalidValue("its transformation must be finite")
        sizes = np.linalg.svd(placement[:3, :3], compute_uv=False)
        if sizes[2] <= 1.0e-9 * sizes[0]:
            raise InvalidValue(
                f"its transformation must be invertible, got scales {(sizes / self.metres).tolist()}"
            )
        return placement

    def _turn(self, prim: Any) -> Array:
        """Returns the rotation (3, 3) of a prim, without scale."""
        turn = self.places.GetLocalToWorldTransform(prim).RemoveScaleShear().ExtractRotationMatrix()
        return self.up @ np.array(turn).T

    def _body(self, prim: Any) -> dict[str, Any]:
        from pxr import UsdGeom, UsdPhysics

        if not prim.IsA(UsdGeom.Xformable):
            raise InvalidValue(f"a rigid body must be an Xformable, got {prim.GetTypeName() or 'no type'}")
        if (outer_body := self._outer_of(prim)) is not None:
            self.nested.append((prim, outer_body))
        api = UsdPhysics.RigidBodyAPI(prim)
        kinematic = bool(value_of(api.GetKinematicEnabledAttr(), self.time, False))
        if self._animated(prim):
            if kinematic:
                raise Unsupported("a kinematic body whose pose is animated")
            self.findings.remark(prim, "its pose is animated; the first pose is used")
        if value_of(api.GetStartsAsleepAttr(), self.time, False):
            self.findings.remark(prim, "physics:startsAsleep is ignored")
        outer = prim.GetParent()
        reset = UsdGeom.Xformable(prim).GetResetXformStack() or not outer or outer.IsPseudoRoot()
        frame = self.metres * self.up if reset else self._placement(outer)[:3, :3]
        turn = self.up if reset else self._turn(outer)
        placement = self._placement(prim)
        body = {
            "path": str(prim.GetPath()),
            "placement": placement,
            "turn": self._turn(prim),
            "kinematic": kinematic,
            "velocity": frame @ vector(api.GetVelocityAttr(), self.time),
            "angular_velocity": turn @ np.radians(vector(api.GetAngularVelocityAttr(), self.time)),
            **self._mass(prim, placement),
        }
        self.numbers[prim.GetPath()] = len(self.numbers)
        return body

    def _rigid_of(self, prim: Any) -> Any:
        """Returns the rigid body that a prim belongs to, itself or the nearest ancestor; ``None``: the world.

        As in the parser of UsdPhysics, a reset transform in between does not matter.
        """
        while prim and not prim.IsPseudoRoot():
            if prim.GetPath() in self.rigid:
                return prim
            prim = prim.GetParent()
        return None

    def _outer_of(self, prim: Any) -> Any:
        """Returns the rigid body whose transform is included in that of another rigid body, or ``None``."""
        from pxr import UsdGeom

        while not (prim.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(prim).GetResetXformStack()):
            prim = prim.GetParent()
            if prim.IsPseudoRoot() or prim.GetPath() in self.rigid:
                return None if prim.IsPseudoRoot() else prim
        return None

    def _animated(self, prim: Any) -> bool:
        """Returns whether the pose of a prim, or of an ancestor that moves it, varies in time."""
        from pxr import UsdGeom

        if not prim or prim.IsPseudoRoot():
            return False
        path = prim.GetPath()
        if path not in self.moving:
            xformable = UsdGeom.Xformable(prim) if prim.IsA(UsdGeom.Xformable) else None
            varies = xformable is not None and xformable.TransformMightBeTimeVarying()
            inherits = xformable is None or not xformable.GetResetXformStack()
            self.moving[path] = varies or (inherits and self._animated(prim.GetParent()))
        return self.moving[path]

    def _collider(self, prim: Any) -> dict[str, Any] | None:
        from pxr import UsdGeom

        carrier = self._rigid_of(prim)
        if carrier is not None and carrier.GetPath() not in self.numbers:
            if carrier.GetPath() in self.wrong:
                return None  # the body is already reported
            raise Unsupported(f"part of the rigid body {path_of(carrier)}, which is omitted")
        if carrier is None and self._animated(prim):
            raise Unsupported("a collider of the world whose pose is animated")
        placement = self._placement(prim)
        self._note_unused(prim)
        return {
            "path": str(prim.GetPath()),
            "body": -1 if carrier is None else self.numbers[carrier.GetPath()],
            "placement": placement,
            "shape": shape_of(prim, self.time, self.most_faces),
            **self._mass(prim, placement),
            "material": self._material(prim),
            "visible": str(UsdGeom.Imageable(prim).ComputeVisibility(self.time)) != "invisible",
        }

    def _note_unused(self, prim: Any) -> None:
        """Records authored attributes of NewtonCollisionAPI and NewtonMassAPI without a counterpart."""
        margin, model, most = (
            value_of(attribute, self.time) if is_authored(attribute) else None
            for attribute in map(
                prim.GetAttribute, ("newton:contactMargin", "newton:massModel", "newton:maxHullVertices")
            )
        )
        if margin is not None and margin > 0.0:
            self.findings.remark(
                prim, f"newton:contactMargin {margin:g} is ignored: contact starts at the surface"
            )
        if most is not None and most >= 0:
            self.findings.remark(prim, f"newton:maxHullVertices {most} is ignored: convex hulls keep all vertices")
        if model == "shell":
            self.findings.add_unsupported(prim, "newton:massModel shell; the mass of a solid is used")

    def _mass(self, prim: Any, placement: Array) -> dict[str, Any]:
        return read_mass(prim, placement, self.time, self.metres, self.kilograms)

    def _material(self, prim: Any) -> dict[str, Any] | None:
        """Returns the physics material bound to a collider, or ``None``."""
        from pxr import UsdShade

        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        if not material or not is_material(material.GetPrim()):
            return None
        material_prim = material.GetPrim()
        if material_prim.GetPath() not in self.materials:
            self.materials[material_prim.GetPath()] = self._collect_errors(
                material_prim,
                lambda prim: read_material(prim, self.time, self.metres, self.kilograms, self.findings),
            )
        found: dict[str, Any] | None = self.materials[material_prim.GetPath()]
        return found
