"""Paths below a run folder: links are not followed or written through, and pipes are not read."""

import fcntl
import os
import socket
import stat

import pytest

from warpcontact.files import run_folder
from warpcontact.files.atomic_files import atomic_file, check_writable, open_for_writing
from warpcontact.files.regular_files import UnsafeFileError, open_regular
from warpcontact.files.run_folder import RunPath, below_run, open_file
from warpcontact.meshes import MeshError, load_mesh
from warpcontact.system.cache_key import cache_key

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links and pipes of POSIX")

LINK = "is a symbolic link, and none is followed below the folder of a run"


@pytest.fixture(params=["descriptors", "paths"])
def run(request, tmp_path, monkeypatch):
    """A run folder behind a link of the user, next to a folder of other files."""
    if request.param == "paths":
        monkeypatch.setattr(run_folder, "_DESCRIPTORS", False)
        monkeypatch.delattr(os, "O_NOFOLLOW", raising=False)
    (tmp_path / "scratch" / "inner").mkdir(parents=True)
    (tmp_path / "scratch" / "inner" / "file").write_text("inner")
    for name in run_folder.SUMMARY, run_folder.EXPERIMENT:
        (tmp_path / "scratch" / name).write_text("{}")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("other")
    (tmp_path / "run").symlink_to("scratch")
    return RunPath(tmp_path / "run")


def plant(path, target):
    (path.root.resolve().joinpath(*path.parts)).symlink_to(target)


ACTIONS = {
    "open": lambda path: path.open_binary(),
    "read": lambda path: path.read(),
    "size": lambda path: path.size(),
    "is_file": lambda path: path.is_file(),
    "is_folder": lambda path: path.is_folder(),
    "sync": lambda path: path.sync(),
    "make": lambda path: path.make(),
}
BELOW = ACTIONS | {
    "status": lambda path: path.status(),
    "names": lambda path: path.names(),
    "create": lambda path: path.create(),
    "replacement_file": lambda path: path.replacement_file().__enter__(),
    "replacement_path": lambda path: path.replacement_path().__enter__(),
    "remove": lambda path: path.remove(),
    "move_to": lambda path: path.move_to(RunPath(path.root) / "moved"),
    "move_from": lambda path: (RunPath(path.root) / "inner/file").move_to(path),
}


def outside(run):
    folder = run.root.parent / "other"
    return {path.name: (path.read_text(), path.stat().st_mtime_ns) for path in folder.iterdir()}


@pytest.mark.parametrize("action", ACTIONS)
def test_link_is_refused_by_name(action, run):
    plant(run / "link", "../other/file")
    with pytest.raises(UnsafeFileError) as error:
        ACTIONS[action](run / "link")
    assert str(error.value) == f"{run / 'link'}: {LINK}"


@pytest.mark.parametrize("action", BELOW)
def test_linked_folder_is_not_entered(action, run):
    plant(run / "link", "../other")
    before = outside(run)
    with pytest.raises(UnsafeFileError) as error:
        BELOW[action](run / "link/file")
    assert str(error.value) == f"{run / 'link'}: {LINK}"
    assert outside(run) == before
    assert (run / "inner/file").read() == b"inner"


def test_names_of_a_linked_folder_are_refused(run):
    plant(run / "link", "../other")
    with pytest.raises(UnsafeFileError, match=LINK):
        (run / "link").names()


def test_removing_a_link_or_a_folder_with_links_keeps_their_targets(run):
    plant(run / "link", "../other")
    plant(run / "inner/link", "../../other")
    plant(run / "inner/dangling", "nowhere")
    (run / "link").remove()
    (run / "inner").remove()
    (run / "missing").remove()
    assert run.names() == ["experiment.toml", "run.json"]
    assert list(outside(run)) == ["file"]


@pytest.mark.parametrize("target", ["../other/file", "../other/new"])
def test_new_file_replaces_a_prepared_link(target, run):
    plant(run / "file", target)
    plant(run / "file.partial", target)
    before = outside(run)
    with (run / "file").replacement_file() as file:
        file.write(b"mine")
    assert (run / "file").read() == b"mine"
    with (run / "named").replacement_path("file") as partial:
        partial.path.write_text("by name")
    assert (run / "named").read() == b"by name"
    plant(run / "created", target)
    os.close((run / "created").create())
    assert (run / "created").size() == 0
    assert outside(run) == before
    assert run.names() == ["created", "experiment.toml", "inner", "named", "run.json"]


def test_failed_block_leaves_the_old_file(run):
    path = run / "inner/file"
    with pytest.raises(TypeError), path.replacement_file() as file:
        file.writelines([b"part", None])
    assert path.read() == b"inner"
    assert (run / "inner").names() == ["file"]


def test_files_are_created_with_the_usual_mode(run):
    os.close((run / "file").create())
    (run.root / "usual").write_bytes(b"")
    assert (run / "file").status().st_mode == (run / "usual").status().st_mode


@pytest.mark.parametrize("name", ["", ".", "..", "a/../b", "a//b", "/a", "a\0b"])
def test_names_outside_of_the_folder_are_refused(name, run):
    with pytest.raises(ValueError, match="the name of a file must not be empty"):
        run / name


@pytest.mark.parametrize("name", ["run.json:stream", "C:", "nul", "Aux.txt", "com1.npz", "lpt² .x", "a.", "a "])
def test_names_reserved_on_windows_are_refused_on_windows(name, run, monkeypatch):
    assert (run / name).name == name
    monkeypatch.setattr(run_folder, "_WINDOWS", True)
    with pytest.raises(ValueError, match="must be valid on Windows"):
        run / f"inner/{name}"
    for usual in ("shard_000000.json", "touch.gap", "console", "com.npz", ".animation.partial.usdc"):
        assert (run / usual).name == usual


def test_descriptors_for_synchronization_are_writable_on_windows(run, monkeypatch):
    modes, synchronize = [], os.fsync

    def noted(descriptor):
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            modes.append(fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE)
        synchronize(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    with (run / "file").replacement_file() as file:
        file.write(b"mine")
        file.close()  # as a wrapper of the file does
    assert modes == [os.O_WRONLY]
    monkeypatch.setattr(run_folder, "_WINDOWS", True)
    (run / "file").sync()
    with (run / "named").replacement_path() as partial:
        partial.path.write_text("by name")
    assert modes == [os.O_WRONLY, os.O_RDWR, os.O_RDWR]
    assert (run / "file").read() == b"mine"


def test_errors_name_the_whole_path(run):
    for action, path in (
        ("read", "no/where"),
        ("create", "no/where"),
        ("read", "inner"),
        ("create", "inner/file/x"),
    ):
        with pytest.raises(OSError, match=r"\[Errno") as error:
            BELOW[action](run / path)
        assert error.value.filename == str(run / path)


# Files that the user names


def test_file_of_the_user_is_found_below_a_run_folder(run, monkeypatch):
    root = run.root.parent
    assert below_run(root / "run" / "inner" / "x") == RunPath(root / "run", ("inner", "x"))
    assert below_run(root / "other" / "x") is None
    assert below_run(root / "run") is None
    monkeypatch.chdir(root)
    assert str(below_run(run_folder.Path("run/report.html"))) == "run/report.html"
    monkeypatch.chdir(root / "run")
    assert str(below_run(run_folder.Path("report.html"))) == "report.html"


def test_output_below_a_run_folder_replaces_links_elsewhere_follows_them(run):
    root = run.root.parent
    plant(run / "table.csv", "../other/file")
    check_writable(root / "run" / "table.csv")
    with open_for_writing(root / "run" / "table.csv") as file:
        file.write(b"table")
    assert outside(run)["file"][0] == "other"
    assert (run / "table.csv").read() == b"table"
    (root / "latest.csv").symlink_to("other/file")
    check_writable(root / "latest.csv")
    with open_for_writing(root / "latest.csv") as file:
        file.write(b"table")
    assert outside(run)["file"][0] == "table"
    assert (root / "latest.csv").is_symlink()


def test_output_is_not_written_through_a_prepared_partial_file(run):
    root = run.root.parent
    (root / "a.html.partial").symlink_to("other/file")
    with atomic_file(root / "a.html") as file:
        file.write(b"page")
    assert outside(run)["file"][0] == "other"
    assert (root / "a.html").read_bytes() == b"page"
    assert not (root / "a.html.partial").is_symlink()


def test_output_path_behind_a_link_below_a_run_folder_is_refused(run):
    plant(run / "link", "../other")
    before = outside(run)
    with pytest.raises(ValueError, match=f"new: cannot be written: {LINK}"):
        check_writable(run.root / "link" / "new")
    with pytest.raises(UnsafeFileError, match=LINK), open_for_writing(run.root / "link" / "new"):
        pass
    with pytest.raises(UnsafeFileError, match=LINK):
        open_file(run.root / "link" / "file")
    assert outside(run) == before


def test_output_path_of_a_pipe_is_checked_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    check_writable(tmp_path / "pipe")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_mesh_behind_a_link_below_a_run_folder_is_refused(run):
    (run.root.parent / "other" / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    plant(run / "a.obj", "../other/a.obj")
    plant(run / "link", "../other")
    for name in ("a.obj", "link/a.obj"):
        with pytest.raises(MeshError, match=f"a.obj' {LINK}"):
            load_mesh(run.root / name, trusted=True)
    (run.root.parent / "b.obj").symlink_to("other/a.obj")
    assert len(load_mesh(run.root.parent / "b.obj", trusted=True).faces) == 1


def test_kernel_cache_key_of_an_experiment_reads_no_links_below_a_run_folder(run):
    folder = run.root.parent / "host"
    folder.mkdir()
    (run.root / "experiment.toml").write_text('law = { type = "laws.py:Cubic" }\n')
    plant(run / "laws.py", "../other/file")
    with pytest.raises(UnsafeFileError, match=f"laws.py: {LINK}"):
        cache_key("cpu", [run.root / "experiment.toml"], host=folder, kernels=folder)
    (run / "laws.py").remove()
    assert cache_key("cpu", [run.root / "experiment.toml"], host=folder, kernels=folder)
    plant(run / "study.toml", "../other/file")
    with pytest.raises(UnsafeFileError, match=f"study.toml: {LINK}"):
        cache_key("cpu", [run.root / "study.toml"], host=folder, kernels=folder)


# Special files


def special(folder, kind):
    path = folder / "special"
    if kind == "a named pipe":
        os.mkfifo(path)
    elif kind == "a socket":
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(str(path))
    else:
        path.symlink_to("/dev/zero")
    return path


@pytest.mark.parametrize("kind", ["a named pipe", "a socket", "a device"])
def test_special_file_is_refused_without_a_read(kind, tmp_path):
    path = special(tmp_path, kind)
    with pytest.raises(UnsafeFileError) as error:
        open_regular(path)
    assert str(error.value) == f"{path}: is not a regular file: it is {kind}"
    if kind != "a device":
        with pytest.raises(UnsafeFileError, match=f"is not a regular file: it is {kind}"):
            (RunPath(tmp_path) / "special").read()


def test_file_that_became_a_pipe_is_refused(tmp_path, monkeypatch):
    """The open file is checked again, and opening does not wait for a writer."""
    regular = tmp_path / "regular"
    regular.write_text("")
    os.mkfifo(tmp_path / "pipe")
    found = os.stat(regular)
    monkeypatch.setattr(os, "stat", lambda *_, **__: found)
    with pytest.raises(UnsafeFileError, match="is not a regular file: it is a named pipe"):
        open_regular(tmp_path / "pipe")


def test_file_that_is_too_large_is_refused_without_a_read(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    with open_regular(path, 5) as file:
        assert file.read() == b"12345"
    with pytest.raises(UnsafeFileError, match=r"file: must have at most 4 B, has 5 B"):
        open_regular(path, 4)
    with path.open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(UnsafeFileError, match=r"must have at most 512 MiB, has 1 GiB"):
        (RunPath(tmp_path) / "file").read()
