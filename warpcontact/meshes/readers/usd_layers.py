"""Which files a USD stage is made of, found out before it is composed.

A stage follows its references, payloads and sublayers wherever they lead. Opened one by one, layers are only
parsed: nothing that they refer to is read before its place is known.
"""

import re
from pathlib import Path
from typing import Any

from warpcontact.meshes.readers.content import Unreadable

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MOST_LAYERS = 1000


def check_layers(path: Path, *, confined: bool) -> None:
    """Checks every layer that the stage of file ``path`` is made of.

    Args:
        path: The file, without links.
        confined: Whether all of them have to lie in the folder of the file or below.

    Raises:
        Unreadable: If a layer lies elsewhere, is missing, is no USD file, or uses value clips (if confined).
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
            raise Unreadable(f"it is made of more than {MOST_LAYERS} files, which is not supported")
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
    """Returns the first that USD says went wrong, without names in its own source and folders of the file."""
    messages = re.findall(r"(?m)' at line \d+ in file .*? : '(.*?)'?$", str(error)) or [str(error)]
    # What its parser says of a place in a text, which it may say before without the place.
    placed = (re.search(r"([^/]*):(\d+):(\d+): (.*?)(?: at '| in <|$)", one) for one in messages)
    found = next((one for one in placed if one), None)
    if found is None:
        return " ".join(re.sub(r"<?\S*/([^\s/>]*)>?", r"\1", messages[0]).split())[:200]
    file, line, column, text = found.groups()
    text = "what stands there is not understood" if text.startswith("parse error matching") else text
    return f"{file}, line {line}, column {column}: {text}"[:200]


def _target(layer: Any, asset: str, folder: Path | None) -> str:
    """Returns the identifier of the layer that ``asset`` in ``layer`` names."""
    from pxr import Ar, Sdf

    if "://" in asset or "`" in asset:
        raise Unreadable(f"it refers to {asset[:200]!r}, which is no file")
    anchored = Sdf.ComputeAssetPathRelativeToLayer(layer, asset)
    outer, inner = anchored, ""
    if Ar.IsPackageRelativePath(anchored):
        outer, inner = Ar.SplitPackageRelativePathOuter(anchored)
    try:
        place = Path(outer).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a loop of links, or a null character
        raise Unreadable(f"it refers to {asset[:200]!r}, which cannot be read: {error}") from None
    if folder is not None and not place.is_relative_to(folder):
        raise Unreadable(
            f"it refers to {asset[:200]!r}, outside of its folder; allowed: files beside it or below, "
            "or any file with trusted=True"
        )
    if not place.is_file():
        raise Unreadable(f"it refers to {asset[:200]!r}, which does not exist")
    if not inner and place.suffix.lower() not in SUFFIXES:
        raise Unreadable(f"it refers to {asset[:200]!r}; allowed: files of type {', '.join(SUFFIXES)}")
    return anchored


def _refuse_clips(layer: Any, place: Any) -> None:
    """Value clips name further files, some by patterns, in which attributes are looked up."""
    # A variant has them as a prim has: any spec is looked at.
    spec = None if place.IsPropertyPath() else layer.GetObjectAtPath(place)
    if spec and any(key.startswith("clip") for key in spec.ListInfoKeys()):
        raise Unreadable(f"it has value clips at {place}, which are read with trusted=True only")
