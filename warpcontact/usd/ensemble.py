"""All environments as colored instances for display, without physics.

There is one ``UsdGeom.PointInstancer`` per body element.
"""

import math
from typing import Any

import numpy as np
import xarray as xr

from warpcontact.drawing.colors import COLORMAP, Scale, per_environment_number
from warpcontact.drawing.content import POINT
from warpcontact.drawing.ensemble import BodyAppearance, Ensemble
from warpcontact.drawing.geometry import body_color
from warpcontact.kernels.catalogue.names import stored_name, suggestion
from warpcontact.usd.author import (
    ENSEMBLE,
    Layout,
    Samples,
    attribute_name,
    identifiers,
    integers,
    long_integers,
    quaternions,
    store_element_name,
    vectors,
)
from warpcontact.usd.geometry import set_color, write_shape, write_surface
from warpcontact.validation.checks import Array


def named_number(recording: xr.Dataset, name: str, outcome: xr.Dataset | None = None) -> xr.DataArray:
    """Returns a variable of a recording.

    Raises:
        ValueError: If there is none; the message lists the variables with one number per environment, including
            those of ``outcome``.
    """
    if stored_name(name) in recording:
        return recording[stored_name(name)]
    tables = [recording] if outcome is None else [recording, outcome]
    variables = [(str(key), one) for table in tables for key, one in table.data_vars.items()]
    available = sorted({key for key, one in variables if _could_color(one)})
    outcomes = "" if outcome is not None else " (an outcome is given as its values, run.outcome[name])"
    hint = suggestion(name, available) or f"; there are: {', '.join(available) or 'none'}"
    raise ValueError(f"color_by must be something that was recorded, got {name!r}{hint}{outcomes}")


def _could_color(array: xr.DataArray) -> bool:
    """Returns whether a variable may have one number per environment, judged without loading it."""
    return "env" in array.dims and array.dtype.kind in "biuf" and "axis" not in array.dims


class Coloring:
    """One number per environment, constant or per record, and its color.

    Args:
        color_by: Name of a variable of the recording, or values (env,) or (time, env) with these coordinates.
        recording: Recording that is exported.

    Attributes:
        name: Name of the variable.
        unit: Unit of the variable.
        is_time_dependent: Whether there is one number per record.
        scale: Color scale over all numbers scanned so far.
    """

    def __init__(self, color_by: str | xr.DataArray, recording: xr.Dataset) -> None:
        if isinstance(color_by, str):
            values = named_number(recording, color_by)
        elif isinstance(color_by, xr.DataArray):
            values = color_by
        else:
            raise TypeError(f"color_by must be a name or an xarray.DataArray, got {type(color_by).__name__}")
        self.name = str(values.name or "color")
        # Instances of sets store the number of their environment under this name.
        if attribute_name(self.name) == attribute_name("environment"):
            raise ValueError(f"color_by must have another name than {self.name!r}, which is reserved")
        found = per_environment_number(values)
        if found is None:
            raise ValueError(
                f"color_by must be one number for each environment, got {self.name!r} of {values.dtype} along "
                f"{', '.join(map(str, values.dims)) or 'nothing'}; items of a set must agree"
            )
        self.is_time_dependent = "time" in found.dims
        if self.is_time_dependent and found.sizes["time"] != recording.sizes["time"]:
            raise ValueError(
                f"color_by must have the {recording.sizes['time']} records of the recording, got "
                f"{found.sizes['time']} of {self.name!r}"
            )
        self.unit = str(values.attrs.get("units", "-"))
        self._values = found
        self.scale = Scale()

    def of(self, envs: list[int], first: int, stop: int) -> Array:
        """Returns the numbers of environments in a range of records, (time or 1, env); NaN if missing."""
        chosen = self._values.isel(time=slice(first, stop)) if self.is_time_dependent else self._values
        recorded = chosen["env"].values
        values = np.full((chosen.sizes["time"] if self.is_time_dependent else 1, len(envs)), np.nan)
        available = np.isin(envs, recorded)
        order = np.argsort(recorded, kind="stable")
        rows = order[np.searchsorted(recorded, np.asarray(envs)[available], sorter=order)]
        values[:, available] = chosen.isel(env=rows).values.astype(np.float64)
        return values

    def scan_records(self, envs: list[int], first: int, stop: int) -> None:
        """Extends the color scale to the numbers of a range of records."""
        self.scale = self.scale.widened(self.of(envs, first, stop))

    def legend(self) -> dict[str, Any]:
        """Returns the legend of the colors: variable, unit, color map and range."""
        legend: dict[str, Any] = {"colorBy": self.name, "unit": self.unit, "colormap": COLORMAP}
        if self.scale.low <= self.scale.high:
            legend |= {"low": self.scale.low, "high": self.scale.high}
        return legend


def define_ensemble(stage: Any, ensemble: Ensemble, layout: Layout, coloring: Coloring | None) -> None:
    """Defines the instances of all environments, as far as they are constant over time.

    Args:
        stage: Stage to write to.
        ensemble: Environments to show.
        layout: Layout of the stage. Its environments have their own prims with physics; their instances are hidden.
        coloring: Coloring of the environments; ``None``: colors of the elements.
    """
    from pxr import Kind, Usd, UsdGeom, Vt

    root = UsdGeom.Xform.Define(stage, ENSEMBLE).GetPrim()
    Usd.ModelAPI(root).SetKind(Kind.Tokens.group)
    root.SetDocumentation(
        "All environments, for display. Ids are their numbers; in a set of bodies, number times bodies of the "
        "set plus item. Those with their own prims are masked by invisibleIds."
    )
    root.SetCustomDataByKey("warpcontact:environments", Vt.IntArray(ensemble.replay.envs))
    if ensemble.left_out:
        root.SetCustomDataByKey("warpcontact:leftOut", Vt.IntArray(ensemble.left_out))
    for key, value in (coloring.legend() if coloring else {}).items():
        root.SetCustomDataByKey(f"warpcontact:{key}", value)
    for appearance in ensemble.appearances:
        _define(stage, ensemble, appearance, layout, coloring)


def _define(
    stage: Any, ensemble: Ensemble, appearance: BodyAppearance, layout: Layout, coloring: Coloring | None
) -> None:
    from pxr import Sdf, UsdGeom

    body, envs = appearance.body, np.array(ensemble.replay.envs)
    path = f"{ENSEMBLE}/{layout.names[body.name]}"
    instancer = UsdGeom.PointInstancer.Define(stage, path)
    store_element_name(instancer.GetPrim(), body.name)
    targets = []
    for number, (row, item) in enumerate(appearance.examples.tolist()):
        own = f"{path}/look_{number}"
        _define_appearance(stage, own, appearance, row, item, layout, color=coloring is None)
        targets.append(Sdf.Path(own))
    instancer.CreatePrototypesRel().SetTargets(targets)
    instancer.CreateProtoIndicesAttr(integers(appearance.numbers.reshape(-1)))
    numbers = np.repeat(envs, body.count)
    ids = numbers if body.single else numbers * body.count + np.tile(np.arange(body.count), len(envs))
    instancer.CreateIdsAttr(long_integers(ids))
    masked = ids[np.isin(numbers, layout.envs)]
    if len(masked):
        instancer.CreateInvisibleIdsAttr(long_integers(masked))
    if (appearance.scales != 1.0).any():
        instancer.CreateScalesAttr(vectors(np.repeat(appearance.scales.reshape(-1, 1), 3, axis=1)))
    if not body.single:
        names = Sdf.ValueTypeNames
        primvar = UsdGeom.PrimvarsAPI(instancer).CreatePrimvar("warpcontact:environment", names.IntArray, "vertex")
        primvar.Set(integers(numbers))


def _define_appearance(
    stage: Any, path: str, appearance: BodyAppearance, row: int, item: int, layout: Layout, *, color: bool
) -> None:
    """Writes one body as in one environment; without ``color`` it takes the color of its instance."""
    from pxr import UsdGeom

    UsdGeom.Xform.Define(stage, path)
    small = 0.5 * POINT * layout.size
    # In a set of bodies, each body has one sphere.
    spheres = {
        f"{layout.names[group.name]}.{number}": (group, number)
        for group in appearance.spheres
        for number in (range(group.radii.shape[1]) if appearance.body.single else [item])
    }
    surfaces = {layout.names[placement.surface.name]: placement for placement in appearance.surfaces}
    forms = {layout.names[form.shape.name]: form for form in appearance.forms}
    # Elements keep their names; a sphere with the same name gets another one.
    names = identifiers([*surfaces, *forms, *spheres])
    for name, placement in surfaces.items():
        write_surface(stage, f"{path}/{names[name]}", placement, row, physics=False, color=color)
    for name, (group, number) in spheres.items():
        radius = float(group.radii[row, number]) or small
        shade = body_color(appearance.body) if color else None
        _define_sphere(stage, f"{path}/{names[name]}", radius, group.places[row, number], shade)
    for name, form in forms.items():
        number = 0 if form.shape.single else item
        own = f"{path}/{names[name]}"
        write_shape(stage, own, form, row, layout.size, item=number, physics=False, color=color)
    if not (appearance.surfaces or appearance.spheres or appearance.forms):
        _define_sphere(stage, f"{path}/centre", small, np.zeros(3), body_color(appearance.body) if color else None)


def _define_sphere(stage: Any, path: str, radius: float, place: Array, color: Array | None) -> None:
    from pxr import Gf, UsdGeom

    sphere = UsdGeom.Sphere.Define(stage, path)
    sphere.CreateRadiusAttr(radius)
    sphere.CreateExtentAttr(vectors(np.array([[-radius] * 3, [radius] * 3])))
    if place.any():
        sphere.AddTranslateOp().Set(Gf.Vec3d(*place.tolist()))
    if color is not None:
        set_color(sphere, color)


def write_ensemble(
    stage: Any,
    ensemble: Ensemble,
    layout: Layout,
    coloring: Coloring | None,
    samples: Samples,
    records: tuple[int, int],
) -> None:
    """Writes the poses of all bodies in the records from ``records[0]`` up to, not including, ``records[1]``."""
    from pxr import UsdGeom

    for appearance in ensemble.appearances:
        body = appearance.body
        instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath(f"{ENSEMBLE}/{layout.names[body.name]}"))
        positions, orientations = ensemble.poses(body, *records)
        places = positions.reshape(len(positions), -1, 3)
        rotations = orientations.reshape(len(places), -1, 4)
        # Instances rotate; this is the half-diagonal of their bounding box in their own frame.
        reach = (math.sqrt(3.0) * appearance.scales * max(appearance.reach, 0.5 * POINT * layout.size)).reshape(
            -1, 1
        )
        extents = np.stack([(places - reach).min(axis=1), (places + reach).max(axis=1)], axis=1)
        samples.write(instancer.CreatePositionsAttr(), [vectors(frame) for frame in places])
        samples.write(instancer.CreateOrientationsfAttr(), [quaternions(frame) for frame in rotations])
        samples.write(instancer.CreateExtentAttr(), [vectors(frame) for frame in extents])
        if coloring is not None and (coloring.is_time_dependent or samples.defaults):
            _color(instancer, ensemble, coloring, body.count, samples, records)


def _color(
    instancer: Any,
    ensemble: Ensemble,
    coloring: Coloring,
    count: int,
    samples: Samples,
    records: tuple[int, int],
) -> None:
    """Writes the color of each instance and the number that it represents."""
    from pxr import Sdf, UsdGeom, Vt

    values = np.repeat(coloring.of(ensemble.replay.envs, *records), count, axis=1)
    names, api = Sdf.ValueTypeNames, UsdGeom.PrimvarsAPI(instancer)
    colors = api.CreatePrimvar("displayColor", names.Color3fArray, UsdGeom.Tokens.vertex).GetAttr()
    shown = [vectors(frame) for frame in coloring.scale.colors(values)]
    name = attribute_name(coloring.name)
    numbers = api.CreatePrimvar(name, names.DoubleArray, UsdGeom.Tokens.vertex).GetAttr()
    numbers.SetDocumentation(f"{coloring.name} [{coloring.unit}]")
    label = [Vt.DoubleArray.FromNumpy(np.ascontiguousarray(frame)) for frame in values]
    for attribute, series in ((colors, shown), (numbers, label)):
        if coloring.is_time_dependent:
            samples.write(attribute, series)
        else:
            attribute.Set(series[0])
