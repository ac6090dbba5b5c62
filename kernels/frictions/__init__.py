"""Friction models. A model is one file; a line here puts it into the catalogue and under every friction test."""

from warpcontact.kernels.frictions.ambrosio import Ambrosio
from warpcontact.kernels.frictions.base import Friction
from warpcontact.kernels.frictions.bengisu_akay import BengisuAkay
from warpcontact.kernels.frictions.brown_mcphee import BrownMcPhee
from warpcontact.kernels.frictions.coulomb import Coulomb
from warpcontact.kernels.frictions.coulomb_threshold import CoulombThreshold
from warpcontact.kernels.frictions.cundall_strack import CundallStrack
from warpcontact.kernels.frictions.dahl import Dahl
from warpcontact.kernels.frictions.elliptic import Elliptic
from warpcontact.kernels.frictions.frictionless import Frictionless
from warpcontact.kernels.frictions.hollars import Hollars
from warpcontact.kernels.frictions.lugre import LuGre
from warpcontact.kernels.frictions.mindlin import Mindlin
from warpcontact.kernels.frictions.regularized_coulomb import RegularizedCoulomb
from warpcontact.kernels.frictions.smooth_stribeck import SmoothStribeck
from warpcontact.kernels.frictions.step_friction import StepFriction
from warpcontact.kernels.frictions.stribeck import Stribeck
from warpcontact.kernels.frictions.tanh import Tanh
from warpcontact.kernels.frictions.threlfall import Threlfall
from warpcontact.kernels.frictions.viscous import Viscous

#: Every friction model that comes with the library: one coefficient, static and dynamic ones, those that remember.
CATALOGUE: tuple[type[Friction], ...] = (
    Frictionless,
    Viscous,
    Tanh,
    RegularizedCoulomb,
    CoulombThreshold,
    Threlfall,
    Ambrosio,
    StepFriction,
    BengisuAkay,
    Stribeck,
    BrownMcPhee,
    Hollars,
    SmoothStribeck,
    Elliptic,
    CundallStrack,
    Mindlin,
    Dahl,
    LuGre,
)

#: Those of hard contact, which have no force of their own.
RIGID: tuple[type[Friction], ...] = (Coulomb,)

__all__ = [
    "CATALOGUE",
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
