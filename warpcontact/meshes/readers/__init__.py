"""Readers of mesh files: from bytes to vertices, faces and groups of faces.

Files are untrusted. A reader refuses content that is ambiguous, and opens no other file (USD: only files in or below the
folder of the file). Nothing is repaired, merged, sorted or silently omitted: face i is face i of the file, unless
polygons were triangulated, which a warning reports. The readers of trimesh reorder and omit faces and accept damaged files
without an error (``tests/meshes/test_trimesh_readers.py``). Imports are NumPy only, and pxr for USD, because readers run in a
separate process (``isolation.py``).
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
    """Reads a mesh file; every failure is reported as one sentence.

    Args:
        path: The file, with one of ``SUFFIXES``.
        prim: Path of a prim, for USD only.
        most_faces: Largest number of triangles.
        confined: Whether the layers of a USD stage must lie in or below the folder of the file.

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
        raise Unreadable("the file needs more memory than allowed, see Limits") from error
    # On damaged files, readers can raise any exception: KeyError, OverflowError, RecursionError.
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise Unreadable(
            f"the content is not valid {suffix[1:].upper()} ({type(error).__name__}: {reason})"
        ) from error
