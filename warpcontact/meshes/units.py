"""Length units of mesh files."""

from math import inf

from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.meshes.mesh import positive

#: Meters per unit.
UNITS = {
    "m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "km": 1e3, "in": 0.0254, "ft": 0.3048,
}  # fmt: skip


def metres(scale: object, unit: str | None, own: float | None) -> float:
    """Returns meters per unit of a file, multiplied by ``scale``.

    Args:
        scale: Additional factor.
        unit: Name of the unit; ``None``: the unit given in the file.
        own: Meters per unit given in the file, or ``None``.

    Raises:
        ValueError: If ``scale`` is not positive and finite, or the unit does not exist.
    """
    factor = positive("scale", scale)
    if unit is not None:
        if not isinstance(unit, str) or unit not in UNITS:
            raise ValueError(f"unit must be one of {', '.join(UNITS)}, got {unit!r}{suggestion(unit, UNITS)}")
        return factor * UNITS[unit]
    return factor * own if own is not None and 0.0 < own < inf else factor
