"""Normal force laws, one file per family. `_CATALOGUE` adds a law to the catalogue and to all law tests."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.formulas import (
    contact_time,
    greatest_force,
    greatest_penetration,
    recommended_dt,
)

if TYPE_CHECKING:
    from warpcontact.kernels.laws.base import Rigid
    from warpcontact.kernels.laws.elastic import (
        Hooke,
        JohnsonCylinder,
        PereiraCylinder,
        PereiraCylinderExternal,
        PowerLaw,
        TwoStiffness,
    )
    from warpcontact.kernels.laws.elastic_foundation import ContactRange, ElasticFoundation, PressureField
    from warpcontact.kernels.laws.hertz import Hertz, HertzElastic
    from warpcontact.kernels.laws.hunt_crossley import (
        CarvalhoMartins,
        Flores,
        Gonthier,
        HerbertMcWhannell,
        HuGuo,
        HuntCrossley,
        HuntCrossley1975,
        LankaraniNikravesh,
        LeeWang,
        PantWijeyewickrema,
        ZhiyingQishao,
    )
    from warpcontact.kernels.laws.linear_dashpot import Anagnostopoulos, HertzDashpot, KelvinVoigt
    from warpcontact.kernels.laws.nonlinear_dashpot import Impact, Jankowski, KuwabaraKono, Tsuji

    CATALOGUE: tuple[type[Law], ...]
    RIGID: tuple[type[Law], ...]

# Modules of the laws of the library, in the order of the catalogue: elastic, exact restitution, others.
_CATALOGUE = {
    "Hooke": "elastic",
    "Hertz": "hertz",
    "HertzElastic": "hertz",
    "PowerLaw": "elastic",
    "JohnsonCylinder": "elastic",
    "PereiraCylinder": "elastic",
    "PereiraCylinderExternal": "elastic",
    "ElasticFoundation": "elastic_foundation",
    "PressureField": "elastic_foundation",
    "ContactRange": "elastic_foundation",
    "HuntCrossley": "hunt_crossley",
    "KelvinVoigt": "linear_dashpot",
    "Tsuji": "nonlinear_dashpot",
    "TwoStiffness": "elastic",
    "Anagnostopoulos": "linear_dashpot",
    "HuntCrossley1975": "hunt_crossley",
    "HerbertMcWhannell": "hunt_crossley",
    "LeeWang": "hunt_crossley",
    "LankaraniNikravesh": "hunt_crossley",
    "Gonthier": "hunt_crossley",
    "ZhiyingQishao": "hunt_crossley",
    "Flores": "hunt_crossley",
    "HuGuo": "hunt_crossley",
    "CarvalhoMartins": "hunt_crossley",
    "Jankowski": "nonlinear_dashpot",
    "PantWijeyewickrema": "hunt_crossley",
    "KuwabaraKono": "nonlinear_dashpot",
    "HertzDashpot": "linear_dashpot",
    "Impact": "nonlinear_dashpot",
}

# Laws of nonsmooth contact, which have no force function.
_RIGID = {"Rigid": "base"}

#: Names of all laws.
NAMES = (*_CATALOGUE, *_RIGID)

__all__ = [
    "CATALOGUE",
    "NAMES",
    "RIGID",
    "Anagnostopoulos",
    "CarvalhoMartins",
    "ContactRange",
    "ElasticFoundation",
    "Flores",
    "Gonthier",
    "HerbertMcWhannell",
    "Hertz",
    "HertzDashpot",
    "HertzElastic",
    "Hooke",
    "HuGuo",
    "HuntCrossley",
    "HuntCrossley1975",
    "Impact",
    "Jankowski",
    "JohnsonCylinder",
    "KelvinVoigt",
    "KuwabaraKono",
    "LankaraniNikravesh",
    "LeeWang",
    "PantWijeyewickrema",
    "PereiraCylinder",
    "PereiraCylinderExternal",
    "PowerLaw",
    "PressureField",
    "Rigid",
    "Tsuji",
    "TwoStiffness",
    "ZhiyingQishao",
    "contact_time",
    "greatest_force",
    "greatest_penetration",
    "recommended_dt",
]

if not TYPE_CHECKING:  # there it would know every name
    __getattr__, __dir__ = lazy_names(
        __name__, {**_CATALOGUE, **_RIGID}, {"CATALOGUE": tuple(_CATALOGUE), "RIGID": tuple(_RIGID)}
    )
