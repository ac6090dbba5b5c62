"""Friction tests: response of friction models to prescribed steady and oscillating slip.

A sphere per friction model is pressed on a plate, in float64, one environment per case. Its mass is so large that forces
do not change its velocity, and its weight balances the normal force, so slip and load are as prescribed. The friction
force, including history effects, is evaluated by the simulator.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from warpcontact._version import __version__
from warpcontact.analysis.compare import instances
from warpcontact.analysis.compare.instances import notes, settings
from warpcontact.building.scene import Scene
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.laws.elastic import Hooke
from warpcontact.meshes import grid
from warpcontact.model.environments import Environments
from warpcontact.scene.elements import ContactMaterial
from warpcontact.stepping.recorder import Recorder
from warpcontact.stepping.simulation import Simulation
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

# Mass of a sphere [kg]: 10 N during 1000 s change its speed by 1e-8 m/s.
SPHERE_MASS = 1.0e12
# Radius of the spheres, and their penetration [m].
RADIUS, DEPTH = 0.05, 1.0e-5
# Range of slip speeds for friction models without a speed parameter [m/s].
DEFAULT_SPEEDS = (1.0e-3, 1.0e-1)
# Amplitude of oscillating slip for friction models without history [m].
DEFAULT_AMPLITUDE = 1.0e-3
# Amplitudes as multiples of the largest one.
RELATIVE_AMPLITUDES = (0.1, 0.3, 1.0)
# Largest amplitude as a multiple of the yield distance of a friction model with history.
AMPLITUDE_RATIO = 6.0
# Range of yield distances that is searched [m], and growth factor of the distance per step.
SHORTEST, LONGEST, GROWTH = 1.0e-9, 1.0e-1, 1.2
# Growth factor in the search for the breakaway coefficient, and its range as multiples of the yield distance.
FINE_GROWTH, BEFORE, BEYOND = 1.005, 0.3, 5.0
#: Allowed normal forces.
LOAD = checks.limits("N", above=0.0)
# Steps per period, and number of periods.
SWING_STEPS = 1000
PERIODS = 2.0


@explain_keywords
def slips(
    friction_models: Any,
    speeds: Any = None,
    *,
    direction: float = 0.0,
    load: float = 10.0,
    device: str = "cpu",
) -> xr.Dataset:
    """Measures the coefficient of friction in steady slip, one environment per speed.

    Args:
        friction_models: A friction model, several, or a mapping from labels to friction models; each an instance or a
            class. A class gets the coefficients 0.4 in slip and μ_s = 0.5 in stick. With given values,
            ``functools.partial(Class, mu=0.3)``, only the others are chosen.
        speeds: Slip speeds [m/s]; default: a range around the speed parameters of the friction models.
        direction: Direction of slip, angle from the surface's x axis about its normal [rad].
        load: Normal force [N].
        device: Warp device.

    Returns:
        A data set with ``coefficient``, F/N against the slip [-], over (friction, speed), and, over friction,
        ``class`` and ``settings``, the parameters.

    Raises:
        TypeError: If an entry is not a friction model.
        ValueError: If a value is out of range, or a class has parameters for which no value can be chosen.
    """
    chosen, load = _chosen(friction_models, load)
    if speeds is None:
        slow, fast = friction_speeds(chosen, load)
        speed_values = np.geomspace(slow / 50.0, 10.0 * fast, 181)
    else:
        speed_values = checks.row("speeds", speeds, checks.limits("m/s", above=0.0))
    angle = float(checks.numbers("direction", direction, (), checks.limits("rad")))
    forward = np.array([np.cos(angle), np.sin(angle), 0.0])
    model = _model(chosen, load, speed_values[:, None] * forward, device)
    _slide(model, _settling(chosen, load, device) / speed_values.min(), speed_values.max())
    force = np.array([model.sensor(f"touch_{k}.friction_force") @ forward for k in range(len(chosen))])
    return xr.Dataset(
        {"coefficient": (("friction", "speed"), 0.0 - force / load, notes("-", "coefficient of friction"))},
        coords=_coordinates(chosen) | {"speed": ("speed", speed_values, notes("m/s", "slip speed"))},
        attrs={"source": f"warpcontact {__version__}", "load": load, "direction": angle},
    )


@explain_keywords
def swings(
    friction_models: Any,
    amplitude: Any = None,
    *,
    speed: float | None = None,
    load: float = 10.0,
    device: str = "cpu",
) -> xr.Dataset:
    """Measures friction under oscillating slip, one environment per amplitude.

    The displacement is −A cos(ω t): the motion starts at rest at a turning point, with empty history.

    Args:
        friction_models: As for ``slips``.
        amplitude: Amplitudes A of the displacement [m]; default: one well beyond the yield distance of every friction
            model, and two smaller ones.
        speed: Largest slip speed of the largest amplitude [m/s]; default: above the speed parameters of the friction
            models. All amplitudes have the same period.
        load: Normal force [N].
        device: Warp device.

    Returns:
        A data set with ``coefficient``, F/N against the positive direction [-], over (friction, amplitude,
        time), and ``displacement`` [m] over (amplitude, time).

    Raises:
        TypeError: If an entry is not a friction model.
        ValueError: If a value is out of range, or a class has parameters for which no value can be chosen.
    """
    chosen, load = _chosen(friction_models, load)
    fast = 3.0 * friction_speeds(chosen, load)[1] if speed is None else speed
    fast = float(checks.numbers("speed", fast, (), checks.limits("m/s", above=0.0)))
    if amplitude is None:
        largest = AMPLITUDE_RATIO * max(_yield_distances(chosen, load, device).values()) or DEFAULT_AMPLITUDE
        sizes = np.array(RELATIVE_AMPLITUDES) * float(f"{largest:.0e}")  # a round number
    else:
        sizes = checks.row("amplitude", amplitude, checks.limits("m", above=0.0))
    omega = fast / sizes.max()
    dt = 2.0 * np.pi / omega / SWING_STEPS
    displacements = -np.cos(2.0 * np.pi * np.arange(round(PERIODS * SWING_STEPS) + 1) / SWING_STEPS)
    speeds = np.diff(displacements, prepend=displacements[0]) / dt
    model = _model(chosen, load, np.zeros((len(sizes), 3)), device)
    simulation = Simulation(model, dt)
    forces = [f"touch_{k}.friction_force" for k in range(len(chosen))]
    recorder = Recorder(model, [*forces, "ball_0.position"], frames=len(displacements), poses=False)
    recorder.start()
    state = np.zeros((2, len(sizes), len(chosen), 3))
    state[0, ..., 2] = RADIUS - DEPTH
    for frame in range(len(displacements)):
        if frame:
            simulation.step()
        # Position and velocity of this frame, as a step with this velocity gives them.
        state[0, ..., 0], state[1, ..., 0] = (
            (sizes * displacements[frame])[:, None],
            (sizes * speeds[frame])[:, None],
        )
        for part, own in model.shares():
            part.state.body_position.assign(state[0, own])
            part.state.body_linear_velocity.assign(state[1, own])
        recorder.take(frame * dt)
    recording = recorder.finish({})
    coefficient = np.array([-recording[name].values[..., 0].T / load for name in forces])
    displacement = recording["ball_0.position"].values[..., 0].T
    return xr.Dataset(
        {
            "coefficient": (
                ("friction", "amplitude", "time"),
                coefficient,
                notes("-", "friction force over normal force"),
            ),
            "displacement": (("amplitude", "time"), displacement, notes("m", "displacement")),
        },
        coords=_coordinates(chosen)
        | {
            "amplitude": ("amplitude", sizes, notes("m", "amplitude of the displacement")),
            "time": ("time", recording["time"].values, notes("s", "time")),
        },
        attrs={"source": f"warpcontact {__version__}", "load": load, "speed": fast},
    )


def _chosen(friction_models: Any, load: float) -> tuple[dict[str, Friction], float]:
    load = float(checks.numbers("load", load, (), LOAD))
    given = instances.named(Friction, friction_models)
    patch = float(np.sqrt(RADIUS * DEPTH))
    return {label: instances.friction(friction, load, patch) for label, friction in given.items()}, load


def breakaway_coefficients(friction_models: Any, load: float, device: str) -> dict[str, float]:
    """Returns, by label, the largest coefficient in slow slip from rest, for friction models with a yield distance.

    It can exceed the coefficient in steady slip.
    """
    chosen, load = _chosen(friction_models, load)
    yield_distances = _yield_distances(chosen, load, device)
    yielding = {label: friction for label, friction in chosen.items() if yield_distances[label] > 0.0}
    if not yielding:
        return {}
    first, last = (extreme(yield_distances[label] for label in yielding) for extreme in (min, max))
    count = np.log(BEYOND * last / (BEFORE * first)) / np.log(FINE_GROWTH)
    distances = BEFORE * first * FINE_GROWTH ** np.arange(count)
    greatest = _from_rest(yielding, load, device, distances).max(axis=0)
    return dict(zip(yielding, greatest.tolist(), strict=True))


def friction_speeds(friction_models: Any, load: float) -> tuple[float, float]:
    """Returns the lowest and the highest speed parameter of the friction models [m/s], or the defaults."""
    chosen, _ = _chosen(friction_models, load)
    speeds = [
        value
        for friction in chosen.values()
        for name, value in friction.parameters().items()
        if friction.limits(name)["unit"] == "m/s" and value > 0.0
    ]
    return (min(speeds), max(speeds)) if speeds else DEFAULT_SPEEDS


def _from_rest(chosen: Mapping[str, Friction], load: float, device: str, distances: Array) -> Array:
    """Returns the coefficients after slip ``distances`` [m] from rest, (distance, friction).

    The slip speed is the lowest speed parameter of the models. Models without history do not depend on the distance.
    """
    speed = friction_speeds(chosen, load)[0]
    model = _model(chosen, load, np.array([[speed, 0.0, 0.0]]), device)
    forces = []
    for travel in np.diff(distances, prepend=0.0):
        Simulation(model, float(travel / speed)).step()
        forces.append([np.linalg.norm(model.sensor(f"touch_{k}.friction_force")) for k in range(len(chosen))])
    return np.array(forces) / load


def _yield_distances(chosen: Mapping[str, Friction], load: float, device: str) -> dict[str, float]:
    """Returns, by label, the slip from rest at which 2/3 of the largest force is reached [m]; 0 without history."""
    distances = SHORTEST * GROWTH ** np.arange(np.log(LONGEST / SHORTEST) / np.log(GROWTH))
    yield_distances = {}
    for label, force in zip(chosen, _from_rest(chosen, load, device, distances).T, strict=True):
        first = int(np.argmax(force >= 2.0 / 3.0 * force.max()))
        yield_distances[label] = float(distances[first]) if first else 0.0
    return yield_distances


def _settling(chosen: Mapping[str, Friction], load: float, device: str) -> float:
    """Returns the slip distance after which all friction models are steady [m]."""
    return 30.0 * max(_yield_distances(chosen, load, device).values())


def _slide(model: Environments, duration: float, fastest: float) -> None:
    """Slides for ``duration`` [s] with growing steps, starting with a slip of ``SHORTEST`` at ``fastest`` [m/s]."""
    time = SHORTEST / fastest
    Simulation(model, time).step()
    while time < duration:
        dt = (GROWTH - 1.0) * time
        Simulation(model, dt).step()
        time += dt


def _model(chosen: Mapping[str, Friction], load: float, velocity: Array, device: str) -> Environments:
    """Builds spheres pressed on a plate with ``load`` [N] that slide with ``velocity`` (env, 3) [m/s]."""
    scene = Scene(gravity=(0.0, 0.0, -load / SPHERE_MASS))
    plate = scene.add_surface(grid((1.0e4, 1.0e4)), name="plate")
    for k, friction in enumerate(chosen.values()):
        ball = scene.add_body(
            SPHERE_MASS, [SPHERE_MASS] * 3, position=(0.0, 0.0, RADIUS - DEPTH), name=f"ball_{k}"
        )
        material = ContactMaterial(law=Hooke(stiffness=load / DEPTH), friction=friction)
        center = scene.add_point(ball, (0.0, 0.0, 0.0))
        scene.add_contact(center, plate, material, radius=RADIUS, name=f"touch_{k}")
    model = scene.build(envs=len(velocity), device=device, precision="float64")
    for k in range(len(chosen)):
        model[f"ball_{k}.linear_velocity"] = velocity
    return model


def _coordinates(chosen: Mapping[str, Friction]) -> dict[str, Any]:
    texts = np.array([settings(friction) for friction in chosen.values()], object)
    kinds = np.array([type(friction).__name__ for friction in chosen.values()], object)
    return {"friction": list(chosen), "class": ("friction", kinds), "settings": ("friction", texts)}
