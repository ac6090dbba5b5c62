"""Validation of a USD stage: the validators of USD, and checks that they omit.

The validators find missing metadata and wrong schemas. They accept non-finite points, faces without points, negative
masses, and rigid bodies inside rigid bodies.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.keywords import explain_keywords

# Rounding of single precision, relative to the compared values.
ROUNDING = 1.0e-5
# Largest number of findings that one check reports for one prim.
MOST = 3


@explain_keywords
def check_usd(path: str | Path) -> list[str]:
    """Returns the defects of a stage, as sentences that begin with the path of a prim; empty if it is valid.

    Checks all time samples. Points, poses, extents and masses must be finite, quaternions of unit length, and
    indices in range. Extents must enclose their geometry, and principal moments must be those of a body. A rigid body
    inside another must reset its transform. All validators of USD must pass.

    Args:
        path: A ``.usd``, ``.usda``, ``.usdc`` or ``.usdz`` file from a trusted source: a malicious file may crash the
            process.

    Raises:
        OSError: If the file cannot be read.
    """
    from pxr import Tf, Usd, UsdValidation

    if not Path(path).is_file():
        raise FileNotFoundError(f"{path} is not a file")
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise OSError(f"cannot read {path}: {str(error).strip()}") from error
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    messages = UsdValidation.ValidationContext(validators).Validate(stage)
    found = [f"{_site(error)}: {error.GetMessage()}" for error in messages]
    for layer in stage.GetUsedLayers(includeClipLayers=True):
        # USD keeps time samples sorted, which non-finite times cannot be.
        invalid = [code for code in layer.ListAllTimeSamples() if not np.isfinite(code)]
        found += [
            f"/: time samples must be at finite times, got {code} in {layer.GetDisplayName()}" for code in invalid
        ]
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)):
        for check in _CHECKS:
            for number, finding in enumerate(check(prim)):
                if number < MOST:
                    found.append(f"{prim.GetPath()}: {finding}")
    return found


def _site(error: Any) -> str:
    sites = error.GetSites()
    return str(sites[0].GetPrim().GetPath()) if sites and sites[0].IsPrim() else "/"


def _samples(attribute: Any) -> Iterator[tuple[str, Any]]:
    """Iterates over the default value and the time samples of an attribute, each with its time as text."""
    from pxr import Usd

    if attribute.HasAuthoredValue():
        default = attribute.Get(Usd.TimeCode.Default())
        if default is not None:
            yield "", default
    for code in attribute.GetTimeSamples():
        value = attribute.Get(code)
        if value is not None:
            yield f" at time {code:g}", value


def _numbers(value: Any) -> NDArray[Any] | None:
    """Returns a value as a float array, quaternions as (…, 4) with the real part last; ``None`` if not numeric."""
    from pxr import Gf

    if isinstance(value, Gf.Quatd | Gf.Quatf | Gf.Quath):
        return np.array([*value.GetImaginary(), value.GetReal()], dtype=np.float64)
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return None
    return array if array.dtype.kind == "f" else None


def _finite(prim: Any) -> Iterator[str]:
    for attribute in prim.GetAttributes():
        name = attribute.GetName()
        # Recorded sensors may be NaN. Limits and breaking forces may be infinite.
        if name.startswith(("warpcontact:", "primvars:warpcontact:")) or attribute.GetTypeName() == "asset":
            continue
        may_be_infinite = "Limit" in name or "break" in name.lower() or name.startswith("limit:")
        for where, value in _samples(attribute):
            numbers = _numbers(value)
            if numbers is None:
                continue
            invalid = np.isnan(numbers) if may_be_infinite else ~np.isfinite(numbers)
            if invalid.any():
                yield f"{name}{where} must be finite, got {numbers[invalid].flat[0]}"
                break


def _quaternions(prim: Any) -> Iterator[str]:
    for attribute in prim.GetAttributes():
        type_name = str(attribute.GetTypeName())
        if not type_name.startswith("quat") or attribute.GetName().startswith("warpcontact:"):
            continue
        # Half precision has three digits.
        allowed = 2.0e-3 if type_name.startswith("quath") else 1.0e-5
        for where, value in _samples(attribute):
            numbers = _numbers(value)
            if numbers is None or numbers.size == 0:
                continue
            length = np.linalg.norm(numbers.astype(np.float64).reshape(-1, 4), axis=1)
            # A zero quaternion means that principal axes are not given; it is the fallback of UsdPhysics.
            if attribute.GetName() == "physics:principalAxes" and not length.any():
                continue
            deviation = np.abs(length - 1.0)
            if not (deviation <= allowed).all():
                yield f"{attribute.GetName()}{where} must be of unit length, got {length[np.argmax(deviation)]:g}"
                break


def _values_over_time(*attributes: Any) -> Iterator[tuple[str, list[Any]]]:
    """Iterates over the values of attributes at the default time and all sample times, each with the time as text.

    A missing value is empty. If an attribute has time samples only, the default time is omitted.
    """
    from pxr import Usd

    sampled = [attribute.GetTimeSamples() for attribute in attributes]
    default = [attribute.Get(Usd.TimeCode.Default()) for attribute in attributes]
    if not any(value is None and codes for value, codes in zip(default, sampled, strict=True)):
        yield "", [() if value is None else value for value in default]
    for code in sorted({code for codes in sampled for code in codes}):
        values = [attribute.Get(code) for attribute in attributes]
        yield f" at time {code:g}", [() if value is None else value for value in values]


def _out_of_range(values: Any, count: int) -> NDArray[Any]:
    """Returns the indices outside 0 … ``count`` − 1."""
    indices = np.array(values, dtype=np.int64)
    return indices[(indices < 0) | (indices >= count)]


def _mesh(prim: Any) -> Iterator[str]:
    from pxr import UsdGeom

    if not prim.IsA(UsdGeom.Mesh):
        return
    mesh = UsdGeom.Mesh(prim)
    counts = mesh.GetFaceVertexCountsAttr()
    topology = mesh.GetPointsAttr(), mesh.GetFaceVertexIndicesAttr(), counts
    for where, (points, indices, given) in _values_over_time(*topology):
        found, sizes = False, np.array(given, dtype=np.int64)
        if len(worst := _out_of_range(indices, len(points))):
            found = True
            yield f"faceVertexIndices{where} must be from 0 to {len(points) - 1}, the last point, got {worst[0]}"
        if (sizes < 3).any():
            found = True
            yield f"faceVertexCounts{where} must be at least 3, got {sizes.min()}"
        if sizes.sum() != len(indices):
            found = True
            yield f"faceVertexCounts{where} must add up to the {len(indices)} indices, got {sizes.sum()}"
        if found:
            break
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        for where, (chosen, faces) in _values_over_time(subset.GetIndicesAttr(), counts):
            if len(_out_of_range(chosen, len(faces))):
                name = subset.GetPrim().GetName()
                yield f"indices of {name}{where} must be from 0 to {len(faces) - 1}, the last face"
                break


def _curves(prim: Any) -> Iterator[str]:
    from pxr import UsdGeom

    if not prim.IsA(UsdGeom.Curves):
        return
    curves = UsdGeom.Curves(prim)
    if prim.IsAbstract() and not curves.GetPointsAttr().HasAuthoredValue():
        return  # points are authored by the prims that refer to the class
    for where, (counts, points) in _values_over_time(curves.GetCurveVertexCountsAttr(), curves.GetPointsAttr()):
        total = np.array(counts, dtype=np.int64).sum()
        if total != len(points):
            yield f"curveVertexCounts{where} must add up to the {len(points)} points, got {total}"
            return


def _instancer(prim: Any) -> Iterator[str]:
    from pxr import UsdGeom

    if not prim.IsA(UsdGeom.PointInstancer):
        return
    instancer = UsdGeom.PointInstancer(prim)
    which = instancer.GetProtoIndicesAttr()
    prototypes = len(instancer.GetPrototypesRel().GetForwardedTargets())
    for where, value in _samples(which):
        if len(worst := _out_of_range(value, prototypes)):
            yield f"protoIndices{where} must be from 0 to {prototypes - 1}, the last prototype, got {worst[0]}"
    for name in ("positions", "orientations", "orientationsf", "scales", "ids"):
        for where, (numbers, value) in _values_over_time(which, prim.GetAttribute(name)):
            if len(value) not in (0, len(numbers)):
                yield f"{name}{where} must be as many as the {len(numbers)} protoIndices, got {len(value)}"
                break
    for where, value in _samples(instancer.GetIdsAttr()):
        if len(np.unique(np.array(value, dtype=np.int64))) != len(value):
            yield f"ids{where} must differ"
            break
    for name, api in _primvars(prim):
        if api.GetInterpolation() not in ("vertex", "varying"):
            continue
        for where, (numbers, value) in _values_over_time(which, api.GetAttr()):
            if len(value) != len(numbers):
                count = len(numbers)
                yield f"primvar {name}{where} must have one value for each of {count} instances, got {len(value)}"
                break


def _primvars(prim: Any) -> Iterator[tuple[str, Any]]:
    from pxr import UsdGeom

    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues():
        yield primvar.GetPrimvarName(), primvar


def _extent(prim: Any) -> Iterator[str]:
    from pxr import Usd, UsdGeom

    if not prim.IsA(UsdGeom.Boundable) or prim.IsAbstract():
        return
    boundable = UsdGeom.Boundable(prim)
    attribute = boundable.GetExtentAttr()
    if not attribute.HasAuthoredValue():
        if prim.IsA(UsdGeom.Gprim) or prim.IsA(UsdGeom.PointInstancer):
            yield "extent must be authored"
        return
    for code in attribute.GetTimeSamples() or [Usd.TimeCode.Default()]:
        found = np.array(attribute.Get(code), dtype=np.float64)
        if found.shape != (2, 3):
            yield f"extent must be two corners, got {found.tolist()}"
            return
        needed = _required_extent(prim, boundable, code)
        if needed is None:
            continue
        slack = ROUNDING * (1.0 + np.abs(needed).max())
        if (found[0] > needed[0] + slack).any() or (found[1] < needed[1] - slack).any():
            where = "" if code == Usd.TimeCode.Default() else f" at time {code:g}"
            yield f"extent{where} must enclose {needed.tolist()}, got {found.tolist()}"
            return


def _required_extent(prim: Any, boundable: Any, code: Any) -> NDArray[Any] | None:
    """Returns the bounding box of a prim, (2, 3), or ``None`` if USD cannot compute it."""
    from pxr import UsdGeom

    if prim.IsA(UsdGeom.PointInstancer):
        corners = UsdGeom.PointInstancer(prim).ComputeExtentAtTime(code, code)
    else:
        corners = UsdGeom.Boundable.ComputeExtentFromPlugins(boundable, code)
    array = np.array(corners, dtype=np.float64) if corners is not None else np.empty(0)
    return array if array.shape == (2, 3) and np.isfinite(array).all() and (array[0] <= array[1]).all() else None


def _mass(prim: Any) -> Iterator[str]:
    from pxr import UsdPhysics

    if not prim.HasAPI(UsdPhysics.MassAPI):
        return
    api = UsdPhysics.MassAPI(prim)
    # In UsdPhysics, 0 is the fallback and means "not given".
    for name, attribute in (("mass", api.GetMassAttr()), ("density", api.GetDensityAttr())):
        for where, value in _samples(attribute):
            if not (np.isfinite(value) and value >= 0.0):
                yield f"{name}{where} must be greater than 0 and finite, or 0: not given, got {value}"
    for where, value in _samples(api.GetDiagonalInertiaAttr()):
        moments = np.sort(np.array(value, dtype=np.float64))
        if not moments.any():
            continue
        if not np.isfinite(moments).all() or moments[0] <= 0.0:
            yield (
                f"diagonalInertia{where} must be greater than 0 and finite, or all 0: not given, got "
                f"{moments.tolist()}"
            )
        elif moments[2] > (moments[0] + moments[1]) * (1.0 + ROUNDING):
            yield (
                f"diagonalInertia{where} must be that of a body: no moment may exceed the sum of the others, got "
                f"{moments.tolist()}"
            )


def _nested(prim: Any) -> Iterator[str]:
    from pxr import UsdGeom, UsdPhysics

    if not prim.HasAPI(UsdPhysics.RigidBodyAPI):
        return
    # UsdPhysics allows a nested body if a transform between both is reset.
    while not (prim.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(prim).GetResetXformStack()):
        prim = prim.GetParent()
        if not prim or prim.IsPseudoRoot():
            return
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            yield f"must not be a rigid body in the rigid body {prim.GetPath()} without !resetXformStack!"
            return


def _material(prim: Any) -> Iterator[str]:
    from pxr import UsdPhysics

    if not prim.HasAPI(UsdPhysics.MaterialAPI):
        return
    api = UsdPhysics.MaterialAPI(prim)
    limits = {"StaticFriction": np.inf, "DynamicFriction": np.inf, "Restitution": 1.0, "Density": np.inf}
    for name, most in limits.items():
        for where, value in _samples(getattr(api, f"Get{name}Attr")()):
            if not (np.isfinite(value) and 0.0 <= value <= most):
                up_to = f" to {most:g}" if np.isfinite(most) else " on"
                yield f"{name[0].lower()}{name[1:]}{where} must be from 0{up_to}, got {value}"


_CHECKS: tuple[Callable[[Any], Iterator[str]], ...] = (
    _finite,
    _quaternions,
    _mesh,
    _curves,
    _instancer,
    _extent,
    _mass,
    _nested,
    _material,
)
