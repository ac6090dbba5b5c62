"""The contract of a friction model."""

from typing import ClassVar

from warpcontact.kernels.catalogue.device_model import Formula


class Friction(Formula):
    """A force in a contact against a velocity of the point's body relative to the surface.

    A subclass declares its parameters and ``force(p, s)``, which returns the force on the point's body as a
    vector in W [N]. ``p`` holds the coefficients; ``s`` has ``velocity`` [m/s], its length ``speed``, the
    ``normal_force`` N ≥ 0 [N], the ``normal``, the ``patch_radius`` √(R δ) of a sphere [m] and, for a
    ``directional`` model, the ``axis``: the x axis of the surface laid into the tangent plane, a unit vector.
    Divide by ``speed`` only where it cannot be zero.

    A model that remembers declares what, with ``wc.history``, and has two functions of ``(p, s, m)``: ``advance``
    returns the memory ``m`` after the time ``m.elapsed`` [s] in which ``s`` prevailed, and ``force`` the force
    from that.

    The same model serves sliding, rolling and torsion; see ``ContactMaterial``.
    """

    part: ClassVar[str] = "friction"

    #: Whether it tells tangential directions apart, and needs ``s.axis``.
    directional: ClassVar[bool] = False
    #: Whether it works for spheres only, by ``s.patch_radius``.
    needs_radius: ClassVar[bool] = False

    @classmethod
    def cone_coefficients(cls) -> tuple[str, str] | None:
        """Returns the parameters that are its static and its dynamic coefficient of friction.

        ``None``: it has none, as an elliptic or a viscous one, and no cone of Coulomb stands for it.
        """
        names = set(cls.varying())
        for pair in (("mu", "mu"), ("mu_static", "mu_dynamic")):
            if names.issuperset(pair):
                return pair
        return None
