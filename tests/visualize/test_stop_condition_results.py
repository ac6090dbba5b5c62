"""Environments stopped by a condition in pictures, reports and statistics of all environments."""

import csv

import numpy as np
import pytest
import report_runs

import warpcontact as wc
from warpcontact.experiment import picture
from warpcontact.files.picture_file import save

# Balls fall from rest: three reach the ground, one reaches an energy that the lighter one does not, one fails.
FALL = {
    "name": "fall",
    "envs": 6,
    "duration": 0.5,
    "dt": 0.01,
    "output": {"usd_envs": 0},
    "body": [{"name": "ball", "mass": 1.0, "inertia": [4e-3] * 3}],
    "variation": {
        "ball.position": {"values": [[0, 0, z] for z in (0.2, 0.4, 0.6, 9.0, 9.0, 9.0)]},
        "ball.mass": {"values": [1.0, 1.0, 1.0, 1.0, 0.5, 1.0]},
        "scene.max_speed": {"values": [1e3, 1e3, 1e3, 1e3, 1e3, 1.0]},
    },
    "stop": {
        "never": {"of": "ball.position", "component": "z", "above": 100.0},
        "down": {"of": "ball.position", "component": "z", "below": 0.0},
        "late": {"of": "scene.kinetic_energy", "above": 11.0},
    },
    "record": {"every": 0.02, "sensors": ["scene.kinetic_energy"]},
}


@pytest.fixture(scope="module")
def titles():
    return []


@pytest.fixture(scope="module")
def run(tmp_path_factory, titles):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            picture, "save", lambda figure, path: (titles.append(figure.get_suptitle()), save(figure, path))
        )
        return report_runs.run(tmp_path_factory.mktemp("fall") / "run", FALL)


def test_stopped_environments_are_held_or_dropped_in_a_quantile_fan(run, tmp_path):
    energy = run.series["scene.kinetic_energy"]
    ends = run.outcome["end_time"].values
    well = [0, 1, 2, 3, 4]
    held = wc.quantile_fan(run, energy.name, (0.0, 0.5, 1.0), missing="drop")
    np.testing.assert_allclose(held, np.quantile(energy[:, well], (0.0, 0.5, 1.0), axis=1), rtol=1e-12)
    left = wc.quantile_fan(run, energy.name, (0.0, 0.5, 1.0), missing="drop", stopped="drop")
    for i, time in enumerate(energy["time"].values):
        # Half a step of tolerance, within which there is no other state.
        there = [env for env in well if env == 4 or time <= ends[env] + 0.005]
        np.testing.assert_allclose(left[:, i], np.quantile(energy[i, there], (0.0, 0.5, 1.0)), rtol=1e-12)
    assert not np.allclose(left, held)
    assert [(fan.attrs["stopped"], fan.attrs["stopped_environments"]) for fan in (held, left)] == [
        ("hold", 4),
        ("drop", 4),
    ]
    wc.write_fan(tmp_path / "fan.svg", left)
    with pytest.raises(ValueError, match="stopped must be one of 'hold', 'drop', got 'no'"):
        wc.quantile_fan(run, energy.name, stopped="no")


def test_pictures_and_reports_count_stopped_environments(run, titles, tmp_path):
    held = "4 stopped and 1 frozen (dotted), shown in their last state"
    assert titles == [f"fall: 6 environments, 0.5 s, float32; {held}"]
    page = report_runs.ParsedPage(wc.report(run, tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "4 stopped ones are included with their last values." in " ".join(page.text.split())


def test_summary_counts_environments_per_stop_condition(run):
    expected_text = "and are frozen at their last valid state: 5; 4 are stopped (down 3, late 1)"
    assert expected_text in str(run)
    assert expected_text in str(wc.open_run(run.folder).health)


def test_tables_have_names_for_codes_and_empty_cells_for_none(run, tmp_path):
    stopped_by = ["down", "down", "down", "late", None, None]
    status = ["STOPPED"] * 4 + ["ACTIVE", "FROZEN"]
    causes = ["NONE"] * 5 + ["TOO_FAST"]
    run.to_csv(tmp_path / "table.csv")
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["stopped_by"] for row in rows] == [word or "" for word in stopped_by]
    assert [row["status"] for row in rows] == status
    assert [row["cause"] for row in rows] == causes
    frame = run.to_dataframe()
    assert frame["status"].tolist() == status
    assert frame["stopped_by"].cat.categories.tolist() == ["never", "down", "late"]
    pq = pytest.importorskip("pyarrow.parquet")
    run.to_parquet(tmp_path / "table.parquet")
    assert pq.read_table(tmp_path / "table.parquet")["stopped_by"].to_pylist() == stopped_by
    np.testing.assert_array_equal(run.table()["stopped_by"], [1, 1, 1, 2, -1, -1])


def test_report_table_has_empty_cells_without_stop_condition(run, tmp_path):
    page = report_runs.ParsedPage(wc.report(run, tmp_path / "report.html").read_text(encoding="utf-8"))
    columns = {column["name"]: column for column in page.blocks["environments"]["columns"]}
    assert columns["stopped_by"]["values"] == [1, 1, 1, 2, None, None]
    assert columns["cause"]["values"] == [0, 0, 0, 0, 0, 2]
