"""Checks the files that a USD stage refers to, before the stage is composed.

A stage follows its references, payloads and sublayers to any file. When layers are opened one by one, they are only
parsed: files that they refer to are read after their paths have been checked.
"""

import re
from pathlib import Path
from typing import Any

from warpcontact.meshes.readers.content import Unreadable

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MOST_LAYERS = 1000


def check_layers(path: Path, *, confined: bool) -> None:
    """Checks every layer of the stage of file ``path``.

    Args:
        path: The file, with links resolved.
        confined: Whether all layers must lie in or below the folder of the file.

    Raises:
        Unreadable: If a layer lies elsewhere, is missing, is not a USD file, or uses value clips (if confined).
    """
    waiting, seen = [str(path)], {str(path)}
    while waiting:
        layer = _open(waiting.pop())
        for asset in layer.GetCompositionAssetDependencies():
            if not asset:
                continue  # an internal reference
            target = _target(layer, asset, path.parent if confined else None)
            if target not in seen:
                seen.add(target)
                waiting.append(target)
        if len(seen) > MOST_LAYERS:
            raise Unreadable(f"the stage has more than {MOST_LAYERS} layers, which is not supported")
        if confined:
            layer.Traverse("/", lambda place, layer=layer: _refuse_clips(layer, place))


def _open(identifier: str) -> Any:
    from pxr import Sdf, Tf

    path = Path(identifier)
    if path.is_file() and not path.stat().st_size:
        raise Unreadable(f"not valid USD: {path.name!r} is empty")
    try:
        layer = Sdf.Layer.FindOrOpen(identifier)
    except Tf.ErrorException as error:
        raise Unreadable(f"not valid USD: {reason(error)}") from error
    if not layer:
        raise Unreadable(f"not valid USD: {path.name!r} cannot be opened")
    return layer


def reason(error: Exception) -> str:
    """Returns the first message of a USD error, without source locations of USD and folders of the file."""
    messages = re.findall(r"(?m)' at line \d+ in file .*? : '(.*?)'?$", str(error)) or [str(error)]
    # Prefer a parser message with a position in the text; the same message may come first without it.
    placed = (re.search(r"([^/]*):(\d+):(\d+): (.*?)(?: at '| in <|$)", one) for one in messages)
    found = next((one for one in placed if one), None)
    if found is None:
        return " ".join(re.sub(r"<?\S*/([^\s/>]*)>?", r"\1", messages[0]).split())[:200]
    file, line, column, text = found.groups()
    text = "syntax error" if text.startswith("parse error matching") else text
    return f"{file}, line {line}, column {column}: {text}"[:200]


def _target(layer: Any, asset: str, folder: Path | None) -> str:
    """Returns the identifier of the layer to which ``asset`` in ``layer`` refers."""
    from pxr import Ar, Sdf

    if "://" in asset or "`" in asset:
        raise Unreadable(f"the stage refers to {asset[:200]!r}, which is not a file")
    anchored = Sdf.ComputeAssetPathRelativeToLayer(layer, asset)
    outer, inner = anchored, ""
    if Ar.IsPackageRelativePath(anchored):
        outer, inner = Ar.SplitPackageRelativePathOuter(anchored)
    try:
        place = Path(outer).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a loop of links, or a null character
        raise Unreadable(f"the stage refers to {asset[:200]!r}, which cannot be read: {error}") from None
    if folder is not None and not place.is_relative_to(folder):
        raise Unreadable(
            f"the stage refers to {asset[:200]!r}, outside of its folder; allowed: files in that folder or below, "
            "or any file with trusted=True"
        )
    if not place.is_file():
        raise Unreadable(f"the stage refers to {asset[:200]!r}, which does not exist")
    if not inner and place.suffix.lower() not in SUFFIXES:
        raise Unreadable(f"the stage refers to {asset[:200]!r}; allowed: files of type {', '.join(SUFFIXES)}")
    return anchored


def _refuse_clips(layer: Any, place: Any) -> None:
    """Raises ``Unreadable`` if a prim has value clips, which name further files, some by patterns."""
    # Any spec is checked, because variants can have clips as well as prims.
    spec = None if place.IsPropertyPath() else layer.GetObjectAtPath(place)
    if spec and any(key.startswith("clip") for key in spec.ListInfoKeys()):
        raise Unreadable(f"value clips at {place} are read with trusted=True only")
