"""UsdPhysics stages that both this library and Newton read, as text."""

from physics_stages import BODY, COLLIDER, CUBE, WEIGHT, body, mesh, moved, prim

WITH_MASS = 'prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMassAPI"]'
BOUND = 'prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]'
PAIRED = 'prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsFilteredPairsAPI"]'
HULL = 'prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"]'
HEAVY = WEIGHT + "\n"
STANDING = (
    "double3 xformOp:translate = (3, 0, 0)\n"
    'uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:translate"]\n'
)
STUFF = "rel material:binding:physics = </stuff>\n"
SIZES = "double radius = 0.1\ndouble height = 0.5\n"
THICK = "double radius = 0.5\ndouble height = 1\n"
CONVEX = 'uniform token physics:approximation = "convexHull"'


def cube(name, content="", apis=COLLIDER):
    return prim("Cube", name, apis, f"double size = 1\n{content}")


def material(name, **values):
    lines = "\n".join(f"float {key.replace('_', ':')} = {value}" for key, value in values.items())
    return prim("Material", name, 'prepend apiSchemas = ["NewtonMaterialAPI", "PhysicsMaterialAPI"]', lines)


def group(name, *members, filtered="", inverted=False):
    targets = ", ".join(f"<{one}>" for one in members)
    lines = [
        f"rel collection:colliders:includes = [{targets}]",
        f"bool physics:invertFilteredGroups = {int(inverted)}",
    ]
    lines += [f"rel physics:filteredGroups = {filtered}"] if filtered else []
    return prim("PhysicsCollisionGroup", name, "", "\n".join(lines))


def about_axes(kind, row):
    parts = ((axis, f'{SIZES}uniform token axis = "{axis}"\n{moved(row, i, 0)}') for i, axis in enumerate("XYZ"))
    return "".join(prim(kind, f"{kind}_{axis}", COLLIDER, content) for axis, content in parts)


TURNED = moved(0, 0, 1, turn=(0, 90, 0))
# Stages whose bodies and shapes are compared.
STAGES = {
    "nested": body(
        "outer", cube("outer_box") + body("inner", cube("inner_box"), moved(2, 0, 0, turn=(0, 0, 30))), TURNED
    ),
    "nested and reset": body("outer", cube("outer_box") + body("inner", cube("inner_box"), STANDING), TURNED),
    # The collider moves with the outer body although a prim between both resets the transform.
    "reset between": body(
        "outer",
        cube("outer_box")
        + prim("Xform", "between", "", STANDING + cube("part") + body("inner", cube("inner_box"))),
        moved(0, 0, 1),
    ),
    "nested with mass": body(
        "outer", HEAVY + cube("outer_box") + body("inner", HEAVY + cube("inner_box"), moved(2, 0, 0))
    ),
    "axes": body(
        "one",
        "".join(about_axes(kind, row) for row, kind in enumerate(("Capsule", "Cylinder", "Cone"))),
        moved(0, 0, 3),
    ),
    "scales": body(
        "one",
        cube("box", moved(1, 0, 0, scale=(2, 3, 4)))
        + prim("Sphere", "ball", COLLIDER, "double radius = 0.5\n" + moved(0, 0, 2, scale=(2, 2, 2)))
        + prim("Cylinder", "rod", COLLIDER, THICK + moved(0, 0, 4, scale=(2, 2, 3))),
        moved(1, 1, 1, turn=(0, 0, 90), scale=(2, 2, 2)),
    ),
    "planes": prim("Plane", "wall", COLLIDER, 'uniform token axis = "X"\n' + moved(0, 1, 0, turn=(0, 0, 20)))
    + body("one", cube("box"), moved(3, 0, 0)),
    "density": material("stuff", physics_density=700)
    + body("a", "float physics:density = 300\n" + cube("a_box", STUFF, BOUND))
    + body("b", cube("b_box", STUFF, BOUND), moved(5, 0, 0), BODY)
    + body(
        "c",
        "float physics:density = 300\n" + cube("c_box", "float physics:density = 50\n", WITH_MASS),
        moved(9, 0, 0),
    ),
    "center of mass": body("one", "point3f physics:centerOfMass = (0.2, 0.1, 0)\n" + cube("box")),
    "principal axes": body(
        "one",
        HEAVY + "quatf physics:principalAxes = (0.9238795325, 0, 0, 0.3826834324)\n" + cube("box"),
        moved(0, 1, 0, turn=(30, 0, 0)),
    ),
    "inertia without mass": body("one", "float3 physics:diagonalInertia = (1, 2, 2.5)\n" + cube("box")),
    "inertia tensor": body(
        "one",
        "double[] newton:inertia = [1, 2, 2.5, 0.1, 0.2, 0.3]\nfloat physics:mass = 7\n" + cube("box"),
        # With both schemas: Newton sees that its own includes the other only if no stage was opened before.
        apis='prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI", "NewtonMassAPI"]',
    ),
    "colliders with masses": body(
        "one",
        cube("a", "float physics:mass = 1\n" + moved(1, 0, 0), WITH_MASS)
        + cube("b", "float physics:mass = 3\n" + moved(-1, 0, 0), WITH_MASS),
    ),
    "collider with inertia": body(
        "one",
        cube(
            "a",
            "float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 2, 2.5)\n"
            "point3f physics:centerOfMass = (0.1, 0, 0)\n" + moved(1, 0, 0, turn=(0, 0, 90)),
            WITH_MASS,
        )
        + cube("b", moved(-1, 0, 0)),
    ),
    "meshes": body("a", prim("Mesh", "a_mesh", COLLIDER, mesh(CUBE)), moved(0, 0, 1, scale=(1, 2, 3)))
    + body("b", prim("Mesh", "b_mesh", HULL, mesh(more=CONVEX)), moved(9, 0, 0)),
}


def row(first=""):
    """Four bodies with a box each; ``first`` is added to the first."""
    return "".join(
        body(name, first * (i == 0) + cube(f"{name}_box"), moved(3 * i, 0, 0), BODY if i else PAIRED)
        for i, name in enumerate("abcd")
    )


# Stages whose pairs of colliders are compared.
TOUCHING = {
    "all": row(),
    "a group with itself": row() + group("g", "/a", "/b", filtered="</g>"),
    "two groups": row() + group("g", "/a", "/b", filtered="</h>") + group("h", "/c"),
    "an inverted group": row() + group("g", "/a", "/b", filtered="</g>", inverted=True) + group("h", "/c"),
    "an inverted group that touches all groups": row()
    + group("g", "/a", "/b", filtered="[</g>, </h>]", inverted=True)
    + group("h", "/c"),
    "a filtered pair": row("rel physics:filteredPairs = </b>\n"),
    "a filtered pair with an outer body": body(
        "a",
        "rel physics:filteredPairs = </c>\n" + cube("a_box") + body("b", cube("b_box"), moved(3, 0, 0)),
        apis=PAIRED,
    )
    + body("c", cube("c_box"), moved(0, 3, 0)),
}
