"""Report of a run: one self-contained file without requests, safe for any text in the run."""

import functools
import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import report_runs

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.validation.number_format import quantity, scaled
from warpcontact.visualize.report import chart, replay, series, write
from warpcontact.visualize.viewer.replay import RunSource

pytestmark = pytest.mark.installed

WEB = Path(__file__).resolve().parents[2] / "web"
HOSTILE = (
    "</script><script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    "\"' onmouseover=alert(1) x='",
    "<!--",
    "]]>",
    "../../etc/passwd",
    "مرحبا بالعالم",
    "\u202egnp.exe",
    "👩‍🚀🚀",
    "\u2028\u2029",
    "&lt;b&gt;",
    "x" * 10_000,
    "<b>" * 3_000,
)


@pytest.fixture(scope="module")
def crate(tmp_path_factory):
    """A run with contacts, outcomes, series and an environment that failed."""
    return report_runs.run(tmp_path_factory.mktemp("crate") / "run")


def written(run, path, **options):
    return wc.report(run, path, **options).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def text(crate, tmp_path_factory):
    return written(crate, tmp_path_factory.mktemp("report") / "report.html")


@pytest.fixture
def copied(crate, tmp_path):
    """Copies the folder of the run, with other entries in run.json."""

    def copy(**entries):
        folder = tmp_path / "copy"
        shutil.copytree(crate.folder, folder)
        summary = json.loads((folder / "run.json").read_text()) | entries
        (folder / "run.json").write_text(json.dumps(summary))
        return folder

    return copy


def ids(page):
    return {attributes["id"] for _, attributes in page.elements if "id" in attributes}


# Content


@pytest.mark.smoke
def test_report_describes_the_run_and_its_results(crate, text):
    page = report_runs.check_harmless(text)
    sections = {"replay-section", "outcomes", "series", "loops", "failed", "environments", "run"}
    assert sections <= ids(page)
    words = " ".join(page.text.split())
    summary = crate.summary
    for expected_text in (
        summary["fingerprint"],
        summary["started"],
        summary["versions"]["numpy"],
        "SemiImplicitEuler",
    ):
        assert expected_text in words
    assert "5×10⁻⁴ s" in words.replace("\u202f", " ") or "0.0005 s" in words.replace("\u202f", " ")
    assert "a body exceeded scene.max_speed" in words
    assert (crate.folder / "experiment.toml").read_text() in page.text


def test_report_statistics_exclude_failed_environments(crate, text):
    page = report_runs.ParsedPage(text)
    values = np.delete(crate.outcome["hardest"].values, 4)
    words = page.text.replace("\u202f", " ").replace("−", "-")
    for number in (values.min(), np.median(values), values.mean(), values.max(), values.std()):
        assert f"{number:.4g}" in words, number
    assert "Over 6 environments, without 1 frozen one." in words


def test_report_table_has_parameters_and_outcomes_of_all_environments(crate, text):
    data = report_runs.ParsedPage(text).blocks["environments"]
    assert data["env"] == list(range(6))
    columns = {column["name"]: column for column in data["columns"]}
    np.testing.assert_allclose(columns["hardest"]["values"], crate.outcome["hardest"], rtol=1e-5)
    np.testing.assert_allclose(
        columns["feet.friction.mu"]["values"], crate.params["feet.friction.mu"][:, 0], rtol=1e-5
    )
    status = columns["status"]
    assert [status["words"][str(code)] for code in status["values"]] == ["ACTIVE"] * 4 + ["FROZEN", "ACTIVE"]
    assert "crate.mass" not in columns  # equal in all environments


def test_report_bands_are_quantiles_of_recorded_sensors(text):
    page = report_runs.ParsedPage(text)
    charts = [attributes for tag, attributes in page.elements if tag == "svg" and "data-series" in attributes]
    series = page.blocks["series"]
    assert len(charts) == len(series)
    assert {float(chart["data-t1"]) for chart in charts} == {0.5}
    assert set(series[0]["lines"]) == {"0", "1", "2", "3", "4", "5"}
    assert all(len(line["x"]) == len(line["y"]) == 101 for line in series[0]["lines"].values())


@pytest.fixture(scope="module")
def recorded_every_step(tmp_path_factory):
    """The crate with a record of each step, and its report: curves have fewer points than records."""
    folder = tmp_path_factory.mktemp("every_step")
    study = report_runs.changed()
    study["record"]["every"] = study["dt"]
    run = report_runs.run(folder / "run", study)
    return run, written(run, folder / "report.html")


def drawn_curve(chart_data, env):
    """Returns times [s] and values of a curve of a report, and the size of a tenth of a unit of its chart."""
    line = chart_data["lines"][env]
    x = np.cumsum(line["x"]) / 10
    seconds = (x - chart.LEFT) / (chart.WIDTH - chart.RIGHT - chart.LEFT) * 0.5
    floor, top = chart.HEIGHT - chart.BOTTOM, chart.TOP
    unit = (chart_data["high"] - chart_data["low"]) / (floor - top)
    return seconds, chart_data["low"] + (floor - np.cumsum(line["y"]) / 10) * unit, 0.1 * unit


@pytest.mark.parametrize(
    ("sensor", "reduced"),
    [
        ("feet.normal_force", lambda values: values.sum("item")),
        ("feet.gap", lambda values: values.min("item")),
        ("scene.kinetic_energy", lambda values: values),
    ],
)
def test_report_curves_include_peaks_and_ends_of_the_data(sensor, reduced, recorded_every_step):
    run, text = recorded_every_step
    page = report_runs.ParsedPage(text)
    data = next(one for one in page.blocks["series"] if one["name"] == sensor)
    expected = reduced(run.series[sensor])
    assert expected.sizes["time"] > series.SAMPLES
    for env in (0, 1, 2, 3, 5):
        own = expected.sel(env=env)
        seconds, values, tenth = drawn_curve(data, str(env))
        assert len(values) <= series.SAMPLES
        peak = int(own.values.argmax())
        assert values.max() == pytest.approx(own.max().item(), abs=tenth)
        assert values.min() == pytest.approx(own.min().item(), abs=tenth)
        assert values[-1] == pytest.approx(own[-1].item(), abs=tenth)
        # A tenth of a unit along the time axis.
        assert seconds[values.argmax()] == pytest.approx(own["time"][peak].item(), abs=0.5 / 2980)
    counted = expected.sel(env=[0, 1, 2, 3, 5])
    env, time = counted.argmax(["env", "time"]).values()
    factor, unit = scaled(data["unit"], max(abs(data["low"]), abs(data["high"])))
    expected_text = (
        f"largest {quantity(factor * counted.max().item(), unit, 5)} at "
        f"{quantity(counted['time'][time].item(), 's', 5)} in environment {counted['env'][env].item()}"
    )
    assert expected_text in page.text


def test_report_loops_include_the_largest_force_of_all_records(recorded_every_step):
    run, text = recorded_every_step
    page = report_runs.ParsedPage(text)
    forces = run.series["feet.normal_force"]
    counted = [int(attributes["data-env"]) for _, attributes in page.elements if "data-env" in attributes]
    force = forces.sel(env=counted).max("item")
    env, time = (int(place) for place in force.argmax(["env", "time"]).values())
    value = quantity(force.max().item(), "N", 5)
    expected_text = (
        f"largest force {value} at {quantity(force['time'][time].item(), 's', 5)} in environment {counted[env]}"
    )
    assert expected_text in page.text


def test_replay_includes_records_of_the_largest_forces(recorded_every_step):
    run, text = recorded_every_step
    page = report_runs.ParsedPage(text)
    shown = [one["env"] for one in page.blocks["replay"]["envs"]]
    force = run.series["feet.normal_force"].sel(env=shown).max(["env", "item"])
    times = np.array(page.blocks["replay"]["times"])
    assert len(times) <= replay.FRAMES < force.sizes["time"]
    assert np.abs(times - force["time"][int(force.values.argmax())].item()).min() < 1e-9
    assert page.blocks["replay"]["largestForce"] >= force.max().item() * (1 - 1e-6)


def test_report_loop_of_a_set_states_its_point(text):
    expected_text = (
        "normal force over penetration of the point with the largest force in each environment, out of 8"
    )
    assert expected_text in " ".join(report_runs.ParsedPage(text).text.split())


def test_report_of_the_same_run_is_bitwise_identical(crate, text, tmp_path):
    assert written(crate.folder, tmp_path / "again.html") == text


def test_requested_environments_are_shown_in_the_report(crate, tmp_path):
    page = report_runs.ParsedPage(written(crate, tmp_path / "some.html", envs=[5, 2]))
    assert [one["env"] for one in page.blocks["replay"]["envs"]] == [2, 5]
    assert {name for name in page.blocks if name.startswith("replay-")} == {"replay-2", "replay-5"}
    assert set(page.blocks["series"][0]["lines"]) == {"2", "5"}
    every = report_runs.ParsedPage(written(crate, tmp_path / "all.html")).blocks["replay"]["envs"]
    labels = {one["env"]: one["label"] for one in every}
    assert labels[4].startswith("4, failed")
    worst = int(crate.outcome["env"][np.delete(crate.outcome["hardest"].values, 4).argmax()])
    worst += worst >= 4
    assert "largest hardest" in labels[worst]


@pytest.mark.smoke
def test_report_command_writes_next_to_the_run_or_to_the_given_path(crate, tmp_path, capsys):
    folder = tmp_path / "run"
    shutil.copytree(crate.folder, folder)
    assert main(["report", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder / "report.html")
    assert main(["report", str(folder), "-o", str(tmp_path / "x.html"), "--envs", "1"]) == 0
    assert [
        one["env"] for one in report_runs.ParsedPage((tmp_path / "x.html").read_text()).blocks["replay"]["envs"]
    ] == [1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "x.html"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--envs", "6"], "environment 6 has no results to report; there are: 0 to 5"),
        (["-o", "report.pdf"], "path must end in .html or .htm, got 'report.pdf'"),
        (["-o", "nowhere/report.html"], "nowhere/report.html: nowhere does not exist"),
        (["-o", "."], "path must end in .html"),
    ],
)
def test_invalid_report_arguments_are_reported(words, message, crate, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(crate.folder), *words]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_report_command_refuses_folder_without_a_run(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    assert "holds no run" in capsys.readouterr().err


def test_parameter_of_a_set_is_one_column_of_tables(crate, tmp_path):
    pytest.importorskip("pandas")
    run = wc.open_run(crate.folder)
    assert run.params["feet.friction.mu"].dims == ("env", "item")
    frame = run.to_dataframe()
    assert [name for name in frame if name.startswith("feet.")] == ["feet.friction.mu", "feet.radius"]
    assert frame["feet.friction.mu"].tolist() == run.params["feet.friction.mu"][:, 3].values.tolist()
    run.to_csv(tmp_path / "table.csv")
    head = (tmp_path / "table.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert [name for name in head if name.startswith("feet.")] == ["feet.friction.mu", "feet.radius"]
    facts = dict(RunSource(crate.folder).facts(1)["Parameters"])
    assert float(facts["feet.friction.mu"]) == pytest.approx(frame["feet.friction.mu"][1], rel=1e-5)
    # One point that differs in one environment.
    params = run.params.load().copy(deep=True)
    params["feet.friction.mu"][5, 2] += 0.1
    run.__dict__["params"] = params
    columns = [name for name in run.to_dataframe() if name.startswith("feet.friction.mu")]
    assert columns == [f"feet.friction.mu.{point}" for point in range(8)]


# Untrusted texts


@pytest.mark.parametrize("hostile", HOSTILE, ids=lambda text: ascii(text[:12]))
def test_malicious_texts_in_report_are_shown_and_inert(hostile, copied, tmp_path):
    folder = copied(
        name=hostile,
        device=hostile,
        integrator=hostile,
        precision=hostile,
        seed=hostile,
        started=[hostile],
        machine={hostile: hostile},
        versions={hostile: hostile},
        warnings=[hostile, {hostile: 1}],
        law_files={hostile: hostile},
        failed={hostile: hostile},
        wall_time=hostile,
        fingerprint=hostile,
    )
    text = written(folder, tmp_path / "hostile.html")
    page = report_runs.check_harmless(text)
    shown = hostile if len(hostile) <= 60 else hostile[:59] + "…"
    assert shown in page.text
    # A name of 10 000 characters is not repeated at every occurrence.
    assert len(text) < 1_600_000


def test_characters_not_allowed_in_html_are_replaced(copied, tmp_path):
    text = written(copied(name="a\x00b\x1b[31m\ufffe\ud800c", device="\x85"), tmp_path / "x.html")
    assert "a\ufffdb\ufffd[31m\ufffd\ufffdc" in report_runs.check_harmless(text).text
    assert not re.search("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]", text)


@pytest.mark.filterwarnings("ignore:no picture or animation")
def test_malicious_names_of_an_experiment_are_shown_and_inert(tmp_path):
    study = report_runs.changed(name="</script><b>&\"'مرحبا🚀" + "y" * 160, duration=0.01, envs=1, variation=None)
    study["contact"][0]["name"] = "z" * 100
    study["record"] = {"sensors": [f"{study['contact'][0]['name']}.gap"], "every": 5e-3}
    study["outcome"] = {"o" * 150: {"type": "Min", "of": study["record"]["sensors"][0], "items": "min"}}
    run = report_runs.run(tmp_path / "run", study)
    page = report_runs.check_harmless(written(run, tmp_path / "x.html"))
    assert "</script><b>&\"'مرحبا🚀y" in page.text
    assert "o" * 39 + "…" in page.text


def test_non_finite_values_are_counted_in_report(crate, tmp_path):
    run = wc.open_run(crate.folder)
    outcome = run.outcome.load().copy()
    outcome["hardest"].values[:3] = np.nan, np.inf, -np.inf
    outcome["place"].values[:] = np.nan
    run.__dict__["outcome"] = outcome
    series = run.series.load().copy()
    series["scene.kinetic_energy"].values[3:] = np.nan
    series["feet.normal_force"].values[:, 0] = np.inf
    run.__dict__["series"] = series
    page = report_runs.check_harmless(written(run, tmp_path / "x.html"))
    assert "3 without a finite value" in page.text
    values = next(c["values"] for c in page.blocks["environments"]["columns"] if c["name"] == "hardest")
    assert values[:3] == [None] * 3


def test_report_without_series_states_how_to_get_a_replay(tmp_path):
    study = report_runs.changed(record={"series": False}, duration=0.01)
    page = report_runs.check_harmless(written(report_runs.run(tmp_path / "run", study), tmp_path / "x.html"))
    assert "no sensors were recorded over time. With [record] series = true" in page.text
    assert not {"series", "loops", "replay-canvas"} & ids(page)
    assert "replay" not in page.blocks
    assert {"outcomes", "environments"} <= ids(page)


def test_report_without_outcomes_states_so(tmp_path):
    study = report_runs.changed(outcome=None, duration=0.01, envs=1, variation=None)
    page = report_runs.check_harmless(written(report_runs.run(tmp_path / "run", study), tmp_path / "x.html"))
    assert "defines no outcomes" in page.text
    assert len(page.blocks["replay"]["envs"]) == 1


def test_report_of_an_unfinished_run_states_progress(crate, tmp_path):
    folder = tmp_path / "part"
    report_runs.run(folder, report_runs.CRATE, shard=3)
    (folder / "commit" / "shard_000001.json").unlink()
    summary = json.loads((folder / "run.json").read_text())
    for key in ("wall_time", "env_steps_per_second", "frozen_environments", "contact_couplings"):
        del summary[key]
    (folder / "run.json").write_text(json.dumps(summary | {"state": "interrupted"}))
    page = report_runs.check_harmless(written(folder, tmp_path / "x.html"))
    assert "This run was interrupted and can be resumed with --resume" in page.text
    assert "3 of 6 environments are finished, in 1 of 2 shards." in page.text
    assert page.blocks["environments"]["env"] == [0, 1, 2]
    assert [one["env"] for one in page.blocks["replay"]["envs"]] == [0, 1, 2]
    (folder / "commit" / "shard_000000.json").unlink()
    page = report_runs.check_harmless(written(folder, tmp_path / "x.html"))
    assert "no environment is finished" in page.text
    assert "0 of 6 environments are finished" in page.text


def test_report_without_valid_scene_omits_replay_only(copied, tmp_path):
    folder = copied()
    path = folder / "experiment.toml"
    path.write_text(path.read_text().replace('shape = "box"', 'shape = "<b>gone</b>"'))
    page = report_runs.check_harmless(written(folder, tmp_path / "x.html"))
    assert "No replay: the scene cannot be restored" in page.text
    assert {"outcomes", "series", "environments"} <= ids(page)


def test_report_refuses_changed_results(copied, tmp_path):
    folder = copied()
    path = next((folder / "data.zarr/outcome/hardest/c").rglob("*"))
    path = path if path.is_file() else next(p for p in path.rglob("*") if p.is_file())
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(wc.RunDataError, match="was changed since it was committed"):
        wc.report(folder, tmp_path / "x.html")
    assert not (tmp_path / "x.html").exists()


# Files of the page


@pytest.mark.skipif(not (WEB / "package.json").is_file(), reason="the sources of the script are in a checkout")
def test_bundled_report_script_matches_its_sources():
    digest = hashlib.sha256()
    sources = sorted(path.relative_to(WEB).as_posix() for path in (WEB / "src").glob("*.js"))
    for name in ("build.mjs", "package-lock.json", "package.json", *sources):
        digest.update(f"{name}\n".encode() + (WEB / name).read_bytes())
    banner = write.asset(write.SCRIPT).splitlines()[0]
    assert f"sources sha256 {digest.hexdigest()}" in banner, "run: cd web && npm ci && npm run build"
    version = json.loads((WEB / "package.json").read_text())["dependencies"]["three"]
    assert f"three.js {version}," in banner
    assert f"three.js {version}," in (WEB.parent / "THIRD_PARTY_NOTICES").read_text(encoding="utf-8")


def test_report_script_contains_no_eval_and_no_inner_html():
    script = write.asset(write.SCRIPT)
    for word in (r"\beval\(", r"new Function\b", r"\.innerHTML\s*=", "insertAdjacentHTML", "document.write"):
        assert not re.search(word, script), word
    assert "</script" not in script.lower()
    assert "<!--" not in script


@functools.cache
def colours():
    style = write.asset(write.STYLE)
    blocks = re.findall(r"\{([^{}]*--page:[^{}]*)\}", style)
    return [dict(re.findall(r"(--[\w-]+):\s*([^;]+);", block)) for block in blocks]


def test_dark_colors_are_equal_by_choice_and_by_system():
    light, chosen, system = colours()
    assert chosen == system
    assert set(light) == set(chosen)
