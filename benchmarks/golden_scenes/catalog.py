"""All golden scenes by name, and the entries of the catalogs that they do not use."""

from collections.abc import Callable

from golden_scenes import couplings, laws, mesh_contact, nonsmooth, runs, shapes
from golden_scenes.names import Names
from golden_scenes.plan import Plan

#: Functions that return the plans of all scenes. The first ones compile longest.
SCENES: dict[str, Callable[[Names], Plan]] = {
    **shapes.SCENES,
    **laws.SCENES,
    **nonsmooth.SCENES,
    **mesh_contact.SCENES,
    **couplings.SCENES,
    **runs.SCENES,
}


def uncovered(names: Names) -> dict[str, list[str]]:
    """Returns the classes of each catalog of the package that no scene uses; compiles no kernel."""
    for describe in SCENES.values():
        describe(names)
    return names.uncovered()
