"""Text of files that others made reaches no terminal as control characters."""

import contextlib
import io
import json
import sys
import unicodedata

import pytest
from tqdm import tqdm

import warpcontact as wc
from warpcontact import hostile
from warpcontact.cli import main
from warpcontact.experiment.run import Run
from warpcontact.experiment.status import RunStatus
from warpcontact.pace import bar_of

EVIL = "\x1b[31mRED\x1b]0;title\x07\r\x9b2J\u202egnp\u2028"


def controls(text):
    """Returns the control characters of a text, other than newline and tab."""
    bad = ("Cc", "Zl", "Zp")
    return [
        c
        for c in text
        if (unicodedata.category(c) in bad and c not in "\n\t")
        or unicodedata.bidirectional(c) in ("RLO", "LRO", "RLE", "LRE", "PDF", "RLI", "LRI", "FSI", "PDI")
    ]


def test_control_characters_are_shown_as_escapes():
    assert hostile.visible(EVIL) == r"\x1b[31mRED\x1b]0;title\x07\r\x9b2J\u202egnp\u2028"
    assert hostile.visible("ν = 0.3 m/s²\n\tä 漢 😀") == "ν = 0.3 m/s²\n\tä 漢 😀"
    assert not controls(hostile.visible("".join(map(chr, range(0x3000)))))


def test_messages_of_errors_are_shown_with_escapes():
    errors = [wc.RunDataError(EVIL), wc.CheckpointError(EVIL), wc.MeshError(EVIL)]
    errors += [
        wc.ExperimentError(EVIL, [EVIL]),
        wc.ExperimentError(EVIL, [EVIL, EVIL]),
        wc.UsdError(EVIL, [EVIL]),
    ]
    for error in errors:
        assert not controls(str(error)), type(error)
        assert "RED" in str(error)


@pytest.fixture
def evil_run(whole_run, copied_run):
    """A run with control characters in all texts of run.json."""
    folder = copied_run(whole_run)
    summary = json.loads((folder / "run.json").read_text())
    kept = ("state", "program", "fingerprint")
    summary |= {key: EVIL for key, value in summary.items() if isinstance(value, str) and key not in kept}
    summary |= {"warnings": [EVIL], "failed": {EVIL: EVIL}, "contact_couplings": {EVIL: [EVIL]}}
    (folder / "run.json").write_text(json.dumps(summary))
    return folder


def test_a_run_is_shown_with_escapes(evil_run, capsys):
    run = wc.open_run(evil_run)
    for text in (str(run), repr(run)):
        assert "RED" in text
        assert not controls(text)
    assert main(["status", str(evil_run), "--verify"]) == 0
    told = capsys.readouterr()
    assert "RED" in told.out
    assert not controls(told.out + told.err)


@pytest.mark.parametrize(
    "text",
    [f"envs = 1\n{json.dumps(EVIL)} = 2\n", f"name = {json.dumps(EVIL)}\n", f"envs = {json.dumps(EVIL)}\n", EVIL],
    ids=["key", "name", "value", "no TOML"],
)
def test_an_experiment_is_refused_with_escapes(text, tmp_path, capsys):
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8", newline="")
    assert main(["plan", str(path)]) == 2
    assert not controls(capsys.readouterr().err)
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_toml(path)
    assert not controls(str(caught.value))


def test_names_in_a_mesh_file_are_shown_with_escapes(tmp_path, capsys):
    path = tmp_path / "a.obj"
    faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    path.write_text(f"o \x1b[31mRED\ng \x9b2J\u202e\n{faces}", encoding="utf-8")
    assert main(["inspect", str(path)]) == 0
    assert not controls(capsys.readouterr().out)
    assert not controls(wc.load_mesh(path).report.to_text())


def test_output_of_commands_is_shown_with_escapes_and_streams_come_back(monkeypatch, capsys):
    out, err = sys.stdout, sys.stderr

    def evil(arguments):
        print(EVIL)
        print(EVIL, file=sys.stderr)
        sys.stdout.writelines([EVIL, "\n"])
        raise ValueError(EVIL)

    monkeypatch.setattr("warpcontact.laws_command.run", evil)
    assert main(["laws"]) == 2
    told = capsys.readouterr()
    assert told.out.count("RED") == 2
    assert told.err.count("RED") == 2
    assert not controls(told.out + told.err)
    assert (sys.stdout, sys.stderr) == (out, err)


def test_texts_of_run_json_make_no_lines(tmp_path):
    forged = "x\nverified: all"
    summary = {"name": forged, "envs": 1, "steps": 1, "failed": {forged: forged}, "state": forged, "duration": 1}
    status = RunStatus(tmp_path, summary, "failed", 1, 0, 0, 0, 0, 0, 0.0)
    assert str(status).count(r"x\nverified: all") == 3
    assert not [line for line in str(status).splitlines() if line.startswith("verified")]
    assert repr(Run(tmp_path, summary)).splitlines() == [repr(Run(tmp_path, summary))]
    assert hostile.visible_lines(["a\tb", forged]) == "a\tb\nx\\nverified: all"


def test_traceback_of_an_unexpected_error_is_shown_with_escapes(monkeypatch, capsys):
    def evil(arguments):
        raise KeyError(EVIL) from RuntimeError(EVIL)

    monkeypatch.setattr("warpcontact.laws_command.run", evil)
    assert main(["laws"]) == 1
    told = capsys.readouterr()
    assert "Traceback" in told.err
    assert r"RuntimeError: \x1b[31mRED" in told.err
    assert not controls(told.out + told.err)


def test_progress_bars_still_move_the_cursor():
    told = io.StringIO()
    with contextlib.redirect_stderr(told), hostile.visible_output():
        bar = bar_of(True, 3, "steps")
        bar.delay = 0
        bar.update(3)
        bar.refresh()
        bar.close()
        assert isinstance(bar, tqdm)
    assert "\r" in told.getvalue()
    assert "\\r" not in told.getvalue()
