"""The contract of a friction model."""

from warpcontact.kernels.formula import Formula


class Friction(Formula):
    """A tangential force in a contact, against the slip of the point's body over the surface.

    A subclass declares its parameters and ``force(p, s)``, which returns the force on the point's body as a
    vector in W [N]. ``p`` holds the coefficients; ``s`` has ``velocity`` (tangential, of the point's body relative
    to the surface) [m/s], its length ``speed`` and the ``normal_force`` N ≥ 0 [N]. Divide by ``speed`` only where
    it cannot be zero.
    """
