"""Golden scenes of runs: outcomes, events, stop conditions, quarantine, resets, checkpoints, USD."""

from typing import Any

import numpy as np

from golden_scenes.mesh_contact import CORNERS, add_ball, hills, rubber, sticky
from golden_scenes.names import Names
from golden_scenes.plan import Arrays, Plan, Trial, forces, normal_forces, require, spread


def ball_and_box(names: Names, **options: Any) -> Any:
    """Returns the scene of a ball and a box with sticky feet on a terrain."""
    scene = names.Scene(**options)
    ground = scene.add_surface(hills(names), name="ground")
    _, center = add_ball(scene, "ball", (0.4, 0.3, 0.15))
    scene.add_contact(center, ground, rubber(names), radius=0.05, name="touch")
    box = scene.add_body(
        2.1, (0.01, 0.012, 0.015), (-0.2, 0.0, 0.22), linear_velocity=(0.2, 0.0, -1.0),
        angular_velocity=(1.0, 2.0, 3.0), name="box",
    )  # fmt: skip
    scene.add_contact(scene.add_points(box, CORNERS), ground, sticky(names), radius=0.01, name="feet")
    return scene


def outcomes(names: Names) -> Plan:
    """Every outcome, stop conditions of both kinds, and contact events."""
    made = {
        "largest": names.make("outcome", "Max", "touch.normal_force"),
        "smallest": names.make("outcome", "Min", "ball.position", component="z"),
        "range": names.make("outcome", "Range", "ball.linear_velocity"),
        "mean": names.make("outcome", "Mean", "feet.normal_force", items="sum"),
        "rms": names.make("outcome", "Rms", "box.angular_velocity", component="norm"),
        "impulse": names.make("outcome", "Integral", "touch.normal_force"),
        "initial": names.make("outcome", "Initial", "ball.position"),
        "final": names.make("outcome", "Final", "ball.position"),
        "change": names.make("outcome", "Change", "scene.kinetic_energy"),
        "time_of_largest": names.make("outcome", "TimeOfMax", "feet.normal_force", items="max"),
        "first": names.make("outcome", "FirstTime", "touch.penetration", above=0.0),
        "duration": names.make("outcome", "Duration", "touch.penetration", above=0.0),
        "count": names.make("outcome", "Count", "feet.normal_force", items="sum", above=1.0),
        "restitution": names.make("outcome", "Restitution", "touch"),
        "work": names.make("outcome", "Work", "feet"),
    }
    stop = {
        "up": names.StopCondition("ball.linear_velocity", component="z", above=0.5, lasting=0.01),
        "slow": names.StopCondition("box.linear_velocity", component="norm", below=0.4),
    }
    return Plan(
        ball_and_box(names),
        steps=3000,
        every=100,
        values={"touch.law.restitution": spread(0.2, 0.95), "ball.mass": spread(0.3, 0.8)},
        record=forces(["touch", "feet"]),
        options={"outcomes": made, "stop": stop, "events": names.ContactEvents(["touch", "feet"], 16)},
        touches=["touch.normal_force"],
        numbers=False,  # times of conditions that never held are NaN
        check=_outcomes_differ,
    )


def _outcomes_differ(arrays: Arrays) -> None:
    require((arrays["outcomes/count"] > 0).any(), "no foot touches")
    require(0 < len(arrays["state/stopped"]) < 4, "stop conditions hold in no or in all environments")
    require((arrays["events/made"] == 0).any(), "no contact ends")


def quarantine(names: Names, policy: str) -> Plan:
    """Environments that fail: one too fast, one too far and one by an overflow, under a policy.

    Args:
        names: The public API.
        policy: ``"freeze"`` or ``"reset"``.
    """
    velocities = np.array([(0.5, 0.2, -1.0), (0.0, 0.0, -60.0), (20.0, 0.0, 5.0), (0.5, 0.0, -1.0)])
    options = {"quarantine": policy, "outcomes": {"peak": names.make("outcome", "Max", "touch.normal_force")}}
    return Plan(
        ball_and_box(names, max_speed=50.0, max_distance=2.0),
        steps=2000,
        every=50,
        values={"ball.linear_velocity": velocities, "box.external_force": [(0, 0, 0)] * 3 + [(3e38, 3e38, 3e38)]},
        record=forces(["touch", "feet"]),
        options=options,
        numbers=False,
        check=lambda arrays: _some_fail(arrays, policy),
    )


def _some_fail(arrays: Arrays, policy: str) -> None:
    if policy == "freeze":
        require(list(arrays["state/frozen"]) == [1, 2, 3], f"frozen are {arrays['state/frozen']}")
        require(len(set(arrays["state/frozen_cause"])) > 1, "all environments fail by the same cause")
    else:
        require((arrays["outcomes/resets"][1:] > 0).all(), f"resets are {arrays['outcomes/resets']}")
    require((arrays["recording/touch.normal_force"][:, 0] > 0).any(), "the ball does not touch")


def reset_in_the_middle(names: Names) -> Plan:
    """Chosen environments are reset, parameters and states are set, and external forces change between runs."""
    scene = ball_and_box(names)
    # A ball that starts in contact: after a reset its friction history must be empty.
    shelf = scene.add_surface(names.meshes.grid((0.4, 0.4)), position=(0.6, -0.6, 0.3), name="shelf")
    _, center = add_ball(scene, "rest", (0.6, -0.6, 0.349), linear_velocity=(0.1, 0.05, 0.0))
    scene.add_contact(center, shelf, sticky(names), radius=0.05, name="lie")
    return Plan(
        scene,
        steps=1600,
        every=40,
        record=[*forces(["touch", "feet", "lie"]), "box.torque"],
        touches=normal_forces(["touch", "lie"]),
        run=_resets,
    )


def _resets(trial: Trial) -> None:
    model = trial.model()
    sim = trial.simulation(model)
    trial.record(sim, trial.plan.steps)
    sim.reset(np.array([True, False, True, False]))
    for contact in ("feet", "lie"):
        trial.keep(f"results/after_reset/{contact}", trial.names.sensor(model, f"{contact}.friction.spring"))
    model["touch.law.restitution"] = spread(0.1, 0.9)
    model["box.external_force"] = spread((0, 0, 0), (4, 1, 0))
    trial.record(sim, trial.plan.steps, "results/second")
    velocity = sim.state.body_linear_velocity.numpy().copy()
    velocity[:, 0] += (0.1, 0.2, 1.0)
    sim.state.body_linear_velocity.assign(velocity)
    force = model.external.force.numpy().copy()
    force[:, 1, 2] = spread(0.0, 10.0)
    model.external.force.assign(force)
    sim.step(777)
    for name in (*forces(["touch", "feet"]), "feet.friction.spring"):
        trial.keep(f"results/{name}", trial.names.sensor(model, name))
    trial.finish(sim)
    sim.reset()
    trial.record(sim, trial.plan.steps, "results/third")
    require(
        not np.array_equal(
            trial.arrays["results/third/touch.normal_force"], trial.arrays["recording/touch.normal_force"]
        ),
        "new parameters change nothing",
    )


def checkpoint(names: Names, nonsmooth: bool) -> Plan:
    """A run that continues from a checkpoint in another simulation, compared with the uninterrupted run.

    Args:
        names: The public API.
        nonsmooth: Whether contact is nonsmooth; otherwise it is compliant, with history.
    """
    if nonsmooth:
        options: dict[str, Any] = {
            "integrator": names.make("integrator", "MoreauJean"),
            "dt": 1e-3,
            "steps": 300,
            "every": 1,
        }
    else:
        peak = names.make("outcome", "Max", "touch.normal_force")
        options = {
            "options": {"outcomes": {"peak": peak}, "events": names.ContactEvents(["touch"], 8)},
            "steps": 1500,
        }
    return Plan(
        ball_and_box(names),
        values={"ball.mass": spread(0.3, 0.8), "feet.friction.mu_static": spread(0.45, 0.6)},
        record=normal_forces(["touch", "feet"]),
        touches=["touch.normal_force"],
        numbers=False,
        run=_saved,
        **options,
    )


def _saved(trial: Trial) -> None:
    first = trial.simulation(trial.model())
    trial.record(first, trial.plan.steps)
    path = trial.folder / "state.npz"
    first.save(path)
    trial.record(first, trial.plan.steps, "results/continued")
    second = trial.simulation(trial.model())
    second.load(path)
    trial.record(second, trial.plan.steps, "results/loaded")
    trial.finish(second)
    for name, values in trial.arrays.items():
        if name.startswith("results/loaded/"):
            other = trial.arrays[name.replace("loaded", "continued")]
            require(values.tobytes() == other.tobytes(), f"{name} differs from the uninterrupted run")


def usd(names: Names) -> Plan:
    """A recording exported to USD, and the steps of the scene that is imported from it."""
    scene = ball_and_box(names)
    hook = scene.add_point(None, (0.0, 0.0, 1.5), name="hook")
    scene.add_spring_damper(hook, scene.points[0], stiffness=20.0, damping=0.1, name="spring")
    egg = scene.add_body(1.1, (5e-3, 6e-3, 7e-3), (0.8, -0.5, 0.16), angular_velocity=(1, 2, 3), name="egg")
    shell = scene.add_shape(egg, names.make("shape", "Ellipsoid", (0.12, 0.09, 0.08)), name="shell")
    plane = scene.add_shape(None, names.make("shape", "Plane"), name="plane")
    names.method(scene, "add_shape_contact", shell, plane, rubber(names), name="tap")
    contacts = ["touch", "feet", "tap"]
    return Plan(
        scene,
        steps=1500,
        every=50,
        record=[*normal_forces(contacts), "spring.force"],
        touches=normal_forces(contacts),
        derivatives=True,
        run=_round_trip,
    )


def _round_trip(trial: Trial) -> None:
    first = trial.simulation(trial.model())
    recording = trial.record(first, trial.plan.steps)
    path = trial.names.export_usd(recording, trial.folder / "scene.usdc", envs=range(2), progress=False)
    scene = trial.names.Scene.from_usd(path, trusted=True)
    second = trial.simulation(trial.model(scene))
    trial.record(second, trial.plan.steps, "results/imported")
    trial.finish(second)
    for name, values in trial.arrays.items():
        if name.startswith("results/imported/"):
            other = trial.arrays[name.replace("results/imported", "recording")]
            require(values.tobytes() == other.tobytes(), f"{name} differs from the exported scene")


SCENES = {
    "outcomes_stops_events": outcomes,
    "quarantine_freeze": lambda names: quarantine(names, "freeze"),
    "quarantine_reset": lambda names: quarantine(names, "reset"),
    "reset_external_forces": reset_in_the_middle,
    "checkpoint_compliant": lambda names: checkpoint(names, False),
    "checkpoint_nonsmooth": lambda names: checkpoint(names, True),
    "usd_round_trip": usd,
}
