"""Text from untrusted files reaches no terminal as control characters."""

import contextlib
import io
import json
import sys
import unicodedata

import pytest
from tqdm import tqdm

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment.progress import RunStatus
from warpcontact.experiment.run import Run
from warpcontact.stepping.chunk_sizer import progress_bar
from warpcontact.validation import safe_text

MALICIOUS = "\x1b[31mRED\x1b]0;title\x07\r\x9b2J\u202egnp\u2028"


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
    assert safe_text.escape_controls(MALICIOUS) == r"\x1b[31mRED\x1b]0;title\x07\r\x9b2J\u202egnp\u2028"
    assert safe_text.escape_controls("ν = 0.3 m/s²\n\tä 漢 😀") == "ν = 0.3 m/s²\n\tä 漢 😀"
    assert not controls(safe_text.escape_controls("".join(map(chr, range(0x3000)))))


def test_messages_of_errors_are_shown_with_escapes():
    errors = [wc.RunDataError(MALICIOUS), wc.CheckpointError(MALICIOUS), wc.MeshError(MALICIOUS)]
    errors += [
        wc.ExperimentError(MALICIOUS, [MALICIOUS]),
        wc.ExperimentError(MALICIOUS, [MALICIOUS, MALICIOUS]),
        wc.UsdError(MALICIOUS, [MALICIOUS]),
    ]
    for error in errors:
        assert not controls(str(error)), type(error)
        assert "RED" in str(error)


@pytest.fixture
def malicious_run(whole_run, copied_run):
    """A run with control characters in all texts of run.json."""
    folder = copied_run(whole_run)
    summary = json.loads((folder / "run.json").read_text())
    kept = ("state", "program", "fingerprint")
    summary |= {key: MALICIOUS for key, value in summary.items() if isinstance(value, str) and key not in kept}
    summary |= {
        "warnings": [MALICIOUS],
        "failed": {MALICIOUS: MALICIOUS},
        "contact_couplings": {MALICIOUS: [MALICIOUS]},
    }
    (folder / "run.json").write_text(json.dumps(summary))
    return folder


def test_run_is_shown_with_escapes(malicious_run, capsys):
    run = wc.open_run(malicious_run)
    for text in (str(run), repr(run)):
        assert "RED" in text
        assert not controls(text)
    assert main(["status", str(malicious_run), "--verify"]) == 0
    output = capsys.readouterr()
    assert "RED" in output.out
    assert not controls(output.out + output.err)


@pytest.mark.parametrize(
    "text",
    [
        f"envs = 1\n{json.dumps(MALICIOUS)} = 2\n",
        f"name = {json.dumps(MALICIOUS)}\n",
        f"envs = {json.dumps(MALICIOUS)}\n",
        MALICIOUS,
    ],
    ids=["key", "name", "value", "no TOML"],
)
def test_refused_experiment_is_shown_with_escapes(text, tmp_path, capsys):
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


def test_command_output_is_shown_with_escapes_and_streams_are_restored(monkeypatch, capsys):
    out, err = sys.stdout, sys.stderr

    def print_malicious(arguments):
        print(MALICIOUS)
        print(MALICIOUS, file=sys.stderr)
        sys.stdout.writelines([MALICIOUS, "\n"])
        raise ValueError(MALICIOUS)

    monkeypatch.setattr("warpcontact.cli.laws.run", print_malicious)
    assert main(["laws"]) == 2
    output = capsys.readouterr()
    assert output.out.count("RED") == 2
    assert output.err.count("RED") == 2
    assert not controls(output.out + output.err)
    assert (sys.stdout, sys.stderr) == (out, err)


def test_texts_of_run_json_cannot_add_lines(tmp_path):
    forged = "x\nverified: all"
    summary = {"name": forged, "envs": 1, "steps": 1, "failed": {forged: forged}, "state": forged, "duration": 1}
    status = RunStatus(tmp_path, summary, "failed", 1, 0, 0, 0, 0, 0, 0.0)
    assert str(status).count(r"x\nverified: all") == 3
    assert not [line for line in str(status).splitlines() if line.startswith("verified")]
    assert repr(Run(tmp_path, summary)).splitlines() == [repr(Run(tmp_path, summary))]
    assert safe_text.escape_lines(["a\tb", forged]) == "a\tb\nx\\nverified: all"


def test_traceback_of_an_unexpected_error_is_shown_with_escapes(monkeypatch, capsys):
    def print_malicious(arguments):
        raise KeyError(MALICIOUS) from RuntimeError(MALICIOUS)

    monkeypatch.setattr("warpcontact.cli.laws.run", print_malicious)
    assert main(["laws"]) == 1
    output = capsys.readouterr()
    assert "Traceback" in output.err
    assert r"RuntimeError: \x1b[31mRED" in output.err
    assert not controls(output.out + output.err)


def test_progress_bars_still_move_the_cursor():
    output = io.StringIO()
    with contextlib.redirect_stderr(output), safe_text.escape_output():
        bar = progress_bar(True, 3, "steps")
        bar.delay = 0
        bar.update(3)
        bar.refresh()
        bar.close()
        assert isinstance(bar, tqdm)
    assert "\r" in output.getvalue()
    assert "\\r" not in output.getvalue()
