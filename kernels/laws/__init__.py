"""Normal-force laws. A law is one file; a line here puts it into the catalogue and under every law test."""

from warpcontact.kernels.laws.anagnostopoulos import Anagnostopoulos
from warpcontact.kernels.laws.base import Law
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
from warpcontact.kernels.laws.undamped import (
    contact_time,
    greatest_force,
    greatest_penetration,
    recommended_dt,
)
from warpcontact.kernels.laws.zhiying_qishao import ZhiyingQishao

#: Every law that comes with the library, in the order of the catalogue: elastic, exact, others.
CATALOGUE: tuple[type[Law], ...] = (
    Hooke,
    Hertz,
    HertzElastic,
    PowerLaw,
    JohnsonCylinder,
    PereiraCylinder,
    PereiraCylinderExternal,
    ElasticFoundation,
    ContactRange,
    HuntCrossley,
    KelvinVoigt,
    Tsuji,
    TwoStiffness,
    Anagnostopoulos,
    HuntCrossley1975,
    HerbertMcWhannell,
    LeeWang,
    LankaraniNikravesh,
    Gonthier,
    ZhiyingQishao,
    Flores,
    HuGuo,
    CarvalhoMartins,
    Jankowski,
    PantWijeyewickrema,
    KuwabaraKono,
    HertzDashpot,
    Impact,
)

#: Those of hard contact, which have no force of their own.
RIGID: tuple[type[Law], ...] = (Rigid,)

__all__ = [
    "CATALOGUE",
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
