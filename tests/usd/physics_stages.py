"""USD physics stages as text, for tests of the import."""

BODY = 'prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]'
COLLIDER = 'prepend apiSchemas = ["PhysicsCollisionAPI"]'
WEIGHT = "float physics:mass = 2\n float3 physics:diagonalInertia = (0.1, 0.2, 0.25)"
CUBE = "(-1,-1,-1), (1,-1,-1), (1,1,-1), (-1,1,-1), (-1,-1,1), (1,-1,1), (1,1,1), (-1,1,1)"
SIDES = "0,3,2,1, 4,5,6,7, 0,1,5,4, 1,2,6,5, 2,3,7,6, 3,0,4,7"


def text(content, *, metres=1.0, up="Z", header=""):
    unit = "" if metres is None else f"metersPerUnit = {metres}\n"
    return f'#usda 1.0\n(\n{unit}upAxis = "{up}"\n{header})\n{content}\n'


def stage(tmp_path, content, **metadata):
    path = tmp_path / "stage.usda"
    path.write_text(text(content, **metadata))
    return path


def prim(kind, name, apis="", content=""):
    return f'def {kind} "{name}" ({apis})\n{{\n{content}\n}}\n'


def moved(*place, scale=None, turn=None):
    """A pose: a translation, a rotation about x, y and z [degrees], scales."""
    ops = [("double3", "translate", place)]
    ops += [] if turn is None else [("double3", "rotateXYZ", turn)]
    ops += [] if scale is None else [("double3", "scale", scale)]
    values = "\n".join(f"{kind} xformOp:{name} = {tuple(value)}" for kind, name, value in ops)
    order = ", ".join(f'"xformOp:{name}"' for _, name, _ in ops)
    return f"{values}\nuniform token[] xformOpOrder = [{order}]\n"


def mesh(points=CUBE, indices=SIDES, counts="4,4,4,4,4,4", more=""):
    return (
        f"point3f[] points = [{points}]\nint[] faceVertexCounts = [{counts}]\n"
        f'int[] faceVertexIndices = [{indices}]\nuniform token subdivisionScheme = "none"\n{more}'
    )


def contact_pairs(scene):
    """Names of the elements of all contacts of two elements, and of all pairs of body contacts."""
    return [
        *((one.points.name, one.surface.name) for one in scene.contacts),
        *((one.shape.name, one.other_shape.name) for one in scene.shape_contacts),
        *((first.name, second.name) for one in scene.body_contacts for first, second in one.pairs),
    ]


def body(name="body", content="", pose="", apis=BODY):
    return prim("Xform", name, apis, f"{pose}\n{content}")
