"""Motions as joints of UsdPhysics between the world and a body."""

from typing import Any

import numpy as np

from warpcontact.algebra.poses import inverse, product, shortest_rotations, transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.kernels.catalogue.device_model import unit_vectors
from warpcontact.kernels.types import BALL, HINGE, PLANAR, SLIDER, TRANSLATION
from warpcontact.scene.elements import Body
from warpcontact.usd.author import store_element_name
from warpcontact.validation.checks import Array

#: Locked degrees of freedom of joints without a UsdPhysics schema, in the joint frame; its x axis is the motion's.
_LOCKED = {PLANAR: ("transX", "rotY", "rotZ"), TRANSLATION: ("rotX", "rotY", "rotZ")}
_SCHEMAS = {HINGE: "RevoluteJoint", SLIDER: "PrismaticJoint", BALL: "SphericalJoint"}


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
    joint.CreateLocalRot1Attr(_quaternion(product(to_body, rotation)))


def _quaternion(values: Array) -> Any:
    from pxr import Gf

    x, y, z, w = (values / np.linalg.norm(values)).tolist()
    return Gf.Quatf(w, x, y, z)
