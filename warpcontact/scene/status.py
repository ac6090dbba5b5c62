"""Status codes of environments, contacts, couplings and catenaries.

``<contact>.status`` and ``<coupling>.status`` report them.
"""

from enum import IntEnum

from warpcontact.kernels import types


class ContactStatus(IntEnum):
    """Status of a contact.

    OPEN: not in contact. CONTACT: in contact. INACTIVE: the closest point is on an inactive face, or beyond the edge
    of a parametric surface. FAR: no surface within the search radius. WRONG_SIDE: deeper than ``max_depth``, or
    entered from the inner side with ``entry="latched"``. DISABLED: not enabled. NOT_CONVERGED: narrow phase of a
    shape contact did not converge; no force is applied.

    ``<contact>.gap`` is the signed distance at OPEN, CONTACT and WRONG_SIDE (negative without contact); not less than
    0 at INACTIVE; the search radius minus the radius at FAR; NaN at DISABLED.
    """

    OPEN = types.OPEN
    CONTACT = types.CONTACT
    INACTIVE = types.INACTIVE
    FAR = types.FAR
    WRONG_SIDE = types.WRONG_SIDE
    DISABLED = types.DISABLED
    NOT_CONVERGED = types.UNSOLVED


class ContactMode(IntEnum):
    """Contact mode of a nonsmooth contact.

    OPEN: no impulse. STICK: closed, no slip. SLIP: closed, with slip or without friction to prevent it.
    """

    OPEN = types.MODE_OPEN
    STICK = types.MODE_STICK
    SLIP = types.MODE_SLIP


class CouplingStatus(IntEnum):
    """Status of a spring-damper or bushing.

    ACTIVE: the force law applies. SLACK: ``tension_only``, and not stretched. BROKEN: the force exceeded
    ``break_force``. OUTSIDE: the length is outside of the table of the law, whose end value is used. NO_DIRECTION: the
    ends coincide and no earlier direction is available, so no force is applied. DISABLED: not enabled.
    """

    ACTIVE = types.COUPLING_ACTIVE
    SLACK = types.COUPLING_SLACK
    BROKEN = types.COUPLING_BROKEN
    OUTSIDE = types.COUPLING_OUTSIDE
    NO_DIRECTION = types.COUPLING_NO_DIRECTION
    DISABLED = types.COUPLING_DISABLED


class CatenaryStatus(IntEnum):
    """Status of a catenary.

    HANGING: its length exceeds the distance of its ends. TAUT: shorter, and stretched. FOLDED: one end is vertically
    above the other, and the cable hangs from both. GROUNDED: a part rests on the floor. SUNK: an end is below the
    floor and is treated as on the floor. LOOSE: weightless and not stretched. DISABLED: not enabled. FAILED: the
    solver did not converge; forces are those of the last iterate.
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
    """Status of an environment between steps.

    ACTIVE: it is stepped. FROZEN: a step failed; it keeps its last valid state, see ``FailureCause``. STOPPED: it
    keeps the state at which a stop condition held.
    """

    ACTIVE = types.ENV_ACTIVE
    FROZEN = types.ENV_FROZEN
    STOPPED = types.ENV_STOPPED


class FailureCause(IntEnum):
    """Cause of failure of a frozen environment.

    NONE: it is not frozen. NON_FINITE: its state, or a quantity that the step is computed from, was not finite.
    TOO_FAST: a body was faster than ``scene.max_speed``. TOO_FAR: a body was farther from the origin than
    ``scene.max_distance``.
    """

    NONE = types.NO_CAUSE
    NON_FINITE = types.NON_FINITE
    TOO_FAST = types.TOO_FAST
    TOO_FAR = types.TOO_FAR
