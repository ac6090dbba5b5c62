"""Normal-force laws. A law is one file; a line here puts it into the catalogue and under every law test."""

from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.hertz import Hertz
from warpcontact.kernels.laws.hooke import Hooke
from warpcontact.kernels.laws.hunt_crossley import HuntCrossley
from warpcontact.kernels.laws.kelvin_voigt import KelvinVoigt

#: Every law that comes with the library, in the order of the catalogue.
CATALOGUE: tuple[type[Law], ...] = (
    Hooke,
    Hertz,
    HuntCrossley,
    KelvinVoigt,
)

__all__ = ["CATALOGUE", "Hertz", "Hooke", "HuntCrossley", "KelvinVoigt"]
