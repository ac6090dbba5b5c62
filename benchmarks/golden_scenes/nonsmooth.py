"""Golden scenes of nonsmooth contact: Moreau–Jean with both solvers, event-driven motion, static problems."""

from typing import Any

import numpy as np

from golden_scenes.couplings import joint_motions
from golden_scenes.mesh_contact import CORNERS, hills
from golden_scenes.names import Names
from golden_scenes.plan import Plan, Trial, require, spread

#: Sensors of the contact problem of a step.
SOLVE = (
    "scene.closed_contacts",
    "scene.solve_residual",
    "scene.solve_iterations",
    "scene.friction_dissipation",
    "scene.impact_dissipation",
    "scene.restitution_limited",
)


def rigid(names: Names, restitution: float = 0.3, mu: float = 0.4) -> Any:
    """Returns a contact material of rigid contact."""
    return names.ContactMaterial(
        law=names.make("law", "Rigid", restitution=restitution), friction=names.make("friction", "Coulomb", mu=mu)
    )


def boxes(names: Names, solver: str, precision: str) -> Plan:
    """Two boxes that fall on a terrain and on each other, and one with compliant feet.

    Args:
        names: The public API.
        solver: Solver of the contact problem.
        precision: Precision of the model.
    """
    scene = names.Scene()
    ground = scene.add_surface(hills(names), name="ground")
    skins, points = [], []
    for name, z in (("lower", 0.2), ("upper", 0.36)):
        body = scene.add_body(
            2.1, (0.01, 0.012, 0.015), (0.0, 0.0, z), angular_velocity=(1.0, 0.5, 2.0), name=name
        )
        skins.append(scene.add_surface(names.meshes.box((0.2, 0.16, 0.12)), body, name=f"{name}_skin"))
        points.append(scene.add_points(body, CORNERS, name=f"{name}_corners"))
    scene.add_contact(points[0], ground, rigid(names), name="lower_ground")
    scene.add_contact(points[1], ground, rigid(names), name="upper_ground")
    scene.add_contact(points[1], skins[0], rigid(names, 0.1, 0.6), max_depth=0.05, name="between")
    soft = names.ContactMaterial(
        law=names.make("law", "HuntCrossley", stiffness=2.1e5, restitution=0.6),
        friction=names.make("friction", "Tanh", mu=0.4),
    )
    scene.add_contact(scene.add_point(skins[0].body, (0, 0, 0)), ground, soft, radius=0.07, name="fender")
    contacts = ["lower_ground", "upper_ground", "between"]
    return Plan(
        scene,
        dt=1e-3,
        steps=600,
        every=10,
        values={
            "lower_ground.law.restitution": spread(0.0, 0.6),
            "upper.linear_velocity": spread((0, 0, -1.0), (0.5, 0.2, -2.0)),
            "between.friction.mu": spread(0.1, 0.9),
        },
        record=[*SOLVE, *(f"{name}.{sensor}" for name in contacts for sensor in ("impulse", "mode"))],
        precision=precision,
        integrator=names.make("integrator", "MoreauJean", solver=solver, compliant=["fender"], recovery_time=0.05),
        touches=["lower_ground.impulse", "scene.impact_dissipation"],
        check=lambda arrays: require((arrays["recording/between.impulse"] != 0).any(), "the boxes do not touch"),
    )


def at_rest(names: Names) -> Plan:
    """Boxes at rest on a plane, with steps that are skipped because they would change nothing."""
    scene = names.Scene()
    ground = scene.add_surface(names.meshes.grid((4.0, 4.0)), name="ground")
    box = scene.add_body(2.1, (0.01, 0.012, 0.015), (0.0, 0.0, 0.0601), name="box")
    scene.add_contact(scene.add_points(box, CORNERS[CORNERS[:, 2] < 0]), ground, rigid(names), name="feet")
    return Plan(
        scene,
        dt=1e-3,
        steps=800,
        every=200,
        values={"box.linear_velocity": spread((0, 0, 0), (1.0, 0.3, 0))},
        record=[*SOLVE, "feet.impulse", "feet.mode"],
        integrator=names.make("integrator", "MoreauJean", solver="gauss_seidel"),
        touches=["feet.impulse"],
    )


def mechanisms(names: Names) -> Plan:
    """Nonsmooth contact of shapes, bodies on joints, prescribed motions and particles, in one problem."""
    scene = names.Scene()
    material = rigid(names)
    with_rolling = names.ContactMaterial(
        law=names.make("law", "Rigid", restitution=0.2),
        friction=names.make("friction", "Coulomb", mu=0.4),
        rolling=names.make("friction", "Coulomb", mu=0.02),
        torsion=names.make("friction", "Coulomb", mu=0.05),
    )
    ground = scene.add_surface(hills(names, 2.0), name="ground")
    plane = scene.add_shape(None, names.make("shape", "Plane"), position=(0.0, 0.0, -0.05), name="plane")
    for number, name in enumerate(("planar", "revolute", "prismatic", "spherical")):
        motion, start = joint_motions(names)[name]
        x = 0.5 * number - 1.5
        body = scene.add_body(1.1, (0.02, 0.03, 0.04), (x, 0.1, 0.3), motion=motion(x), name=name, **start)
        point = scene.add_point(body, (0.2, 0.02, -0.1), name=f"{name}_tip")
        scene.add_contact(point, ground, material, radius=0.05, name=f"{name}_touch")
    table = scene.add_body(
        1.1, (1, 1, 1), (0.8, 1.2, 0.2),
        motion=names.make("joint", "Harmonic", direction=(0, 0, 1), amplitude=0.02, frequency=4.0), name="table",
    )  # fmt: skip
    sheet = scene.add_surface(names.meshes.grid((0.8, 0.8)), table, name="sheet")
    rider = scene.add_body(0.53, (1e-3,) * 3, (0.8, 1.2, 0.27), angular_velocity=(0, 8.0, 5.0), name="rider")
    scene.add_contact(
        scene.add_point(rider, (0, 0, 0)), sheet, with_rolling, radius=0.05, torsion_radius=0.01, name="ride"
    )
    egg = scene.add_body(1.1, (5e-3, 6e-3, 7e-3), (-1.0, -1.2, 0.1), angular_velocity=(1, 2, 3), name="egg")
    shell = scene.add_shape(egg, names.make("shape", "Ellipsoid", (0.12, 0.09, 0.08)), name="shell")
    names.method(scene, "add_shape_contact", shell, plane, material, name="tap")
    places = np.array([[0.0, 0.0, 0.2], [0.01, 0.0, 0.35], [0.0, 0.02, 0.5]]) + np.array([0.8, -1.2, 0.0])
    balls = scene.add_bodies(places, 0.5, (1e-3,) * 3, name="balls")
    spheres = scene.add_shape(balls, names.make("shape", "Sphere", 0.07), name="spheres")
    names.method(scene, "add_particle_contact", spheres, material, name="heap")
    scene.add_contact(scene.add_point(balls, (0, 0, 0)), ground, material, radius=0.07, name="bed")
    return Plan(
        scene,
        dt=1e-3,
        steps=500,
        every=10,
        values={"tap.law.restitution": spread(0.0, 0.6), "heap.friction.mu": spread(0.1, 0.8)},
        record=[
            *SOLVE,
            "ride.impulse",
            "ride.torque",
            "tap.impulse",
            "bed.impulse",
            "revolute_touch.impulse",
            "balls.force",
        ],
        precision="float64",
        integrator=names.make("integrator", "MoreauJean", solver="auto", theta=0.55),
        touches=["ride.impulse", "tap.impulse", "bed.impulse", "revolute_touch.impulse"],
    )


def event_driven(names: Names) -> Plan:
    """A bouncing ball with spin and a sliding block, from event to event, and an equilibrium."""
    scene = names.Scene()
    ground = scene.add_surface(names.meshes.grid((10.0, 10.0)), name="ground")
    ball = scene.add_body(
        2.1,
        (8e-3,) * 3,
        (0.0, 0.0, 0.4),
        linear_velocity=(0.5, 0.0, 0.0),
        angular_velocity=(1.0, 5.0, 2.0),
        name="ball",
    )
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, rigid(names, 0.6, 0.2), radius=0.1, name="touch")
    values = {"ball.position": [(0, 0, 0.4), (0, 0, 0.6)]}
    return Plan(scene, envs=2, precision="float64", run=_event_run, values=values, still=True)


def _event_run(trial: Trial) -> None:
    unilateral = trial.names.unilateral
    model = trial.model()
    for env in range(trial.plan.envs):
        found = unilateral.EventDriven(model, env).run(1.2, every=0.02)
        require(len(found.events) > 3, "there are too few events")
        group = f"results/env_{env}"
        for quantity in ("position", "orientation", "linear_velocity", "angular_velocity"):
            trial.keep(f"{group}/{quantity}", found[f"ball.{quantity}"].values)
        trial.keep(f"{group}/event_time", [event.time for event in found.events])
        trial.keep(f"{group}/event_impulse", [event.impulse for event in found.events])
        trial.keep(f"{group}/event_kind", [str(event.kind) for event in found.events])


def static_problems(names: Names) -> Plan:
    """Static unilateral problems by every method, with and without friction, and an equilibrium of a body."""
    scene = names.Scene()
    ground = scene.add_surface(names.meshes.grid((10.0, 10.0)), name="ground")
    box = scene.add_body(10.0, (4.17, 4.17, 1.67), (0, 0, 1.0), external_force=(20.0, 5.0, 0), name="box")
    corners = scene.add_points(box, [(x, y, -1.0) for x in (-0.5, 0.5) for y in (-0.5, 0.5)], name="corners")
    scene.add_contact(corners, ground, rigid(names, 0.5, 0.5), name="feet")
    return Plan(scene, envs=1, precision="float64", run=_static_run, still=True)


def _static_run(trial: Trial) -> None:
    unilateral = trial.names.unilateral
    random = np.random.default_rng(7)
    rows = random.normal(size=(20, 12, 18))
    delassus = rows @ np.swapaxes(rows, 1, 2)
    w = 2.0 * random.normal(size=(20, 4, 3))
    w[..., 0] -= 1.0
    for method in ("projection", "gauss_seidel", "prox", "energy"):
        options = {"device": trial.device} if method != "projection" else {}
        found = unilateral.solve_delassus(delassus, w, mu=0.4, method=method, **options)
        for name in ("lam", "status", "iterations", "residual"):
            trial.keep(f"results/{method}/{name}", getattr(found, name))
    chain = 1000.0 * (2.0 * np.eye(5) - np.eye(5, k=1) - np.eye(5, k=-1))
    loads = np.array([30.0, -5.0, 12.0, 4.0, 18.0]) * np.linspace(0.5, 2.0, 8)[:, None]
    d = [0.020, 0.060, 0.055, 0.080, 0.070]
    for method in ("enumeration", "energy", "projection", "prox", "gauss_seidel"):
        many = loads if method != "enumeration" else loads[4]
        found = unilateral.solve(chain, many, np.eye(5), d, method=method)
        require(np.any(found.lam > 0), "no contact is closed")
        for name in ("u", "lam", "gap", "residual"):
            trial.keep(f"results/chain/{method}/{name}", getattr(found, name))
    # A block on two feet, which share friction in any proportion: the Delassus matrix is singular.
    rows = np.array([[0, 1, -0.5], [1, 0, 1.0], [0, 1, 0.5], [1, 0, 1.0]])
    block = unilateral.Problem(
        K=np.diag([10.0, 10.0, 4.17]), f=[20.0, -98.1, 3.0], G=-rows.reshape(2, 2, 3), d=[0.0, 0.0], mu=0.5
    )
    for name in ("u", "lam"):
        trial.keep(f"results/block/{name}", getattr(block.solve(), name))
    equilibrium = unilateral.equilibrium(trial.model())
    require(equilibrium.holds, "the box is not in equilibrium")
    trial.keep("results/equilibrium/force", equilibrium.force)
    trial.keep("results/equilibrium/mode", equilibrium.mode)


SCENES = {
    "moreau_jean_gauss_seidel": lambda names: boxes(names, "gauss_seidel", "float32"),
    "moreau_jean_accelerated_float64": lambda names: boxes(names, "accelerated", "float64"),
    "moreau_jean_at_rest": at_rest,
    "moreau_jean_mechanisms_float64": mechanisms,
    "event_driven": event_driven,
    "static_problems": static_problems,
}
