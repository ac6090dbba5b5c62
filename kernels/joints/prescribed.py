"""Prescribed motions: functions of time, and velocities set by the user."""

import math
from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import ROWS, parameter
from warpcontact.kernels.joints.base import Motion
from warpcontact.kernels.types import PRESCRIBED

Vector = tuple[float, float, float]

TWO_PI = wp.constant(wp.float64(2.0 * math.pi))
# Columns of a sample: start of its interval, and four coefficients for each of six components.
COLUMNS = 1 + 4 * 6


class Prescribed(Motion):
    """Prescribed velocities: those in the state, which only the user changes."""

    formula = "x = x + v dt, R = exp(ω dt) R"
    kind = PRESCRIBED


class Harmonic(Motion):
    """Harmonic translation along a direction, or harmonic rotation about an axis."""

    formula = "d (or rotation vector) = e a sin(2π f t + φ), e: unit vector"
    reference = "elementary"
    provenance = "R"
    exactly_one_of = ("amplitude", "angle")
    device = ("translation_amplitude", "rotation_amplitude", "direction", "frequency", "phase")

    direction: Vector = parameter("-", "direction or axis, world axes", shape=(3,), direction=True)
    amplitude: float | None = parameter("m", "amplitude of the displacement a", default=None)
    angle: float | None = parameter("rad", "amplitude of the rotation a", default=None)
    frequency: float = parameter("Hz", "frequency f", at_least=0.0)
    phase: float = parameter("rad", "phase φ at time 0", default=0.0)
    anchor: Vector | None = parameter(
        "m", "center of rotation, world; default: center of mass", shape=(3,), default=None
    )

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        zero = np.zeros_like(values["frequency"])
        given = {
            "translation_amplitude": values.get("amplitude", zero),
            "rotation_amplitude": values.get("angle", zero),
        }
        return {name: values[name] for name in ("direction", "frequency", "phase")} | given

    @wp.func
    def displacement(p: Any, t: Any):
        cycles = p.frequency * t
        # Remove whole cycles, because the sine of a large argument is less accurate.
        phase = TWO_PI * (cycles - wp.floor(cycles)) + p.phase
        return p.translation_amplitude * wp.sin(phase) * p.direction

    @wp.func
    def rotation(p: Any, t: Any):
        cycles = p.frequency * t
        phase = TWO_PI * (cycles - wp.floor(cycles)) + p.phase
        return p.rotation_amplitude * wp.sin(phase) * p.direction


@wp.func
def row_at(samples: wp.array2d(dtype=wp.float64), first: wp.int32, count: wp.int32, t: wp.float64):
    """Returns the row of the interval of ``t``; outside the table the first or last row."""
    low = first
    high = first + count
    while high - low > 1:
        middle = (low + high) // 2
        if samples[middle, 0] <= t:
            low = middle
        else:
            high = middle
    return low


@wp.func
def spline(
    samples: wp.array2d(dtype=wp.float64), first: wp.int32, count: wp.int32, t: wp.float64, column: wp.int32
):
    """Returns three components of the splines at ``t``, constant outside the table."""
    # The last row contains the end value only: a constant polynomial.
    within = wp.max(t, samples[first, 0])
    row = row_at(samples, first, count, within)
    x = within - samples[row, 0]
    if row == first + count - 1:
        x = wp.float64(0.0)
    value = wp.vec3d()
    for component in range(3):
        at = column + 4 * component
        value[component] = samples[row, at + 3] + x * (
            samples[row, at + 2] + x * (samples[row, at + 1] + x * samples[row, at])
        )
    return value


class Table(Motion):
    """Tabulated motion: modified Akima splines through displacements and rotation vectors.

    The cubics have continuous velocity, reproduce straight lines and constant values exactly, and overshoot
    little. Before the first and after the last time the pose is constant.
    """

    formula = "d = s D(r t), rotation vector = s Θ(r t): modified Akima splines, held before and after"
    reference = "Akima, J. ACM 17 (1970) 589"
    provenance = "R"
    device = ("first", "count", "scale", "rate")
    sampled = True

    times: tuple[float, ...] = parameter("s", "times, increasing", shape=(ROWS,))
    displacements: tuple[Vector, ...] | None = parameter(
        "m", "displacement at each time, world axes", shape=(ROWS, 3), default=None
    )
    rotations: tuple[Vector, ...] | None = parameter(
        "rad", "rotation vector at each time, world axes", shape=(ROWS, 3), default=None
    )
    scale: float = parameter("-", "factor s on displacements and rotations", default=1.0)
    rate: float = parameter("-", "time factor r", default=1.0, above=0.0)
    anchor: Vector | None = parameter(
        "m", "center of rotation, world; default: center of mass", shape=(3,), default=None
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        times = np.asarray(self.times, dtype=np.float64)
        if len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise ValueError(f"Table.times must be at least two increasing times [s], got {self.times!r}")
        if self.displacements is None and self.rotations is None:
            raise ValueError("Table takes displacements or rotations or both, got none")
        for name in ("displacements", "rotations"):
            rows = getattr(self, name)
            if rows is not None and len(rows) != len(times):
                raise ValueError(f"Table.{name} must have one row for each of {len(times)} times, got {len(rows)}")

    def samples(self) -> np.ndarray:
        """Returns a row for each time: the time and the coefficients of the polynomials of its interval."""
        from scipy.interpolate import Akima1DInterpolator  # slow to import

        times = np.asarray(self.times, dtype=np.float64)
        rows = np.zeros((len(times), COLUMNS))
        rows[:, 0] = times
        for block, values in enumerate((self.displacements, self.rotations)):
            if values is None:
                continue
            points = np.asarray(values, dtype=np.float64)
            # (4, interval, component), highest power first.
            pieces = Akima1DInterpolator(times, points, method="makima").c
            coefficients = rows[:, 1 + 12 * block : 13 + 12 * block].reshape(len(times), 3, 4)
            coefficients[:-1] = pieces.transpose(1, 2, 0)
            coefficients[-1, :, 3] = points[-1]
            rows[:, 1 + 12 * block : 13 + 12 * block] = coefficients.reshape(len(times), 12)
        return rows

    @wp.func
    def displacement(p: Any, t: Any, samples: Any):
        return p.scale * spline(samples, wp.int32(p.first), wp.int32(p.count), p.rate * t, 1)

    @wp.func
    def rotation(p: Any, t: Any, samples: Any):
        return p.scale * spline(samples, wp.int32(p.first), wp.int32(p.count), p.rate * t, 13)
