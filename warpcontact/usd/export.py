"""Recordings as animated USD stages."""

from collections.abc import Iterable
from pathlib import Path

import xarray as xr
from numpy.typing import ArrayLike

from warpcontact.drawing.content import Content
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.scene.scene import Scene
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
    scene: Scene | None = None,
    spacing: ArrayLike = (0.0, 0.0),
    force_scale: float | None = None,
    ensemble: bool | str = "auto",
    color_by: str | xr.DataArray | None = None,
    clip_frames: int | None = None,
    progress: bool | None = None,
) -> Path:
    """Writes a recording as an animated USD stage: Z up, metres, kilograms, one time code per record.

    ``/World/env_<number>`` is an environment with full physics, by the schemas of UsdPhysics; ``/World/Ensemble``
    shows all others as instances. What is where, and what of it is read from which variable of the recording, is
    described in ``docs/usd.md``.

    Args:
        recording: What ``Simulation.run`` returned, or the same data set loaded from a file.
        path: File to write, ``.usda`` (text), ``.usdc`` or ``.usd`` (binary), or ``.usdz`` (a package of one
            binary file); replaced if it exists, once the new one is whole, and with ``clip_frames`` removed
            before its clips change.
        envs: Numbers of the environments with full physics, as in the coordinate ``env``; ``None``: the first 16.
        scene: What was simulated; ``None``: what the recording remembers.
        spacing: Distance along x and y between neighbouring environments on a grid [m], each with surfaces
            of its own; 0 along both: all in place, with common surfaces.
        force_scale: Length of arrows [m/N]; ``None``: the largest force is 1.5 times the largest body.
        ensemble: Whether all environments of the recording are shown; ``"auto"``: where there are more than
            ``envs``, and in place, and of very many some that are evenly spread over all.
        color_by: What colours the ensemble, from low to high by viridis: name of a parameter or sensor of the
            recording with one number for each environment, or one for all items of a set in it, or values with
            the coordinate ``env``, such as an outcome, or with ``time`` and ``env``. ``None``: the colours of the
            bodies.
        clip_frames: For long recordings: number of records of a value clip. The file then refers to a folder
            beside it, ``<file name>.clips``, with one file for so many records; these are written one after the
            other, with no more than that in memory, and an export that was interrupted goes on behind those that
            are whole. ``None``: one file.
        progress: Whether to show a progress bar; ``None``: on exports of over a second, in a terminal.

    Returns:
        The path.

    Raises:
        ValueError: If the suffix, an environment, the spacing, the scale or what colours is not allowed, the
            recording lacks its scene or the pose of a body, or a pose is not finite; the message names it.
        TypeError: If an argument is of another type.
        OSError: If the file cannot be written, or the folder of its clips is that of another; names it.
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
    """Writes a single file."""
    from pxr import Usd

    stage = Usd.Stage.CreateInMemory()
    content, records = Content.of(export.replay), (0, len(export.replay.codes))
    ranges = export.ranges([(records, content)])
    export.define(stage, content, ranges)
    export.animate(stage, content, Samples(export.replay.codes, stage.GetRootLayer()), records, report_progress)
    save_stage(stage, path)
