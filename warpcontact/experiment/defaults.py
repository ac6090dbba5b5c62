"""Default sensors and recording interval of an experiment."""

from warpcontact.experiment.schema import Settings
from warpcontact.model.environments import Environments
from warpcontact.scene.couplings import Bushing, Catenary, SpringDamper

# Default sensors of couplings.
_COUPLING_SENSORS: dict[type, tuple[str, str]] = {
    SpringDamper: ("length", "force"),
    Bushing: ("displacement", "force"),
    Catenary: ("tension_a", "tension_b"),
}

# Default number of intervals between frames.
FRAMES = 100


def default_interval(settings: Settings) -> float:
    """Returns the default time between frames [s]."""
    steps = max(1, round(settings.duration / settings.dt / FRAMES))
    return float(f"{steps * settings.dt:.12g}")


def default_sensors(model: Environments, *, with_gap: bool = False) -> list[str]:
    """Returns the default sensors: the most important ones of each element, and the kinetic energy of the scene.

    Args:
        model: The model.
        with_gap: Whether to include gaps of point contacts without contact, which require a search.
    """
    scene = model.scene
    depth = "gap" if with_gap else "penetration"
    sensors: list[tuple[str, tuple[str, ...]]]
    sensors = [(contact.name, (depth, "normal_force")) for contact in scene.contacts if contact.points.single]
    sensors += [(contact.name, ("gap", "normal_force")) for contact in scene.shape_contacts if contact.single]
    sensors += [(contact.name, ("contacts", "max_penetration")) for contact in scene.particle_contacts]
    sensors += [(coupling.name, _COUPLING_SENSORS[type(coupling)]) for coupling in scene.couplings]
    sensors += [(coupling.name, ("minimum_distance", "force")) for coupling in scene.contact_couplings]
    sensors += [(element.name, element.recorded) for element in scene.force_elements]
    # For sets only sums over all items are recorded by default.
    joints = [f"{body.name}.{key}" for body in scene.bodies if body.single for key in ("angle", "displacement")]
    names = [f"{name}.{key}" for name, keys in sensors for key in keys]
    return names + [name for name in joints if name in model.sensor_names] + ["scene.kinetic_energy"]
