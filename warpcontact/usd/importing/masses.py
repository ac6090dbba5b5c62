"""Mass properties of a rigid body or collider: PhysicsMassAPI and NewtonMassAPI, in SI units."""

from math import inf, isfinite
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from warpcontact.usd.importing.findings import InvalidValue, number, vector
from warpcontact.usd.importing.schemas import has, is_authored, value_of

Array = npt.NDArray[np.float64]
# Negative principal moments up to this fraction of the largest one are attributed to rounding.
_ROUNDING = 1.0e-9


def read_mass(prim: Any, placement: Array, time: Any, metres: float, kilograms: float) -> dict[str, Any]:
    """Returns the authored mass properties of a body or collider.

    Args:
        prim: Prim of the body or collider.
        placement: Matrix (4, 4) from prim to world [m], for column vectors.
        time: Time code to read at.
        metres: Length unit of the stage [m].
        kilograms: Mass unit of the stage [kg].

    Returns:
        ``mass`` [kg] and ``density`` [kg/m³], 0 if not given; and, ``None`` if not given, ``moments`` (3,) [kg·m²],
        ``axes`` (4,), quaternion (x, y, z, w) from principal axes to prim, and ``centre`` (3,), world [m].

    Raises:
        InvalidValue: If a value is out of range.
    """
    from pxr import UsdPhysics

    found: dict[str, Any] = {"mass": 0.0, "density": 0.0, "moments": None, "axes": None, "centre": None}
    if not has(prim, "PhysicsMassAPI"):
        return found
    api = UsdPhysics.MassAPI(prim)
    found["mass"] = kilograms * number(api.GetMassAttr(), time, least=0.0)
    found["density"] = number(api.GetDensityAttr(), time, least=0.0) * kilograms / metres**3
    moments, axes = _tensor(prim, time)
    if moments is None:
        moments, axes = vector(api.GetDiagonalInertiaAttr(), time), _axes(api, time)
    if moments.any():
        if (moments < 0.0).any():
            raise InvalidValue(f"physics:diagonalInertia must be positive, got {moments.tolist()}")
        found["moments"], found["axes"] = kilograms * metres**2 * moments, axes
    # The fallback, -inf in all components, means "not given".
    if value_of(api.GetCenterOfMassAttr(), time, (-inf,) * 3) != (-inf,) * 3:
        centre = vector(api.GetCenterOfMassAttr(), time)
        found["centre"] = placement[:3, :3] @ centre + placement[:3, 3]
    return found


def _axes(api: Any, time: Any) -> Array | None:
    """Returns the authored principal axes, a quaternion (x, y, z, w) of unit length."""
    axes = value_of(api.GetPrincipalAxesAttr(), time)
    if axes is None:
        return None
    quaternion = np.array([*axes.GetImaginary(), axes.GetReal()], dtype=np.float64)
    length = float(np.linalg.norm(quaternion))
    if not isfinite(length):
        raise InvalidValue(f"physics:principalAxes must be finite, got {quaternion.tolist()}")
    return quaternion / length if length > 0.0 else None


def _tensor(prim: Any, time: Any) -> tuple[Array | None, Array | None]:
    """Returns principal moments and axes of ``newton:inertia``, which overrides those of PhysicsMassAPI."""
    attribute = prim.GetAttribute("newton:inertia")
    given = value_of(attribute, time, ()) if is_authored(attribute) else ()
    if not len(given):
        return None, None
    values = np.array(given, dtype=np.float64)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise InvalidValue(f"newton:inertia must be 6 finite numbers, got {values.tolist()}")
    xx, yy, zz, xy, xz, yz = values
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if moments[0] < -_ROUNDING * moments[2] or not moments[2] > 0.0:
        raise InvalidValue(f"newton:inertia must have positive principal moments, got {moments.tolist()}")
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return np.maximum(moments, 0.0), Rotation.from_matrix(axes).as_quat()
