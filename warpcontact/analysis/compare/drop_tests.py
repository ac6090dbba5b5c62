"""Drop tests: impacts of a sphere on a plate, with one body per law, simulated in float64.

The elastic parameter of a law class, and the damping for a given restitution, are found by measuring forces and rebounds
in the same scene. The method needs no knowledge of the formula of a law.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator

from warpcontact.analysis.compare import instances as samples
from warpcontact.building.scene import Scene
from warpcontact.kernels.laws.base import Law
from warpcontact.meshes import grid
from warpcontact.model.environments import Environments
from warpcontact.scene.elements import ContactMaterial
from warpcontact.scene.status import ContactStatus
from warpcontact.stepping.simulation import Simulation
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

# Contact time as a multiple of δ/v. Undamped contacts take 2.6 to 3.14 δ/v, depending on the exponent.
CONTACT_TIME = 3.0
# Steps per contact time. The error of laws with a jump at the largest penetration is about 1/STEPS.
STEPS = 1000
# Steps per contact time in the series of dampings, which needs less accuracy.
COARSE_STEPS = 250
# Steps between records, a divisor of both.
STRIDE = 2
# Largest duration in contact times. Restitution 0.01 with two stiffnesses takes 51.
MAX_CONTACT_TIMES = 60
# Dampings as multiples of ``samples.damping_scale``: restitution falls from 0.999 to below 0.05.
DAMPINGS = np.geomspace(1.0e-3, 30.0, 61)
# Penetrations at which elastic forces are evaluated, as multiples of the target penetration.
DEPTHS = np.geomspace(1.0e-4, 1.0e2, 1201)
# Penetration of the undamped impact if neither a depth nor a law with a given elastic parameter defines it [m].
DEFAULT_DEPTH = 1.0e-3
# Radius of the sphere as a multiple of the largest penetration; its center must stay above the plate.
RADIUS = 50.0
# Radius of the sphere for laws whose force depends on the curvature [m].
CURVED_RADIUS = 0.1
#: Allowed values of the fields of ``Impact``.
LIMITS = {
    "mass": checks.limits("kg", above=0.0),
    "speed": checks.limits("m/s", above=0.0),
    "depth": checks.limits("m", above=0.0),
}
SENSORS = ("penetration", "approach_speed", "normal_force")


@dataclass(frozen=True)
class Impact:
    """Impact in which laws are compared.

    Attributes:
        mass: Mass of the sphere [kg].
        speed: Impact speed [m/s].
        depth: Penetration of the undamped impact [m], to which the elastic parameters of classes are fitted;
            ``None``: that of the first law with a given elastic parameter, or ``DEFAULT_DEPTH``.
        device: Warp device.
    """

    mass: float
    speed: float
    depth: float | None
    device: str

    def __post_init__(self) -> None:
        for name, allowed in LIMITS.items():
            value = getattr(self, name)
            if value is not None or name != "depth":
                object.__setattr__(self, name, float(checks.numbers(name, value, (), allowed)))

    @property
    def energy(self) -> float:
        """Kinetic energy before the impact [J]."""
        return 0.5 * self.mass * self.speed**2


@dataclass(frozen=True)
class LawCase:
    """Law with its parameters in the impact.

    Attributes:
        law: Instance of the law.
        depth: Penetration of its undamped impact [m]; NaN if it exceeds the evaluated range.
        given: Whether the elastic parameter was given instead of fitted to ``depth``.
        varied: Name of the dissipation parameter that is varied; ``None`` if there is none, or if it was given.
    """

    law: Law
    depth: float
    given: bool
    varied: str | None


@dataclass(frozen=True)
class Run:
    """Measurements of all laws.

    Attributes:
        time: Time since first contact at the common speed (frame,) [s].
        sensors: By label and name of the sensor, (frame, env).
        rebound: By label, separation speed over impact speed (env,); NaN if the sphere did not leave the plate.
    """

    time: Array
    sensors: Mapping[str, Mapping[str, Array]]
    rebound: Mapping[str, Array]


def cases(laws: Any, impact: Impact) -> dict[str, LawCase]:
    """Returns instances of ``laws`` by label.

    The elastic parameter of a class is fitted to the depth of ``impact``, or to that of the first law with a given
    elastic parameter.

    Raises:
        TypeError: If an entry is not a law.
        ValueError: If a class has parameters for which no value can be chosen.
    """
    given = samples.named(Law, laws)
    with_modulus = {label: entry for label, entry in given.items() if samples.is_modulus_given(entry)}
    default_depth = impact.depth or DEFAULT_DEPTH
    instances = {label: samples.law(entry, 1.0, default_depth) for label, entry in with_modulus.items()}
    depths = DEPTHS * default_depth
    own = {
        label: float(np.interp(impact.energy, work, depths, right=np.nan))
        for label, work in _static_work(instances, depths, impact).items()
    }
    depth = impact.depth or next((depth for depth in own.values() if depth > 0.0), DEFAULT_DEPTH)
    without_modulus = {label: entry for label, entry in given.items() if label not in with_modulus}
    unit = {label: samples.law(entry, 1.0, depth) for label, entry in without_modulus.items()}
    for label, work in _static_work(unit, DEPTHS * depth, impact).items():
        modulus = impact.energy / float(np.interp(depth, DEPTHS * depth, work))
        instances[label] = samples.law(without_modulus[label], modulus, depth)
    found = {}
    for label, entry in given.items():
        varied = samples.dissipation_parameter(instances[label])
        given_values = samples.values_of(entry) or {}
        found[label] = LawCase(
            law=instances[label],
            depth=own.get(label, depth),
            given=label in with_modulus,
            varied=None if varied in given_values else varied,
        )
    return found


def dissipation_values(chosen: Mapping[str, LawCase], restitution: Array, impact: Impact) -> dict[str, Array]:
    """Returns, by label, the values of the varied parameter for each ``restitution``; no entry for elastic laws.

    A damping is interpolated in a series of runs. If no damping of the series suffices, the largest useful one is
    returned.
    """
    values = {label: restitution for label, case in chosen.items() if case.varied == "restitution"}
    damped = {label: case for label, case in chosen.items() if case.varied is not None and label not in values}
    if not damped:
        return values
    series = {
        label: np.append(0.0, DAMPINGS)
        * samples.damping_scale(case.law, case.varied or "", impact.mass, impact.speed, _undamped_depth(case))
        for label, case in damped.items()
    }
    speeds = np.full(len(DAMPINGS) + 1, impact.speed)
    run = drop(
        damped, series, speeds, impact, steps=COARSE_STEPS, max_contact_times=MAX_CONTACT_TIMES // 4, record=False
    )
    for label, damping in series.items():
        rebound = run.rebound[label]
        # Decreasing part of the curve; NaN if the sphere did not leave in time.
        falling = rebound < np.append(np.inf, np.fmin.accumulate(rebound)[:-1])
        rising = rebound[falling][::-1]
        found = np.zeros_like(restitution)
        if len(rising) > 1:
            found = PchipInterpolator(rising, damping[falling][::-1])(np.clip(restitution, rising[0], rising[-1]))
        # Dampings below the resolution of the series are set to zero.
        values[label] = np.where(found < 0.1 * damping[1], 0.0, found)
    return values


def drop(
    chosen: Mapping[str, LawCase],
    values: Mapping[str, Array],
    speeds: Array,
    impact: Impact,
    *,
    steps: int = STEPS,
    max_contact_times: int = MAX_CONTACT_TIMES,
    record: bool = True,
) -> Run:
    """Simulates all impacts until every sphere has left the plate, or for ``max_contact_times`` contact times.

    Args:
        chosen: Laws by label.
        values: By label, values of the varied parameter (env,).
        speeds: Impact speed of each environment (env,) [m/s].
        impact: Mass and device.
        steps: Steps per contact time of the stiffest law.
        max_contact_times: Largest duration, in contact times of the softest law.
        record: Whether to record sensors over time.
    """
    deepest = max(map(_undamped_depth, chosen.values()))
    shortest = min(map(_undamped_depth, chosen.values())) / speeds.max()
    longest = deepest / speeds.min()
    dt = CONTACT_TIME * shortest / steps
    # At any speed, first contact is in the middle of a step, some steps after the start.
    height = (2 * STRIDE + 0.5) * dt * speeds
    model = _model({label: case.law for label, case in chosen.items()}, height, speeds, deepest, impact)
    for label, value in values.items():
        model[f"touch_{_index(chosen, label)}.law.{chosen[label].varied}"] = value
    names = [f"touch_{k}.{name}" for k in range(len(chosen)) for name in SENSORS] if record else []
    sim = Simulation(model, dt)
    parts: list[dict[str, Array]] = []
    has_left = np.zeros((len(chosen), len(speeds)), dtype=bool)
    for _ in range(int(np.ceil(max_contact_times * longest / shortest))):
        recording = sim.run(steps * dt, names, every=STRIDE * dt, poses=False, progress=False)
        # The first frame of a run repeats the last frame of the previous run.
        first = 1 if parts else 0
        parts.append({name: recording[name].values[first:] for name in (*names, "time")})
        has_left = _has_left(model, list(chosen.values()))
        if has_left.all():
            break
    out = np.array([model.sensor(f"ball_{k}.linear_velocity")[:, 2] for k in range(len(chosen))])
    rebound = np.where(has_left, out / speeds, np.nan)
    frames = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Run(
        time=frames["time"] - float(height[0] / speeds[0]),
        sensors={
            label: {name: frames[f"touch_{k}.{name}"] for name in SENSORS} if record else {}
            for k, label in enumerate(chosen)
        },
        rebound=dict(zip(chosen, rebound, strict=True)),
    )


def _index(chosen: Mapping[str, Any], label: str) -> int:
    return list(chosen).index(label)


def _has_left(model: Environments, chosen: Sequence[LawCase]) -> NDArray[np.bool_]:
    """Returns which spheres are out of contact and moving away, (law, env)."""
    has_left = []
    for k, case in enumerate(chosen):
        in_contact = model.sensor(f"touch_{k}.status") == ContactStatus.CONTACT
        if not case.law.pulls:
            # Where the force is cut off at zero, a sphere flies freely before its penetration is zero.
            in_contact &= model.sensor(f"touch_{k}.normal_force") != 0.0
        has_left.append(~in_contact & (model.sensor(f"ball_{k}.linear_velocity")[:, 2] > 0.0))
    return np.array(has_left)


def _undamped_depth(case: LawCase) -> float:
    """Returns the penetration of the undamped impact [m], or the default if it is NaN."""
    return case.depth if case.depth > 0.0 else DEFAULT_DEPTH


def _static_work(laws: Mapping[str, Law], depths: Array, impact: Impact) -> dict[str, Array]:
    """Returns, by label, the work of the static force up to each of ``depths`` [J]; one environment per depth."""
    if not laws:
        return {}
    model = _model(laws, -depths, np.zeros_like(depths), float(depths.max()), impact)
    works = {}
    for k, label in enumerate(laws):
        force = model.sensor(f"touch_{k}.normal_force")
        # Below the first depth the force is assumed linear; this part is at most 1e-8 of the energy.
        works[label] = cumulative_trapezoid(force, depths, initial=0.0) + 0.5 * force[0] * depths[0]
    return works


def _model(laws: Mapping[str, Law], height: Array, speeds: Array, depth: float, impact: Impact) -> Environments:
    """Builds spheres with lowest points at ``height`` (env,) [m], moving down at ``speeds`` (env,) [m/s]."""
    radius = RADIUS * depth
    scene = Scene(gravity=(0.0, 0.0, 0.0))
    # Contact at the origin, where floating-point positions have the finest resolution.
    plate = scene.add_surface(grid((10.0 * radius, 10.0 * radius)), position=(0.0, 0.0, -radius), name="plate")
    for k, law in enumerate(laws.values()):
        inertia = [0.4 * impact.mass * radius**2] * 3
        ball = scene.add_body(impact.mass, inertia, name=f"ball_{k}")
        contact_radius = CURVED_RADIUS if law.needs_curvature else radius
        # The lowest points of all spheres coincide.
        center = scene.add_point(ball, (0.0, 0.0, contact_radius - radius))
        scene.add_contact(center, plate, ContactMaterial(law=law), radius=contact_radius, name=f"touch_{k}")
    model = scene.build(envs=len(height), device=impact.device, precision="float64")
    zero = np.zeros_like(height)
    for k in range(len(laws)):
        model[f"ball_{k}.position"] = np.stack([zero, zero, height], axis=1)
        model[f"ball_{k}.linear_velocity"] = np.stack([zero, zero, -speeds], axis=1)
    return model
