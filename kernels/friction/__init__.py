"""Friction models, one file each. `_CATALOGUE` adds a model to the catalogue and to all friction tests."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.lazy_catalogue import lazy_names
from warpcontact.kernels.friction.base import Friction

if TYPE_CHECKING:
    from warpcontact.kernels.friction.ambrosio import Ambrosio
    from warpcontact.kernels.friction.bengisu_akay import BengisuAkay
    from warpcontact.kernels.friction.brown_mcphee import BrownMcPhee
    from warpcontact.kernels.friction.coulomb import Coulomb
    from warpcontact.kernels.friction.coulomb_threshold import CoulombThreshold
    from warpcontact.kernels.friction.cundall_strack import CundallStrack
    from warpcontact.kernels.friction.dahl import Dahl
    from warpcontact.kernels.friction.elliptic import Elliptic
    from warpcontact.kernels.friction.frictionless import Frictionless
    from warpcontact.kernels.friction.hollars import Hollars
    from warpcontact.kernels.friction.lugre import LuGre
    from warpcontact.kernels.friction.mindlin import Mindlin
    from warpcontact.kernels.friction.regularized_coulomb import RegularizedCoulomb
    from warpcontact.kernels.friction.smooth_stribeck import SmoothStribeck
    from warpcontact.kernels.friction.step_friction import StepFriction
    from warpcontact.kernels.friction.stribeck import Stribeck
    from warpcontact.kernels.friction.tanh import Tanh
    from warpcontact.kernels.friction.threlfall import Threlfall
    from warpcontact.kernels.friction.viscous import Viscous

    CATALOGUE: tuple[type[Friction], ...]
    RIGID: tuple[type[Friction], ...]

# Modules of the models of the library: one coefficient, static and dynamic coefficients, models with history.
_CATALOGUE = {
    "Frictionless": "frictionless",
    "Viscous": "viscous",
    "Tanh": "tanh",
    "RegularizedCoulomb": "regularized_coulomb",
    "CoulombThreshold": "coulomb_threshold",
    "Threlfall": "threlfall",
    "Ambrosio": "ambrosio",
    "StepFriction": "step_friction",
    "BengisuAkay": "bengisu_akay",
    "Stribeck": "stribeck",
    "BrownMcPhee": "brown_mcphee",
    "Hollars": "hollars",
    "SmoothStribeck": "smooth_stribeck",
    "Elliptic": "elliptic",
    "CundallStrack": "cundall_strack",
    "Mindlin": "mindlin",
    "Dahl": "dahl",
    "LuGre": "lugre",
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
