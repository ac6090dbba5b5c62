"""What is recorded, as one labelled data set; apart, because xarray takes as long to import as all the rest."""

import xarray as xr

from warpcontact.scene import Scene


class Recording(xr.Dataset):
    """An ``xarray.Dataset`` of readings that remembers the scene they came from."""

    __slots__ = ("scene",)

    scene: Scene
