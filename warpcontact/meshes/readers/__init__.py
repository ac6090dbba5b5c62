"""Readers of mesh files: from the bytes to vertices, faces and groups of faces.

Files come from anywhere. A reader takes what it needs, refuses what it cannot be sure of, and opens no other
file (USD: none out of the folder of the file). Nothing is repaired, merged, sorted or left out without a word:
face i is face i of the file, unless the file has polygons, which a warning then says. Only NumPy is imported,
and pxr for USD: a reader starts in a process of its own.
"""

import os
from collections.abc import Callable
from pathlib import Path

from warpcontact.meshes.readers.content import Content, Unreadable
from warpcontact.meshes.readers.glb import read_glb
from warpcontact.meshes.readers.obj import read_obj
from warpcontact.meshes.readers.off import read_off
from warpcontact.meshes.readers.parts import too_many
from warpcontact.meshes.readers.ply import read_ply
from warpcontact.meshes.readers.stl import read_stl
from warpcontact.meshes.readers.usd import read_usd
from warpcontact.meshes.readers.usd_layers import SUFFIXES as USD_SUFFIXES

_READERS: dict[str, Callable[[bytes], Content]] = {
    ".stl": read_stl,
    ".obj": read_obj,
    ".ply": read_ply,
    ".off": read_off,
}
#: Extensions of files that can be read.
SUFFIXES = (*_READERS, ".glb", *USD_SUFFIXES)

__all__ = ["SUFFIXES", "USD_SUFFIXES", "Content", "Unreadable", "read"]


def read(path: str | os.PathLike[str], prim: str | None, most_faces: int, *, confined: bool) -> Content:
    """Reads a mesh file; whatever stops a reader becomes one sentence.

    Args:
        path: The file, with one of ``SUFFIXES``.
        prim: Path of a prim, for USD only.
        most_faces: Number of triangles that are allowed.
        confined: Whether a USD stage may be made of files out of the folder of the file.

    Raises:
        Unreadable: If the content is damaged or not supported.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        if suffix in USD_SUFFIXES:
            content = read_usd(path, prim, most_faces, confined=confined)
        else:
            data = path.read_bytes()
            if not data:
                raise Unreadable("the file is empty")
            content = read_glb(data, most_faces) if suffix == ".glb" else _READERS[suffix](data)
        if max(len(content.faces), len(content.vertices) / 3) > most_faces:
            raise too_many(len(content.faces), most_faces)
        return content
    except Unreadable:
        raise
    except MemoryError as error:
        raise Unreadable("it needs more memory than is allowed, see Limits") from error
    # Readers of damaged files stop with anything: KeyError, OverflowError, RecursionError.
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise Unreadable(
            f"the content is not valid {suffix[1:].upper()} ({type(error).__name__}: {reason})"
        ) from error
