"""Damper models of spring-dampers."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter, table
from warpcontact.kernels.couplings.springs import tables
from warpcontact.kernels.couplings.springs.base import Damper, value_at

_MANUAL = "Simcenter STAR-CCM+ manual, spring-damper coupling"


class Undamped(Damper):
    """No damping."""

    formula = "f = 0"

    @wp.func
    def force(p: Any, s: Any):
        return type(s.rate)(0.0)

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        return np.zeros_like(lengths)


class Viscous(Damper):
    """Constant damping coefficient."""

    formula = "f = k_d ẋ"
    reference = f"{_MANUAL}, (4944)"
    provenance = "R"

    damping: float = parameter("N·s/m", "damping coefficient k_d", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return p.damping * s.rate

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        return values["damping"]


class PolynomialDamping(Damper):
    """Damping coefficient quadratic in the extension, clipped at zero."""

    formula = "f = max(0, a + b (x − x₀) + c (x − x₀)²) ẋ"
    reference = f"{_MANUAL}; the polynomial method of its reference"
    provenance = "R"

    a: float = parameter("N·s/m", "damping coefficient a at rest length")
    b: float = parameter("N·s/m²", "coefficient b of the first order", default=0.0)
    c: float = parameter("N·s/m³", "coefficient c of the second order", default=0.0)

    @wp.func
    def force(p: Any, s: Any):
        coefficient = p.a + s.extension * (p.b + s.extension * p.c)
        return wp.max(coefficient, type(s.rate)(0.0)) * s.rate

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        e = lengths - values["rest_length"]
        return np.maximum(values["a"] + e * (values["b"] + e * values["c"]), 0.0)


class DampingTable(Damper):
    """Damping coefficient over the distance, piecewise linear; constant outside the table."""

    formula = "f = k_d(x) ẋ"
    reference = f"{_MANUAL}; the table method of its reference"
    provenance = "R"

    table: tuple[tuple[float, float], ...] = table(
        "N·s/m", "damping coefficient k_d over the distance x", at_least=0.0
    )
    scale: float = parameter("-", "factor on the damping", default=1.0, at_least=0.0)

    @wp.func
    def force(p: Any, s: Any, row: Any):
        return p.scale * value_at(row, s.length) * s.rate

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        return values["scale"] * tables.value_of(self.table, lengths)
