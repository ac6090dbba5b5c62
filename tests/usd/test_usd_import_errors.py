"""Stages with invalid content, or content without a counterpart, are rejected with a list."""

import re

import all_elements_scene
import numpy as np
import pytest
from physics_stages import COLLIDER, CUBE, SIDES, WEIGHT, body, mesh, moved, prim, stage, text
from pxr import Usd

import warpcontact as wc
from warpcontact.meshes.isolation import Limits
from warpcontact.usd.author import identifiers
from warpcontact.usd.description import write_description

BALL = prim("Sphere", "ball", COLLIDER, "double radius = 1")


def problems(path, **options):
    with pytest.raises(wc.UsdError) as raised:
        wc.Scene.from_usd(path, **options)
    assert all(problem[:100] in str(raised.value) for problem in raised.value.problems[:1])
    return raised.value.problems


def weighing(line):
    return body(content=f"{line}\n{BALL}")


def part(points=CUBE, indices=SIDES, counts="4,4,4,4,4,4", more=""):
    return body(content=WEIGHT + "\n" + prim("Mesh", "part", COLLIDER, mesh(points, indices, counts, more)))


HULL = 'uniform token physics:approximation = "convexHull"'
KINEMATIC = "bool physics:kinematicEnabled = 1\n"
WRONG = {
    "negative mass": (weighing("float physics:mass = -1"), "/body: physics:mass must be at least 0, got -1"),
    "mass not a number": (weighing("float physics:mass = nan"), "/body: physics:mass must be at least 0, got nan"),
    "infinite mass": (weighing("float physics:mass = inf"), "/body: physics:mass must be at least 0, got inf"),
    "negative density": (weighing("float physics:density = -3"), "physics:density must be at least 0, got -3"),
    "negative inertia": (weighing("float3 physics:diagonalInertia = (1, -1, 1)"), "diagonalInertia must be"),
    "inertia of no body": (weighing("float3 physics:diagonalInertia = (1, 1, 5)"), "no principal moment may"),
    "centre not a number": (weighing("point3f physics:centerOfMass = (nan, 0, 0)"), "must be 3 finite numbers"),
    "velocity not a number": (weighing("vector3f physics:velocity = (nan, 0, 0)"), "physics:velocity must be"),
    "no mass at all": (body(), "/body: physics:mass must be authored"),
    "mass without a size": (body(content="float physics:mass = 1"), "physics:diagonalInertia must be authored"),
    "a place not a number": (body(content=WEIGHT, pose=moved("nan", 0, 0).replace("'", "")), "must be finite"),
    "flat": (body(content=BALL, pose=moved(0, 0, 0, scale=(1, 1, 0))), "must be invertible"),
    "points not numbers": (part(CUBE.replace("1,1,1", "1,nan,1")), "/body/part: points["),
    "an index too large": (part(indices=SIDES.replace("7", "9")), "must be from 0 to 7, got 9"),
    "a negative index": (part(indices=SIDES.replace("7", "-2")), "must be from 0 to 7, got -2"),
    "counts too large": (part(counts="4,4,4,4,4,5"), "add up to 25 vertices, but faceVertexIndices has 24"),
    "no faces": (part(counts="", indices=""), "the mesh has no faces"),
    "a flat hull": (
        body(content=WEIGHT + "\n" + prim("Mesh", "part", COLLIDER.replace("]", ', "PhysicsMeshCollisionAPI"]'),
             mesh("(0,0,0), (1,0,0), (1,1,0), (0,1,0)", "0,1,2,3", "4", HULL))),
        "/body/part: the points must not be coplanar",
    ),
    "a negative radius": (body(content=BALL.replace("= 1", "= -1")), "/body/ball: radius must be greater than 0"),
    "friction": (
        prim("Material", "m", 'prepend apiSchemas = ["PhysicsMaterialAPI"]', "float physics:staticFriction = -0.1")
        + body(content=prim("Sphere", "ball", 'prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]',
                            "rel material:binding:physics = </m>")),
        "/m: physics:staticFriction must be at least 0, got -0.1",
    ),
    "gravity": (
        prim("PhysicsScene", "s", "", "float physics:gravityMagnitude = nan") + body(content=WEIGHT),
        "/s: physics:gravityMagnitude must be a number, got nan",
    ),
    "nothing": (prim("Xform", "empty"), "there is no rigid body and no collider"),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_invalid_prim_is_refused_with_its_value_even_if_unsupported_prims_are_skipped(tmp_path, what):
    content, message = WRONG[what]
    for skip in (False, True):
        found = problems(stage(tmp_path, content), skip_unsupported=skip, trusted=True)
        assert any(message in problem for problem in found), found


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({"metres": 0.0}, "metersPerUnit must be positive and finite, got 0"),
        ({"metres": "nan"}, "metersPerUnit must be positive and finite, got nan"),
        ({"header": "kilogramsPerUnit = -1\n"}, "kilogramsPerUnit must be positive and finite, got -1"),
    ],
)
def test_invalid_stage_units_are_refused(tmp_path, metadata, message):
    assert message in problems(stage(tmp_path, body(content=WEIGHT), **metadata), trusted=True)[0]


def joint(kind="PhysicsRevoluteJoint", name="joint"):
    return prim(kind, name, "", "rel physics:body0 = </body>")


UNSUPPORTED = {
    "a joint": (joint(), "/joint: a joint, PhysicsRevoluteJoint"),
    "an articulation": (
        prim("Xform", "robot", 'prepend apiSchemas = ["PhysicsArticulationRootAPI"]'), "/robot: an articulation"
    ),
    "a deformable": (
        prim("Mesh", "cloth", 'prepend apiSchemas = ["PhysxDeformableBodyAPI"]'), "/cloth: a deformable body"
    ),
    "a prim of another program": (prim("MjcActuator", "motor"), "/motor: MjcActuator, a type of another program"),
    "an instancer": (
        prim("PointInstancer", "many", "", body("prototype", BALL) + "rel prototypes = </many/prototype>"),
        "/many/prototype: physics in a PointInstancer",
    ),
    "two scenes": (
        prim("PhysicsScene", "one") + prim("PhysicsScene", "two"), "/two: a scene in addition to /one"
    ),
    "curves": (prim("BasisCurves", "wire", COLLIDER), "/wire: a collider of type BasisCurves"),
    "a group that collides": (prim("Xform", "group", COLLIDER), "/group: a collider of type Xform"),
    "a sheared box": (
        prim("Xform", "outer", "", moved(0, 0, 0, scale=(1, 2, 1))
             + prim("Cube", "box", COLLIDER, "double size = 1\n" + moved(0, 0, 0, turn=(0, 0, 30)))),
        "/outer/box: a sheared box",
    ),
    "an uneven capsule": (
        prim("Capsule", "pill", COLLIDER, "double radius = 1\n" + moved(0, 0, 0, scale=(1, 2, 1))),
        "/pill: a capsule with unequal scales",
    ),
    "a body that is led": (
        body("led", KINEMATIC + "double3 xformOp:translate.timeSamples = {0: (0,0,0), 1: (1,0,0)}\n"
             'uniform token[] xformOpOrder = ["xformOp:translate"]'),
        "/led: a kinematic body whose pose is animated",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", UNSUPPORTED)
def test_unsupported_prim_is_refused_or_skipped_with_a_warning(tmp_path, what):
    content, message = UNSUPPORTED[what]
    path = stage(tmp_path, body(content=WEIGHT + "\n" + BALL) + content)
    (found,) = problems(path, trusted=True)
    assert message in found
    assert found.endswith("(not supported)")
    scene = wc.Scene.from_usd(path, skip_unsupported=True, trusted=True)
    assert [one.name for one in scene.bodies] == ["body"]
    assert any(remark.startswith("omitted: ") and message in remark for remark in scene.import_warnings)


def test_all_import_problems_are_listed(tmp_path):
    content = "".join(joint(name=f"joint_{i}") for i in range(70)) + weighing("float physics:mass = -1")
    path = stage(tmp_path, content)
    assert len(problems(path)) == 71
    with pytest.raises(wc.UsdError, match="has 71 problems") as raised:
        wc.Scene.from_usd(path)
    assert "and 21 more" in str(raised.value)


def test_long_names_are_shortened_in_messages(tmp_path):
    name = "b" * 10_000
    (found,) = problems(stage(tmp_path, body(name, BALL + "float physics:mass = -1")))
    assert "bbb…bbb" in found
    assert len(found) < 300


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("broken.usda", text('def Xform "a" {'), r"not valid USD: broken.usda, line \d+, column \d+: Expected }"),
        ("broken.usda", text("def Xform a {"), "line 6, column 1: syntax error"),
        ("broken.usda", text('def "a" {\n double x = "s"\n}'), "column 13: Error parsing simple value: [^/<]*"),
        ("other.usda", "nothing", "not valid USD: other.usda is not a valid usda layer"),
        ("broken.usdc", "PXR-USDC and no more", "not valid USD: File too small to contain bootstrap structure"),
        ("empty.usd", "", "not valid USD: 'empty.usd' is empty"),
        ("empty.usdc", "", "not valid USD: 'empty.usdc' is empty"),
        ("scene.gltf", "{}", "the extension '.gltf' is not one of .usd, .usda"),
    ],
)
def test_invalid_stage_files_are_refused(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_text(content)
    assert re.fullmatch(f".*{message}.*", problems(path)[0])
    assert not re.search(r"pxr|::|\n", problems(path)[0])


def test_missing_stage_file_is_refused(tmp_path):
    assert problems(tmp_path / "none.usda") == ("it does not exist",)
    (tmp_path / "folder.usda").mkdir()
    assert problems(tmp_path / "folder.usda") == ("it is not a regular file",)


def test_files_outside_the_folder_are_read_only_if_trusted(tmp_path):
    (tmp_path / "outer.usda").write_text(text(body(content=WEIGHT), header='defaultPrim = "body"\n'))
    (tmp_path / "in").mkdir()
    path = stage(tmp_path / "in", prim("Xform", "all", "prepend references = @../outer.usda@"))
    assert "outside of its folder" in problems(path)[0]
    assert [one.name for one in wc.Scene.from_usd(path, trusted=True).bodies] == ["all"]


def test_reader_crash_is_reported_as_an_error(tmp_path):
    # The parser of USD recurses into dictionaries until its stack is exhausted.
    deep = "dictionary a = {" * 50_000 + "}" * 50_000
    path = tmp_path / "deep.usda"
    path.write_text(f"#usda 1.0\n(\ncustomLayerData = {{ {deep} }}\n)\n")
    assert "the reader process crashed" in problems(path)[0]


@pytest.mark.slow
def test_slow_stage_is_refused_after_the_time_limit(tmp_path):
    doubling = "".join(
        prim("Xform", f"p{i}", "", "".join(prim("Xform", n, f"prepend references = </p{i - 1}>") for n in "ab"))
        for i in range(1, 24)
    )
    path = stage(tmp_path, body("p0", WEIGHT) + doubling)
    assert "takes more than 3 s of processor time" in problems(path, limits=Limits(seconds=3.0))[0]


def test_number_of_triangles_is_limited(tmp_path):
    assert "allowed: 5 triangles" in problems(stage(tmp_path, part()), limits=Limits(faces=5))[0]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"contact_time": 0.0}, ValueError, "contact_time must be greater than 0"),
        ({"samples": "all"}, ValueError, "samples must be a whole number of points"),
        ({"material": "rubber"}, TypeError, r"material must be a wc.ContactMaterial, a table of them, or None"),
        ({"skip_unsupported": "yes"}, ValueError, "skip_unsupported must be True or False"),
        ({"limits": 3}, TypeError, "limits must be a Limits or None"),
    ],
)
def test_invalid_import_arguments_are_refused(tmp_path, options, error, message):
    with pytest.raises(error, match=message):
        wc.Scene.from_usd(stage(tmp_path, body(content=WEIGHT)), **options)


def test_stage_with_several_descriptions_is_refused(tmp_path):
    scopes = "".join(prim("Scope", name, "", "custom int64 warpcontact:schema = 2") for name in "ab")
    assert "a stage must have one description, got descriptions at /a, /b" in problems(stage(tmp_path, scopes))[0]


@pytest.mark.slow
def test_damaged_description_is_read_or_refused_with_a_reason(tmp_path):
    stage = Usd.Stage.CreateInMemory()
    scene = all_elements_scene.contact_scene()
    write_description(stage, scene, identifiers(scene.element_names()))
    content = stage.GetRootLayer().ExportToString().encode()
    random = np.random.default_rng(6)
    reasons = []
    for number in range(40):
        data = bytearray(content)
        for place in random.integers(0, len(data), 20):
            data[place] = data[int(random.integers(0, len(data)))]
        path = tmp_path / f"{number}.usda"
        path.write_bytes(data)
        try:
            wc.Scene.from_usd(path)
        except wc.UsdError as error:
            reasons.append(error.problems)
    assert all(reasons)


@pytest.mark.slow
def test_damaged_stage_is_read_or_refused_with_a_reason(tmp_path):
    content = text(three_kinds()).encode()
    random = np.random.default_rng(5)
    reasons = []
    for number in range(60):
        data = bytearray(content)
        for place in random.integers(0, len(data), 3):
            data[place] = int(random.integers(32, 127))
        path = tmp_path / f"{number}.usda"
        path.write_bytes(data)
        try:
            wc.Scene.from_usd(path, skip_unsupported=True)
        except wc.UsdError as error:
            reasons.append(error.problems)
    assert all(reasons)


def three_kinds():
    floor = prim("Plane", "floor", COLLIDER, 'uniform token axis = "Z"')
    box = prim("Mesh", "box", COLLIDER, mesh())
    return (
        floor + body("one", WEIGHT + "\n" + BALL) + body("two", "float physics:mass = 2\n" + box, moved(1, 2, 3))
    )
