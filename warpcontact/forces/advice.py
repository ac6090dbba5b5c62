"""Warnings about the initial state of a model and the time step, of all force elements.

``Simulation.check`` returns them, and the first step issues them.
"""

from typing import TYPE_CHECKING

from warpcontact.forces.couplings.stability import stability_warnings

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments


def advice_needs_evaluation(model: "Environments", nonsmooth: "NonsmoothContacts | None") -> bool:
    """Returns whether ``scene_advice`` evaluates the contacts of the initial state."""
    # Elements of the first part have advice for all environments.
    return any(element.advice_needs_evaluation(model, nonsmooth) for element in model.parts[0].force_elements)


def scene_advice(
    model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None", stiffness_factor: float
) -> list[str]:
    """Returns the warnings about the initial state of a model and the time step.

    Args:
        model: The model.
        dt: Time step [s].
        nonsmooth: The nonsmooth contacts, which have impulses instead of forces; ``None``: there are none.
        stiffness_factor: That of the integrator, see ``Integrator.stiffness_factor``.
    """
    if advice_needs_evaluation(model, nonsmooth):
        model.evaluate()
    own = [
        sentence for element in model.parts[0].force_elements for sentence in element.advice(model, dt, nonsmooth)
    ]
    return own + stability_warnings(model, dt, stiffness_factor)
