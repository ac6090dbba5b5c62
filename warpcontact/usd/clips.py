"""Writes stage files: complete or not at all, and long recordings as USD value clips.

Clips are files of some records each, written one by one and resumable:

    run.usdc                          metadata, and the clip of each time
    run.usdc.clips/topology.usdc      all that is constant over time, and the first record as default values
    run.usdc.clips/manifest.usdc      attributes stored in clips
    run.usdc.clips/clip_000000.usdc   time samples of a block of records, and of the next record
    run.usdc.clips/clips.json         name of the stage, complete clips, and digests of their inputs

One block of records is in memory at a time. A clip also holds the first record of the next one, so that viewers
interpolate between clips. The stage is removed before its clips change and written last: if it exists, it is complete.
"""

import contextlib
import hashlib
import json
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.drawing.content import Content
from warpcontact.drawing.lines import Coil
from warpcontact.files.atomic_files import write_json
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import PARTIAL, RunPath, below_run, run_path_of
from warpcontact.usd.author import WORLD, Samples

if TYPE_CHECKING:
    from warpcontact.usd.export import Export, ProgressCallback

#: Suffixes of stage files.
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_PACKAGE = ".usdz"

FOLDER_SUFFIX = ".clips"
RECORD = "clips.json"

_CLIP = re.compile(r"clip_.*\.usdc")

Range = tuple[int, int]


def check_path(path: str | Path) -> Path:
    """Returns ``path`` as a ``Path``.

    Raises:
        ValueError: If its suffix is not one of ``SUFFIXES``.
    """
    file = Path(path)
    if file.suffix not in SUFFIXES:
        raise ValueError(f"path must end in {', '.join(SUFFIXES)}, got {str(path)!r}")
    return file


def save_stage(stage: Any, path: Path) -> None:
    """Writes a stage to a file, or a package of one."""
    if path.suffix == _PACKAGE:
        _save_package(stage, path)
    else:
        save_layer(stage.GetRootLayer(), path)


def save_layer(layer: Any, path: Path | RunPath) -> None:
    """Writes a layer. An existing file is replaced when the new one is complete.

    Raises:
        OSError: If the file cannot be written; the message names it.
    """
    with _atomic_replace(path) as partial:
        layer.Export(str(partial))


def remove_file(path: Path) -> None:
    """Removes a file if it exists, and syncs the folder, so that the removal precedes later writes on disk.

    Raises:
        OSError: If the file cannot be removed; the message names it.
    """
    run_path = run_path_of(path)
    try:
        if run_path.exists():
            run_path.remove()
            run_path.parent.sync()
    except OSError as error:
        raise OSError(f"cannot write {path}: {error.strerror or error}") from error


def _save_package(stage: Any, path: Path) -> None:
    from pxr import Sdf, UsdUtils

    with (
        _atomic_replace(path) as partial,
        tempfile.TemporaryDirectory(prefix=f".{path.stem}.", dir=path.parent) as folder,
    ):
        content = Path(folder) / f"{path.stem}.usdc"
        stage.GetRootLayer().Export(str(content))
        if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(content)), str(partial)):
            raise OSError("the package could not be created")


@contextlib.contextmanager
def _atomic_replace(path: Path | RunPath) -> Iterator[Path]:
    """Yields the name of a temporary file that replaces ``path`` if the block ends without an error."""
    from pxr import Sdf, Tf

    run_path = run_path_of(path)
    path = run_path.path
    try:
        run_path.parent.make()
        # The suffix determines the format.
        with run_path.replacement_path(f".{path.stem}{PARTIAL}{path.suffix}") as partial:
            yield partial.path
    except (Tf.ErrorException, OSError) as error:
        reason = error.strerror or str(error) if isinstance(error, OSError) else _first_sentence(str(error))
        raise OSError(f"cannot write {path}: {reason}") from error
    # USD caches open files by name, so reload an earlier version that is open.
    opened = Sdf.Layer.Find(str(path.resolve()))
    if opened:
        opened.Reload(force=True)


def _first_sentence(message: str) -> str:
    """Returns the first sentence of a USD error, without source locations."""
    parts = [line.partition(" : ")[2].strip(" '") for line in message.strip().splitlines()]
    return next(filter(None, parts), message.strip())


def check_frames(value: Any, path: Path) -> int:
    """Returns the number of records per clip.

    Raises:
        ValueError: If it is not a positive integer, or ``path`` is a package, which cannot hold clips.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise ValueError(f"clip_frames must be a whole number of records, at least 1, got {value!r}")
    if path.suffix == _PACKAGE:
        raise ValueError(f"clip_frames is not for .usdz, which is one file, got {str(path)!r}")
    return int(value)


class Clips:
    """Writes an export as clips.

    Args:
        export: "Export" to write.
        path: Path of the stage.
        frames: Number of records per clip.
    """

    def __init__(self, export: "Export", path: Path, frames: int) -> None:
        self.export = export
        self.path = path
        folder = path.with_name(path.name + FOLDER_SUFFIX)
        self.folder = below_run(folder) or RunPath(folder)
        count = len(export.replay.codes)
        self.blocks = [(first, min(first + frames, count)) for first in range(0, count, frames)]
        self._inputs: list[str] = []

    def write(self, report_progress: "ProgressCallback") -> None:
        """Writes the clips that do not exist yet, then the stage.

        Raises:
            OSError: If a file cannot be written, or the folder belongs to another stage; the message names it.
        """
        from pxr import Sdf, Usd

        owner = self._read_manifest().get("stage", self.path.name)
        if owner != self.path.name:
            raise FileExistsError(f"cannot write {self.path}: {self.folder} holds the clips of {owner!r}")
        ranges = self.export.ranges(self._contents(noting=True))
        stage = Usd.Stage.CreateInMemory()
        manifest = Sdf.Layer.CreateAnonymous(".usdc")
        first = self._content((0, 1), ranges.coils)
        self.export.define(stage, first, ranges)
        header = Samples([], None, declared=manifest)
        self.export.animate(stage, first, header, (0, 1), lambda _: None)
        topology = self.folder / "topology.usdc"
        remove_file(self.path)
        save_layer(stage.GetRootLayer(), topology)
        save_layer(manifest, self.folder / "manifest.usdc")
        about = {
            "stage": self.path.name,
            "topology": _sha(topology),
            "codes": _digest(np.array(self.export.replay.codes)),
        }
        reusable = self._reusable(about)
        done: list[dict[str, Any]] = []
        for number, (block, given) in enumerate(zip(self.blocks, self._inputs, strict=True)):
            file = self.folder / _name(number)
            entry = {"file": file.name, "records": list(block), "input": given}
            earlier = reusable.get(file.name, {})
            if {**entry, "sha256": earlier.get("sha256")} == earlier and _sha(file) == earlier["sha256"]:
                report_progress((block[1] - block[0]) * len(self.export.replay.envs))
            else:
                self._write_clip(stage, file, block, ranges.coils, report_progress)
            done.append({**entry, "sha256": _sha(file)})
            # Later clips of an earlier attempt may be complete as well.
            later = [reusable[name] for name in sorted(reusable) if name > file.name]
            write_json(self.folder / RECORD, {**about, "clips": [*done, *later]})
        write_json(self.folder / RECORD, {**about, "clips": done})
        for name in self.folder.names():
            if _CLIP.fullmatch(name) and name not in {entry["file"] for entry in done}:
                (self.folder / name).remove()
        save_layer(self._root(stage), self.path)

    def _contents(self, *, noting: bool) -> Iterator[tuple[Range, Content]]:
        for block in self.blocks:
            records = self._with_next(block)
            content = self._content(records, None)
            if noting:
                self._inputs.append(self._input(content, records))
            yield records, content

    def _with_next(self, block: Range) -> Range:
        return block[0], min(block[1] + 1, len(self.export.replay.codes))

    def _content(self, records: Range, coils: dict[str, Coil] | None) -> Content:
        return Content.of(self.export.replay.part(*records), coils, pressure=self.export.pressure)

    def _input(self, content: Content, records: Range) -> str:
        """Returns the SHA-256 of all values shown in a clip."""
        data = content.replay.data
        values = [np.ascontiguousarray(data[name].values) for name in sorted(map(str, data.data_vars))]
        ensemble, coloring = self.export.ensemble, self.export.coloring
        if ensemble is not None:
            for body in ensemble.replay.scene.bodies:
                values += ensemble.poses(body, *records)
            if coloring is not None:
                values.append(coloring.of(ensemble.replay.envs, *records))
        return _digest(*values)

    def _reusable(self, about: dict[str, str]) -> dict[str, dict[str, Any]]:
        """Returns the clips of an earlier attempt at the same export, by file name."""
        manifest = self._read_manifest()
        try:
            same = all(manifest[key] == value for key, value in about.items())
            return {str(entry["file"]): dict(entry) for entry in manifest["clips"]} if same else {}
        except (ValueError, KeyError, TypeError):
            return {}

    def _read_manifest(self) -> dict[str, Any]:
        """Returns the content of ``clips.json``; empty if it cannot be read."""
        try:
            manifest = json.loads((self.folder / RECORD).read())
        except UnsafeFileError:
            raise
        except (OSError, ValueError, RecursionError):
            return {}
        return manifest if isinstance(manifest, dict) else {}

    def _write_clip(
        self, stage: Any, file: RunPath, block: Range, coils: dict[str, Coil], report_progress: "ProgressCallback"
    ) -> None:
        from pxr import Sdf

        records = self._with_next(block)
        content = self._content(records, coils)
        layer = Sdf.Layer.CreateAnonymous(".usdc")
        samples = Samples(content.replay.codes, layer, defaults=False)
        self.export.animate(
            stage, content, samples, records, lambda envs: report_progress(envs * (block[1] - block[0]))
        )
        save_layer(layer, file)

    def _root(self, topology: Any) -> Any:
        """Returns the root layer, which refers to the topology and the clips."""
        from pxr import Sdf, Usd, UsdGeom, UsdPhysics

        layer, given = Sdf.Layer.CreateAnonymous(".usdc"), topology.GetRootLayer()
        stage = Usd.Stage.Open(layer)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        for key in ("startTimeCode", "endTimeCode", "timeCodesPerSecond", "framesPerSecond", "customLayerData"):
            setattr(layer, key, getattr(given, key))
        world = stage.DefinePrim(WORLD)
        stage.SetDefaultPrim(world)
        below = f"./{self.folder.name}"
        codes = self.export.replay.codes
        clips = Usd.ClipsAPI(world)
        clips.SetClipAssetPaths([Sdf.AssetPath(f"{below}/{_name(k)}") for k in range(len(self.blocks))])
        clips.SetClipManifestAssetPath(Sdf.AssetPath(f"{below}/manifest.usdc"))
        clips.SetClipPrimPath(WORLD)
        clips.SetClipActive([(codes[first], number) for number, (first, _) in enumerate(self.blocks)])
        clips.SetClipTimes([(codes[0], codes[0]), (codes[-1], codes[-1])])
        # As a reference, because clips are weaker than default values in the layer that names them. Without a stage,
        # which would search for the file before it exists.
        del stage, world, clips
        reference = Sdf.Reference(f"{below}/topology.usdc", WORLD)
        layer.GetPrimAtPath(WORLD).referenceList.prependedItems.append(reference)
        return layer


def _name(number: int) -> str:
    return f"clip_{number:06d}.usdc"


def _sha(path: RunPath) -> str:
    """Returns the SHA-256 of a file, or an empty text if it cannot be read."""
    try:
        with path.open_binary() as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except UnsafeFileError:
        raise
    except OSError:
        return ""


def _digest(*values: Any) -> str:
    total = hashlib.sha256()
    for value in values:
        array = np.ascontiguousarray(value)
        total.update(f"{array.dtype}{array.shape}".encode())
        total.update(array.tobytes() if array.dtype.kind != "O" else repr(array.tolist()).encode())
    return total.hexdigest()
