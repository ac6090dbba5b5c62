"""Atomic writing of stage files: complete or not at all."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from warpcontact.files.run_folder import PARTIAL, RunPath, place_of

#: Suffixes of stage files.
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_PACKAGE = ".usdz"


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
    place = place_of(path)
    try:
        if place.is_there():
            place.remove()
            place.parent.sync()
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

    place = place_of(path)
    path = place.path
    try:
        place.parent.make()
        # The suffix determines the format.
        with place.replaced(f".{path.stem}{PARTIAL}{path.suffix}") as partial:
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
