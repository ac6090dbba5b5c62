"""Motions as joints of UsdPhysics between the world and a body."""

from typing import Any

import numpy as np

from warpcontact.algebra.poses import inverse, product, shortest_rotations, transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.kernels.catalogue.device_model import unit_vectors
from warpcontact.kernels.types import BALL, HINGE, PLANAR, SLIDER, TRANSLATION
from warpcontact.scene.scene import Body
from warpcontact.usd.author import store_element_name
from warpcontact.validation.checks import Array

#: Freedoms that a joint without a schema of its own takes away, in its frame, whose x axis is that of the motion.
_LOCKED = {PLANAR: ("transX", "rotY", "rotZ"), TRANSLATION: ("rotX", "rotY", "rotZ")}
_SCHEMAS = {HINGE: "RevoluteJoint", SLIDER: "PrismaticJoint", BALL: "SphericalJoint"}


def is_joint(body: Body) -> bool:
    """Whether the motion of a body is a joint; others are free or kinematic."""
    return body.single and body.motion.kind in (*_SCHEMAS, *_LOCKED)


def define_joint(stage: Any, path: str, body: Body, body_path: str) -> None:
    """Writes a joint, without its place."""
    from pxr import UsdPhysics

    kind = body.motion.kind
    joint = getattr(UsdPhysics, _SCHEMAS.get(kind, "Joint")).Define(stage, path)
    joint.CreateBody1Rel().SetTargets([body_path])
    if kind in _SCHEMAS:
        joint.CreateAxisAttr(UsdPhysics.Tokens.x)
    for freedom in _LOCKED.get(kind, ()):
        limit = UsdPhysics.LimitAPI.Apply(joint.GetPrim(), freedom)
        # Locked, as UsdPhysics has it: the lower limit is above the upper one.
        limit.CreateLowAttr(1.0)
        limit.CreateHighAttr(-1.0)
    store_element_name(joint.GetPrim(), body.name)
    joint.GetPrim().SetDocumentation(f"{type(body.motion).__name__} of {body.name} on the world.")


def write_joint(prim: Any, replay: Replay, body: Body, pose: tuple[Array, Array], row: int, offset: Any) -> None:
    """Writes where a joint is in environment number ``row`` of the export, which is ``offset`` off [m].

    Args:
        prim: The joint.
        replay: What is exported.
        body: Its body.
        pose: Position (3,) [m] and orientation (4,) of the body in the first record.
        row: The environment.
        offset: Where it is on the grid, (3,) [m].
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
    turn = shortest_rotations((1.0, 0.0, 0.0), along)
    back = inverse(orientation)
    inside = transform_points((place - position)[None], np.zeros(3), back)[0]
    joint = UsdPhysics.Joint(prim)
    joint.CreateLocalPos0Attr(Gf.Vec3f(*(place + np.asarray(offset)).tolist()))
    joint.CreateLocalRot0Attr(_quaternion(turn))
    joint.CreateLocalPos1Attr(Gf.Vec3f(*inside.tolist()))
    joint.CreateLocalRot1Attr(_quaternion(product(back, turn)))


def _quaternion(values: Array) -> Any:
    from pxr import Gf

    x, y, z, w = (values / np.linalg.norm(values)).tolist()
    return Gf.Quatf(w, x, y, z)
