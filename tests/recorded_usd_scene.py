"""A scene with many kinds of elements, its recording, and functions to read a stage."""

import numpy as np
import scenes
from pxr import Usd, UsdGeom, UsdValidation
from scipy.spatial.transform import Rotation

import warpcontact as wc

ENVS = 4
RADII = np.array([0.05, 0.06, 0.07, 0.08])
CORNERS = 0.2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
TILT = Rotation.from_rotvec([0.0, 0.3, 0.0]).as_quat()
SENSORS = ("gap", "normal_force", "friction_force", "normal", "point", "status", "slip_speed")


def simulate(device, precision="float32"):
    """A ball and a spinning cube, with a mesh and a point set, that fall onto a partly active floor."""
    scene = wc.Scene(gravity=(0.0, 0.0, -9.81))
    floor = scene.add_surface(
        scenes.square(5.0), name="floor", active_faces=[0], color=(0.8, 0.6, 0.4), position=(0.1, 0.2, -0.02)
    )
    scene.add_surface(scenes.square(), name="hidden", position=(0, 0, -3), orientation=TILT, visible=False)
    ball = scene.add_body(mass=0.5, inertia=(5e-4,) * 3, position=(2, -2, 0.1), name="ball", color=(1, 0, 0))
    cube = scene.add_body(
        mass=2.0,
        inertia=(0.05, 0.06, 0.07),
        position=(1, -2, 0.4),
        linear_velocity=(0.3, 0.0, 0.0),
        angular_velocity=(1, 2, 3),
        name="cube",
    )
    hull = scene.add_surface(wc.meshes.box((0.4, 0.3, 0.2)), body=cube, position=(0.1, 0, 0), name="hull")
    material = scenes.oracle_law()
    scene.add_contact(scene.add_point(ball, (0, 0, 0.01)), floor, material, radius=0.05, name="touch")
    corners = scene.add_points(cube, CORNERS, name="corners")
    scene.add_contact(corners, floor, material, name="cube-floor", color=(0, 1, 0))
    pins = scene.add_points(None, [(0, 0, 0), (0, 0, 9)], name="pins")
    scene.add_contact(pins, hull, material, radius=0.02, name="pin", visible=False, enabled=False)
    model = scene.build(envs=ENVS, device=device, precision=precision)
    model["touch.radius"] = RADII
    model["ball.linear_velocity"] = np.linspace((0, 0, 0), (1, 0, -1), ENVS)
    record = [f"{contact}.{key}" for contact in ("touch", "cube-floor") for key in SENSORS]
    record += ["pin.gap", "ball.force", "cube.force", "cube.linear_velocity", "cube.angular_velocity"]
    simulation = wc.Simulation(model, dt=1e-3)
    return simulation.run(duration=0.3, record=[*record, "scene.kinetic_energy"], every=1e-2)


def export(recording, tmp_path, suffix=".usda", **options):
    path = tmp_path / f"stage{suffix}"
    assert wc.export_usd(recording, path, **options) == path
    assert wc.check_usd(path) == []
    return Usd.Stage.Open(str(path))


def value(stage, path, name, code=None):
    attribute = stage.GetPrimAtPath(path).GetAttribute(name)
    assert attribute, f"{path}.{name}"
    found = attribute.Get() if code is None else attribute.Get(code)
    return np.array(found) if not isinstance(found, str) else found


def world(stage, path, code):
    """Rotation (3, 3) and translation of a prim, for column vectors."""
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(stage.GetPrimAtPath(path)))
    return matrix[:3, :3].T, matrix[3, :3]


def arrows(stage, path, code):
    """Starts and vectors (n, 3) of the arrows at ``path``, NaN if invisible."""
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath(path))
    ids = np.array(instancer.GetIdsAttr().Get(code))
    every = UsdGeom.PointInstancer.IgnoreMask
    given = instancer.ComputeInstanceTransformsAtTime(code, code, UsdGeom.PointInstancer.IncludeProtoXform, every)
    matrices = np.array(given)
    count = len(matrices) // 2
    assert list(instancer.GetProtoIndicesAttr().Get()) == [0] * count + [1] * count
    start = matrices[:count, 3, :3] - 0.5 * matrices[:count, 2, :3]
    end = matrices[count:, 3, :3] + 0.5 * matrices[count:, 2, :3]
    neck = matrices[:count, 3, :3] + 0.5 * matrices[:count, 2, :3]
    behind = matrices[count:, 3, :3] - 0.5 * matrices[count:, 2, :3]
    hidden = np.isin(ids, np.array(instancer.GetInvisibleIdsAttr().Get(code))).reshape(2, count)
    assert (hidden[0] == hidden[1]).all()
    unseen = np.where(hidden[0][:, None], np.nan, 0.0)
    np.testing.assert_allclose(neck + unseen, behind + unseen, atol=1e-5, err_msg="a head sits on its shaft")
    return start + unseen, end - start + unseen


def findings(stage):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 20
    return UsdValidation.ValidationContext(validators).Validate(stage)
