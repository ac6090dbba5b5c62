"""Implements ``Scene.from_usd``: reads the file in a sandboxed process and builds the scene."""

import os
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.meshes.isolation import Limits, read_sandboxed
from warpcontact.meshes.readers import USD_SUFFIXES, Unreadable
from warpcontact.scene.elements import ContactMaterial
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.surface_contact import check_amount
from warpcontact.usd.importing.assemble import build_scene
from warpcontact.usd.importing.errors import UsdError, shortened
from warpcontact.usd.importing.packing import unpack
from warpcontact.usd.importing.restore import restore_scene
from warpcontact.usd.importing.stage import read_stage
from warpcontact.validation import checks
from warpcontact.validation.checks import limits as allowed


def scene_from_usd(
    path: str | os.PathLike[str],
    *,
    custom_types: Iterable[type[Formula]],
    material: ContactMaterial | None,
    contact_time: float,
    samples: int | str,
    skip_unsupported: bool,
    trusted: bool,
    limits: Limits | None,
) -> SceneData:
    """Returns the scene of a USD file; arguments and errors as for ``Scene.from_usd``."""
    if material is not None and not isinstance(material, ContactMaterial):
        raise TypeError(f"material must be a wc.ContactMaterial or None, got {material!r}")
    if limits is not None and not isinstance(limits, Limits):
        raise TypeError(f"limits must be a Limits or None, got {limits!r}")
    duration = float(checks.numbers("contact_time", contact_time, (), allowed("s", above=0.0)))
    amount = check_amount("samples", samples)
    skip = checks.switch("skip_unsupported", skip_unsupported)
    subject = f"stage {shortened(path)!r}"
    found = _read(Path(path), subject, checks.switch("trusted", trusted), Limits() if limits is None else limits)
    if "description" in found:
        if found["additions"] and not skip:
            raise UsdError(subject, [f"{one} (not supported)" for one in found["additions"]])
        scene = restore_scene(found["description"], custom_types, subject)
        scene.suggested_dt = found["stepping"]["dt"]
        scene.suggested_iterations = found["stepping"]["iterations"]
        scene.import_warnings = tuple(f"omitted: {one}" for one in found["additions"])
        return scene
    return build_scene(
        found["physics"],
        subject,
        material=material,
        contact_time=duration,
        samples=amount,
        skip_unsupported=skip,
    )


def _read(path: Path, subject: str, trusted: bool, limits: Limits) -> Any:
    try:
        if path.suffix.lower() not in USD_SUFFIXES:
            raise Unreadable(f"the extension {path.suffix!r} is not one of {', '.join(USD_SUFFIXES)}")
        if not path.is_file():  # excludes pipes, which would block
            raise Unreadable("it is not a regular file" if path.exists() else "it does not exist")
        file = os.path.abspath(path)
        if trusted:
            return read_stage(file, limits.faces, confined=False)
        task = {"file": file, "most_faces": limits.faces}
        return read_sandboxed("warpcontact.usd.importing.stage", task, limits, partial(unpack, limits=limits))
    except (Unreadable, OSError) as error:
        raise UsdError(subject, [str(error)]) from error
