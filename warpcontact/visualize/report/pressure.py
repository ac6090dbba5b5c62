"""Areas of body contacts colored by pressure, as data of the replay; read by ``web/src/patches.js``."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from warpcontact.drawing.colors import pressure_stops
from warpcontact.drawing.contact_pressure import PressurePatches
from warpcontact.drawing.drawing import Drawing
from warpcontact.drawing.reduction import evenly
from warpcontact.visualize.report.packing import Pack

# Largest number of triangles of an environment over all records; with more, some records show the area of an earlier one.
TRIANGLES = 40_000


class PressureData:
    """Areas of body contacts in all records of a drawing.

    Args:
        drawing: The drawing.

    Attributes:
        largest: Largest pressure, the end of the color scale [Pa].
    """

    def __init__(self, drawing: Drawing) -> None:
        self._drawing = drawing
        self.largest = 0.0
        if drawing.pressure is not None:
            self.largest = drawing.pressure.peak(range(len(drawing.times)), range(len(drawing.envs)))

    @property
    def description(self) -> dict[str, Any] | None:
        """Color scale of all environments; ``None`` if no contact has a pressure."""
        return {"largest": self.largest, "stops": pressure_stops()} if self.largest > 0.0 else None

    def add(self, pack: Pack, row: int, finest: float) -> int:
        """Adds the areas of environment ``row`` to a pack.

        Args:
            pack: The pack.
            row: Index of the environment in the drawing.
            finest: Largest position error that is invisible [m].

        Returns:
            The number of records that have their own areas.
        """
        pressure = self._drawing.pressure
        if pressure is None or self.largest <= 0.0:
            return len(self._drawing.times)
        records = range(len(self._drawing.times))
        areas = [self._merged(patches) for patches in pressure.each((record, row) for record in records)]
        count = sum(len(faces) for _, _, faces in areas)
        own = evenly(len(areas), max(1, len(areas) * TRIANGLES // max(count, TRIANGLES)))
        areas = [areas[number] for number in own]
        pack.indices(np.asarray(own))
        pack.indices(np.cumsum([0, *(len(vertices) for vertices, _, _ in areas)]))
        pack.indices(np.cumsum([0, *(len(faces) for _, _, faces in areas)]))
        vertices, values, faces = (np.concatenate(column) for column in zip(*areas, strict=True))
        if len(vertices):
            pack.series(vertices, finest)
            pack.series(values[:, None])
        else:
            pack.exact(vertices)
            pack.exact(values)
        pack.indices(faces)
        return len(own)

    def _merged(self, patches: Sequence[PressurePatches]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns vertices (n, 3) [m], pressures (n,) [Pa] and faces (m, 3) of some areas, with common vertices."""
        refined = [one.refined(self.largest) for one in patches]
        positions = np.concatenate([np.zeros((0, 3)), *(one.positions.reshape(-1, 3) for one in refined)])
        pressures = np.concatenate([np.zeros(0), *(one.pressures.reshape(-1) for one in refined)])
        rows, numbers = np.unique(np.column_stack([positions, pressures]), axis=0, return_inverse=True)
        return rows[:, :3], rows[:, 3], numbers.reshape(-1, 3)
