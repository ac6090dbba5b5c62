"""Events equal the changes of contact status in a recording of every step."""

import numpy as np
import pytest
from scenes import square

import warpcontact as wc

DT = 2.0e-4


def box(envs=3, device="cpu"):
    """A box of four points that falls on a square, with a different tilt in each environment, and a sphere."""
    scene = wc.Scene()
    ground = scene.add_surface(square(), name="ground")
    law = wc.ContactMaterial(law=wc.laws.HuntCrossley(stiffness=1e4, exponent=1.0, restitution=0.6))
    body = scene.add_body(mass=1.0, inertia=(0.005,) * 3, position=(0, 0, 0.15), name="box")
    corners = scene.add_points(body, [(x, y, -0.1) for x in (-0.1, 0.1) for y in (-0.1, 0.1)], name="corners")
    scene.add_contact(corners, ground, law, name="feet")
    other = scene.add_body(mass=1.0, inertia=(0.005,) * 3, position=(0.5, 0, 0.12), name="ball")
    scene.add_contact(scene.add_point(other, (0, 0, 0)), ground, law, radius=0.1, name="touch")
    model = scene.build(envs=envs, device=device)
    tilt = np.linspace(0.05, 0.2, envs)
    zero = 0 * tilt
    model["box.orientation"] = np.stack([np.sin(tilt / 2), zero, zero, np.cos(tilt / 2)], axis=1)
    return model


def changes(recording, env, names):
    """Returns (time, contact, item, made) of all changes of contact, in the order of events."""
    time = recording["time"].to_numpy()
    found = []
    before = dict.fromkeys(names, 0)
    # The last state is not the start of any step.
    for number in range(len(time) - 1):
        for contact, name in enumerate(names):
            now = np.atleast_1d(recording[f"{name}.penetration"].to_numpy()[number, env] > 0.0)
            for item in np.flatnonzero(now != before[name]):
                found.append((time[number], contact, item, int(now[item])))
            before[name] = now
    return found


def test_contact_events_match_changes_in_recording(device):
    names = ["feet", "touch"]
    steps = 3000
    record = [f"{name}.penetration" for name in names]
    # Deterministic sums, so that two runs on a GPU are equal.
    recording = wc.Simulation(box(device=device), DT, deterministic=True).run(steps * DT, record=record, every=DT)
    sim = wc.Simulation(box(device=device), DT, deterministic=True, events=wc.ContactEvents(names, most=200))
    sim.step(steps)
    events = sim.events()
    assert events.sizes == {"env": 3, "event": 200}
    assert events["contact"].attrs["flag_meanings"] == "feet touch"
    for env in range(3):
        expected = changes(recording, env, names)
        count = len(expected)
        assert 10 < count < 200
        found = events.isel(env=env)
        # Environment clocks are sums of steps.
        np.testing.assert_allclose(found["time"][:count], [one[0] for one in expected], rtol=1e-11)
        for key, column in (("contact", 1), ("item", 2), ("made", 3)):
            np.testing.assert_array_equal(found[key][:count], [one[column] for one in expected])
        assert np.isnan(found["time"][count:]).all()
        assert (found["contact"][count:] == -1).all()
    np.testing.assert_array_equal(sim.outcomes()["events_missed"], 0)


def test_latest_events_are_stored_and_older_ones_counted():
    steps = 3000
    all_of_them, few = (
        wc.Simulation(box(), DT, events=wc.ContactEvents(["touch", "feet"], most=most)) for most in (300, 7)
    )
    for sim in (all_of_them, few):
        sim.step(steps)
    missed = few.outcomes()["events_missed"].to_numpy()
    whole, last = all_of_them.events(), few.events()
    for env in range(3):
        count = int(np.isfinite(whole["time"][env]).sum())
        assert missed[env] == count - 7 > 0
        for key in ("time", "contact", "item", "made"):
            np.testing.assert_array_equal(last[key][env], whole[key][env, count - 7 : count])


def test_contact_at_the_start_begins_at_time_zero():
    model = box(1)
    model["ball.position"] = (0.5, 0.0, 0.099)
    sim = wc.Simulation(model, DT, events=wc.ContactEvents(["touch"]))
    sim.step()
    assert sim.events()["time"][0, 0] == 0.0
    assert sim.events()["made"][0, 0] == 1


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: wc.ContactEvents([]), "Events.contacts must be one or more names of contacts"),
        (lambda: wc.ContactEvents("touch"), "must be a list of names of contacts, got the string 'touch'"),
        (lambda: wc.ContactEvents(["touch", "touch"]), "must be different contacts"),
        (lambda: wc.ContactEvents(["touch"], most=0), "Events.most must be a whole number of at least 1, got 0"),
        (
            lambda: wc.ContactEvents(["tuch"]),
            "events: 'tuch' is not a contact; contacts that can have events: 'feet', 'touch'",
        ),
        (lambda: wc.ContactEvents(["ball"]), "events: 'ball' is not a contact"),
    ],
)
def test_events_raise_for_elements_without_events(make, problem):
    model = box(1)
    with pytest.raises((TypeError, ValueError), match=problem):
        wc.Simulation(model, DT, events=make())


def test_particle_contact_has_no_events():
    scene = wc.Scene()
    grains = scene.add_bodies([(0, 0, 0), (0, 0, 1)], mass=1.0, inertia=(0.1,) * 3, name="grains")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_particle_contact(scene.add_shape(grains, wc.shapes.Sphere(0.1)), material, name="pile")
    model = scene.build()
    with pytest.raises(
        ValueError, match="events: 'pile' is a particle contact, whose contact pairs have no fixed numbers"
    ):
        wc.Simulation(model, DT, events=wc.ContactEvents(["pile"]))
    with pytest.raises(
        ValueError, match=r"pile\.contacts is not computed in every step, so only Final can use it"
    ):
        wc.Simulation(model, DT, outcomes={"n": wc.outcomes.Max("pile.contacts")})
    sim = wc.Simulation(model, DT, outcomes={"n": wc.outcomes.Final("pile.contacts")})
    sim.step(3)
    np.testing.assert_array_equal(sim.outcomes()["n"], 0.0)


def test_events_of_simulation_without_events_raise_with_remedy():
    with pytest.raises(ValueError, match=r"no events are recorded: pass events=wc\.ContactEvents"):
        wc.Simulation(box(1), DT).events()
