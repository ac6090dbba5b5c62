"""Spring and damper models of spring-dampers."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter, table
from warpcontact.kernels.catalogue.keywords import keywords_of, refuse_unknown
from warpcontact.kernels.couplings.springs.base import (
    Damper,
    Spring,
    area_below,
    area_to,
    polynomial,
    row_at,
    value_at,
    value_of,
)

_MANUAL = "Simcenter STAR-CCM+ manual, spring-damper coupling"


class Linear(Spring):
    """Constant stiffness."""

    formula = "f = k (x − x₀)"
    reference = _MANUAL
    provenance = "R"
    validity = "any stiffness"

    stiffness: float = parameter("N/m", "stiffness k", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return p.stiffness * s.extension

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        return values["stiffness"]


class Polynomial(Spring):
    """Force cubic in the extension, zero at rest length or given at a reference length.

    It is the integral of the stiffness k = a + 2 b (x − x₀) + 3 c (x − x₀)².
    """

    formula = "f = P(x − x₀),  or  f_r + P(x − x₀) − P(x_r − x₀);  P(e) = a e + b e² + c e³"
    reference = f"{_MANUAL}, (4949) to (4951)"
    provenance = "R"
    validity = "where it rises"
    device = ("a", "b", "c", "offset")

    a: float = parameter("N/m", "stiffness a at rest length")
    b: float = parameter("N/m²", "coefficient b of the second order", default=0.0)
    c: float = parameter("N/m³", "coefficient c of the third order", default=0.0)
    reference_length: float | None = parameter(
        "m", "length x_r at which the force is f_r", default=None, at_least=0.0
    )
    reference_force: float = parameter("N", "force f_r at the reference length, or at rest length", default=0.0)

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        a, b, c = values["a"], values["b"], values["c"]
        e = values.get("reference_length", values["rest_length"]) - values["rest_length"]
        return {"a": a, "b": b, "c": c, "offset": values["reference_force"] - e * (a + e * (b + e * c))}

    @wp.func
    def force(p: Any, s: Any):
        return p.offset + polynomial(p.a, p.b, p.c, s.extension)

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        e = lengths - values["rest_length"]
        return values["a"] + e * (2.0 * values["b"] + 3.0 * values["c"] * e)


class StiffnessTable(Spring):
    """Stiffness over the distance, piecewise linear, integrated exactly; constant outside the table.

    The force is zero at rest length, or ``reference_force`` at ``reference_length``. ``StiffnessTable.of`` samples
    a function.
    """

    formula = "f = f_r + ∫ k(ξ) dξ from x_r to x"
    reference = f"{_MANUAL}, (4948) and (4949)"
    provenance = "R"
    validity = "within the table"
    device = ("scale", "offset")

    table: tuple[tuple[float, float], ...] = table("N/m", "stiffness k over the distance x")
    scale: float = parameter("-", "factor on the stiffness", default=1.0, at_least=0.0)
    reference_length: float | None = parameter(
        "m", "length x_r at which the force is f_r", default=None, at_least=0.0
    )
    reference_force: float = parameter("N", "force f_r at the reference length, or at rest length", default=0.0)

    @classmethod
    def of(
        cls, stiffness: Callable[[np.ndarray], np.ndarray], lengths: Any, **parameters: Any
    ) -> "StiffnessTable":
        """Returns the table of a function of the distance, sampled at ``lengths``.

        Args:
            stiffness: Vectorized function of the distance [m] that returns the stiffness [N/m].
            lengths: Sample points [m].
            **parameters: Parameters of the spring.
        """
        names = [field.name for field in dataclasses.fields(cls) if field.name != "table"]
        refuse_unknown(f"{cls.__name__}.of", parameters, [*keywords_of(cls.of), *names])
        x = np.asarray(lengths, dtype=np.float64)
        return cls(table=tuple(zip(x.tolist(), np.asarray(stiffness(x)).tolist(), strict=True)), **parameters)

    def coefficients(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        before = area_to(self.table, values.get("reference_length", values["rest_length"]))
        scale = values["scale"]
        return {"scale": scale, "offset": values["reference_force"] - scale * before}

    @wp.func
    def force(p: Any, s: Any, row: Any):
        return p.offset + p.scale * area_below(row, s.length)

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        return values["scale"] * value_of(self.table, lengths)


class ForceTable(Spring):
    """Force over the distance, piecewise linear; constant outside the table."""

    formula = "f = f_e(x)"
    reference = f"{_MANUAL}, (4946)"
    provenance = "R"
    validity = "within the table"

    table: tuple[tuple[float, float], ...] = table("N", "force f_e over the distance x")
    scale: float = parameter("-", "factor on the force", default=1.0)

    @wp.func
    def force(p: Any, s: Any, row: Any):
        return p.scale * value_at(row, s.length)

    def slope(self, values: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray | None:
        return values["scale"] * row_at(self.table, lengths)[..., 2]


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
        return values["scale"] * value_of(self.table, lengths)
