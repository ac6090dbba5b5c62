"""Export of recordings as animated USD stages."""

from collections.abc import Iterable
from pathlib import Path

import xarray as xr
from numpy.typing import ArrayLike

from warpcontact.drawing.content import Content
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.scene.scene_data import SceneData
from warpcontact.usd.author import Samples
from warpcontact.usd.clips import Clips, check_frames
from warpcontact.usd.files import check_path, save_stage
from warpcontact.usd.stage import Export, ProgressCallback
from warpcontact.validation.safe_text import escape_controls, terminal


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
    options = (envs, scene, spacing, force_scale, ensemble, color_by)
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
    content, records = Content.of(export.replay), (0, len(export.replay.codes))
    ranges = export.ranges([(records, content)])
    export.define(stage, content, ranges)
    export.animate(stage, content, Samples(export.replay.codes, stage.GetRootLayer()), records, report_progress)
    save_stage(stage, path)
