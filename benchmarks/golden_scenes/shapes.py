"""Golden scenes of contact between analytic shapes, and of contact among particles."""

from typing import Any

import numpy as np
import warp as wp

from golden_scenes.mesh_contact import rubber, sticky
from golden_scenes.names import Names
from golden_scenes.plan import Plan, Trial, forces, normal_forces, require, spread


def forms(names: Names) -> dict[str, Any]:
    """Returns a shape of every class but the plane, about 0.2 m large."""
    sizes: dict[str, tuple[Any, ...]] = {
        "Sphere": (0.1,),
        "Ellipsoid": ((0.12, 0.09, 0.08),),
        "Superellipsoid": ((0.12, 0.09, 0.08), (0.6, 0.8)),
        "Cylinder": (0.08, 0.1),
        "Capsule": (0.07, 0.08),
        "Cone": (0.1, 0.2),
        "RoundedBox": ((0.1, 0.09, 0.08), 0.02),
        "Torus": (0.1, 0.04),
    }
    return {name: names.make("shape", name, *size) for name, size in sizes.items()}


def on_a_plane(names: Names) -> Plan:
    """A shape of every class, dropped on a plane, with friction, in float64 like the geometry of shapes."""
    scene = names.Scene()
    plane = scene.add_shape(
        None, names.make("shape", "Plane"), orientation=(0.0, 0.05, 0.0, 0.99875), name="plane"
    )
    material = rubber(names)
    kinds = forms(names)
    for number, (name, form) in enumerate(kinds.items()):
        body = scene.add_body(
            1.1, (5e-3, 6e-3, 7e-3), (0.5 * number - 2.0, 0.0, 0.35), (0.2, 0.3, 0.1, 0.9273618495495704),
            linear_velocity=(0.3, 0.1, -1.0), angular_velocity=(2.0, 1.0, 3.0), name=f"{name}_body",
        )  # fmt: skip
        shape = scene.add_shape(body, form, (0.001, 0.0, 0.002), name=name)
        names.method(scene, "add_shape_contact", shape, plane, material, name=f"{name}_touch")
    contacts = [f"{name}_touch" for name in kinds]
    return Plan(
        scene,
        dt=2e-4,
        steps=2000,
        every=50,
        values={"Sphere.radius": spread(0.08, 0.12), "Torus.minor_radius": spread(0.03, 0.05)},
        record=[*forces(contacts), *(f"{contact}.gap" for contact in contacts)],
        precision="float64",
        touches=normal_forces(contacts),
    )


def pairs(names: Names) -> Plan:
    """Pairs of curved shapes with a law of the local curvatures and friction with history, in float64."""
    scene = names.Scene(gravity=(0.0, 0.0, 0.0))
    material = names.ContactMaterial(
        law=names.make("law", "HertzElastic", modulus=1.1e6, restitution=0.8),
        friction=names.make("friction", "CundallStrack", mu_static=0.5, mu_dynamic=0.4, stiffness=1.1e4),
        rolling=names.make("friction", "Tanh", mu=0.02),
    )
    kinds = forms(names)
    chosen = (("Ellipsoid", "Ellipsoid"), ("Capsule", "Superellipsoid"), ("Sphere", "Torus"))
    labels = []
    for number, pair in enumerate(chosen):
        shapes = []
        for side, kind in enumerate(pair):
            label = f"{kind}_{number}_{side}"
            body = scene.add_body(
                1.1, (5e-3, 6e-3, 7e-3), (0.01 * side, number, 0.25 * side), (0.2, 0.3, 0.1, 0.9273618495495704),
                linear_velocity=(0.0, 0.0, 1.0 - 2.0 * side), angular_velocity=(0.5, 1.0, 2.0),
                name=f"{label}_body",
            )  # fmt: skip
            shapes.append(scene.add_shape(body, kinds[kind], name=label))
        labels.append(f"pair_{number}")
        names.method(scene, "add_shape_contact", *shapes, material, name=labels[-1])
    return Plan(
        scene,
        dt=2e-4,
        steps=1000,
        every=20,
        values={
            "pair_0.law.modulus": spread(1e6, 3e6),
            "Ellipsoid_0_0.semi_axes": spread((0.12, 0.09, 0.08), (0.1, 0.1, 0.1)),
        },
        record=[*forces(labels), "pair_0.torque", "pair_0.point", "pair_1.curvature_2"],
        precision="float64",
        touches=normal_forces(labels),
    )


def parametric_surface(names: Names) -> Plan:
    """An ellipsoid that slides in a bowl, which is a custom parametric surface."""
    scene = names.Scene()
    bowl = scene.add_shape(None, _bowl(names)(radius=1.0), name="bowl")
    egg = scene.add_body(
        1.1,
        (5e-3, 6e-3, 7e-3),
        (0.2, 0.1, 0.14),
        linear_velocity=(0.3, -0.5, -0.3),
        angular_velocity=(1, 2, 3),
        name="egg",
    )
    shell = scene.add_shape(egg, forms(names)["Ellipsoid"], name="shell")
    names.method(scene, "add_shape_contact", shell, bowl, rubber(names), name="touch")
    return Plan(
        scene,
        dt=2e-4,
        steps=1000,
        every=20,
        values={"bowl.radius": spread(0.8, 1.2)},
        record=[*forces(["touch"]), "touch.gap", "touch.status"],
        touches=["touch.normal_force"],
    )


def _bowl(names: Names) -> type:
    class Bowl(names.ParametricSurface):  # type: ignore[misc, name-defined]
        """z = (x² + y²)/(2 r) over a square."""

        radius: float = names.parameter("m", "radius of curvature r", above=0.0)

        u_range = (-0.7, 0.7)
        v_range = (-0.7, 0.7)

        @wp.func
        def position(p: Any, u: Any, v: Any):
            return wp.vec3d(u, v, (u * u + v * v) / (wp.float64(2.0) * p.radius))

    return Bowl


def few_particles(names: Names) -> Plan:
    """Ten spheres and a capsule in a box-shaped heap on a terrain, with history per pair."""
    scene = names.Scene()
    ground = scene.add_surface(names.meshes.grid((4.0, 4.0), (3, 3)), name="ground")
    material = sticky(names)
    x, y, z = np.meshgrid([0.0, 0.19], [0.0, 0.2], [0.0, 0.19], indexing="ij")
    places = np.stack([x.ravel(), y.ravel(), z.ravel() + 0.15], axis=1) + np.arange(8)[:, None] * [
        0.003,
        -0.002,
        0.0,
    ]
    balls = scene.add_bodies(places, np.linspace(0.3, 0.6, 8), (2e-3,) * 3, name="balls")
    rod = scene.add_body(0.6, (2e-3, 5e-3, 5e-3), (0.1, 0.1, 0.6), angular_velocity=(0, 0, 4.0), name="rod")
    spheres = scene.add_shape(
        balls, [names.make("shape", "Sphere", 0.09 + 0.002 * i) for i in range(8)], name="spheres"
    )
    capsule = scene.add_shape(rod, names.make("shape", "Capsule", 0.06, 0.15), name="capsule")
    scene.add_contact(scene.add_point(balls, (0, 0, 0)), ground, material, radius=0.09, name="bed")
    names.method(scene, "add_particle_contact", [spheres, capsule], material, name="heap")
    return Plan(
        scene,
        dt=2e-4,
        steps=2000,
        every=50,
        values={"heap.law.stiffness": spread(3e4, 6e4), "rod.linear_velocity": spread((0, 0, -1), (0.5, 0.2, -2))},
        record=["heap.contacts", "bed.normal_force", "balls.force", "scene.kinetic_energy"],
        touches=["heap.contacts", "bed.normal_force"],
        run=_with_pairs,
    )


def many_particles(names: Names) -> Plan:
    """60 spheres, with neighbor lists, groups, an excluded pair and a fixed body, in float64."""
    scene = names.Scene()
    random = np.random.default_rng(5)
    x, y, z = np.meshgrid(np.arange(4.0), np.arange(4.0), np.arange(4.0), indexing="ij")
    places = 0.1 * np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)[:60] + random.uniform(
        -0.004, 0.004, (60, 3)
    )
    velocities = random.normal(0.0, 0.7, (60, 3))
    grains = scene.add_bodies(places, 0.1, (1e-4,) * 3, linear_velocities=velocities, name="grains")
    fixed = scene.add_body(1.1, (1, 1, 1), (0.15, 0.15, -0.3), motion=names.make("joint", "Fixed"), name="fixed")
    other = scene.add_body(0.2, (1e-3,) * 3, (0.15, 0.15, 0.6), linear_velocity=(0, 0, -3.0), name="other")
    sphere = names.make("shape", "Sphere", 0.05)
    shapes = [
        scene.add_shape(grains, sphere, group=1, mask=3, name="grain"),
        scene.add_shape(fixed, names.make("shape", "Sphere", 0.28), name="floor"),
        scene.add_shape(other, names.make("shape", "Capsule", 0.05, 0.05), group=2, mask=1, name="hammer"),
    ]
    names.method(
        scene, "add_particle_contact", shapes, rubber(names), exclude=[(shapes[1], shapes[2])], skin=0.01,
        max_neighbors=40, name="heap",
    )  # fmt: skip
    return Plan(
        scene,
        envs=3,
        dt=2e-4,
        steps=1200,
        every=60,
        values={"scene.gravity": spread((0, 0, -9.81), (1, 0, -9), 3), "heap.friction.mu": spread(0.1, 0.6, 3)},
        record=["heap.contacts", "grains.kinetic_energy", "other.force", "fixed.reaction_force"],
        precision="float64",
        touches=["heap.contacts"],
        run=_with_pairs,
    )


def _with_pairs(trial: Trial) -> None:
    sim = trial.simulation(trial.model())
    trial.record(sim, trial.plan.steps)
    trial.finish(sim)
    data = trial.names.attribute(sim.model, "contact_pairs")("heap")
    require(data.sizes["pair"] > 0, "no pair is in contact at the end")
    trial.keep_data_set("results", data)


SCENES = {
    "shapes_on_plane_float64": on_a_plane,
    "shape_pairs_float64": pairs,
    "parametric_surface": parametric_surface,
    "few_particles": few_particles,
    "many_particles_float64": many_particles,
}
