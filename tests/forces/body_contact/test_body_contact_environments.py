"""Body contact with sizes, poses and parameters that differ between environments, with pressure and with impulses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import warpcontact as wc

K = 1e8  # Pa/m
BOX = (0.2, 0.16, 0.12)  # m
TURN = Rotation.from_rotvec([0.1, 0.2, 0.3])
# Sizes of shapes by name of the parameter [m], and the height of the center over the lowest point if they stand.
SIZES = {
    "RoundedBox": ({"half_extents": np.array(BOX) / 2}, 0.06),
    "Sphere": ({"radius": 0.05}, 0.05),
    "Ellipsoid": ({"semi_axes": np.array([0.05, 0.03, 0.08])}, 0.08),
    "Cylinder": ({"radius": 0.05, "half_length": 0.1}, 0.1),
    "Cone": ({"radius": 0.06, "height": 0.12}, 0.0),
    "Capsule": ({"radius": 0.04, "half_length": 0.08}, 0.12),
}


def form(kind, scale=1.0):
    """Returns a shape of a class, ``scale`` times as large."""
    sizes = {key: scale * value for key, value in SIZES[kind][0].items()}
    return getattr(wc.shapes, kind)(**{k: tuple(v) if np.ndim(v) else v for k, v in sizes.items()})


def add_solids(scene, scale=1.0, place=lambda number, height: (0, 0, height), turn=TURN):
    """Adds a body for a mesh, and for each kind of shape; returns their solids by name."""
    solids = {}
    for i, kind in enumerate(("mesh", *SIZES)):
        position = place(i, SIZES["RoundedBox" if kind == "mesh" else kind][1])
        body = scene.add_body(
            mass=1.0, inertia=(0.01,) * 3, position=position, orientation=turn.as_quat(), name=f"{kind}_body"
        )
        if kind == "mesh":
            solids[kind] = scene.add_surface(wc.meshes.box(BOX), body, scale=scale, name=kind)
        else:
            solids[kind] = scene.add_shape(body, form(kind, scale), name=kind)
    return solids


@pytest.mark.parametrize("floor", ["half-space", "mesh", "box"])
def test_force_grows_with_the_cube_of_the_scale(floor, device):
    """All lengths of an environment, with the depth, are multiplied by its scale."""
    scales = np.array([1e-2, 1.0, 1e2])
    scene = wc.Scene(gravity=(0, 0, 0))
    solids = add_solids(scene)
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
    floors = []
    for i, (kind, solid) in enumerate(solids.items()):
        name = f"{kind}_floor"
        if floor == "half-space":
            lower = scene.add_shape(None, wc.shapes.Plane(), name=name)
        elif floor == "mesh":
            lower = scene.add_surface(wc.meshes.box((0.5, 0.5, 0.2)), position=(10 * i, 0, -0.1), name=name)
        else:
            lower = scene.add_shape(
                None, wc.shapes.RoundedBox((0.25, 0.25, 0.1)), position=(10 * i, 0, -0.1), name=name
            )
        floors.append(lower)
        scene.add_body_contact(solid, lower, material, name=f"{kind}_press")
    model = scene.build(envs=3, device=device, precision="float64")
    column = scales[:, None]
    for i, kind in enumerate(solids):
        height = SIZES["RoundedBox" if kind == "mesh" else kind][1]
        # Overlap of some millimeters; an ellipsoid and a cone are tilted as well.
        model[f"{kind}_body.position"] = column * [10 * i + 0.01, 0.02, height - 2e-3]
        model[f"{kind}_body.orientation"] = np.tile(TURN.as_quat(), (3, 1))
        if kind == "mesh":
            model["mesh.scale"] = scales
        else:
            for key, value in SIZES[kind][0].items():
                model[f"{kind}.{key}"] = np.multiply.outer(scales, value)
        if floor != "half-space":
            model[f"{kind}_floor.position"] = column * [10 * i, 0, -0.1]
        if floor == "mesh":
            model[f"{kind}_floor.scale"] = scales
        elif floor == "box":
            model[f"{kind}_floor.half_extents"] = column * [0.25, 0.25, 0.1]
    for kind in solids:
        for key, power in {"force": 3, "torque": 4, "area": 2, "volume": 3, "depth": 1, "max_pressure": 1}.items():
            values = model.sensor(f"{kind}_press.{key}")
            values = values / scales.reshape(-1, *(1,) * (values.ndim - 1)) ** power
            # A sphere without friction has no torque.
            size = np.abs(values[1] if key != "torque" else 0.1 * model.sensor(f"{kind}_press.force")[1]).max()
            assert size > 0, (kind, key)
            # Rounding of positions of up to 60 m, relative to depths of millimeters.
            np.testing.assert_allclose(values, np.broadcast_to(values[1], values.shape), atol=1e-10 * size)


def part_scene(value, rigid, mesh=None):
    """Returns a scene in which all parameters have values that follow from a number near 1."""
    scene = wc.Scene()
    turn = Rotation.from_rotvec([0.02 * value, -0.03 * value, 0.2 * value])
    scale = 1.0 + 0.1 * value
    solids = add_solids(
        scene,
        scale,
        lambda number, height: (10.0 * number, 3.0 * (number % 2), height * scale + 1e-4 * value),
        turn,
    )
    shelf = scene.add_surface(
        [wc.meshes.box((80.0, 1.0, 0.2)), wc.meshes.box((80.0, 2.0, 0.2))] if mesh is None
        else wc.meshes.box((80.0, 1.0 + mesh, 0.2)),
        position=(30.0, 0.1 * value, -0.1 + 2.2e-3 * value),
        orientation=Rotation.from_rotvec([0.01 * value, 0, 0]).as_quat(),
        scale=1.0 - 0.01 * value,
        name="shelf",
    )  # fmt: skip
    slab = scene.add_shape(
        None,
        wc.shapes.RoundedBox((40.0, 0.5 + 0.1 * value, 0.1)),
        position=(30.0, 3.0, -0.1 + 2e-3 * value),
        orientation=Rotation.from_rotvec([-0.01 * value, 0, 0]).as_quat(),
        name="slab",
    )
    law = wc.laws.Rigid(restitution=0.1 * value) if rigid else wc.laws.ElasticFoundation(stiffness=1e7 * value)
    friction = {"mu": 0.2 * value} if rigid else {"mu": 0.2 * value, "velocity_scale": 0.1}
    model = wc.friction.Coulomb if rigid else wc.friction.Tanh
    material = wc.ContactMaterial(law=law, friction=model(**friction))
    for i, (kind, solid) in enumerate(solids.items()):
        below = slab if i % 2 else shelf
        options = {"kappa": 0.3 * value, "max_depth": 0.05 * value, "margin": 2e-3 * value, "force_scale": value}
        if rigid and kind in ("Cone", "Ellipsoid"):
            below = scene.add_shape(None, wc.shapes.Plane(), (0, 0, 1e-3 * value), name=f"{kind}_plane")
        scene.add_body_contact(solid, below, material, name=f"{kind}_press", **options)
    return scene


@pytest.mark.parametrize("rigid", [False, True], ids=["pressure", "impulses"])
def test_environments_with_own_parameters_equal_scenes_with_these_values_bitwise(rigid, device):
    values, meshes = (0.7, 1.0, 1.3), (0, 1, 0)
    alone = [
        part_scene(value, rigid, mesh).build(device=device, precision="float64")
        for value, mesh in zip(values, meshes, strict=True)
    ]
    many = part_scene(1.0, rigid).build(envs=len(values), device=device, precision="float64")
    changed = set()
    for name in many:
        if name == "shelf.mesh":
            many[name] = meshes
            continue
        values_of_name = np.concatenate([one[name] for one in alone])
        if (values_of_name != values_of_name[0]).any():
            changed.add(name)
            many[name] = values_of_name
    kinds = ("mesh", *SIZES)
    contact = ("law.restitution" if rigid else "law.stiffness", "friction.mu", "kappa", "max_depth", "margin")
    wanted = {f"{kind}_press.{key}" for kind in kinds for key in (*contact, "force_scale")}
    wanted |= {f"{kind}.{key}" for kind, (sizes, _) in SIZES.items() for key in sizes}
    wanted |= {f"{name}.{key}" for name in ("shelf", "slab") for key in ("position", "orientation")}
    assert wanted | {"mesh.scale", "shelf.scale", "slab.half_extents"} <= changed
    integrator = {"integrator": wc.integrators.MoreauJean()} if rigid else {}
    simulations = [wc.Simulation(model, dt=2e-4, **integrator) for model in (*alone, many)]
    touched = set()
    for _ in range(6):
        for sim in simulations:
            sim.step(10)
        touched |= {kind for kind in kinds if np.abs(many.sensor(f"{kind}_press.force")).max() > 0}
        for kind in kinds:
            for sensor in (f"{kind}_body.position", f"{kind}_body.angular_velocity", f"{kind}_press.force"):
                together = many.sensor(sensor)
                for env, model in enumerate(alone):
                    np.testing.assert_array_equal(together[env], model.sensor(sensor)[0], err_msg=sensor)
    assert touched == set(kinds)


@pytest.mark.parametrize("rigid", [False, True], ids=["pressure", "impulses"])
def test_environment_equals_the_same_among_4096_bitwise_after_steps(rigid, device):
    """With history: springs of friction of patches, impulses and identities of points."""
    count, chosen = 4096, [0, 1717, 4095]
    law = wc.laws.Rigid() if rigid else wc.laws.ElasticFoundation(stiffness=1e7, damping=10.0)
    stick = wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1e4)
    friction = wc.friction.Coulomb(mu=0.5) if rigid else stick
    material = wc.ContactMaterial(law=law, friction=friction)
    models = []
    for envs in (count, len(chosen)):
        scene = wc.Scene()
        floor = scene.add_surface(wc.meshes.box((6.0, 6.0, 0.2)), position=(0, 0, -0.1), name="floor")
        solids = [floor]
        for kind in ("mesh", "RoundedBox", "Cylinder"):
            body = scene.add_body(mass=1.0, inertia=(0.01,) * 3, name=f"{kind}_body")
            if kind == "mesh":
                solids.append(scene.add_surface(wc.meshes.box(BOX), body))
            else:
                solids.append(scene.add_shape(body, form(kind)))
        scene.add_body_contact(solids, material, name="press")
        models.append(scene.build(envs=envs, device=device, precision="float32"))
    rng = np.random.default_rng(0)
    many, few = models
    for i, kind in enumerate(("mesh", "RoundedBox", "Cylinder")):
        height = SIZES["RoundedBox" if kind == "mesh" else kind][1]
        position = np.array([1.0 * i, 0.0, height - 1e-3]) + 1e-3 * rng.normal(size=(count, 3))
        turns = Rotation.from_rotvec([[0.01, 0.01, 1.0]] * rng.normal(size=(count, 3))).as_quat()
        velocity = 0.1 * rng.normal(size=(count, 3))
        for model, rows in ((many, slice(None)), (few, chosen)):
            model[f"{kind}_body.position"] = position[rows]
            model[f"{kind}_body.orientation"] = turns[rows]
            model[f"{kind}_body.linear_velocity"] = velocity[rows]
    for model in models:
        integrator = {"integrator": wc.integrators.MoreauJean()} if rigid else {}
        wc.Simulation(model, dt=1e-4, **integrator).step(2)
    for sensor in (
        "mesh_body.position",
        "RoundedBox_body.angular_velocity",
        "Cylinder_body.linear_velocity",
        "press.force",
    ):
        np.testing.assert_array_equal(many.sensor(sensor)[chosen], few.sensor(sensor), err_msg=sensor)
    assert (np.abs(many.sensor("press.friction_force")).max(axis=(0, 2)) > 0).sum() >= 3
