"""Drops spheres on a plate: a scene of one body per law, run by the engine in float64.

The elastic parameter of a class and the damping that returns a restitution are found by measuring forces and
rebounds of the very same scene, so that nothing about a formula has to be known here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator

from warpcontact.analysis.compare import instances as samples
from warpcontact.kernels.laws.base import Law
from warpcontact.meshes import grid
from warpcontact.model.environments import Environments
from warpcontact.scene.scene import ContactMaterial, Scene
from warpcontact.scene.status import ContactStatus
from warpcontact.stepping.simulation import Simulation
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

# An undamped contact takes 2.6 to 3.14 δ/v, by the exponent.
CONTACT_TIME = 3.0
# Steps per contact time: what is off in laws that jump at the greatest depth is about one part in this.
STEPS = 1000
# A series of dampings only has to lead to the right one.
COARSE_STEPS = 250
# Steps between records, a divisor of both.
STRIDE = 2
# Contact times after which a sphere is given up: e = 0.01 of two stiffnesses takes 51.
MAX_CONTACT_TIMES = 60
# Dampings in terms of ``samples.damping_scale``: restitution falls from 0.999 to below 0.05.
DAMPINGS = np.geomspace(1.0e-3, 30.0, 61)
# Depths at which elastic forces are read, in terms of the depth that the impact is to have.
DEPTHS = np.geomspace(1.0e-4, 1.0e2, 1201)
# Depth of the undamped impact if neither a depth nor a law with an elastic parameter of its own is given [m].
DEFAULT_DEPTH = 1.0e-3
# Sphere in terms of the greatest depth: its centre has to stay above the plate.
RADIUS = 50.0
# Of laws whose force depends on the curvature, every sphere has this radius [m].
CURVED_RADIUS = 0.1
#: What the values of an impact may be.
LIMITS = {
    "mass": checks.limits("kg", above=0.0),
    "speed": checks.limits("m/s", above=0.0),
    "depth": checks.limits("m", above=0.0),
}
SENSORS = ("penetration", "approach_speed", "normal_force")


@dataclass(frozen=True)
class Impact:
    """What all laws are compared in.

    Attributes:
        mass: Mass of the sphere [kg].
        speed: Its speed at touch [m/s].
        depth: Depth of the undamped impact that the elastic parameters of classes are set to [m]; ``None``: that
            of the first law whose elastic parameter is given, if there is one.
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
        """Kinetic energy at touch [J]."""
        return 0.5 * self.mass * self.speed**2


@dataclass(frozen=True)
class LawCase:
    """A law in the impact.

    Attributes:
        law: The law.
        depth: Depth of its undamped impact [m]; NaN if that is too deep to be found.
        given: Whether its elastic parameter was given, not chosen for that depth.
        varied: The parameter that decides what an impact loses; ``None`` if there is none, or it was given.
    """

    law: Law
    depth: float
    given: bool
    varied: str | None


@dataclass(frozen=True)
class Run:
    """What was measured of all laws: of a law by its label.

    Attributes:
        time: Time since touch at the common speed (frame,) [s].
        sensors: By label and name of the sensor, (frame, env).
        rebound: By label, speed away from the plate over the impact speed (env,); NaN where it did not leave.
    """

    time: Array
    sensors: Mapping[str, Mapping[str, Array]]
    rebound: Mapping[str, Array]


def cases(laws: Any, impact: Impact) -> dict[str, LawCase]:
    """Returns instances of ``laws`` by their labels.

    The elastic parameter of a class is chosen for the depth of ``impact``, or for that of the first law whose
    elastic parameter is given.

    Raises:
        TypeError: If a law is none.
        ValueError: If a class needs values that only its author knows.
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
    """Returns by label the values of what is varied that give each ``restitution``; nothing for elastic laws.

    A damping is interpolated in a series of runs; where none in the series is enough, the largest useful one.
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
        # The falling part of the curve; NaN where the sphere crept out too slowly to wait for.
        falling = rebound < np.append(np.inf, np.fmin.accumulate(rebound)[:-1])
        rising = rebound[falling][::-1]
        found = np.zeros_like(restitution)
        if len(rising) > 1:
            found = PchipInterpolator(rising, damping[falling][::-1])(np.clip(restitution, rising[0], rising[-1]))
        # Less than the smallest damping that makes a difference is none.
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
    """Runs all impacts until every sphere has left, or for ``max_contact_times`` contact times.

    Args:
        chosen: The laws.
        values: By label, values of what is varied (env,).
        speeds: Impact speed of every environment (env,) [m/s].
        impact: Mass and device.
        steps: Steps per contact time of the stiffest law.
        max_contact_times: Contact times of the softest law to wait for.
        record: Whether to keep sensors over time.
    """
    deepest = max(map(_undamped_depth, chosen.values()))
    shortest = min(map(_undamped_depth, chosen.values())) / speeds.max()
    longest = deepest / speeds.min()
    dt = CONTACT_TIME * shortest / steps
    # Touch falls into the middle of a step, whatever the speed, and some steps after the start.
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
        # A run begins with the frame that the one before ended with.
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
    """Returns which spheres are free and on their way out, (law, env)."""
    has_left = []
    for k, case in enumerate(chosen):
        in_contact = model.sensor(f"touch_{k}.status") == ContactStatus.CONTACT
        if not case.law.pulls:
            # Behind a force that was cut at zero a sphere flies free before its depth is zero.
            in_contact &= model.sensor(f"touch_{k}.normal_force") != 0.0
        has_left.append(~in_contact & (model.sensor(f"ball_{k}.linear_velocity")[:, 2] > 0.0))
    return np.array(has_left)


def _undamped_depth(case: LawCase) -> float:
    """Returns the depth of an undamped impact, as far as it is known [m]."""
    return case.depth if case.depth > 0.0 else DEFAULT_DEPTH


def _static_work(laws: Mapping[str, Law], depths: Array, impact: Impact) -> dict[str, Array]:
    """Returns by label the work of the force at rest up to each of ``depths``, one environment per depth [J]."""
    if not laws:
        return {}
    model = _model(laws, -depths, np.zeros_like(depths), float(depths.max()), impact)
    works = {}
    for k, label in enumerate(laws):
        force = model.sensor(f"touch_{k}.normal_force")
        # Below the first depth the force is taken as linear; there is 1e-8 of the energy or less.
        works[label] = cumulative_trapezoid(force, depths, initial=0.0) + 0.5 * force[0] * depths[0]
    return works


def _model(laws: Mapping[str, Law], height: Array, speeds: Array, depth: float, impact: Impact) -> Environments:
    """Returns spheres for impacts of ``depth``, lowest points at ``height``, going down at ``speeds`` (env,)."""
    radius = RADIUS * depth
    scene = Scene(gravity=(0.0, 0.0, 0.0))
    # Lowest points at the origin, where numbers are finest.
    plate = scene.add_surface(grid((10.0 * radius, 10.0 * radius)), position=(0.0, 0.0, -radius), name="plate")
    for k, law in enumerate(laws.values()):
        inertia = [0.4 * impact.mass * radius**2] * 3
        ball = scene.add_body(impact.mass, inertia, name=f"ball_{k}")
        own = CURVED_RADIUS if law.needs_curvature else radius
        # Their lowest points are in one place.
        centre = scene.add_point(ball, (0.0, 0.0, own - radius))
        scene.add_contact(centre, plate, ContactMaterial(law=law), radius=own, name=f"touch_{k}")
    model = scene.build(envs=len(height), device=impact.device, precision="float64")
    zero = np.zeros_like(height)
    for k in range(len(laws)):
        model[f"ball_{k}.position"] = np.stack([zero, zero, height], axis=1)
        model[f"ball_{k}.linear_velocity"] = np.stack([zero, zero, -speeds], axis=1)
    return model
