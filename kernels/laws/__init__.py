"""Normal-force laws, one file each. `_CATALOGUE` adds a law to the catalogue and to all law tests."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.lazy_catalogue import lazy_names
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.undamped import (
    contact_time,
    greatest_force,
    greatest_penetration,
    recommended_dt,
)

if TYPE_CHECKING:
    from warpcontact.kernels.laws.anagnostopoulos import Anagnostopoulos
    from warpcontact.kernels.laws.carvalho_martins import CarvalhoMartins
    from warpcontact.kernels.laws.contact_range import ContactRange
    from warpcontact.kernels.laws.elastic_foundation import ElasticFoundation
    from warpcontact.kernels.laws.flores import Flores
    from warpcontact.kernels.laws.gonthier import Gonthier
    from warpcontact.kernels.laws.herbert_mcwhannell import HerbertMcWhannell
    from warpcontact.kernels.laws.hertz import Hertz
    from warpcontact.kernels.laws.hertz_dashpot import HertzDashpot
    from warpcontact.kernels.laws.hertz_elastic import HertzElastic
    from warpcontact.kernels.laws.hooke import Hooke
    from warpcontact.kernels.laws.hu_guo import HuGuo
    from warpcontact.kernels.laws.hunt_crossley import HuntCrossley
    from warpcontact.kernels.laws.hunt_crossley_1975 import HuntCrossley1975
    from warpcontact.kernels.laws.impact import Impact
    from warpcontact.kernels.laws.jankowski import Jankowski
    from warpcontact.kernels.laws.johnson_cylinder import JohnsonCylinder
    from warpcontact.kernels.laws.kelvin_voigt import KelvinVoigt
    from warpcontact.kernels.laws.kuwabara_kono import KuwabaraKono
    from warpcontact.kernels.laws.lankarani_nikravesh import LankaraniNikravesh
    from warpcontact.kernels.laws.lee_wang import LeeWang
    from warpcontact.kernels.laws.pant_wijeyewickrema import PantWijeyewickrema
    from warpcontact.kernels.laws.pereira_cylinder import PereiraCylinder, PereiraCylinderExternal
    from warpcontact.kernels.laws.power_law import PowerLaw
    from warpcontact.kernels.laws.rigid import Rigid
    from warpcontact.kernels.laws.tsuji import Tsuji
    from warpcontact.kernels.laws.two_stiffness import TwoStiffness
    from warpcontact.kernels.laws.zhiying_qishao import ZhiyingQishao

    CATALOGUE: tuple[type[Law], ...]
    RIGID: tuple[type[Law], ...]

# Modules of the laws of the library, in the order of the catalogue: elastic, exact restitution, others.
_CATALOGUE = {
    "Hooke": "hooke",
    "Hertz": "hertz",
    "HertzElastic": "hertz_elastic",
    "PowerLaw": "power_law",
    "JohnsonCylinder": "johnson_cylinder",
    "PereiraCylinder": "pereira_cylinder",
    "PereiraCylinderExternal": "pereira_cylinder",
    "ElasticFoundation": "elastic_foundation",
    "ContactRange": "contact_range",
    "HuntCrossley": "hunt_crossley",
    "KelvinVoigt": "kelvin_voigt",
    "Tsuji": "tsuji",
    "TwoStiffness": "two_stiffness",
    "Anagnostopoulos": "anagnostopoulos",
    "HuntCrossley1975": "hunt_crossley_1975",
    "HerbertMcWhannell": "herbert_mcwhannell",
    "LeeWang": "lee_wang",
    "LankaraniNikravesh": "lankarani_nikravesh",
    "Gonthier": "gonthier",
    "ZhiyingQishao": "zhiying_qishao",
    "Flores": "flores",
    "HuGuo": "hu_guo",
    "CarvalhoMartins": "carvalho_martins",
    "Jankowski": "jankowski",
    "PantWijeyewickrema": "pant_wijeyewickrema",
    "KuwabaraKono": "kuwabara_kono",
    "HertzDashpot": "hertz_dashpot",
    "Impact": "impact",
}

# Laws of nonsmooth contact, which have no force function.
_RIGID = {"Rigid": "rigid"}

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
