"""Sensors that exist only with nonsmooth contact."""

from collections.abc import Collection

from warpcontact.scene.scene_data import SceneData
from warpcontact.validation.checks import similar

#: Sensors of the scene: struct of ``NonsmoothContacts``, array, unit and meaning.
OF_SCENE = {
    "closed_contacts": ("solve_result", "count", "-", "number of closed nonsmooth contacts in the last step"),
    "solve_residual": (
        "solve_result",
        "residual",
        "-",
        "relative residual of the contact problem of the last step",
    ),
    "solve_iterations": ("solve_result", "iterations", "-", "number of solver iterations in the last step"),
    "solve_converged": ("solve_result", "converged", "-", "1: the solver converged in the last step"),
    "solve_failures": ("statistics", "failures", "-", "number of steps without convergence, since reset"),
    "restitution_limited": (
        "statistics",
        "restitution_limited",
        "-",
        "number of steps in which restitution was reduced, so that impacts add no energy",
    ),
    "friction_dissipation": (
        "statistics",
        "friction_dissipation",
        "J",
        "energy dissipated by friction of nonsmooth contacts, since reset",
    ),
    "impact_dissipation": (
        "statistics",
        "impact_dissipation",
        "J",
        "energy dissipated by impacts of nonsmooth contacts, since reset",
    ),
}

#: Sensors of contacts, and of points of body contacts.
OF_CONTACTS = ("impulse", "mode", "point", "point_gap", "point_force", "load_ratio", "overflow")


def is_nonsmooth_sensor(name: str) -> bool:
    """Returns whether a sensor, given by name, exists only with nonsmooth contact."""
    element, _, quantity = name.rpartition(".")
    return quantity in OF_SCENE if element == "scene" else quantity in OF_CONTACTS


def sensor_hint(name: str, stored_count: Collection[str], scene: SceneData) -> str:
    """Returns the end of a message about an unknown sensor: the required integrator, or similar names."""
    element = name.rpartition(".")[0]
    contacts = {contact.name for contact in scene.contacts} | {contact.name for contact in scene.shape_contacts}
    contacts |= {contact.name for contact in scene.body_contacts}
    if is_nonsmooth_sensor(name) and (element == "scene" or element in contacts):
        return "; only nonsmooth contact has it, with the integrator MoreauJean"
    return similar(name, stored_count)
