"""Golden scenes of all normal laws and friction models: one ball per law, with a friction model each."""

from typing import Any

from golden_scenes.names import Names
from golden_scenes.plan import Plan, forces, normal_forces, spread

#: Parameters of every law. The stiffnesses stop a ball of 0.53 kg at 1 m/s within about 2 mm.
LAWS: dict[str, dict[str, float]] = {
    "Hooke": {"stiffness": 1.1e5},
    "Hertz": {"stiffness": 3.1e6},
    "HertzElastic": {"modulus": 1.1e7, "restitution": 0.7},
    "PowerLaw": {"stiffness": 2.1e6, "exponent": 1.4},
    "JohnsonCylinder": {"modulus": 3.1e6, "length": 0.05, "clearance": 9.0e-3},
    "PereiraCylinder": {"modulus": 2.3e6, "length": 0.05, "clearance": 9.0e-3},
    "PereiraCylinderExternal": {"modulus": 2.1e6, "length": 0.05, "clearance": 0.1},
    "ElasticFoundation": {"stiffness": 1.1e9, "area": 1.1e-4, "damping": 0.3},
    "ContactRange": {"k1": 1.1e9, "k2": 3.1e5, "ramp": 1e-3, "area": 1.1e-4},
    "HuntCrossley": {"stiffness": 3.1e6, "restitution": 0.6},
    "KelvinVoigt": {"stiffness": 1.1e5, "restitution": 0.6},
    "Tsuji": {"stiffness": 3.1e6, "restitution": 0.6},
    "TwoStiffness": {"stiffness": 1.1e5, "exponent": 1.1, "restitution": 0.6},
    "Anagnostopoulos": {"stiffness": 1.1e5, "restitution": 0.6},
    "HuntCrossley1975": {"stiffness": 3.1e6, "restitution": 0.6},
    "HerbertMcWhannell": {"stiffness": 3.1e6, "restitution": 0.6},
    "LeeWang": {"stiffness": 3.1e6, "restitution": 0.6},
    "LankaraniNikravesh": {"stiffness": 3.1e6, "restitution": 0.6},
    "Gonthier": {"stiffness": 3.1e6, "restitution": 0.6},
    "ZhiyingQishao": {"stiffness": 3.1e6, "restitution": 0.6},
    "Flores": {"stiffness": 3.1e6, "restitution": 0.6},
    "HuGuo": {"stiffness": 3.1e6, "restitution": 0.6},
    "CarvalhoMartins": {"stiffness": 3.1e6, "restitution": 0.6},
    "Jankowski": {"stiffness": 3.1e6, "restitution": 0.6},
    "PantWijeyewickrema": {"stiffness": 1.1e5, "exponent": 1.2, "restitution": 0.6},
    "KuwabaraKono": {"stiffness": 3.1e6, "viscosity": 3.1e-4},
    "HertzDashpot": {"stiffness": 3.1e6, "damping": 30.0},
    "Impact": {"stiffness": 3.1e6, "exponent": 1.5, "damping": 30.0, "depth": 5e-4},
    "PressureField": {"modulus": 1.5e9, "other_modulus": 4.1e9, "area": 1.1e-4, "damping": 0.3},
}

#: Parameters of every friction model.
FRICTIONS: dict[str, dict[str, float]] = {
    "Frictionless": {},
    "Viscous": {"drag": 0.7},
    "Tanh": {"mu": 0.4},
    "RegularizedCoulomb": {"mu": 0.4},
    "CoulombThreshold": {"mu": 0.4},
    "Threlfall": {"mu": 0.4},
    "Ambrosio": {"mu": 0.4},
    "StepFriction": {"mu_static": 0.5, "mu_dynamic": 0.4},
    "BengisuAkay": {"mu_static": 0.5, "mu_dynamic": 0.4},
    "Stribeck": {"mu_static": 0.5, "mu_dynamic": 0.4, "viscosity": 0.1},
    "BrownMcPhee": {"mu_static": 0.5, "mu_dynamic": 0.4, "viscosity": 0.1},
    "Hollars": {"mu_static": 0.5, "mu_dynamic": 0.4, "viscosity": 0.1},
    "SmoothStribeck": {"mu_static": 0.5, "mu_dynamic": 0.4},
    "Elliptic": {"mu_1": 0.4, "mu_2": 0.2, "angle": 0.3},
    "CundallStrack": {"mu_static": 0.5, "mu_dynamic": 0.4, "stiffness": 3.1e4, "damping": 3.0},
    "Mindlin": {"mu_static": 0.5, "mu_dynamic": 0.4, "shear_modulus": 5.1e6, "damping": 1.0},
    "Dahl": {"mu": 0.4, "stiffness": 1.1e3},
    "LuGre": {"mu_static": 0.5, "mu_dynamic": 0.4, "stribeck_speed": 0.05, "stiffness": 1.1e3, "damping": 0.7},
}

#: Laws per scene.
LAWS_PER_SCENE = 7


def laws(names: Names, number: int) -> Plan:
    """Drops spinning balls on a terrain, one per law, with a friction model each.

    An outcome is computed in each step, so that forces are computed by the staged kernels, which compile fast.

    Args:
        names: The public API.
        number: Number of the scene, which takes ``LAWS_PER_SCENE`` laws; scenes alternate in precision.
    """
    first = number * LAWS_PER_SCENE
    chosen = list(LAWS.items())[first : first + LAWS_PER_SCENE]
    friction_models = list(FRICTIONS.items())
    scene = names.Scene()
    ground = scene.add_surface(names.meshes.sinusoidal_terrain((4.0, 4.0), (16, 16), 0.05, 2.0), name="ground")
    for place, (law, values) in enumerate(chosen):
        friction, of_friction = friction_models[(first + place) % len(friction_models)]
        body = scene.add_body(
            mass=0.53,
            inertia=(5e-4, 6e-4, 7e-4),
            position=(0.5 * place - 1.5, 0.1, 0.12),
            linear_velocity=(0.3, -0.1, -1.0),
            angular_velocity=(2.0, -5.0, 3.0),
            name=law,
        )
        material = names.ContactMaterial(
            law=names.make("law", law, **values), friction=names.make("friction", friction, **of_friction)
        )
        centre = scene.add_point(body, (0.001, 0.002, 0.0))
        scene.add_contact(centre, ground, material, radius=0.05, name=f"{law}_{friction}")
    contacts = [contact.name for contact in scene.contacts]
    peak = names.make("outcome", "Max", f"{contacts[0]}.normal_force")
    values: dict[str, Any] = {f"{law}.mass": spread(0.4, 0.7) for law, _ in chosen}
    return Plan(
        scene,
        steps=1600,
        every=10,
        values=values,
        record=[*forces(contacts), *(f"{law}.linear_velocity" for law, _ in chosen)],
        precision=("float32", "float64")[number % 2],
        options={"outcomes": {"peak": peak}},
        touches=normal_forces(contacts),
    )


SCENES = {
    f"laws_{number + 1}": lambda names, number=number: laws(names, number)
    for number in range(-(-len(LAWS) // LAWS_PER_SCENE))
}
