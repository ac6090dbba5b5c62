"""Reads a USD file: the description of an exported scene, or the UsdPhysics content of other stages."""

from pathlib import Path
from typing import Any

from warpcontact.meshes.readers.unreadable import Unreadable
from warpcontact.meshes.readers.usd_layers import check_layers, reason
from warpcontact.usd.importing.additions import additions
from warpcontact.usd.importing.physics import read_physics
from warpcontact.usd.importing.records import earlier_description, read_records
from warpcontact.usd.importing.stepping import stepping_of


def answer(task: dict[str, Any]) -> tuple[dict[str, Any], list[Any]]:
    """Returns the answer of the reader process; ``task`` holds the arguments of ``read_stage``."""
    from warpcontact.usd.importing.packing import pack

    try:
        return pack(read_stage(**task, confined=True))
    except Unreadable as error:
        return {"error": str(error)}, []


def read_stage(file: str, most_faces: int, *, confined: bool) -> dict[str, Any]:
    """Returns ``description``, the records of an exported scene, or ``physics``, the result of ``read_physics``.

    A description is accompanied by ``additions``, what the stage contains in addition to it, and ``stepping``.

    Args:
        file: Path of the file.
        most_faces: Largest number of triangles per mesh.
        confined: Whether all layers of the stage must lie in or below the folder of the file.

    Raises:
        Unreadable: If the file is damaged, or refers to files that are not allowed.
    """
    from pxr import Tf, Usd

    path = Path(file).resolve()
    check_layers(path, confined=confined)
    try:
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
        records = read_records(stage)
        if records is not None:
            return {
                "description": records,
                "additions": additions(stage, records),
                "stepping": stepping_of(stage),
            }
        physics = read_physics(stage, most_faces)
        if (warning := earlier_description(stage)) is not None:
            physics["findings"]["remarks"].append(warning)
        return {"physics": physics}
    except Tf.ErrorException as error:
        raise Unreadable(f"not valid USD: {reason(error)}") from error
    except Unreadable:
        raise
    except ValueError as error:
        raise Unreadable(str(error)) from error
