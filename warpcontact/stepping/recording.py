"""Recorded sensors as labeled data sets; a separate module, because importing xarray is slow."""

from typing import TYPE_CHECKING, Any

import xarray as xr

from warpcontact.kernels.catalogue.names import stored_name
from warpcontact.scene.scene_data import SceneData


class Series(xr.Dataset):
    """An ``xarray.Dataset`` of sensors that also accepts aliases of sensors: ``data["touch.delta"]``."""

    __slots__ = ()

    if not TYPE_CHECKING:  # the types are those of the base

        def __getitem__(self, key: Any) -> Any:
            if isinstance(key, str):
                return super().__getitem__(self._stored(key))
            if isinstance(key, list):
                return super().__getitem__([self._stored(one) for one in key])
            return super().__getitem__(key)

        def __contains__(self, key: Any) -> bool:
            return super().__contains__(self._stored(key))

    def _stored(self, key: Any) -> Any:
        """Returns the stored name of a variable; unknown names unchanged."""
        if isinstance(key, str) and key not in self._variables and (name := stored_name(key)) in self._variables:
            return name
        return key


class Recording(Series):
    """The data set that ``Simulation.run`` returns: sensors over time, and the scene."""

    __slots__ = ("scene",)

    scene: SceneData
