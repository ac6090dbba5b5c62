"""Friction models, one file per family. `_CATALOGUE` adds a model to the catalogue and to all friction tests."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names
from warpcontact.kernels.friction.base import Friction

if TYPE_CHECKING:
    from warpcontact.kernels.friction.base import Frictionless
    from warpcontact.kernels.friction.bristle import Dahl, LuGre
    from warpcontact.kernels.friction.coulomb import (
        Ambrosio,
        Coulomb,
        CoulombThreshold,
        Elliptic,
        RegularizedCoulomb,
        Tanh,
        Threlfall,
        Viscous,
    )
    from warpcontact.kernels.friction.stribeck import (
        BengisuAkay,
        BrownMcPhee,
        Hollars,
        SmoothStribeck,
        StepFriction,
        Stribeck,
    )
    from warpcontact.kernels.friction.tangential_spring import CundallStrack, Mindlin

    CATALOGUE: tuple[type[Friction], ...]
    RIGID: tuple[type[Friction], ...]

# Modules of the models of the library: one coefficient, static and dynamic coefficients, models with history.
_CATALOGUE = {
    "Frictionless": "base",
    "Viscous": "coulomb",
    "Tanh": "coulomb",
    "RegularizedCoulomb": "coulomb",
    "CoulombThreshold": "coulomb",
    "Threlfall": "coulomb",
    "Ambrosio": "coulomb",
    "StepFriction": "stribeck",
    "BengisuAkay": "stribeck",
    "Stribeck": "stribeck",
    "BrownMcPhee": "stribeck",
    "Hollars": "stribeck",
    "SmoothStribeck": "stribeck",
    "Elliptic": "coulomb",
    "CundallStrack": "tangential_spring",
    "Mindlin": "tangential_spring",
    "Dahl": "bristle",
    "LuGre": "bristle",
}

# Models of nonsmooth contact, which have no force function.
_RIGID = {"Coulomb": "coulomb"}

#: Names of all models.
NAMES = (*_CATALOGUE, *_RIGID)

__all__ = [
    "CATALOGUE",
    "NAMES",
    "RIGID",
    "Ambrosio",
    "BengisuAkay",
    "BrownMcPhee",
    "Coulomb",
    "CoulombThreshold",
    "CundallStrack",
    "Dahl",
    "Elliptic",
    "Frictionless",
    "Hollars",
    "LuGre",
    "Mindlin",
    "RegularizedCoulomb",
    "SmoothStribeck",
    "StepFriction",
    "Stribeck",
    "Tanh",
    "Threlfall",
    "Viscous",
]

if not TYPE_CHECKING:  # there it would know every name
    __getattr__, __dir__ = lazy_names(
        __name__, {**_CATALOGUE, **_RIGID}, {"CATALOGUE": tuple(_CATALOGUE), "RIGID": tuple(_RIGID)}
    )
