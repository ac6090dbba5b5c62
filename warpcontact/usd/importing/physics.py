"""What UsdPhysics says on a stage: gravity, rigid bodies, colliders and what they are made of, in SI units, Z up.

Everything that is not understood is noted: see ``Findings``.
"""

from dataclasses import asdict
from math import inf, isfinite
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.readers.unreadable import Unreadable
from warpcontact.usd.importing import kinds
from warpcontact.usd.importing.colliders import shape_of
from warpcontact.usd.importing.filters import apart
from warpcontact.usd.importing.findings import Findings, Unsupported, Wrong, number, path_of, vector

Array = npt.NDArray[np.float64]

#: Gravity where a stage says none, or less than nothing [m/s²].
GRAVITY = 9.81
#: Most rigid bodies, and most colliders, of one stage.
MOST = 50_000
# Turns Y up into Z up.
_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read_physics(stage: Any, most_faces: int) -> dict[str, Any]:
    """Returns what a stage says of physics.

    Args:
        stage: The stage.
        most_faces: Number of triangles that a mesh may have.

    Returns:
        ``gravity`` (3,) [m/s²]; ``bodies`` and ``colliders``, see ``_Reader``; ``apart``, pairs of numbers of
        colliders that do not touch (n, 2); and the ``Findings``.

    Raises:
        Unreadable: If it has too many rigid bodies or colliders.
    """
    return _Reader(stage, most_faces).read()


def read_gravity(stage: Any, scene: Any) -> Array:
    """Returns the gravity (3,) that the prim of a physics scene says [m/s²]; NaN if it makes no sense."""
    reader = _Reader(stage, 0)
    reader.metres, reader.kilograms, reader.up = reader._units()
    gravity = reader._gravity([scene])
    return np.full(3, np.nan) if reader.findings.wrong else gravity


class _Reader:
    """Reads one stage.

    Of a body: ``path``; ``placement``, the matrix (4, 4) from its prim to the world [m], for columns; ``turn``
    (3, 3), its axes without scale; ``kinematic``; ``velocity`` and ``angular_velocity``, world [m/s, rad/s]; and
    what MassAPI says, 0 or ``None`` where it says nothing: ``mass`` [kg], ``density`` [kg/m³], ``moments`` (3,)
    [kg·m²], ``axes`` (4,), quaternion (x, y, z, w) of the principal axes to its prim, ``centre`` (3,), world [m].

    Of a collider: ``path``; ``body``, the number of its body, −1: none; ``placement``; ``shape``; ``mass``,
    ``density``, ``moments``, ``axes`` and ``centre`` as of a body; and ``material``, ``None`` or ``static``,
    ``dynamic``, ``restitution`` and ``density``; ``visible``.
    """

    def __init__(self, stage: Any, most_faces: int) -> None:
        from pxr import Usd, UsdGeom

        self.stage = stage
        self.most_faces = most_faces
        self.findings = Findings()
        self.time = Usd.TimeCode.EarliestTime()
        self.places = UsdGeom.XformCache(self.time)
        self.numbers: dict[Any, int] = {}  # of bodies by path
        self.materials: dict[Any, Any] = {}
        self.moving: dict[Any, bool] = {}  # whether a prim, or one that carries it, is animated

    def read(self) -> dict[str, Any]:
        self.metres, self.kilograms, self.up = self._units()
        prims = kinds.sorted_out(self.stage, self.findings)
        for what, count in (("rigid bodies", len(prims.bodies)), ("colliders", len(prims.colliders))):
            if count > MOST:
                raise Unreadable(f"it has {count} {what}; allowed: {MOST}")
        bodies = [found for prim in prims.bodies if (found := self._tried(prim, self._body)) is not None]
        colliders = [found for prim in prims.colliders if (found := self._tried(prim, self._collider)) is not None]
        gravity = self._gravity(prims.scenes)
        pairs = self._tried(
            self.stage.GetPseudoRoot(), lambda root: apart(self.stage, [c["path"] for c in colliders])
        )
        if not prims.bodies and not prims.colliders and not self.findings.unsupported:
            self.findings.wrong.append(
                "there is no rigid body and no collider of UsdPhysics; load_mesh reads meshes"
            )
        return {
            "gravity": gravity,
            "bodies": bodies,
            "colliders": colliders,
            "apart": np.empty((0, 2), dtype=np.int64) if pairs is None else pairs,
            "findings": asdict(self.findings),
        }

    def _tried(self, prim: Any, read: Any) -> Any:
        try:
            return read(prim)
        except (Wrong, Unreadable) as error:
            self.findings.blame(prim, error)
        except Unsupported as error:
            self.findings.pass_over(prim, error)
        return None

    def _units(self) -> tuple[float, float, Array]:
        """Returns metres and kilograms per unit, and the turn (3, 3) to Z up."""
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
            self.findings.remarks.append(
                "the stage does not say metersPerUnit, so its unit is 0.01 m, as USD has it"
            )
        up = str(UsdGeom.GetStageUpAxis(self.stage))
        if up not in ("Y", "Z"):
            self.findings.wrong.append(f"upAxis must be Y or Z, got {up!r}")
        if up == "Y":
            self.findings.remarks.append("the up axis is Y: all was turned, so that z is up")
        return found[0], found[1], _Z_UP if up == "Y" else np.eye(3)

    def _gravity(self, scenes: list[Any]) -> Array:
        from pxr import UsdPhysics

        down = np.array([0.0, 0.0, -1.0])
        if not scenes:
            self.findings.remarks.append(f"there is no PhysicsScene: gravity is {GRAVITY} m/s² down")
            return GRAVITY * down
        for other in scenes[1:]:
            self.findings.pass_over(other, f"a scene beside {path_of(scenes[0])}; one file is one scene")
        scene = UsdPhysics.Scene(scenes[0])
        found = self._tried(scenes[0], lambda prim: vector(scene.GetGravityDirectionAttr(), self.time))
        direction = np.zeros(3) if found is None else self.up @ found
        length = float(np.linalg.norm(direction))
        magnitude = scene.GetGravityMagnitudeAttr().Get(self.time)
        if not magnitude < inf:  # nor NaN
            self.findings.blame(scenes[0], f"physics:gravityMagnitude must be a number, got {magnitude:g}")
            return down
        own = GRAVITY if magnitude < 0.0 else float(magnitude) * self.metres
        return own * (direction / length if length > 0.0 else down)

    def _placement(self, prim: Any) -> Array:
        """Returns the matrix from a prim to the world, for columns [m]."""
        # Gf multiplies rows.
        placement = np.array(self.places.GetLocalToWorldTransform(prim)).T
        placement[:3] = self.metres * self.up @ placement[:3]
        if not np.isfinite(placement).all():
            raise Wrong("its transformation must be finite")
        sizes = np.linalg.svd(placement[:3, :3], compute_uv=False)
        if sizes[2] <= 1.0e-9 * sizes[0]:
            raise Wrong(f"its transformation must not flatten it, got scales {(sizes / self.metres).tolist()}")
        return placement

    def _turn(self, prim: Any) -> Array:
        """Returns the rotation (3, 3) of a prim, without scale."""
        turn = self.places.GetLocalToWorldTransform(prim).RemoveScaleShear().ExtractRotationMatrix()
        return self.up @ np.array(turn).T

    def _body(self, prim: Any) -> dict[str, Any]:
        from pxr import UsdGeom, UsdPhysics

        if not prim.IsA(UsdGeom.Xformable):
            raise Wrong(f"a rigid body must be an Xformable, got {prim.GetTypeName() or 'no type'}")
        carrier = self._body_of(prim.GetParent())
        if carrier is not None and not UsdGeom.Xformable(prim).GetResetXformStack():
            raise Wrong(f"the rigid body is nested in the rigid body {path_of(carrier)}")
        api = UsdPhysics.RigidBodyAPI(prim)
        kinematic = bool(api.GetKinematicEnabledAttr().Get(self.time))
        if self._animated(prim):
            if kinematic:
                raise Unsupported("a kinematic body whose pose is animated")
            self.findings.remark(prim, "its pose is animated; what it starts with is taken")
        if api.GetStartsAsleepAttr().Get(self.time):
            self.findings.remark(prim, "starts asleep on the stage; it is awake here")
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

    def _body_of(self, prim: Any) -> Any:
        """Returns the rigid body that a prim is part of, itself or one that carries it; ``None``: the world."""
        from pxr import UsdGeom

        while prim and not prim.IsPseudoRoot():
            if prim.GetPath() in self.numbers:
                return prim
            if prim.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(prim).GetResetXformStack():
                return None
            prim = prim.GetParent()
        return None

    def _animated(self, prim: Any) -> bool:
        """Whether the pose of a prim, or of one that carries it, changes in time."""
        from pxr import UsdGeom

        if not prim or prim.IsPseudoRoot():
            return False
        path = prim.GetPath()
        if path not in self.moving:
            place = UsdGeom.Xformable(prim) if prim.IsA(UsdGeom.Xformable) else None
            own = place is not None and place.TransformMightBeTimeVarying()
            outer = place is None or not place.GetResetXformStack()
            self.moving[path] = own or (outer and self._animated(prim.GetParent()))
        return self.moving[path]

    def _mass(self, prim: Any, placement: Array) -> dict[str, Any]:
        """Returns what MassAPI says of a body or collider."""
        from pxr import UsdPhysics

        said: dict[str, Any] = {"mass": 0.0, "density": 0.0, "moments": None, "axes": None, "centre": None}
        if not prim.HasAPI(UsdPhysics.MassAPI):
            return said
        api = UsdPhysics.MassAPI(prim)
        said["mass"] = self.kilograms * number(api.GetMassAttr(), self.time, least=0.0)
        said["density"] = number(api.GetDensityAttr(), self.time, least=0.0) * self.kilograms / self.metres**3
        moments = vector(api.GetDiagonalInertiaAttr(), self.time)
        if moments.any():
            if (moments < 0.0).any():
                raise Wrong(f"physics:diagonalInertia must be positive, got {moments.tolist()}")
            said["moments"] = self.kilograms * self.metres**2 * moments
        axes = api.GetPrincipalAxesAttr().Get(self.time)
        turn = np.array([*axes.GetImaginary(), axes.GetReal()], dtype=np.float64)
        length = float(np.linalg.norm(turn))
        if not isfinite(length):
            raise Wrong(f"physics:principalAxes must be finite, got {turn.tolist()}")
        if length > 0.0:
            said["axes"] = turn / length
        # −inf in all of them: not given.
        if api.GetCenterOfMassAttr().Get(self.time) != (-inf,) * 3:
            centre = vector(api.GetCenterOfMassAttr(), self.time)
            said["centre"] = placement[:3, :3] @ centre + placement[:3, 3]
        return said

    def _collider(self, prim: Any) -> dict[str, Any]:
        from pxr import UsdGeom

        carrier = self._body_of(prim)
        if carrier is None and self._animated(prim):
            raise Unsupported("a collider of the world whose pose is animated")
        placement = self._placement(prim)
        return {
            "path": str(prim.GetPath()),
            "body": -1 if carrier is None else self.numbers[carrier.GetPath()],
            "placement": placement,
            "shape": shape_of(prim, self.time, self.most_faces),
            **self._mass(prim, placement),
            "material": self._material(prim),
            "visible": str(UsdGeom.Imageable(prim).ComputeVisibility(self.time)) != "invisible",
        }

    def _material(self, prim: Any) -> dict[str, float] | None:
        """Returns what the material of a collider says of physics."""
        from pxr import UsdPhysics, UsdShade

        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        if not material or not material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
            return None
        own = material.GetPrim()
        if own.GetPath() not in self.materials:
            api = UsdPhysics.MaterialAPI(own)
            self.materials[own.GetPath()] = self._tried(
                own,
                lambda _: {
                    "static": number(api.GetStaticFrictionAttr(), self.time, least=0.0),
                    "dynamic": number(api.GetDynamicFrictionAttr(), self.time, least=0.0),
                    "restitution": number(api.GetRestitutionAttr(), self.time, least=0.0, most=1.0),
                    "density": number(api.GetDensityAttr(), self.time, least=0.0)
                    * self.kilograms
                    / self.metres**3,
                },
            )
        found: dict[str, float] | None = self.materials[own.GetPath()]
        return found
