"""Run folders with planted links and pipes: no command accesses files outside, blocks, or prints a traceback."""

import ast
import os
import shutil
import signal
import sys
from pathlib import Path

import pytest
import sharded_runs

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.visualize.viewer.replay import RunSource

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links and pipes of POSIX")

PACKAGE = Path(wc.__file__).parent

# Entries of a killed run that are replaced. {checkpoint}: the name of its checkpoint.
FOLDERS = (
    "checkpoint",
    "commit",
    "data.zarr",
    "data.zarr.partial",
    "data.zarr/outcome",
    "data.zarr/outcome/status",
    "data.zarr/params",
    "data.zarr/series",
    "data.zarr/series/touch.gap",
    "data.zarr/series/touch.gap/c",
    "data.zarr/series/touch.gap/c/0",
    "out.usdc.clips",
    "progress",
    "staging",
    "staging/shard_000001",
    "staging/shard_000001/series",
    "staging/shard_000001/series/touch.gap",
    "staging/shard_000002",
)
FILES = (
    ".out.partial.usdc",
    "animation.usdc",
    ".animation.partial.usdc",
    "checkpoint/{checkpoint}",
    "checkpoint/shard_000002-000000000019.npz",
    "checkpoint/shard_000002-000000000019.npz.partial",
    "commit/shard_000000.json",
    "commit/shard_000001.json",
    "commit/shard_000001.json.partial",
    "commit/shard_000002.json.partial",
    "commit/store.json",
    "data.zarr/series/touch.gap/c/0/0",
    "data.zarr/series/touch.gap/c/1/2",
    "data.zarr/series/touch.gap/zarr.json",
    "data.zarr/series/zarr.json",
    "data.zarr/zarr.json",
    "experiment.toml",
    "experiment.toml.partial",
    "out.csv",
    "out.csv.partial",
    "out.png",
    "out.png.partial",
    "out.usdc",
    "picture.png",
    "picture.png.partial",
    "progress/shard_000001.json",
    "progress/shard_000001.json.partial",
    "report.html",
    "report.html.partial",
    "run.json",
    "run.json.partial",
    "staging/shard_000001/series/touch.gap/c/1/2",
)


class Waited(BaseException):
    """Raised if a command waits for the other end of a pipe."""


@pytest.fixture(autouse=True)
def no_waiting():
    def late(*_):
        raise Waited

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(300)  # the machine may be busy
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def place(part_run, tmp_path):
    """A folder with a copy of a killed run, and a folder of other files."""
    shutil.copytree(part_run, tmp_path / "run")
    (tmp_path / "outside").mkdir()
    return tmp_path


def planted(place, name, kind):
    """Replaces a file or folder of the run by a link to a copy outside, a broken link, or a pipe."""
    folder = place / "run"
    path = folder / name.format(checkpoint=sharded_runs.records(folder)[1]["checkpoint"])
    target = place / "outside" / "target"
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "link":
        if path.is_dir():
            shutil.copytree(path, target)
        elif path.exists():
            shutil.copy(path, target)
        elif name in FOLDERS:
            for inner in ("shard_000000/a", "shard_000001/a", "clip_000000.usdc", "series/a"):
                (target / inner).parent.mkdir(parents=True, exist_ok=True)
                (target / inner).write_text("precious")
        else:
            target.write_text("precious")
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(target)


def snapshot(folder):
    return {
        path.relative_to(folder): (path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else None)
        for path in folder.rglob("*")
    }


def commands(folder):
    """Commands on a run folder, by names."""
    text = str(folder)

    def experiment():
        return wc.Experiment.from_toml(folder.parent / "study.toml")

    return {
        "status": lambda: main(["status", text, "--verify"]),
        "print": lambda: print(wc.open_run(folder), wc.open_run(folder).scene),
        "report": lambda: main(["report", text, "--envs", "0"]),
        "csv": lambda: main(["export", text, "--csv", f"{text}/out.csv"]),
        "usd": lambda: main(["export", text, "--usd", f"{text}/out.usdc", "--envs", "0", "--clips", "30"]),
        "render": lambda: main(["render", text, "-o", f"{text}/out.png", "--size", "32x32", "--samples", "1"]),
        "view": lambda: RunSource(folder).refresh(),
        "resume": lambda: experiment().run(folder, resume=True, device="cpu", progress=False, checkpoint=0.0),
        "overwrite": lambda: experiment().run(folder, overwrite=True, device="cpu", progress=False, shard=4),
    }


CASES = [(name, kind) for name in (*FOLDERS, *FILES) for kind in ("link", "pipe")]
CASES += [(name, "dangling link") for name in FILES]
# Cases of every test run; the others are slow.
FIRST = {
    ("checkpoint", "link"),
    ("data.zarr/series", "link"),
    ("run.json", "pipe"),
    ("report.html", "dangling link"),
}


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize(
    ("name", "kind"),
    [pytest.param(*case, marks=() if case in FIRST else pytest.mark.slow) for case in CASES],
)
def test_planted_link_is_not_followed(name, kind, place, capsys):
    sharded_runs.study(place)
    planted(place, name, kind)
    before = snapshot(place / "outside")
    for command, act in commands(place / "run").items():
        message = str(place / "run")
        try:
            act()
        except (wc.ExperimentError, wc.RunDataError, OSError) as error:
            message = str(error)
        assert str(place / "run") in message, command
        assert len(message.splitlines()) == 1, command
        assert snapshot(place / "outside") == before, command
    capsys.readouterr()


# Only ``run_folder`` opens files below a run folder.

# Audit events of Python's functions that open, list, make, move or remove the path in their first arguments.
EVENTS = {
    "open": 1,
    **dict.fromkeys(
        ("os.listdir", "os.scandir", "os.mkdir", "os.remove", "os.rmdir", "os.truncate", "os.chmod"), 1
    ),
    **dict.fromkeys(("os.utime", "os.chown", "os.link", "os.symlink", "os.rename", "shutil.move"), 2),
    **dict.fromkeys(("shutil.copyfile", "shutil.copytree"), 2),
    **dict.fromkeys(("shutil.rmtree", "pathlib.Path.glob", "pathlib.Path.rglob", "glob.glob"), 1),
    "tempfile.mkstemp": 1,
}


@pytest.fixture
def opened_by_path(monkeypatch):
    """Collects paths below a folder that Python opens, lists, makes, moves or removes by name."""
    found, watched = [], []

    def hook(event, arguments):
        if watched and event in EVENTS:
            for path in arguments[: EVENTS[event]]:
                if isinstance(path, str | bytes | os.PathLike) and below(os.fsdecode(path)):
                    found.append((event, os.fsdecode(path)))

    def below(path):
        return os.path.abspath(path).startswith(f"{watched[0]}/")

    sys.addaudithook(hook)  # the hook cannot be removed; it does nothing after this test
    yield lambda folder: watched.append(str(folder)) or found
    watched.clear()


def test_run_folder_is_used_through_descriptors_only(part_run, tmp_path, opened_by_path, capsys):
    folder = tmp_path / "run"
    shutil.copytree(part_run, folder)
    sharded_runs.study(tmp_path)
    found = opened_by_path(folder)
    (tmp_path / "seen").mkdir()
    with pytest.raises(FileNotFoundError):
        (folder / "nothing").open()
    assert found == [("open", f"{folder}/nothing")]
    found.clear()
    for act in commands(folder).values():
        assert act() != 2
    study = sharded_runs.study(tmp_path, usd_envs=1)
    wc.Experiment.from_toml(study).run(folder, overwrite=True, device="cpu", progress=False)
    capsys.readouterr()
    assert (folder / "animation.usdc").is_file()
    # The experiment and its files are read from the user's folder, which may be anywhere.
    assert found == []


# Methods of paths, and functions, that open, list, make, move or remove a path.
CALLS = {
    *("read_bytes", "read_text", "write_bytes", "write_text", "touch", "unlink", "rmdir", "mkdir", "rename"),
    *("iterdir", "glob", "rglob", "symlink_to", "hardlink_to", "chmod", "fromfile", "tofile", "memmap", "loadtxt"),
    *("genfromtxt", "savetxt", "LocalStore", "open_dataset", "load_dataset", "mkstemp", "mkdtemp"),
    *("NamedTemporaryFile", "TemporaryDirectory"),
}
# Same for these modules.
CALLS_OF = {
    "os": {
        *("open", "listdir", "scandir", "walk", "remove", "makedirs", "removedirs", "replace", "link", "symlink"),
        *("truncate", "utime", "chown", "mkfifo"),
    },
    "shutil": {"rmtree", "copy", "copy2", "copyfile", "copytree", "move"},
    "io": {"open"},
}
# Modules that use run folders.
USERS = (
    "experiment",
    "visualize/report",
    "visualize/viewer/replay.py",
    "cli/commands.py",
    "cli/run_folders.py",
    "files/direct_io.py",
    "files/picture_file.py",
    "stepping/checkpoint.py",
    "usd/clips.py",
)
# Calls that do not access the file system, or access files elsewhere.
ALLOWED = {
    ("cli/commands.py", "open"),  # the null device, for a closed pipe
    ("experiment/user_code.py", "glob"),  # names of laws, for a suggestion
    ("experiment/quantities.py", "loadtxt"),  # of an open file
    ("experiment/user_code.py", "mkdir"),  # the state folder of the user
    ("experiment/user_code.py", "touch"),
    ("visualize/report/write.py", "read_text"),  # of the package
    ("usd/clips.py", "TemporaryDirectory"),  # a new folder with a random name
}


def calls_of_files(path):
    """Yields the file system calls of a module that use a path and not a ``RunPath``."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        owner = getattr(getattr(node.func, "value", None), "id", "")
        words = any(isinstance(argument, ast.Constant | ast.JoinedStr) for argument in node.args)
        by_mode = name == "open" and (isinstance(node.func, ast.Name) or words)
        by_path = name == "replace" and len(node.args) == 1 and not node.keywords
        if name in CALLS or name in CALLS_OF.get(owner, ()) or by_mode or by_path:
            yield name, node.lineno


def test_modules_of_run_folders_open_no_path_themselves():
    modules = [path for name in USERS for path in (PACKAGE / name).rglob("*.py")]
    modules += [PACKAGE / name for name in USERS if name.endswith(".py")]
    assert len(modules) > 40
    found = [
        f"{path.relative_to(PACKAGE).as_posix()}:{line}: {name}"
        for path in modules
        for name, line in calls_of_files(path)
        if (path.relative_to(PACKAGE).as_posix(), name) not in ALLOWED
    ]
    assert found == []
