"""Physics of a stage for other simulators: gravity, rigid bodies, masses, velocities, joints, collision groups."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from warpcontact.algebra.vectors import inverse, quat_multiply, shortest_rotations, transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.kernels.catalogue.device_model import unit_vectors
from warpcontact.kernels.types import BALL, FIXED, HINGE, PLANAR, PRESCRIBED, SLIDER, TIME_FUNCTION, TRANSLATION
from warpcontact.scene.elements import Body
from warpcontact.usd.author import Samples, store_element_name, vectors
from warpcontact.validation.checks import Array

# Relative tolerance, because recordings store the time step in single precision.
_SINGLE = 1.0e-6

#: Locked degrees of freedom of joints without a UsdPhysics schema, in the joint frame; its x axis is the motion's.
_LOCKED = {PLANAR: ("transX", "rotY", "rotZ"), TRANSLATION: ("rotX", "rotY", "rotZ")}
_SCHEMAS = {HINGE: "RevoluteJoint", SLIDER: "PrismaticJoint", BALL: "SphericalJoint"}


def define_gravity(stage: Any, path: str, gravity: Array) -> None:
    """Writes the physics scene with gravity [m/s²]."""
    from pxr import Gf, UsdPhysics

    scene = UsdPhysics.Scene.Define(stage, path)
    magnitude = float(np.linalg.norm(gravity))
    # A direction of zero length would mean "down" by convention; without gravity it does not matter.
    direction = gravity / magnitude if magnitude > 0.0 else np.array([0.0, 0.0, -1.0])
    scene.CreateGravityDirectionAttr(Gf.Vec3f(*direction.tolist()))
    scene.CreateGravityMagnitudeAttr(magnitude)
    # By this value, readers of the description detect later changes of the gravity attributes.
    scene.GetPrim().SetCustomDataByKey("warpcontact:gravity", Gf.Vec3d(*gravity.tolist()))


def write_stepping(scene: Any, dt: float, iterations: int | None) -> None:
    """Writes solver settings into a PhysicsScene, with the schema NewtonSceneAPI.

    A time step whose inverse is not an integer is omitted.

    Args:
        scene: Prim of the PhysicsScene.
        dt: Time step [s].
        iterations: Maximum number of solver iterations per step; ``None``: the reader's default.
    """
    from pxr import Sdf

    rate = round(1.0 / dt)
    is_integer = rate >= 1 and abs(rate * dt - 1.0) < _SINGLE
    values = {"timeStepsPerSecond": rate if is_integer else None, "maxSolverIterations": iterations}
    for name, value in values.items():
        if value is not None:
            scene.AddAppliedSchema("NewtonSceneAPI")
            kind, uniform = Sdf.ValueTypeNames.Int, Sdf.VariabilityUniform
            scene.CreateAttribute(f"newton:{name}", kind, False, uniform).Set(value)


def apply_rigid_body(prim: Any, body: Body, scene: str | None) -> None:
    """Makes a prim a rigid body whose center of mass is its origin, as for every ``Body``.

    Fixed bodies and bodies with prescribed motion are kinematic. ``scene``: path of its physics scene, needed if
    there are several.
    """
    from pxr import Gf, UsdPhysics

    api = UsdPhysics.RigidBodyAPI.Apply(prim)
    if body.motion.kind in (FIXED, PRESCRIBED, TIME_FUNCTION):
        api.CreateKinematicEnabledAttr(True)
    if scene is not None:
        api.CreateSimulationOwnerRel().SetTargets([scene])
    UsdPhysics.MassAPI.Apply(prim).CreateCenterOfMassAttr(Gf.Vec3f(0.0))


class Masses:
    """Masses and inertias of the bodies in all environments, as far as they are available.

    They are used if they were recorded, or if the recording states that they equal those of the scene. Otherwise the
    study may have varied them, and the values of the scene could be wrong.
    """

    def __init__(self, replay: Replay) -> None:
        self._by_body = {
            body.name: (replay.value_or_default(f"{body.name}.mass", body.mass), self._principal(replay, body))
            for body in replay.scene.bodies
            if body.single
        }

    @staticmethod
    def _principal(replay: Replay, body: Body) -> list[tuple[Array, Array]] | None:
        inertia = replay.value_or_default(f"{body.name}.inertia", body.inertia)
        return None if inertia is None else [principal(tensor) for tensor in inertia]

    def write(self, prim: Any, body: Body, row: int) -> None:
        """Writes mass and inertia of a body in environment ``row`` of the export."""
        from pxr import Gf, UsdPhysics

        api, (mass, inertia) = UsdPhysics.MassAPI(prim), self._by_body[body.name]
        if mass is not None:
            api.CreateMassAttr(float(mass[row]))
        if inertia is not None:
            moments, axes = inertia[row]
            api.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
            # Gf multiplies row vectors from the left: its rotation matrix is the transpose of ours.
            rotation = Gf.Matrix3d(*axes.T.reshape(-1).tolist()).ExtractRotation().GetQuat()
            api.CreatePrincipalAxesAttr(Gf.Quatf(rotation))


def principal(inertia: Array) -> tuple[Array, Array]:
    """Returns the principal moments and the rotation matrix (3, 3) from principal axes to body frame of a tensor.

    The moments of a diagonal tensor keep their order.
    """
    if not (inertia - np.diag(np.diag(inertia))).any():
        return np.diag(inertia).copy(), np.eye(3)
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return moments, axes


def write_velocity(prim: Any, samples: Samples, replay: Replay, body: Body, row: int) -> None:
    """Writes the recorded velocities of a body, so that a simulator can start from any record.

    UsdPhysics expects them in the frame of the body's pose, whose axes are those of the world here, and the angular
    velocity in degrees per second.
    """
    from pxr import UsdPhysics

    api = UsdPhysics.RigidBodyAPI(prim)
    linear = replay.series(f"{body.name}.linear_velocity")
    if linear is not None:
        samples.write(api.CreateVelocityAttr(), list(vectors(linear[:, row])))
    angular = replay.series(f"{body.name}.angular_velocity")
    if angular is not None:
        degrees = np.degrees(angular[:, row].astype(np.float64))
        samples.write(api.CreateAngularVelocityAttr(), list(vectors(degrees)))


def define_collision_groups(stage: Any, path: str, envs: Sequence[str], shared: str | None) -> None:
    """Defines collision groups: an environment collides with itself and with the shared surfaces only.

    Args:
        stage: Stage to write to.
        path: Path of the scope of the groups.
        envs: Paths of the environments.
        shared: Path of the shared surfaces; ``None`` if there are none.
    """
    from pxr import UsdGeom, UsdPhysics

    UsdGeom.Scope.Define(stage, path)

    def group_of(prim_path: str) -> Any:
        group = UsdPhysics.CollisionGroup.Define(stage, f"{path}/{prim_path.rpartition('/')[2]}")
        group.GetCollidersCollectionAPI().CreateIncludesRel().AddTarget(prim_path)
        return group

    shared_groups = [] if shared is None else [group_of(shared).GetPath()]
    for env in envs:
        group = group_of(env)
        # Inverted, the total size of the lists is linear in the number of environments, not quadratic.
        group.CreateInvertFilteredGroupsAttr(True)
        group.CreateFilteredGroupsRel().SetTargets([group.GetPath(), *shared_groups])


def is_joint(body: Body) -> bool:
    """Returns whether the motion of a body is written as a joint; other bodies are free or kinematic."""
    return body.single and body.motion.kind in (*_SCHEMAS, *_LOCKED)


def define_joint(stage: Any, path: str, body: Body, body_path: str) -> None:
    """Defines a joint without its frames."""
    from pxr import UsdPhysics

    kind = body.motion.kind
    joint = getattr(UsdPhysics, _SCHEMAS.get(kind, "Joint")).Define(stage, path)
    joint.CreateBody1Rel().SetTargets([body_path])
    if kind in _SCHEMAS:
        joint.CreateAxisAttr(UsdPhysics.Tokens.x)
    for freedom in _LOCKED.get(kind, ()):
        limit = UsdPhysics.LimitAPI.Apply(joint.GetPrim(), freedom)
        # In UsdPhysics, a lower limit above the upper one means locked.
        limit.CreateLowAttr(1.0)
        limit.CreateHighAttr(-1.0)
    store_element_name(joint.GetPrim(), body.name)
    joint.GetPrim().SetDocumentation(f"{type(body.motion).__name__} of {body.name} on the world.")


def write_joint(prim: Any, replay: Replay, body: Body, pose: tuple[Array, Array], row: int, offset: Any) -> None:
    """Writes the frames of a joint in environment ``row`` of the export.

    Args:
        prim: Prim of the joint.
        replay: Replay that is exported.
        body: Body of the joint.
        pose: Position (3,) [m] and orientation (4,) of the body in the first record.
        row: Index of the environment in the export.
        offset: Position of the environment on the grid, (3,) [m].
    """
    from pxr import Gf, UsdPhysics

    position, orientation = pose
    values = {
        key: replay.setting(f"{body.name}.motion.{key}", np.asarray(value, dtype=np.float64))[row]
        for key, value in body.motion.parameters().items()
    }
    axis = values.get("axis", values.get("normal"))
    place = values.get("anchor", position)
    along = np.array([1.0, 0.0, 0.0]) if axis is None else unit_vectors("axis", axis)
    rotation = shortest_rotations((1.0, 0.0, 0.0), along)
    to_body = inverse(orientation)
    local = transform_points((place - position)[None], np.zeros(3), to_body)[0]
    joint = UsdPhysics.Joint(prim)
    joint.CreateLocalPos0Attr(Gf.Vec3f(*(place + np.asarray(offset)).tolist()))
    joint.CreateLocalRot0Attr(_quaternion(rotation))
    joint.CreateLocalPos1Attr(Gf.Vec3f(*local.tolist()))
    joint.CreateLocalRot1Attr(_quaternion(quat_multiply(to_body, rotation)))


def _quaternion(values: Array) -> Any:
    from pxr import Gf

    x, y, z, w = (values / np.linalg.norm(values)).tolist()
    return Gf.Quatf(w, x, y, z)
