"""Descriptions of models of others (see ``rest_models.py``) as USD stages with UsdPhysics, and of scenes read from stages."""

from collections.abc import Sequence

import numpy as np
from rest_models import Array, Description, matrix
from scipy.spatial.transform import Rotation

import warpcontact as wc

PRIMS = {"plane": "Plane", "sphere": "Sphere", "capsule": "Capsule", "cylinder": "Cylinder", "box": "Cube"}
SIZES = {
    "sphere": ("radius",),
    "capsule": ("radius", "half_length"),
    "cylinder": ("radius", "half_length"),
    "box": ("half_extents",),
    "ellipsoid": ("semi_axes",),
}


def stage(description: Description) -> str:
    """Returns a text stage of a description. Body number i is the prim ``/body_i``."""
    gravity = np.array(description["gravity"])
    colliders = description["colliders"]
    text = ['#usda 1.0\n(\nmetersPerUnit = 1\nkilogramsPerUnit = 1\nupAxis = "Z"\n)']
    magnitude = float(np.linalg.norm(gravity))
    text.append(
        _prim(
            "PhysicsScene",
            "scene",
            (),
            f"vector3f physics:gravityDirection = {_tuple(gravity / magnitude)}\n"
            f"float physics:gravityMagnitude = {magnitude!r}",
        )
    )
    for mu in sorted({one["friction"] for one in colliders}):
        text.append(
            _prim(
                "Material",
                _material(mu),
                ("PhysicsMaterialAPI",),
                f"float physics:staticFriction = {mu!r}\nfloat physics:dynamicFriction = {mu!r}\n"
                "float physics:restitution = 0",
            )
        )
    for number, body in enumerate(description["bodies"]):
        content = [
            _pose(body["position"], body["orientation"]),
            f"float physics:mass = {body['mass']!r}",
            f"float3 physics:diagonalInertia = {_tuple(body['inertia'])}",
            "point3f physics:centerOfMass = (0, 0, 0)",
            "quatf physics:principalAxes = (1, 0, 0, 0)",
            *_colliders(description, number),
        ]
        text.append(
            _prim("Xform", f"body_{number}", ("PhysicsRigidBodyAPI", "PhysicsMassAPI"), "\n".join(content))
        )
    return "\n".join([*text, *_colliders(description, -1)]) + "\n"


def describe(scene: wc.Scene) -> Description:
    """Returns the description of a scene of rigid bodies with convex colliders in body contact."""
    bodies, frames = [], [np.eye(3)] * (len(scene.bodies) + 1)
    for number, body in enumerate(scene.bodies):
        moments, axes = np.linalg.eigh(np.asarray(body.inertia, dtype=float))
        frames[number] = axes * np.sign(np.linalg.det(axes))
        turn = matrix(body.orientation) @ frames[number]
        bodies.append(
            {
                "name": body.name,
                "position": body.position.tolist(),
                "orientation": _quaternion(turn),
                "mass": float(body.mass),
                "inertia": moments.tolist(),
                "linear_velocity": body.linear_velocity.tolist(),
                "angular_velocity": body.angular_velocity.tolist(),
            }
        )
    colliders = []
    for solid in (*scene.shapes, *scene.surfaces):
        number = -1 if solid.body is None else solid.body.index
        shape = hasattr(solid, "kind")
        turn = matrix(solid.orientations[0] if shape else solid.orientation)
        one = {
            "body": number,
            "position": (frames[number].T @ (solid.positions[0] if shape else solid.position)).tolist(),
            "orientation": _quaternion(frames[number].T @ turn),
        }
        if shape:
            form = solid.form()
            one["kind"] = {"RoundedBox": "box"}.get(type(form).__name__, type(form).__name__.lower())
            sizes = [np.ravel(getattr(form, key)) for key in SIZES.get(one["kind"], ())]
            one["size"] = np.concatenate([*sizes, np.zeros(0)]).tolist() or [1.0, 1.0, 1.0]
        else:
            one |= {"kind": "mesh", "size": [], "vertices": (solid.mesh.vertices * solid.scale).tolist()}
            one["faces"] = solid.mesh.faces.tolist()
        colliders.append(one)
    numbers = {solid.name: number for number, solid in enumerate((*scene.shapes, *scene.surfaces))}
    touching = set()
    for contact in scene.body_contacts:
        for pair in contact.pairs:
            first, second = sorted(numbers[solid.name] for solid in pair)
            touching.add((first, second))
            for number in (first, second):
                colliders[number]["friction"] = float(contact.material.friction.mu_static)
    for second, one in enumerate(colliders):
        one["excluded"] = [
            first
            for first, other in enumerate(colliders[:second])
            if one["body"] != other["body"] and (first, second) not in touching
        ]
    return {"gravity": scene.gravity.tolist(), "bodies": bodies, "colliders": colliders}


def _colliders(description: Description, body: int) -> list[str]:
    every = description["colliders"]
    return [_collider(every, number) for number, one in enumerate(every) if one["body"] == body]


def _collider(colliders: Sequence[dict], number: int) -> str:
    one = colliders[number]
    kind, size, scale = one["kind"], one["size"], None
    schemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]
    content = [f"rel material:binding:physics = </{_material(one['friction'])}>"]
    if kind == "mesh":
        schemas.append("PhysicsMeshCollisionAPI")
        faces = np.array(one["faces"])
        content += [
            f"point3f[] points = [{', '.join(map(_tuple, one['vertices']))}]",
            f"int[] faceVertexCounts = {[3] * len(faces)}",
            f"int[] faceVertexIndices = {faces.ravel().tolist()}",
            'uniform token subdivisionScheme = "none"',
            'uniform token physics:approximation = "convexHull"',
        ]
    elif kind in ("capsule", "cylinder"):
        content += [f"double radius = {size[0]!r}", f"double height = {2 * size[1]!r}", 'uniform token axis = "Z"']
    elif kind == "sphere":
        content.append(f"double radius = {size[0]!r}")
    elif kind == "plane":
        content.append('uniform token axis = "Z"')
    else:
        scale = size
        content.append("double size = 2" if kind == "box" else "double radius = 1")
    if one["excluded"]:
        schemas.append("PhysicsFilteredPairsAPI")
        paths = ", ".join(f"<{_path(colliders, other)}>" for other in one["excluded"])
        content.append(f"rel physics:filteredPairs = [{paths}]")
    name = {"mesh": "Mesh", "ellipsoid": "Sphere"}.get(kind) or PRIMS[kind]
    return _prim(
        name,
        f"collider_{number}",
        schemas,
        "\n".join([_pose(one["position"], one["orientation"], scale), *content]),
    )


def _path(colliders: Sequence[dict], number: int) -> str:
    body = colliders[number]["body"]
    return f"{f'/body_{body}' if body >= 0 else ''}/collider_{number}"


def _prim(kind: str, name: str, schemas: Sequence[str], content: str) -> str:
    listed = f"(prepend apiSchemas = [{', '.join(map(_quoted, schemas))}])" if schemas else ""
    return f'def {kind} "{name}" {listed}\n{{\n{content}\n}}'


def _pose(position: Sequence[float], orientation: Sequence[float], scale: Sequence[float] | None = None) -> str:
    values = [
        f"double3 xformOp:translate = {_tuple(position)}",
        f"quatd xformOp:orient = {_tuple(np.roll(orientation, 1))}",
    ]
    names = ["xformOp:translate", "xformOp:orient"]
    if scale is not None:
        values.append(f"double3 xformOp:scale = {_tuple(scale)}")
        names.append("xformOp:scale")
    return "\n".join([*values, f"uniform token[] xformOpOrder = [{', '.join(map(_quoted, names))}]"])


def _material(mu: float) -> str:
    return f"friction_{mu}".replace(".", "_")


def _quaternion(turn: Array) -> list[float]:
    return Rotation.from_matrix(turn).as_quat().tolist()


def _quoted(text: str) -> str:
    return f'"{text}"'


def _tuple(values: Sequence[float] | Array) -> str:
    return f"({', '.join(repr(float(value)) for value in values)})"
