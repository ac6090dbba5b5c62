"""Sensors of a contact: values for each status match the table of the documentation, and the alias ``delta``."""

from pathlib import Path

import numpy as np
import pytest
from scenes import oracle_law, square
from test_experiment import content

import warpcontact as wc
from warpcontact import ContactStatus
from warpcontact.usd.ensemble import named_number

DOCS = Path(__file__).parents[3] / "docs" / "contact.md"
RADIUS, REACH, DEPTH = 0.1, 0.5, 0.05
VELOCITY = np.array([0.3, 0.0, -0.5])
# Above the active half of a square, outside of it, in contact, above the inactive half, far, too deep, disabled.
PLACES = [
    (0.5, -0.5, 0.15),
    (1.08, -0.5, 0.05),
    (0.5, -0.5, 0.08),
    (-0.5, 0.5, 0.13),
    (0.5, -0.5, 0.8),
    (0.5, -0.5, 0.03),
    (0.5, -0.5, 0.08),
]
CODES = (
    ContactStatus.OPEN,
    ContactStatus.OPEN,
    ContactStatus.CONTACT,
    ContactStatus.INACTIVE,
    ContactStatus.FAR,
    ContactStatus.WRONG_SIDE,
    ContactStatus.DISABLED,
)


@pytest.fixture(scope="module")
def model(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    plate = scene.add_surface(square(), active_faces=[0], name="plate")
    ball = scene.add_body(1.0, (4e-3,) * 3, linear_velocity=VELOCITY, name="ball")
    options = {"radius": RADIUS, "max_depth": DEPTH, "search_radius": REACH, "name": "touch"}
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), plate, oracle_law(), **options)
    model = scene.build(envs=len(PLACES), device=device)
    model["ball.position"] = PLACES
    model["touch.enabled"] = [code != ContactStatus.DISABLED for code in CODES]
    return model


def documented():
    """The table of the documentation: cells by sensor and column."""
    lines = DOCS.read_text(encoding="utf-8").splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("| sensor |"))
    head, _, *rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines[first : lines.index("", first)]
    ]
    assert [column.partition(",")[0] for column in head[1:]] == [code.name for code in CODES]
    return {row[0].strip("`"): row[1:] for row in rows}


def meaning(place):
    """Returns the values of the cells of the table, for a sphere above the plane z = 0."""
    S = np.array([min(place[0], 1.0), place[1], 0.0])
    s, d = place[2], np.linalg.norm(place - S)
    n = (place - S) / d
    depth = RADIUS - s
    # The law of oracle_law: k = 1e5 N/m, c = 100 N·s/m, μ = 0.3.
    force = 1e5 * depth + 100.0 * -VELOCITY[2]
    return {
        "s − RC ≥ 0": s - RADIUS,
        "s − RC < 0": s - RADIUS,
        "max(d − RC, 0)": max(d - RADIUS, 0.0),
        "max(r − RC, 0)": max(REACH - RADIUS, 0.0),
        "NaN": np.nan,
        "0": 0.0,
        "δ = RC − s": depth,
        "N": force,
        "F_t": [-0.3 * force * np.tanh(VELOCITY[0] / 1e-3), 0.0, 0.0],
        "M": 0.0,
        "v_t": VELOCITY[0],
        "δ̇": -VELOCITY[2],
        "n": n,
        "P": place,
        "K": S + 0.5 * (place - RADIUS * n - S),
    }


def test_sensors_have_the_documented_value_at_each_status(model):
    assert model.sensor("touch.status").tolist() == list(CODES)
    table = documented()
    sensors = {name.partition(".")[2] for name in model.sensor_names if name.startswith("touch.")}
    assert set(table) == sensors - {"status"}
    for name, cells in table.items():
        for env, (cell, found) in enumerate(zip(cells, model.sensor(f"touch.{name}"), strict=True)):
            expected = np.broadcast_to(meaning(np.array(PLACES[env]))[cell], found.shape)
            np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7, err_msg=f"{name}, {CODES[env].name}")
            assert "≥ 0" not in cell or found >= 0.0
            assert "< 0" not in cell or found < 0.0


def test_delta_is_an_alias_of_penetration_on_input_only(model):
    depth = model.sensor("touch.penetration")
    np.testing.assert_array_equal(model.sensor("touch.delta"), depth)
    assert model.find_sensor("touch.delta").name == "touch.penetration"
    assert "touch.delta" not in model.sensor_names
    outcomes = {
        "deepest": wc.outcomes.Max("touch.delta"),
        "first": wc.outcomes.FirstTime("touch.delta", above=0.0),
    }
    stop = {"deep": wc.StopCondition("touch.delta", above=1.0)}
    sim = wc.Simulation(model, dt=1e-6, outcomes=outcomes, stop=stop)
    recording = sim.run(2e-6, ["touch.delta", "touch.gap", "touch.penetration"], poses=False)
    assert list(recording.data_vars) == ["touch.penetration", "touch.gap"]
    assert recording["touch.delta"].name == "touch.penetration"
    assert "touch.delta" in recording
    assert list(recording[["touch.delta"]].data_vars) == ["touch.penetration"]
    np.testing.assert_array_equal(recording["touch.delta"][0], depth)
    np.testing.assert_array_equal(recording.isel(env=[2])["touch.delta"][0], depth[2:3])
    found = sim.outcomes()
    np.testing.assert_array_equal(found["deepest"], recording["touch.penetration"].max("time"))
    assert "touch.penetration" in found["deepest"].attrs["long_name"]
    with pytest.raises(KeyError, match=r"no sensor 'ball\.delta'; there are: ball\.position"):
        model.sensor("ball.delta")
    with pytest.raises(KeyError, match=r"'touch\.delta' is a sensor, not a parameter"):
        model["touch.delta"]
    with pytest.raises(KeyError, match=r"touch\.depth"):
        recording["touch.depth"]
    model.reset()


def test_close_spelling_of_an_alias_suggests_the_alias(model):
    with pytest.raises(KeyError, match=r"no sensor 'touch.dellta'; did you mean 'touch.delta'\?"):
        model.sensor("touch.dellta")


@pytest.mark.parametrize("name", ["touch.impulse", "touch.mode", "scene.closed_contacts"])
def test_sensor_of_nonsmooth_contact_names_its_integrator(name, model):
    expected = rf"no sensor '{name}'; only nonsmooth contact has it, with the integrator MoreauJean"
    with pytest.raises(KeyError, match=expected):
        model.sensor(name)
    with pytest.raises(KeyError, match=expected):
        wc.Simulation(model, 1e-4, outcomes={"largest": wc.outcomes.Max(name)})


def test_run_reports_all_unknown_sensors(model):
    with pytest.raises(
        KeyError, match=r"'tuch.gap'; did you mean 'touch.gap'\? no sensor 'foo.gap'; did you mean"
    ):
        wc.Simulation(model, 1e-4).run(1e-3, ["tuch.gap", "touch.gap", "foo.gap"])


def test_delta_is_stored_as_penetration_by_experiments(device, tmp_path):
    watched = {"outcome": {"deepest": {"type": "Max", "of": "touch.delta"}}}
    watched["stop"] = {"deep": {"of": "touch.delta", "above": 1.0}}
    record = {"sensors": ["touch.delta", "touch.gap", "touch.penetration"]}
    raw = content(record=record, output={"usd_envs": 0}, **watched)
    raw["body"][0]["position"][2] = 0.095
    run = wc.Experiment.from_dict(raw).run(tmp_path / "out", device=device)
    files = [path.read_text(encoding="utf-8") for path in (run.files["experiment"], run.files["summary"])]
    assert not any("delta" in text for text in files)
    opened = wc.open_run(tmp_path / "out")
    assert [name for name in opened.series.data_vars if name.startswith("touch.")] == [
        "touch.penetration",
        "touch.gap",
    ]
    deepest = opened.series["touch.penetration"].max("time")
    assert opened.series["touch.delta"].encoding["preferred_chunks"]["env"] == 4
    for data in (opened.series, opened.recording, opened.series.isel(env=[0, 1, 2, 3])):
        np.testing.assert_array_equal(data["touch.delta"].max("time"), deepest)
    np.testing.assert_allclose(opened.outcome["deepest"], deepest, rtol=1e-6)
    fan = wc.quantile_fan(opened, "touch.delta")
    assert fan.identical(wc.quantile_fan(opened, "touch.penetration"))
    assert named_number(opened.recording, "touch.delta").name == "touch.penetration"
    again = wc.Experiment.from_toml(opened.files["experiment"])
    assert again.settings.record.sensors == ("touch.penetration", "touch.gap")
    assert again.settings.outcome["deepest"].of == "touch.penetration"


PROPOSALS = [
    ("touch.delta_dot", "touch.approach_speed"),
    ("touch.force", "touch.normal_force"),
    ("touch.depth", "touch.penetration"),
    ("touch.distance", "touch.gap"),
    ("touch.slip", "touch.slip_speed"),
    ("touch.position", "touch.point"),
    ("tuch.delta", "touch.penetration"),
    ("ball.velocity", "ball.linear_velocity"),
    ("ball.omega", "ball.angular_velocity"),
    ("ball.quat", "ball.orientation"),
    ("ball.pos", "ball.position"),
    ("ball.energy", "ball.kinetic_energy"),
]


@pytest.mark.parametrize(("name", "meant"), PROPOSALS, ids=[name for name, _ in PROPOSALS])
def test_unknown_sensor_suggests_the_name_of_this_library(name, meant, model):
    with pytest.raises(KeyError, match=f"no sensor '{name}'; did you mean '{meant}'"):
        model.sensor(name)


PARAMETERS = [
    ("touch.k", "touch.law.stiffness"),
    ("touch.law.c", "touch.law.damping"),
    ("touch.mu", "touch.friction.mu"),
    ("ball.m", "ball.mass"),
    ("ball.velocity", "ball.linear_velocity"),
    ("touch.r", "touch.radius"),
]


@pytest.mark.parametrize(("name", "meant"), PARAMETERS, ids=[name for name, _ in PARAMETERS])
def test_unknown_parameter_suggests_the_name_of_this_library(name, meant, model):
    with pytest.raises(KeyError, match=f"no parameter '{name}'; did you mean '{meant}'"):
        model[name] = 1.0
