"""Golden scenes of point contact with meshes: execution plans, options, several bodies, body sets."""

from typing import Any

import numpy as np
import warp as wp

from golden_scenes.names import Names
from golden_scenes.plan import Arrays, Plan, forces, normal_forces, require, spread

#: Corners of a box of 0.2 m × 0.16 m × 0.12 m, (8, 3) [m].
CORNERS = 0.5 * np.array([0.2, 0.16, 0.12]) * np.array(np.meshgrid(*[(-1, 1)] * 3)).T.reshape(-1, 3)


def rubber(names: Names, **values: Any) -> Any:
    """Returns the contact material that most scenes share, so that they share kernels."""
    law = names.make("law", "HuntCrossley", **({"stiffness": 2.1e5, "restitution": 0.6} | values))
    return names.ContactMaterial(law=law, friction=names.make("friction", "Tanh", mu=0.4))


def sticky(names: Names) -> Any:
    """Returns a contact material with history in friction, rolling and torsion."""
    return names.ContactMaterial(
        law=names.make("law", "KelvinVoigt", stiffness=5.1e4, restitution=0.6),
        friction=names.make(
            "friction", "CundallStrack", mu_static=0.5, mu_dynamic=0.4, stiffness=1.1e4, damping=5.0
        ),
        rolling=names.make("friction", "Tanh", mu=0.02),
        torsion=names.make("friction", "CundallStrack", mu_static=0.3, mu_dynamic=0.2, stiffness=1.1e4),
    )


def hills(names: Names, half: float = 1.0) -> Any:
    """Returns a terrain of 2 · 12² faces with vertices that float32 rounds."""
    return names.meshes.sinusoidal_terrain((2 * half, 2 * half), (12, 12), 0.07, 1.1)


def add_ball(scene: Any, name: str, position: Any, **options: Any) -> Any:
    """Adds a ball of 0.53 kg with unequal moments of inertia, and returns it with the point at its center.

    Masses of the scenes have reciprocals that are rounded, so that a change of the order of operations shows.
    """
    options = {"linear_velocity": (0.5, 0.2, -1.0), "angular_velocity": (3.0, -2.0, 5.0)} | options
    body = scene.add_body(0.53, (5e-4, 6e-4, 7e-4), position, name=name, **options)
    return body, scene.add_point(body, (0.001, 0.0, 0.002), name=f"{name}_center")


def one_ball(names: Names, precision: str) -> Plan:
    """A single-body environment without outcomes, which a CPU steps by multi-step launches."""
    scene = names.Scene()
    ground = scene.add_surface(hills(names), name="ground")
    _, center = add_ball(scene, "ball", (0.05, 0.1, 0.15))
    scene.add_contact(center, ground, rubber(names), radius=0.05, name="touch")
    return Plan(
        scene,
        steps=2000,
        every=20,
        values={
            "ball.linear_velocity": spread((0.1, 0.0, -0.5), (0.9, 0.4, -1.5)),
            "touch.law.restitution": spread(0.2, 0.9),
            "scene.gravity": spread((0, 0, -9.81), (0.5, 0.3, -9.0)),
        },
        record=[*forces(["touch"]), "touch.gap", "touch.status", "ball.linear_velocity"],
        precision=precision,
        integrator=names.make("integrator", "SemiImplicitEuler"),
        touches=normal_forces(["touch"]),
    )


def box_of_points(names: Names) -> Plan:
    """A box with 8 corners and 40 more points, in several clusters, with one radius per point."""
    scene = names.Scene()
    ground = scene.add_surface(hills(names), name="ground")
    box = scene.add_body(
        2.1, (0.01, 0.012, 0.015), (0.05, 0.0, 0.25), angular_velocity=(1.0, 2.0, 3.0), name="box"
    )
    more = np.random.default_rng(3).uniform(-0.06, 0.06, (40, 3))
    points = scene.add_points(box, np.concatenate([CORNERS, more]), name="points")
    radii = np.linspace(0.001, 0.01, len(points.positions))
    scene.add_contact(points, ground, rubber(names), radius=radii, kappa=0.3, name="hull")
    return Plan(
        scene,
        steps=3000,
        every=50,
        values={"box.mass": spread(1.0, 3.0), "hull.friction.mu": spread(0.1, 0.7)},
        record=["hull.normal_force", "hull.friction_force", "box.force", "box.torque"],
        touches=["hull.normal_force"],
    )


def surface_options(names: Names) -> Plan:
    """Active faces, several meshes, scale, boundary, search and other options of contacts, on one body."""
    scene = names.Scene()
    mesh = names.meshes.grid((1.0, 1.0), (4, 4))
    other = names.meshes.sinusoidal_terrain((1.0, 1.0), (6, 6), 0.02, 0.7)
    half = np.arange(len(mesh.faces)) % 3 != 0
    ground = scene.add_surface([mesh, other], name="ground", active_faces=[half, None], scale=1.1)
    body = scene.add_body(2.1, (0.02, 0.03, 0.04), (0.0, 0.0, 0.08), angular_velocity=(0.3, 1.0, 2.0), name="body")
    places = {"active": (0.2, 0.2), "outer": (0.5, 0.0), "deep": (-0.2, 0.1), "plain": (-0.3, -0.3), "off": (0, 0)}
    points = {name: scene.add_point(body, (*place, 0.0), name=f"{name}_point") for name, place in places.items()}
    material = rubber(names)
    options: dict[str, dict[str, Any]] = {
        "active": {"search": "active"},
        "outer": {"boundary": "outer", "kappa": 1.0},
        "deep": {"max_depth": 0.004, "search_radius": 0.3},
        "plain": {"force_scale": 0.5, "kappa": 0.0},
        "off": {"enabled": False},
    }
    for name, keywords in options.items():
        names.call(scene.add_contact, points[name], ground, material, radius=0.05, name=name, **keywords)
    return Plan(
        scene,
        steps=2400,
        every=40,
        values={
            "ground.mesh": [0, 1, 0, 1],
            "ground.scale": spread(0.9, 1.1),
            "body.position": spread((0.0, 0.0, 0.08), (0.05, -0.05, 0.1)),
            "deep.max_depth": spread(0.001, 0.01),
            "plain.force_scale": spread(0.5, 1.0),
            "off.enabled": [0, 0, 0, 1],
        },
        record=[
            "body.force",
            *forces(options),
            *(f"{name}.gap" for name in options),
            *(f"{name}.status" for name in options),
        ],
        touches=["body.force"],
        check=_options_act,
    )


def _options_act(arrays: Arrays) -> None:
    for name in ("active", "outer", "deep", "plain"):
        require((arrays[f"recording/{name}.normal_force"] != 0).any(), f"{name} never touches")
    require((arrays["recording/deep.status"] == 4).any(), "no penetration exceeds max_depth")
    require((arrays["recording/off.normal_force"][:, :3] == 0).all(), "a disabled contact acts")
    require((arrays["recording/outer.status"] == 1).any(), "no sphere touches the boundary")


def several_bodies(names: Names) -> Plan:
    """Balls on a moving plate and on a terrain, and a set of bodies, without outcomes."""
    scene = names.Scene()
    ground = scene.add_surface(hills(names), name="ground")
    plate = scene.add_body(3.0, (0.1, 0.1, 0.2), (0.0, 0.0, 0.4), angular_velocity=(0.2, 0.1, 1.0), name="plate")
    sheet = scene.add_surface(names.meshes.grid((0.6, 0.6), (2, 2)), plate, (0.0, 0.0, 0.01), name="sheet")
    material = rubber(names)
    _, center = add_ball(scene, "ball", (0.1, 0.05, 0.5))
    scene.add_contact(center, sheet, material, radius=0.05, name="on_plate")
    scene.add_contact(center, ground, material, radius=0.05, name="on_ground")
    scene.add_contact(
        scene.add_points(plate, 3.0 * CORNERS[:4]), ground, material, radius=0.02, name="plate_on_ground"
    )
    x, y = np.meshgrid([-0.6, 0.0, 0.6], [-0.6, 0.6])
    places = np.stack([x.ravel(), y.ravel(), np.full(6, 0.2)], axis=1)
    grains = scene.add_bodies(places, np.linspace(0.1, 0.3, 6), (1e-4,) * 3, name="grains")
    radii = np.linspace(0.02, 0.05, 6)
    scene.add_contact(scene.add_point(grains, (0, 0, 0)), ground, material, radius=radii, name="bed")
    contacts = ["on_plate", "on_ground", "plate_on_ground", "bed"]
    return Plan(
        scene,
        steps=3000,
        every=50,
        values={"grains.linear_velocity": spread((0.2, 0, -1), (-0.3, 0.4, -1)), "ball.mass": spread(0.3, 0.8)},
        record=[*forces(contacts), "plate.force", "grains.kinetic_energy", "scene.angular_momentum"],
        touches=normal_forces(["on_plate", "plate_on_ground", "bed"]),
    )


def rolling_and_torsion(names: Names, precision: str) -> Plan:
    """A ball that slides, rolls and spins on a slope, with history in friction and torsion."""
    scene = names.Scene(gravity=(0.7, 0.2, -9.81))
    ground = scene.add_surface(
        names.meshes.grid((4.0, 4.0), (5, 5)), orientation=(0.0, 0.1, 0.0, 0.995), name="ground"
    )
    _, center = add_ball(scene, "ball", (0.0, 0.0, 0.06))
    scene.add_contact(center, ground, sticky(names), radius=0.05, torsion_radius=0.01, name="touch")
    return Plan(
        scene,
        steps=3000,
        every=50,
        values={
            "ball.angular_velocity": spread((0.0, 0.0, 20.0), (5.0, 30.0, -10.0)),
            "touch.rolling.mu": spread(0.0, 0.05),
            "touch.torsion_radius": spread(0.002, 0.02),
        },
        record=[
            *forces(["touch"]),
            "touch.torque",
            "touch.slip_speed",
            "touch.friction.spring",
            "touch.torsion.spring",
        ],
        precision=precision,
        touches=["touch.normal_force", "touch.torque", "touch.friction.spring"],
    )


def latched(names: Names) -> Plan:
    """Latched and swept contacts of fast balls with a thin moving plate, with substeps at crossings."""
    scene = names.Scene(gravity=(0.0, 0.0, 0.0))
    carrier = scene.add_body(50.0, (5.0, 5.0, 9.0), angular_velocity=(0.1, 0.2, 0.3), name="carrier")
    plate = scene.add_surface(names.meshes.box((1.0, 1.0, 0.004)), carrier, name="plate")
    material = names.ContactMaterial(
        law=names.make("law", "Hooke", stiffness=1.1e4), friction=names.make("friction", "Tanh", mu=0.3)
    )
    options: dict[str, dict[str, Any]] = {
        "swept": {"swept": True},
        "latched": {"entry": "latched"},
        "both": {"entry": "latched", "swept": True},
    }
    for number, (name, keywords) in enumerate(options.items()):
        _, center = add_ball(
            scene, f"{name}_ball", (0.3 * number - 0.3, 0.05, 0.031), linear_velocity=(0.5, 0, -8)
        )
        scene.add_contact(center, plate, material, radius=0.01, name=name, **keywords)
    return Plan(
        scene,
        dt=1e-3,
        steps=120,
        every=4,
        values={f"{name}_ball.linear_velocity": spread((0.5, 0.1, -2.0), (1.0, -0.2, -9.0)) for name in options},
        record=[*forces(options), "swept.crossings", "both.crossings", *(f"{name}.status" for name in options)],
        options={"crossing_substeps": 4},
        touches=["swept.normal_force", "both.normal_force"],
        check=lambda arrays: require(
            (arrays["recording/swept.crossings"] > 0).any(), "no point crosses the plate"
        ),
    )


def surfaces(names: Names) -> Plan:
    """Contact of two surfaces by sample points with areas, from both sides, and with a custom law."""
    scene = names.Scene()
    bed = names.ContactMaterial(
        law=names.make("law", "ElasticFoundation", stiffness=3.1e7, damping=0.2),
        friction=names.make("friction", "Tanh", mu=0.4),
    )
    ground = scene.add_surface(hills(names), name="ground")
    skins = []
    for name, z in (("lower", 0.2), ("upper", 0.36)):
        body = scene.add_body(
            2.1, (0.01, 0.012, 0.015), (0.0, 0.0, z), angular_velocity=(1.0, 0.5, 2.0), name=name
        )
        skins.append(scene.add_surface(names.meshes.box((0.2, 0.16, 0.12)), body, name=f"{name}_skin"))
    scene.add_surface_contact(skins[0], ground, bed, samples=60, name="on_ground")
    scene.add_surface_contact(skins[1], skins[0], bed, samples=(40, "centroids"), sides="average", name="between")
    names_of = ["on_ground", "between_first", "between_second"]
    return Plan(
        scene,
        steps=2400,
        every=80,
        values={"lower.mass": spread(1.0, 3.0), "on_ground.law.stiffness": spread(2e7, 4e7)},
        record=[*normal_forces(names_of), "upper.force", "lower.torque"],
        touches=normal_forces(["on_ground", "between_first"]),
    )


def custom_law(names: Names) -> Plan:
    """A custom law and a custom friction model with history variables."""
    scene = names.Scene()
    ground = scene.add_surface(hills(names), name="ground")
    law, friction = _custom(names)
    _, center = add_ball(scene, "ball", (0.05, 0.1, 0.15))
    material = names.ContactMaterial(law=law(stiffness=3.1e7, softening=2e-3), friction=friction(stiffness=1.1e4))
    scene.add_contact(center, ground, material, radius=0.05, name="touch")
    return Plan(
        scene,
        steps=1600,
        every=20,
        values={"touch.law.stiffness": spread(2e7, 4e7)},
        record=[*forces(["touch"]), "touch.law.deepest", "touch.friction.spring"],
        options={"outcomes": {"peak": names.make("outcome", "Max", "touch.normal_force")}},
        touches=["touch.normal_force", "touch.law.deepest"],
    )


def _custom(names: Names) -> tuple[type, type]:
    class Softening(names.Law):  # type: ignore[misc, name-defined]
        """N = k δ² / (1 + deepest penetration / s)."""

        stiffness: float = names.parameter("N/m²", "stiffness k", above=0.0)
        softening: float = names.parameter("m", "penetration s at which the stiffness is half", above=0.0)

        deepest = names.history("m", "deepest penetration")

        @wp.func
        def advance(p: Any, c: Any, m: Any):
            m.deepest = wp.max(m.deepest, c.delta)
            return m

        @wp.func
        def force(p: Any, c: Any, m: Any):
            return p.stiffness * c.delta * c.delta / (type(c.delta)(1.0) + m.deepest / p.softening)

    class Elastic(names.Friction):  # type: ignore[misc, name-defined]
        """F = −k ξ with the tangential displacement ξ."""

        stiffness: float = names.parameter("N/m", "stiffness k", above=0.0)

        spring = names.history("m", "displacement ξ", tangent=True)

        @wp.func
        def advance(p: Any, s: Any, m: Any):
            m.spring = m.spring + m.elapsed * s.velocity
            return m

        @wp.func
        def force(p: Any, s: Any, m: Any):
            return -p.stiffness * m.spring

    return Softening, Elastic


SCENES = {
    "one_ball_float32": lambda names: one_ball(names, "float32"),
    "one_ball_float64": lambda names: one_ball(names, "float64"),
    "box_of_points": box_of_points,
    "surface_options": surface_options,
    "several_bodies": several_bodies,
    "rolling_torsion_float32": lambda names: rolling_and_torsion(names, "float32"),
    "rolling_torsion_float64": lambda names: rolling_and_torsion(names, "float64"),
    "latched_swept": latched,
    "surface_contact": surfaces,
    "custom_law": custom_law,
}
