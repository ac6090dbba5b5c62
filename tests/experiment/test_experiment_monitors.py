"""Outcomes, stop conditions, events and the quarantine in experiment files, and errors."""

import copy
import tomllib
import warnings

import pytest
from test_experiment_errors import VALID_STUDY

import warpcontact as wc
from warpcontact.experiment.experiment_copy import to_toml
from warpcontact.experiment.observation import monitor_arguments

PEAK = {"type": "Max", "of": "touch.normal_force"}
LANDED = {"of": "ball.position", "component": "z", "below": 0.1, "lasting": 0.05}
EVENTS = {"contacts": ["touch"], "most": 4}
OWN = '''"""An outcome of one's own."""

from typing import Any

import warp as wp
import warpcontact as wc


class Cube(wc.Outcome):
    """Mean of the third powers over time."""

    memory = (0.0, 0.0)

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        m[0] += x * x * x * dt
        m[1] += dt
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0] / m[1]


class Wrong(Cube):
    """Of mixed precision."""

    @wp.func
    def result(m: Any, time: Any):
        return m[0] * 2.0
'''


def content(**sections):
    return copy.deepcopy(VALID_STUDY) | sections


def outcome(**changes):
    return {"outcome": {"peak": {key: v for key, v in (PEAK | changes).items() if v is not None}}}


def stop(**changes):
    return {"stop": {"landed": {key: v for key, v in (LANDED | changes).items() if v is not None}}}


def events(**changes):
    return {"events": EVENTS | changes}


HARD = {"integrator": {"type": "MoreauJean"}}
BAD = [
    ({"outcome": []}, "outcome must be a table, got []"),
    ({"outcome": {"peak": 3}}, "outcome.peak must be a table, got 3"),
    ({"outcome": {"peak": "Max"}}, "outcome.peak must be a table, got 'Max'; write { type = 'Max', of = … }"),
    ({"outcome": {"peak": {"of": "touch.gap"}}}, "outcome.peak.type is missing: one of Max, Min, Range"),
    ({"outcome": {"p q": PEAK}}, 'outcome."p q": a name must be letters, digits, _ and -'),
    ({"outcome": {"status": PEAK}}, "outcome.status: 'status' is the name of a variable that every result has"),
    (outcome(type="Maxi"), "outcome.peak.type must be one of Max, Min, Range"),
    (outcome(of=None), "outcome.peak.of is missing: the name of a sensor, or of a contact"),
    (outcome(of=3), "outcome.peak.of must be a text, got 3"),
    (outcome(of="touch.normal_forc"), "outcome.peak: no sensor 'touch.normal_forc'; did you mean"),
    (outcome(colour=1), "outcome.peak.colour is not known; allowed: type, of, component, items"),
    (outcome(component="q"), "outcome.peak.component must be one of 'x', 'y', 'z', 'w', 'norm', got 'q'"),
    (outcome(component="z"), "outcome.peak: touch.normal_force has no components, got component='z'"),
    (outcome(items="mean"), "outcome.peak.items must be one of 'each', 'sum', 'max', 'min', got 'mean'"),
    (outcome(items="sum"), "outcome.peak: touch.normal_force has no items, got items='sum'"),
    (outcome(above=1.0), "outcome.peak.above is not known"),
    (outcome(type="FirstTime"), "outcome.peak: FirstTime takes either above or below, got neither"),
    (
        outcome(type="FirstTime", above=1, below=2),
        "outcome.peak: FirstTime takes either above or below, got above",
    ),
    (outcome(type="FirstTime", above="x"), "outcome.peak.above must be a number, got 'x'"),
    (outcome(type="Restitution", of="tuch"), "outcome.peak: no sensor 'tuch.penetration'; did you mean"),
    (outcome(type="Restitution", of="touch") | HARD, "outcome.peak: Restitution must be of a compliant contact"),
    (
        outcome(of="ball.force") | HARD,
        "outcome.peak: ball.force is not computed in every step, so only Final can use it",
    ),
    (outcome(type="none.py:Cube"), "outcome.peak.type: there is no file 'none.py'"),
    ({"stop": {"landed": {}}}, "stop.landed.of is missing: the name of a sensor"),
    (stop(below=None), "stop.landed: StopCondition takes either above or below, got neither"),
    (stop(above=1), "stop.landed: StopCondition takes either above or below, got above=1.0 and below=0.1"),
    (stop(component=None), "stop.landed: ball.position is a vector; set component to 'x', 'y', 'z', 'norm'"),
    (stop(of="ball.positio"), "stop.landed: no sensor 'ball.positio'; did you mean 'ball.position'?"),
    (stop(lasting=-1.0), "stop.landed.lasting must be at least 0, got -1 s"),
    (stop(blow=1), "stop.landed.blow is not known; did you mean 'below'?"),
    (events(contacts="touch"), "events.contacts must be a list, got 'touch'"),
    (events(contacts=[]), "events: ContactEvents.contacts must be one or more names of contacts"),
    (
        events(contacts=["tuch"]),
        "events.contacts[0]: 'tuch' is not a contact; contacts that can have events: 'touch'",
    ),
    (events(contacts=["touch", "touch"]), "events: ContactEvents.contacts must be different contacts"),
    (events(most=0), "events.most must be at least 1, got 0"),
    ({"events": {"most": 3}}, "events.contacts is missing: a list of names of contacts"),
    ({"quarantine": {"policy": "explode"}}, "quarantine.policy must be one of 'freeze', 'reset', 'raise'"),
    ({"quarantine": {"max_speed": 0.0}}, "quarantine.max_speed must be greater than 0, got 0 m/s"),
    (
        {"quarantine": {"max_speed": float("inf")}},
        "quarantine.max_speed must be finite, got inf; leave the key out",
    ),
    ({"quarantine": {"max_distance": -1}}, "quarantine.max_distance must be greater than 0, got -1 m"),
    ({"quarantine": {"polic": "raise"}}, "quarantine.polic is not known; did you mean 'policy'?"),
]


@pytest.mark.parametrize(("sections", "expected"), BAD, ids=[line[:60] for _, line in BAD])
def test_invalid_monitor_is_reported_with_key_value_and_allowed_values(sections, expected):
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict(content(**sections))
    assert [line for line in caught.value.problems if line.startswith(expected)], caught.value.problems
    assert len(caught.value.problems) == 1


def test_invalid_monitors_are_all_reported():
    sections = outcome(of="touch.gp") | stop(of="ball.x") | events(contacts=["ball"])
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict(content(**sections))
    assert [line.partition(":")[0] for line in caught.value.problems] == [
        "outcome.peak",
        "stop.landed",
        "events.contacts[0]",
    ]


def test_monitor_settings_round_trip():
    quarantine = {"policy": "reset", "max_speed": 1e4, "max_distance": 1e6}
    fall = {"type": "FirstTime", "of": "ball.position", "component": "z", "below": 0.5}
    sections = outcome() | stop() | events() | {"quarantine": quarantine}
    sections["outcome"]["fall"] = fall
    experiment = wc.Experiment.from_dict(content(**sections))
    again = wc.Experiment.from_dict(tomllib.loads(to_toml(experiment.settings, "all of it")))
    assert again.settings.model_dump() == experiment.settings.model_dump()
    model = again.model()
    assert set(model["scene.max_speed"]) == {1e4}
    assert set(model["scene.max_distance"]) == {1e6}
    watched = monitor_arguments(again.settings)
    assert watched["quarantine"] == "reset"
    assert repr(watched["outcomes"]["fall"]) == "<FirstTime ball.position z below 0.5>"
    assert repr(watched["stop"]["landed"]) == "<StopCondition where ball.position z is below 0.1>"
    assert watched["events"].most == 4
    more, less = (wc.Experiment.from_dict(content(**own)).plan(device="cpu") for own in (sections, {}))
    assert "outcomes" in {need.purpose for need in more.footprint.items}
    assert "outcomes" not in {need.purpose for need in less.footprint.items}


def test_custom_outcome_of_a_file_is_copied_and_runs(tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    own = {"outcome": {"cube": {"type": "mine.py:Cube", "of": "touch.gap"}}}
    experiment = wc.Experiment.from_dict(content(duration=0.02, **own), tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        experiment.run(tmp_path / "out", device="cpu", progress=False)
    assert (tmp_path / "out" / "mine.py").read_text() == OWN
    written = tomllib.loads((tmp_path / "out" / "experiment.toml").read_text())
    assert written["outcome"]["cube"]["type"] == "mine.py:Cube"
    for name, problem in (
        ("Cub", "has no outcome 'Cub'; did you mean 'Cube'?"),
        ("Wrong", f"Wrong does not compile: {tmp_path / 'mine.py'}, line 30: Input types must be the same, got "),
    ):
        own["outcome"]["cube"]["type"] = f"mine.py:{name}"
        with pytest.raises(wc.ExperimentError, match="outcome") as caught:
            wc.Experiment.from_dict(content(**own), tmp_path)
        assert problem in caught.value.problems[0]
