"""Commands end with the right exit code for any terminal encoding, and files are UTF-8 for any locale."""

import ast
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
import sharded_runs

import warpcontact
from warpcontact.cli import main

ENCODINGS = ("ascii", "cp1252", "cp932")
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
# Functions that open text in the encoding of the locale unless they get one.
TEXT = {"open", "read_text", "write_text", "fdopen", "NamedTemporaryFile", "TemporaryFile", "TextIOWrapper"}
# Modules and objects with an ``open`` function of another kind.
NO_FILES = {"os", "webbrowser", "viewer", "zarr"}
PROCESSES = {"run", "Popen", "check_output"}


@pytest.fixture
def mesh(tmp_path):
    file = tmp_path / "Größe.obj"
    file.write_text(TRIANGLE, encoding="utf-8")
    return file


def encoded_text(stream):
    stream.flush()
    return stream.buffer.getvalue().decode(stream.encoding)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_output_escapes_characters_outside_the_encoding(encoding, mesh, monkeypatch):
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2))
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    assert main(["inspect", str(mesh)]) == 0
    assert main(["laws"]) == 0
    assert main(["inspect", str(mesh.with_name("Ähre≤.obj"))]) == 2
    with pytest.raises(SystemExit) as ended:
        main(["run", "--help"])
    assert ended.value.code == 0
    assert "  faces                  1" in encoded_text(out)
    escaped = "Ähre≤.obj".encode(encoding, "backslashreplace").decode(encoding)
    assert escaped in encoded_text(err)


@pytest.mark.slow
def test_run_and_status_succeed_in_the_c_locale(tmp_path):
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    environment.pop("PYTHONIOENCODING", None)
    out = tmp_path / "Größe"
    for words in (
        ["run", sharded_runs.study(tmp_path), "--out", out, "--device", "cpu"],
        ["status", out],
        ["report", out],
    ):
        command = [sys.executable, "-m", "warpcontact", *map(str, words)]
        ended = subprocess.run(command, capture_output=True, env=environment, check=False)
        assert (ended.returncode, b"Traceback" in ended.stderr) == (0, False), ended
    for file in ("run.json", "experiment.toml", "report.html"):
        assert (out / file).read_text(encoding="utf-8")


def test_every_text_file_is_opened_with_an_encoding():
    unclear = []
    for file in sorted(Path(warpcontact.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and not has_encoding(node):
                unclear.append(f"{file}:{node.lineno}")
    assert unclear == []


def has_encoding(call):
    """Whether a call opens no file, a binary one, or one with an encoding."""
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    keywords = {keyword.arg: keyword.value for keyword in call.keywords}
    if name in PROCESSES:
        return "text" not in keywords or "encoding" in keywords
    owner = getattr(call.func, "value", None)
    if name not in TEXT or (isinstance(owner, ast.Name) and owner.id in NO_FILES):
        return True
    modes = [*call.args, *keywords.values()] if name in ("open", "fdopen") else [keywords.get("mode")]
    binary = any(isinstance(mode, ast.Constant) and "b" in str(mode.value) for mode in modes)
    # Temporary files are binary unless they get a mode.
    return binary or "encoding" in keywords or ("Temporary" in name and keywords.get("mode") is None)
