"""State of a contact, as ``<contact>.status`` reports it."""

from enum import IntEnum

from warpcontact.kernels import types


class Status(IntEnum):
    """State of a contact.

    OPEN: not touching. CONTACT: touching. HIDDEN: the nearest point is not on the active part. FAR: nothing
    within the search radius. WRONG_SIDE: deeper than ``max_depth``, or come from the inner side with
    ``entry="latched"``. DISABLED: not enabled.
    """

    OPEN = types.OPEN
    CONTACT = types.CONTACT
    HIDDEN = types.HIDDEN
    FAR = types.FAR
    WRONG_SIDE = types.WRONG_SIDE
    DISABLED = types.DISABLED
