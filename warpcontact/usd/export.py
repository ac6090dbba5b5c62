"""Exports recordings as animated USD stages: options, the complete stage, its camera and its lights."""

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from warpcontact._version import __version__
from warpcontact.drawing.content import Content, SceneRanges
from warpcontact.drawing.ensemble import Ensemble
from warpcontact.drawing.replay import Replay
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.scene.scene_data import SceneData
from warpcontact.usd.author import WORLD, Layout, Samples, write_box
from warpcontact.usd.clips import Clips, check_frames, check_path, save_stage
from warpcontact.usd.description import write_description
from warpcontact.usd.ensemble import Coloring, define_ensemble, write_ensemble
from warpcontact.usd.environments import Environments, layout_of
from warpcontact.usd.materials import UsdMaterials
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits
from warpcontact.validation.safe_text import escape_controls, terminal

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

# Direction from the scene to the camera, and margin around the scene.
_FROM = np.array([0.55, -0.75, 0.42])
_MARGIN = 1.15
# 36 mm film. The unit (0.1 mm if the stage is in cm) does not matter: only ratios are used.
_FILM = (36.0, 20.25)
_FOCAL = 35.0


class Export:
    """Export of one recording; arguments and errors as for ``export_usd``.

    Attributes:
        replay: Environments with full physics.
        ensemble: All environments shown as instances; ``None`` if there are none.
        coloring: Coloring of the instances; ``None``: colors of the bodies.
        pressure: Whether to show the areas of body contacts colored by pressure.
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
        pressure: bool,
    ) -> None:
        self.spacing = checks.numbers("spacing", spacing, (2,), limits("m", at_least=0.0))
        if force_scale is not None:
            force_scale = float(checks.numbers("force_scale", force_scale, (), limits("m/N", above=0.0)))
        self.force_scale = force_scale
        self.pressure = checks.switch("pressure", pressure)
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


def define_camera(stage: Any, path: str, low: Array, high: Array) -> None:
    """Writes a camera with the box between two corners (3,) [m] in view."""
    from pxr import Gf, UsdGeom

    center, radius = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1.0e-3)
    # The bounding sphere of the box must fit into the smaller (vertical) angle of view.
    half_angle = math.atan(0.5 * _FILM[1] / _FOCAL)
    distance = _MARGIN * radius / math.sin(half_angle)
    back = _FROM / np.linalg.norm(_FROM)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    rows = [[*right, 0.0], [*up, 0.0], [*back, 0.0], [*(center + distance * back), 1.0]]
    camera = UsdGeom.Camera.Define(stage, path)
    camera.AddTransformOp().Set(Gf.Matrix4d(*np.array(rows).reshape(-1).tolist()))
    camera.CreateProjectionAttr(UsdGeom.Tokens.perspective)
    camera.CreateHorizontalApertureAttr(_FILM[0])
    camera.CreateVerticalApertureAttr(_FILM[1])
    camera.CreateFocalLengthAttr(_FOCAL)
    camera.CreateFocusDistanceAttr(distance)
    near = max(0.01 * distance, distance - 20.0 * radius)
    camera.CreateClippingRangeAttr(Gf.Vec2f(near, distance + 100.0 * radius))
    camera.GetPrim().SetDocumentation("All bodies of the environments are in view at all times.")


def define_lights(stage: Any, path: str) -> None:
    """Writes a distant light (sun) and a dome light (sky)."""
    from pxr import Gf, UsdGeom, UsdLux

    UsdGeom.Scope.Define(stage, path)
    sun = UsdLux.DistantLight.Define(stage, f"{path}/Sun")
    # The small angle gives about daylight, for a camera with white at 1.
    sun.CreateIntensityAttr(35000.0)
    sun.CreateAngleAttr(0.53)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(40.0, 25.0, 0.0))
    sky = UsdLux.DomeLight.Define(stage, f"{path}/Sky")
    sky.CreateIntensityAttr(0.35)


def define_display_material(stage: Any, scope: str, prim: Any) -> None:
    """Writes a material that shows ``displayColor`` into ``scope`` and binds it to ``prim`` and its descendants.

    Most renderers other than Hydra's built-in one ignore ``displayColor`` without a material.
    """
    from pxr import Sdf, UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, scope)
    path = f"{scope}/Display"
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.6)
    reader = UsdShade.Shader.Define(stage, f"{path}/Color")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    output = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(output)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


@explain_keywords
def export_usd(
    recording: xr.Dataset,
    path: str | Path,
    *,
    envs: int | Iterable[int] | None = None,
    scene: SceneData | None = None,
    spacing: ArrayLike = (0.0, 0.0),
    force_scale: float | None = None,
    ensemble: bool | str = "auto",
    color_by: str | xr.DataArray | None = None,
    pressure: bool = True,
    clip_frames: int | None = None,
    progress: bool | None = None,
) -> Path:
    """Writes a recording as an animated USD stage: Z up, meters, kilograms, one time code per record.

    ``/World/env_<number>`` is an environment with full physics in the schemas of UsdPhysics. ``/World/Ensemble``
    shows all others as instances. ``docs/usd.md`` lists all prims and the variables of the recording they show.

    Args:
        recording: Result of ``Simulation.run``, or the same data set loaded from a file.
        path: File to write: ``.usda`` (text), ``.usdc`` or ``.usd`` (binary), or ``.usdz`` (a package of one binary
            file). An existing file is replaced when the new one is complete; with ``clip_frames`` it is removed
            before its clips change.
        envs: Numbers of the environments with full physics, as in the coordinate ``env``; ``None``: the first 16.
        scene: Scene of the recording; ``None``: the scene stored with the recording.
        spacing: Distance along x and y between neighboring environments on a grid [m], each with its own surfaces.
            0 along both: all environments in place, with common surfaces.
        force_scale: Arrow length per force [m/N]; ``None``: the largest force is 1.5 times the largest body.
        ensemble: Whether to show all environments of the recording. ``"auto"``: if there are more than ``envs`` and
            ``spacing`` is 0; a large ensemble is reduced to an evenly spaced subset.
        color_by: Quantity that colors the ensemble, from low to high in viridis: the name of a parameter or sensor
            of the recording with one number per environment, or one equal for all items of a set; or values with
            the coordinate ``env``, such as an outcome, or with ``time`` and ``env``. ``None``: colors of the bodies.
        pressure: Whether to show the areas of body contacts as meshes colored by pressure, from 0 to the largest one of
            all records.
        clip_frames: Number of records per value clip, for long recordings. The file then refers to the folder
            ``<file name>.clips`` next to it, with one file per clip. Clips are written one by one, with one clip in
            memory, and an interrupted export resumes after the complete ones. ``None``: one file.
        progress: Whether to show a progress bar; ``None``: in a terminal, for exports that take over a second.

    Returns:
        The path.

    Raises:
        ValueError: If the suffix, an environment, the spacing, the scale or ``color_by`` is invalid, the recording
            lacks its scene or the pose of a body, or a pose is not finite; the message names it.
        TypeError: If an argument has the wrong type.
        OSError: If the file cannot be written, or the clip folder belongs to another stage; the message names it.
    """
    from tqdm import tqdm

    path = check_path(path)
    frames = None if clip_frames is None else check_frames(clip_frames, path)
    options = (envs, scene, spacing, force_scale, ensemble, color_by, pressure)
    export = Export(recording, *options)
    replay = export.replay
    bar = tqdm(
        total=len(replay.codes) * len(replay.envs),
        unit="record",
        unit_scale=True,
        desc=escape_controls(path.name),
        delay=1.0,
        file=terminal(),
        disable=None if progress is None else not progress,
    )
    with bar:
        if frames is None:
            _write(export, path, lambda done: bar.update(done * len(replay.codes)))
        else:
            Clips(export, path, frames).write(bar.update)
    return path


def _write(export: Export, path: Path, report_progress: ProgressCallback) -> None:
    """Writes a single file, without clips."""
    from pxr import Usd

    stage = Usd.Stage.CreateInMemory()
    content, records = Content.of(export.replay, pressure=export.pressure), (0, len(export.replay.codes))
    ranges = export.ranges([(records, content)])
    export.define(stage, content, ranges)
    export.animate(stage, content, Samples(export.replay.codes, stage.GetRootLayer()), records, report_progress)
    save_stage(stage, path)
