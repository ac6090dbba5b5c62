"""Golden scenes of couplings and joints: springs, bushings, catenaries, contact couplings, prescribed motions."""

from typing import Any

import numpy as np
import warp as wp

from golden_scenes.mesh_contact import add_ball, hills, rubber
from golden_scenes.names import Names
from golden_scenes.plan import Plan, Trial, normal_forces, require, simulate, spread


def springs(names: Names, precision: str) -> Plan:
    """Spring-dampers of every kind, a rope, one that breaks, a custom spring and a bushing."""
    scene = names.Scene()
    hook = scene.add_point(None, (0.0, 0.0, 2.0), name="hook")
    stiffness = names.make("spring", "StiffnessTable", table=((0.0, 40.0), (0.4, 55.0), (1.5, 20.0)))
    force = names.make("spring", "ForceTable", table=((0.1, -3.0), (0.5, 0.3), (2.0, 9.0)), scale=1.5)
    damping = names.make("spring", "DampingTable", table=((0.0, 0.1), (0.5, 0.4), (2.0, 0.2)))
    polynomial = names.make("spring", "Polynomial", a=40.0, b=10.0, c=5.0)
    polynomial_damping = names.make("spring", "PolynomialDamping", a=0.3, b=0.1, c=0.05)
    linear, viscous = names.make("spring", "Linear", stiffness=51.0), names.make("spring", "Viscous", damping=0.3)
    undamped = names.make("spring", "Undamped")
    kinds: dict[str, dict[str, Any]] = {
        "plain": {"stiffness": 50.0, "damping": 0.2, "rest_length": 0.6},
        "linear": {"spring": linear, "damper": viscous, "rest_length": 0.6},
        "polynomial": {"spring": polynomial, "damper": polynomial_damping, "rest_length": 0.6},
        "stiffness_table": {"spring": stiffness, "damper": damping, "rest_length": 0.6},
        "force_table": {"spring": force, "damper": undamped},
        "rope": {"stiffness": 200.0, "damping": 0.5, "rest_length": 1.1, "tension_only": True},
        "weak": {"stiffness": 30.0, "rest_length": 0.4, "break_force": 40.0},
        "custom": {"spring": _custom_spring(names)(force_scale=5.0, length_scale=0.3), "rest_length": 0.6},
    }
    for number, (name, options) in enumerate(kinds.items()):
        body = scene.add_body(
            0.53, (5e-3, 6e-3, 7e-3), (0.3 * number - 1.0, 0.1 * number, 1.3), linear_velocity=(0.4, -0.3, 0.5),
            name=f"{name}_body",
        )  # fmt: skip
        end = scene.add_point(body, (0.02, 0.0, 0.05), name=f"{name}_end")
        scene.add_spring_damper(hook, end, name=name, **options)
    bushed = scene.add_body(
        0.53, (5e-3, 6e-3, 7e-3), (0.0, 0.0, 2.0), angular_velocity=(3.0, 2.0, 1.0), name="bushed"
    )
    scene.add_bushing(
        hook, scene.add_point(bushed, (0.0, 0.01, 0.0)), stiffness=(300.0, 200.0, 100.0), damping=(0.3, 0.2, 0.1),
        turn_stiffness=(2.0, 1.0, 0.5), turn_damping=(0.01, 0.02, 0.01),
        orientation=(0.1, 0.2, 0.3, 0.9273618495495704), name="bushing",
    )  # fmt: skip
    sensors = [f"{name}.{sensor}" for name in kinds for sensor in ("force", "rate", "status")]
    return Plan(
        scene,
        dt=5e-4,
        steps=1600,
        every=40,
        values={
            "plain.stiffness": spread(30.0, 80.0),
            "weak.break_force": spread(25.0, 30.0),
            "weak_body.linear_velocity": spread((0.4, -0.3, 0.5), (3.0, -2.0, -6.0)),
            "polynomial.damper.a": spread(0.1, 0.5),
            "bushed.external_torque": spread((0, 0, 0), (0.1, 0.2, 0.3)),
        },
        record=[*sensors, "bushing.force", "bushing.torque", "plain_body.force"],
        precision=precision,
        touches=[*(f"{name}.force" for name in kinds if name != "rope"), "bushing.torque"],
        check=lambda arrays: require((arrays["recording/weak.status"] == 2).any(), "no spring breaks"),
    )


def _custom_spring(names: Names) -> type:
    class Hardening(names.Spring):  # type: ignore[misc, name-defined]
        """f = F₀ sinh((x − x₀)/L)."""

        force_scale: float = names.parameter("N", "force F₀", above=0.0)
        length_scale: float = names.parameter("m", "length L", above=0.0)

        @wp.func
        def force(p: Any, s: Any):
            return p.force_scale * wp.sinh(s.extension / p.length_scale)

    return Hardening


def mooring(names: Names, precision: str) -> Plan:
    """A buoy on catenaries, with and without a sea bed, slack and taut."""
    scene = names.Scene()
    buoy = scene.add_body(
        5.0e3,
        (5e3, 6e3, 7e3),
        (0.0, 0.0, 0.0),
        linear_velocity=(2.0, 1.0, 0.5),
        external_force=(0, 0, 5.2e4),
        name="buoy",
    )
    fairlead = scene.add_point(buoy, (0.3, 0.1, -1.0), name="fairlead")
    ends = {"bed_1": (60, 10, -50), "bed_2": (-50, 40, -50), "bed_3": (-30, -70, -50), "free": (20, 5, -30)}
    for name, place in ends.items():
        anchor = scene.add_point(None, place, name=f"{name}_anchor")
        floor = -50.0 if name.startswith("bed") else None
        length = 100.0 if floor is not None else 36.0
        scene.add_catenary(
            anchor, fairlead, length=length, mass_per_length=20.0, axial_stiffness=1e6, floor=floor, name=name
        )
    sensors = ("tension_a", "tension_b", "grounded_length", "status")
    return Plan(
        scene,
        dt=5e-3,
        steps=400,
        every=10,
        values={"bed_1.length": spread(82.0, 110.0), "bed_2.mass_per_length": spread(10.0, 40.0)},
        record=[f"{name}.{sensor}" for name in ends for sensor in sensors],
        precision=precision,
        touches=[f"{name}.tension_b" for name in ends],
        run=_with_catenaries,
        check=lambda arrays: require(
            (arrays["recording/bed_1.grounded_length"] > 0).any(), "no catenary is grounded"
        ),
    )


def _with_catenaries(trial: Trial) -> None:
    sim = trial.simulation(trial.model())
    trial.record(sim, trial.plan.steps)
    trial.finish(sim)
    trial.keep("results/shape", trial.names.attribute(sim.model, "catenary_shape")("bed_1", count=9))
    trial.keep("results/stiffness", trial.names.attribute(sim.model, "catenary_stiffness")("free"))


def contact_coupling(names: Names) -> Plan:
    """A box kept off a wall and off another body by contact couplings, with friction."""
    scene = names.Scene(gravity=(0.0, 0.0, -1.0))
    wall = scene.add_surface(names.meshes.grid((1.0, 1.0), (4, 4)), name="wall")
    block = scene.add_body(
        5.0, (0.05, 0.06, 0.07), (0.0, 0.0, 0.13), linear_velocity=(0.3, 0.1, -1.0),
        angular_velocity=(0.2, 0.1, 0.5), name="block",
    )  # fmt: skip
    hull = scene.add_surface(names.meshes.box((0.2, 0.1, 0.2)), block, name="hull")
    other = scene.add_body(3.0, (0.05, 0.06, 0.07), (0.02, 0.01, 0.37), linear_velocity=(0, 0, -2.0), name="other")
    skin = scene.add_surface(names.meshes.icosphere(0.1, 2), other, name="skin")
    stop = names.ContactRange.from_impact(
        mass=5.0, area=0.02, speed=1.5, effective_range=0.03, closest=0.005, damping_ratio=0.1
    )
    friction = names.make("friction", "Tanh", mu=0.3)
    scene.add_contact_coupling(hull, wall, stop, friction, quadrature=3, damping_ramp=0.01, name="keep")
    scene.add_contact_coupling(skin, hull, stop, friction, sides="average", facing="all", name="apart")
    sensors = ("force", "torque", "effective_area", "minimum_distance")
    wanted = [f"{name}.{sensor}" for name in ("keep", "apart") for sensor in sensors]
    return Plan(
        scene,
        dt=2e-4,
        steps=1200,
        every=40,
        values={"block.linear_velocity": spread((0.3, 0.1, -0.5), (0.3, 0.1, -1.5)), "keep.k1": spread(8e5, 2e6)},
        record=[*wanted, "keep_first.friction_force"],
        options={"deterministic": True},  # a GPU otherwise sums the contacts of a surface by atomics
        touches=["keep.force", "apart.force", "keep.effective_area"],
        numbers=False,  # a minimum distance is NaN before the surfaces come into range
    )


def prescribed_motions(names: Names) -> Plan:
    """Bodies that follow functions of time, each with a ball that rides on it."""
    scene = names.Scene()
    table = {
        "times": (0.0, 0.05, 0.15, 0.3),
        "displacements": ((0, 0, 0), (0.05, 0, 0.02), (0.02, 0.1, 0), (0, 0, 0.1)),
    }
    motions = {
        "shaken": names.make("joint", "Harmonic", direction=(0, 0.3, 1), amplitude=0.02, frequency=6.0),
        "tilted": names.make(
            "joint", "Harmonic", direction=(1, 0, 0.2), angle=0.1, frequency=4.0, anchor=(0, 0, -0.2)
        ),
        "led": names.make(
            "joint", "Table", **table, rotations=((0, 0, 0), (0, 0.1, 0), (0.1, 0, 0.3), (0, 0, 0.5))
        ),
        "set": names.make("joint", "Prescribed"),
        "custom": _custom_motion(names)(amplitude=0.02, rate=30.0),
    }
    material = rubber(names)
    for number, (name, motion) in enumerate(motions.items()):
        place = np.array([0.6 * number - 1.2, 0.0, 0.0])
        velocity = {"linear_velocity": (0.2, 0.1, 0.3)} if name == "set" else {}
        body = scene.add_body(1.1, (0.01, 0.01, 0.01), place, motion=motion, name=name, **velocity)
        sheet = scene.add_surface(names.meshes.grid((0.5, 0.5), (2, 2)), body, name=f"{name}_sheet")
        _, center = add_ball(
            scene, f"{name}_ball", place + np.array([0.0, 0.0, 0.07]), linear_velocity=(0, 0, -0.5)
        )
        scene.add_contact(center, sheet, material, radius=0.05, name=f"{name}_touch")
    contacts = [f"{name}_touch" for name in motions]
    return Plan(
        scene,
        dt=2e-4,
        steps=1600,
        every=40,
        values={"shaken.motion.frequency": spread(4.0, 9.0), "led.motion.rate": spread(0.5, 1.5)},
        record=[*normal_forces(contacts), *(f"{name}.reaction_force" for name in motions)],
        touches=normal_forces(contacts),
    )


def _custom_motion(names: Names) -> type:
    class Heave(names.Motion):  # type: ignore[misc, name-defined]
        """z = a sin(ω t)."""

        amplitude: float = names.parameter("m", "amplitude a")
        rate: float = names.parameter("rad/s", "angular frequency ω")

        @wp.func
        def displacement(p: Any, t: Any):
            return wp.vec3d(wp.float64(0.0), wp.float64(0.0), p.amplitude * wp.sin(p.rate * t))

    return Heave


def joints(names: Names, precision: str) -> Plan:
    """Bodies on joints of every kind, in contact with a terrain."""
    scene = names.Scene()
    ground = scene.add_surface(hills(names, 2.0), name="ground")
    kinds = joint_motions(names)
    material = rubber(names)
    for number, (name, (motion, start)) in enumerate(kinds.items()):
        x = 0.5 * number - 1.5
        body = scene.add_body(1.1, (0.02, 0.03, 0.04), (x, 0.1, 0.35), motion=motion(x), name=name, **start)
        tip = scene.add_point(body, (0.2, 0.02, -0.12), name=f"{name}_tip")
        scene.add_contact(tip, ground, material, radius=0.06, name=f"{name}_touch")
    contacts = [f"{name}_touch" for name in kinds if name != "fixed"]
    return Plan(
        scene,
        dt=2e-4,
        steps=2400,
        every=60,
        values={
            "revolute.motion.axis": spread((0, 1, 0), (0.3, 1, 0.1)),
            "prismatic.external_force": spread((0, 0, 0), (0, 0, -5)),
            "planar.mass": spread(0.7, 1.5),
        },
        record=[
            *normal_forces(contacts),
            *(f"{name}.reaction_{load}" for name in kinds if name != "free" for load in ("force", "torque")),
            "revolute.angle",
            "prismatic.displacement_rate",
            "planar.angle",
        ],
        precision=precision,
        touches=normal_forces(contacts),
        run=simulate,
    )


def joint_motions(names: Names) -> dict[str, tuple[Any, dict[str, Any]]]:
    """Returns, by a name, the joint of a body at ``x`` as a function of ``x``, and its initial velocities."""
    along_z: dict[str, Any] = {"linear_velocity": (0.0, 0.0, -1.0)}
    return {
        "free": (lambda x: names.make("joint", "Free"), along_z),
        "fixed": (lambda x: names.make("joint", "Fixed"), {}),
        "translation": (lambda x: names.make("joint", "Translation"), along_z),
        "planar": (lambda x: names.make("joint", "Planar", normal=(0, 1, 0)), along_z),
        "revolute": (
            lambda x: names.make("joint", "Revolute", axis=(0, 1, 0), anchor=(x - 0.3, 0.1, 0.35)),
            {"angular_velocity": (0.0, 2.0, 0.0)},
        ),
        "prismatic": (lambda x: names.make("joint", "Prismatic", axis=(0, 0, 1)), along_z),
        "spherical": (
            lambda x: names.make("joint", "Spherical", anchor=(x - 0.2, 0.1, 0.45)),
            {"angular_velocity": (0.5, 2.0, 0.3)},
        ),
    }


SCENES = {
    "springs_float32": lambda names: springs(names, "float32"),
    "mooring_float64": lambda names: mooring(names, "float64"),
    "contact_coupling": contact_coupling,
    "prescribed_motions": prescribed_motions,
    "joints_float64": lambda names: joints(names, "float64"),
}
