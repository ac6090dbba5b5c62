"""State of an environment, a contact, a coupling or a line.

Of the last three it is what ``<contact>.status`` and ``<coupling>.status`` report.
"""

from enum import IntEnum

from warpcontact.kernels import types


class ContactStatus(IntEnum):
    """State of a contact.

    OPEN: not touching. CONTACT: touching. INACTIVE: the nearest point is not on the active part, or beyond the edge
    of a patch. FAR: nothing within the search radius. WRONG_SIDE: deeper than ``max_depth``, or come from the
    inner side with ``entry="latched"``. DISABLED: not enabled. NOT_CONVERGED: of a shape contact, where its
    surfaces meet was not found; no force acts.

    ``<contact>.gap`` is the signed distance at OPEN, CONTACT and WRONG_SIDE, where it is negative without contact;
    not less than 0 at INACTIVE; the search radius less the radius at FAR; NaN at DISABLED.
    """

    OPEN = types.OPEN
    CONTACT = types.CONTACT
    INACTIVE = types.INACTIVE
    FAR = types.FAR
    WRONG_SIDE = types.WRONG_SIDE
    DISABLED = types.DISABLED
    NOT_CONVERGED = types.UNSOLVED


class ContactMode(IntEnum):
    """What a nonsmooth contact does.

    OPEN: no force. STICK: it holds, and does not slide. SLIP: it holds, and slides, or nothing keeps it from it.
    """

    OPEN = types.MODE_OPEN
    STICK = types.MODE_STICK
    SLIP = types.MODE_SLIP


class CouplingStatus(IntEnum):
    """State of a spring-damper or a bushing.

    ACTIVE: acting. SLACK: ``tension_only``, and not stretched. BROKEN: by more than its ``break_force``. OUTSIDE:
    of the distances of its table, the end of which is held. NO_DIRECTION: its ends are in one place, and nothing
    is known of where they came from, so that no force acts. DISABLED: not enabled.
    """

    ACTIVE = types.COUPLING_ACTIVE
    SLACK = types.COUPLING_SLACK
    BROKEN = types.COUPLING_BROKEN
    OUTSIDE = types.COUPLING_OUTSIDE
    NO_DIRECTION = types.COUPLING_NO_DIRECTION
    DISABLED = types.COUPLING_DISABLED


class CatenaryStatus(IntEnum):
    """State of a catenary.

    HANGING: longer than the distance of its ends. TAUT: shorter, and stretched. FOLDED: its ends are above one
    another, and it hangs from both. GROUNDED: a part of it rests on the floor. SUNK: an end lies below the floor,
    and is taken to be on it. LOOSE: without weight and not stretched. DISABLED: not enabled. FAILED: no solution
    was found, and the forces are those of the last iterate.
    """

    HANGING = types.LINE_HANGING
    TAUT = types.LINE_TAUT
    FOLDED = types.LINE_FOLDED
    GROUNDED = types.LINE_GROUNDED
    SUNK = types.LINE_SUNK
    LOOSE = types.LINE_LOOSE
    DISABLED = types.LINE_DISABLED
    FAILED = types.LINE_FAILED


class EnvironmentStatus(IntEnum):
    """State of an environment between steps.

    ACTIVE: it is stepped. FROZEN: a step failed, and it is held at the last state before; ``FailureCause`` says why.
    STOPPED: it is held at the state at which a stop condition held.
    """

    ACTIVE = types.ENV_ACTIVE
    FROZEN = types.ENV_FROZEN
    STOPPED = types.ENV_STOPPED


class FailureCause(IntEnum):
    """Why an environment was frozen.

    NONE: it was not. NON_FINITE: its state, or what was to lead to it, was no longer made of finite numbers.
    TOO_FAST: a body was faster than ``scene.max_speed``. TOO_FAR: a body was farther from the origin than
    ``scene.max_distance``.
    """

    NONE = types.NO_CAUSE
    NON_FINITE = types.NON_FINITE
    TOO_FAST = types.TOO_FAST
    TOO_FAR = types.TOO_FAR
