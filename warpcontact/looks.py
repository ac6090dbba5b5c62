"""What is launched to look at a state: what sensors need, of some environments apart from the others."""

from collections.abc import Iterable, Set
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.kernels import measures
from warpcontact.kernels.motions.measures import coordinates
from warpcontact.of_scene import SMOOTH
from warpcontact.schedule import Span, force_stages

if TYPE_CHECKING:
    from warpcontact.unilateral.hard_contacts import HardContacts

#: Needs of sensors that tell of surfaces that are far away as well.
OF_FAR = ("distances", "points", "contact_couplings", *SMOOTH)
#: Needs that can be computed of some environments apart from the others, and in every step.
IN_PARTS = frozenset(("contacts", "wrenches", "distances", *measures.OF_BODIES, "points", "coordinates"))

#: What tells contacts and wrenches, of what is far away as well.
EVALUATED = frozenset(("wrenches", "distances"))

#: All needs.
KNOWN = IN_PARTS.union(OF_FAR, ("reactions", "piles"))


def known_needs(needs: Iterable[str]) -> frozenset[str]:
    """Returns ``needs``; raises ``ValueError`` if nothing tells how to compute one."""
    wanted = frozenset(needs)
    if unknown := wanted - KNOWN:
        raise ValueError(f"needs {sorted(unknown)} are not known, there are {sorted(KNOWN)}")
    return wanted


def in_parts(device: wp.Device, hard: "HardContacts | None", needs: Set[str]) -> bool:
    """Whether ``look_stages`` computes all that sensors with ``needs`` are of, and nobody waits for a device."""
    return device.is_cpu and needs <= IN_PARTS and not (hard is not None and shows(needs))


def shows(needs: Set[str]) -> bool:
    """Whether sensors with ``needs`` tell of contacts, of which hard ones have to be shown."""
    return not needs.isdisjoint(("contacts", "wrenches", *OF_FAR))


def looks_at_near(span: Span, needs: Set[str]) -> bool:
    """Whether looks for sensors with ``needs`` leave contacts as a step of ``span`` from there finds them."""
    return span.cached and span.model.device.is_cpu and shows(needs) and needs.isdisjoint(OF_FAR)


def look_span(
    kind: type[Span],
    model: Any,
    count: int,
    hard: "HardContacts | None",
    needs: Set[str],
    own: wp.array | None = None,
) -> Span:
    """Returns ``count`` environments, or the slice ``own`` of them, to be looked at.

    Forces are told of what may touch alone, unless a sensor is of what is far away: all is looked at then, and
    what is far is searched for, to the last digit. On a GPU steps alone leave out what cannot touch.
    """
    cached = model.device.is_cpu and needs.isdisjoint(OF_FAR)
    return kind(model, count, cached, ordered=True, hard=hard, slice=own)


def look_stages(span: Span, needs: Set[str], no_step: Any, all_active: Any) -> list[wp.Launch]:
    """Returns the launches that compute what sensors need, of frozen environments too.

    Args:
        span: The environments.
        needs: Those of the sensors.
        no_step: A step of 0 for each environment.
        all_active: The status of an active one for each.
    """
    a = span.model.arrays
    launches = []
    if shows(needs):
        # On a GPU what adds up empties queues as well, and to what piles and nonsmooth contacts add has to be there.
        added_to = span.model.device.is_cuda or span.model.piles or span.hard is not None
        by_block = not added_to and "wrenches" not in needs
        launches += force_stages(span, a.state, no_step, all_active, by_block=by_block)
    return launches + measure_stages(span, needs, a.state, all_active)


def measure_stages(span: Span, needs: Set[str], state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that measure what sensors need of ``state``, whose contacts are computed.

    Args:
        span: The environments.
        needs: Those of the sensors.
        state: Their state.
        status: Of the environments [env]; left out are those that are not active.
    """
    model = span.model
    a, real = model.arrays, model.types.real
    launches = []
    for name, (_, kernel) in measures.OF_BODIES.items():
        if name in needs:
            launches += span.prepare(kernel(real), model.body_count, [status, a.model, state, getattr(a, name)])
    if "points" in needs:
        inputs = [status, a.model, state, a.contacts, a.points]
        launches += span.prepare(measures.points(real), model.contact_count, inputs)
    if "coordinates" in needs:
        inputs = [status, a.model, state, a.coordinates]
        launches += span.prepare(coordinates(real), model.body_count, inputs)
    return launches
