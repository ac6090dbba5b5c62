"""Report of a contact coupling: minimum distance of the surfaces and largest area in range."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.model.environments import Environments
    from warpcontact.scene.contact_coupling import ContactCoupling
    from warpcontact.scene.contact_range import ExpectedImpact

# Maximum number of environments that are listed.
NAMED = 8
# Error of the stopping distance with steps of τ/20, relative to the distance traveled in the range.
PART_OF_STEPS = 1.0e-3


@dataclass(frozen=True)
class CouplingReport:
    """Minimum distance and effective area of a coupling in each environment since reset; can be printed.

    Attributes:
        name: Name of the coupling.
        effective_area: Largest area in range, (env,) [m²].
        minimum_distance: Smallest distance of a face in range, (env,) [m]; negative: penetration of the other
            surface; NaN: no face was in range.
        effective_range: Distance at which the force begins, (env,) [m].
        impact: The impact from which the range was computed; ``None``: not specified.
        first_env: Number of the first environment.
    """

    name: str
    effective_area: Array
    minimum_distance: Array
    effective_range: Array
    impact: "ExpectedImpact | None"
    first_env: int

    @property
    def in_range(self) -> NDArray[np.bool_]:
        """Whether any face was in range, (env,)."""
        return ~np.isnan(self.minimum_distance)

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Whether the surfaces touched, (env,)."""
        return self.minimum_distance <= 0.0

    @property
    def passed(self) -> NDArray[np.bool_]:
        """Whether the distance fell below ``closest`` of the expected impact, (env,); false if there is no impact.

        A tolerance of 0.1 % of the distance traveled allows for the error of the time step.
        """
        if self.impact is None:
            return np.zeros(len(self.minimum_distance), dtype=bool)
        closest = self.impact.closest
        return self.minimum_distance < closest - PART_OF_STEPS * (self.effective_range - closest)

    def __str__(self) -> str:
        reached = self.in_range
        lines = [f"{self.name}: {_count(reached)} came into range"]
        if reached.any():
            low, high = self.minimum_distance[reached].min(), self.minimum_distance[reached].max()
            lines.append(f"smallest distance: {_span(low, high)} m")
            low, high = self.effective_area[reached].min(), self.effective_area[reached].max()
            estimate = "" if self.impact is None else f", estimated {self.impact.area:.4g} m²"
            lines.append(f"largest area in range: {_span(low, high)} m²{estimate}")
        if self.impact is not None:
            lines.append(f"passed the closest distance of {self.impact.closest:.4g} m: {self._named(self.passed)}")
        lines.append(f"the surfaces met: {self._named(self.touched)}")
        return "\n".join(lines)

    def _named(self, mask: NDArray[np.bool_]) -> str:
        numbers = self.first_env + np.flatnonzero(mask)
        if not len(numbers):
            return "in no environment"
        more = f" and {len(numbers) - NAMED} more" if len(numbers) > NAMED else ""
        word = "environment" if len(numbers) == 1 else "environments"
        return f"in {word} {', '.join(map(str, numbers[:NAMED]))}{more}"


def report(coupling: "ContactCoupling", model: "Environments") -> CouplingReport:
    """Implements ``ContactCoupling.report``."""
    return CouplingReport(
        name=coupling.name,
        effective_area=model.sensor(f"{coupling.name}.effective_area").astype(np.float64),
        minimum_distance=model.sensor(f"{coupling.name}.minimum_distance").astype(np.float64),
        effective_range=model[f"{coupling.name}.effective_range"],
        impact=coupling.range.impact,
        first_env=model.first_env,
    )


#: Sensors of a coupling that are stored as outcomes of a run.
OUTCOMES = ("effective_area", "minimum_distance")


def report_of(coupling: "ContactCoupling", outcome: "xr.Dataset", parameters: "xr.Dataset") -> CouplingReport:
    """Returns the report of a coupling from the outcomes and parameters (env, …) of a run."""
    envs = outcome.sizes["env"]
    name = f"{coupling.name}.effective_range"
    ranges = parameters[name].values if name in parameters else np.full(envs, coupling.range.effective_range)
    return CouplingReport(
        name=coupling.name,
        effective_area=outcome[f"{coupling.name}.effective_area"].values.astype(np.float64),
        minimum_distance=outcome[f"{coupling.name}.minimum_distance"].values.astype(np.float64),
        effective_range=ranges,
        impact=coupling.range.impact,
        first_env=int(outcome["env"].values[0]) if envs else 0,
    )


def _count(mask: NDArray[np.bool_]) -> str:
    return f"{int(mask.sum())} of {len(mask)} environments"


def _span(low: float, high: float) -> str:
    return f"{low:.4g}" if f"{low:.4g}" == f"{high:.4g}" else f"{low:.4g} to {high:.4g}"
