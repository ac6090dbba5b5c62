"""Options of a USD export and the writing of a complete stage."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from warpcontact._version import __version__
from warpcontact.drawing.content import Content
from warpcontact.drawing.ensemble import Ensemble
from warpcontact.drawing.ranges import SceneRanges
from warpcontact.drawing.replay import Replay
from warpcontact.scene.scene_data import SceneData
from warpcontact.usd.author import Samples, write_box
from warpcontact.usd.coloring import Coloring
from warpcontact.usd.description import write_description
from warpcontact.usd.ensemble import define_ensemble, write_ensemble
from warpcontact.usd.environments import Environments, layout_of
from warpcontact.usd.layout import WORLD, Layout
from warpcontact.usd.materials import UsdMaterials
from warpcontact.usd.scenery import define_camera, define_display_material, define_lights
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

#: Schema of the stage metadata. Increases when a stage must be read differently.
SCHEMA = 1
# Attributes of recordings → metadata keys of the stage.
_METADATA_KEYS = {
    "source": "source",
    "name": "name",
    "device": "device",
    "precision": "precision",
    "integrator": "integrator",
    "fingerprint": "fingerprint",
}
#: Called with the number of items written since the last call.
ProgressCallback = Callable[[int], None]


class Export:
    """Export of one recording; arguments and errors as for ``export_usd``.

    Attributes:
        replay: Environments with full physics.
        ensemble: All environments shown as instances; ``None`` if there are none.
        coloring: Coloring of the instances; ``None``: colors of the bodies.
    """

    def __init__(
        self,
        recording: xr.Dataset,
        envs: int | Iterable[int] | None,
        scene: SceneData | None,
        spacing: ArrayLike,
        force_scale: float | None,
        ensemble: bool | str,
        color_by: str | xr.DataArray | None,
    ) -> None:
        self.spacing = checks.numbers("spacing", spacing, (2,), limits("m", at_least=0.0))
        if force_scale is not None:
            force_scale = float(checks.numbers("force_scale", force_scale, (), limits("m/N", above=0.0)))
        self.force_scale = force_scale
        if not (isinstance(ensemble, bool) or ensemble == "auto"):
            raise ValueError(f"ensemble must be True, False or 'auto', got {ensemble!r}")
        if ensemble is True and self.spacing.any():
            raise ValueError("ensemble=True shows all environments in place: leave spacing 0 along both axes")
        self.replay = Replay.of(recording, scene, envs)
        self.coloring = None if color_by is None else Coloring(color_by, recording)
        self.ensemble: Ensemble | None = None
        if not self.spacing.any():
            self.ensemble = Ensemble.of(recording, self.replay.scene, self.replay.envs, ensemble)
        self._layout: Layout | None = None
        self._environments: Environments | None = None

    def ranges(self, blocks: Iterable[tuple[tuple[int, int], Content]]) -> SceneRanges:
        """Returns the ranges over all records, which are given as blocks of (range of records, content)."""

        def contents() -> Iterator[Content]:
            for records, content in blocks:
                if self.ensemble is not None:
                    self.ensemble.scan_records(*records)
                    if self.coloring is not None:
                        self.coloring.scan_records(self.ensemble.replay.envs, *records)
                yield content

        ranges = SceneRanges.of(contents())
        if self.ensemble is not None:
            self.ensemble = self.ensemble.drop()
        return ranges

    def define(self, stage: Any, content: Content, ranges: SceneRanges) -> None:
        """Writes all that is constant over time; ``content`` begins with the first record."""
        from pxr import Kind, Usd, UsdGeom

        materials = UsdMaterials(self.replay)
        scale = ranges.force_scale if self.force_scale is None else self.force_scale
        self._layout = layout = layout_of(content, ranges, self.spacing, scale, materials)
        self._metadata(stage, layout)
        world = UsdGeom.Xform.Define(stage, WORLD).GetPrim()
        Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
        stage.SetDefaultPrim(world)
        define_display_material(stage, f"{WORLD}/Looks", world)
        places = np.array([layout.place(row) for row in range(len(layout.envs))])
        low, high = (ranges.low + places).min(axis=0), (ranges.high + places).max(axis=0)
        define_camera(stage, f"{WORLD}/Camera", low, high)
        define_lights(stage, f"{WORLD}/Lights")
        self._environments = Environments(stage, content, layout, materials)
        self._environments.define(content, ranges)
        if self.ensemble is not None:
            define_ensemble(stage, self.ensemble, layout, self.coloring)
        self._write_extents(world, low, high)
        write_description(stage, self.replay.scene, layout.names)

    def animate(
        self,
        stage: Any,
        content: Content,
        samples: Samples,
        records: tuple[int, int],
        report_progress: ProgressCallback,
    ) -> None:
        """Writes what changes over time in a range of records.

        Args:
            stage: Stage, after ``define``.
            content: Content of these records.
            samples: Destination of the values.
            records: Range of records; the end is exclusive.
            report_progress: Called with the number of environments finished.
        """
        assert self._environments is not None
        assert self._layout is not None
        self._environments.animate(content, samples, report_progress)
        if self.ensemble is not None:
            write_ensemble(stage, self.ensemble, self._layout, self.coloring, samples, records)

    def _write_extents(self, world: Any, low: Array, high: Array) -> None:
        """Writes the extent of the world at all times. Skipped with an ensemble, whose extent needs all records."""
        from pxr import Usd, UsdGeom

        if self.ensemble is not None:
            return
        corners = np.array([low, high])
        cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_], useExtentsHint=True)
        bound = cache.ComputeWorldBound(world).ComputeAlignedRange()
        if not bound.IsEmpty():
            corners = np.array([*corners, bound.GetMin(), bound.GetMax()])
        write_box(world, corners.min(axis=0), corners.max(axis=0))

    def _metadata(self, stage: Any, layout: Layout) -> None:
        from pxr import UsdGeom, UsdPhysics, Vt

        replay = self.replay
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        stage.SetStartTimeCode(replay.codes[0])
        stage.SetEndTimeCode(replay.codes[-1])
        stage.SetTimeCodesPerSecond(replay.rate)
        stage.SetFramesPerSecond(replay.rate)
        attrs = replay.data.attrs
        notes: dict[str, Any] = {
            "version": __version__,
            "schema": SCHEMA,
            "environments": Vt.IntArray(replay.envs),
            "startTime": float(replay.times[0]),
            "forceScale": layout.force_scale,
        }
        notes |= {key: str(attrs[name]) for name, key in _METADATA_KEYS.items() if name in attrs}
        if "frozen_environments" in attrs:
            frozen = set(attrs["frozen_environments"])
            notes["frozenEnvironments"] = Vt.IntArray([env for env in replay.envs if env in frozen])
        notes |= {key: float(attrs[key]) for key in ("dt",) if key in attrs}
        notes |= {key: int(attrs[key]) for key in ("seed",) if key in attrs}
        stage.GetRootLayer().customLayerData = {"warpcontact": notes}
