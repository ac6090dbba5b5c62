"""Friction models. A model is one file; a line here puts it into the catalogue and under every friction test."""

from warpcontact.kernels.frictions.base import Friction
from warpcontact.kernels.frictions.frictionless import Frictionless
from warpcontact.kernels.frictions.regularized_coulomb import RegularizedCoulomb
from warpcontact.kernels.frictions.tanh import Tanh

#: Every friction model that comes with the library, in the order of the catalogue.
CATALOGUE: tuple[type[Friction], ...] = (
    Frictionless,
    Tanh,
    RegularizedCoulomb,
)

__all__ = ["CATALOGUE", "Frictionless", "RegularizedCoulomb", "Tanh"]
