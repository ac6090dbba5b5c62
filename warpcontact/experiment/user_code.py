"""Loads user-defined laws, other device models and outcomes from Python files, named as ``FILE.py:CLASS``.

A file is executed like an imported module. It must be inside of the folder of the experiment, so that an experiment
cannot execute files elsewhere. Errors in a file are reported in one sentence with the line.

A run folder can come from elsewhere, with law files that contain any code. Therefore the SHA-256 of each file that a
run copies into its folder is recorded outside of it, as the name of an empty file in the state folder of the user.
Only recorded files and files that the caller trusts are executed.
"""

import contextlib
import hashlib
import importlib.util
import io
import itertools
import linecache
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from warpcontact.experiment.errors import ExperimentError, abbreviated
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import is_run_folder, read_file
from warpcontact.forces.registry import FILE_MODULE
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.kernels.couplings.springs import Damper, Spring
from warpcontact.kernels.friction import Friction
from warpcontact.kernels.joints import Motion
from warpcontact.kernels.laws import Law
from warpcontact.kernels.outcomes.base import Outcome
from warpcontact.kernels.shapes.base import Shape
from warpcontact.scene.scene_element import SceneElement
from warpcontact.validation.checks import check_length
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

#: ``True``: any file may be executed; otherwise the recorded files, and those with one of these SHA-256.
Trust = bool | Collection[str]

#: Base classes of user-defined classes.
KINDS: tuple[type, ...] = (Law, Friction, Spring, Damper, Motion, Shape, Outcome, SceneElement)
# Names of base classes in messages, if they differ from the public name of the class.
_BASE_NAMES = {Shape: "wc.ParametricSurface", SceneElement: "SceneElement of warpcontact.scene.scene_element"}

# Modules by path and content, so that experiments with an unchanged file share its classes and compiled kernels.
_MODULES: dict[tuple[Path, bytes], ModuleType] = {}
# Each loading has a new module name, so that neither Python nor Warp finds definitions of an earlier one.
_NUMBERS = itertools.count(1)


def digest_of(content: bytes) -> str:
    """Returns the SHA-256 of the content of a file."""
    return hashlib.sha256(content).hexdigest()


def may_run(content: bytes, trust: Trust) -> bool:
    """Whether a file of a run folder may be executed."""
    if isinstance(trust, bool):
        return trust or _is_recorded(digest_of(content))
    return digest_of(content) in trust or _is_recorded(digest_of(content))


def record_trusted(contents: Iterable[bytes]) -> None:
    """Records that files with these contents may be executed; warns if they cannot be recorded."""
    for content in contents:
        if _is_recorded(digest_of(content)):
            continue
        try:
            folder = trusted_folder()
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            (folder / digest_of(content)).touch(0o600)
        except (OSError, RuntimeError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            text = (
                f"the law files of this run could not be recorded as trusted: {reason}; to resume or render it, use "
                "--trust"
            )
            warnings.warn(RunWarning(text, WarningLevel.CAUTION), stacklevel=2)
            return


def trusted_folder() -> Path:
    """Returns the folder with the recorded SHA-256.

    Raises:
        RuntimeError: If the user has no home folder.
    """
    if os.name == "nt":
        given, default = os.environ.get("LOCALAPPDATA", ""), ("AppData", "Local")
    else:
        given, default = os.environ.get("XDG_STATE_HOME", ""), (".local", "state")
    base = Path(given) if os.path.isabs(given) else Path.home().joinpath(*default)
    return base / "warpcontact" / "trusted_laws"


def _is_recorded(sha: str) -> bool:
    with contextlib.suppress(OSError, RuntimeError):
        return (trusted_folder() / sha).is_file()
    return False


class TrustError(ExperimentError):
    """A run folder names Python files that no run of this user has written there and that are not trusted."""


@dataclass(frozen=True)
class UserFile:
    """A loaded Python file of the user.

    Attributes:
        path: Path with links resolved.
        content: Content when it was loaded.
        module: The module.
    """

    path: Path
    content: bytes
    module: ModuleType


class UserFiles:
    """The Python files that an experiment names; each is read once, and later changes are ignored.

    Args:
        folder: Folder of the experiment.
        on_stage: Called with a short description before a file is loaded.
        trusted: Files that may be executed if the folder is a run folder; see ``may_run``.
    """

    def __init__(self, folder: Path, on_stage: Callable[[str], None], trusted: Trust = False) -> None:
        self.folder = folder
        self.on_stage = on_stage
        self.trusted = trusted
        self._files: dict[str, UserFile] = {}
        self._failures: dict[str, str] = {}

    def check_trusted(self, raw: Any) -> None:
        """Checks that all files that an experiment names may be executed, before any of them is.

        Args:
            raw: Content of the experiment file.

        Raises:
            TrustError: If some may not; the message names them.
        """
        if not is_run_folder(self.folder):
            return
        untrusted = []
        for name in dict.fromkeys(_files_in(raw)):
            if name in self._files:  # loaded before, with content that was trusted
                continue
            with contextlib.suppress(ValueError):  # ``file`` raises it again, with the key
                if not may_run(self._read(name), self.trusted):
                    untrusted.append(name)
        if untrusted:
            raise _untrusted(self.folder, untrusted)

    def file(self, name: str) -> UserFile:
        """Returns the file called ``name``, relative to the folder.

        Raises:
            ValueError: If there is no such file, it is outside of the folder or cannot be loaded; the message
                continues the key ``type``.
        """
        if name not in self._files and name not in self._failures:
            try:
                self._files[name] = self._load(name)
            except ValueError as error:
                self._failures[name] = str(error)
        if name in self._failures:
            raise ValueError(self._failures[name])
        return self._files[name]

    def find(self, file: str, name: str, *bases: type) -> Any:
        """Returns the class ``name`` of a file.

        Args:
            file: The file, relative to the folder.
            name: Name of the class.
            bases: Allowed base classes, from ``KINDS``.

        Raises:
            ValueError: If there is no such class; the message continues the key ``type``.
        """
        defined = vars(self.file(file).module)
        given = defined.get(name)
        if given is None:
            available = [key for key, value in defined.items() if _is_formula(value, bases) and value not in bases]
            hint = suggestion(name, available) or f"; there are: {', '.join(available) or 'none'}"
            raise ValueError(f": {file} has no {_kind_names(bases)} {name!r}{hint}")
        if not _is_formula(given, bases):
            kinds = [kind for kind in KINDS if _is_formula(given, (kind,))]
            derived = " or ".join(_BASE_NAMES.get(base, f"wc.{base.__name__}") for base in bases)
            fact = (
                f"a {_kind_names(kinds)} and no {_kind_names(bases)}"
                if kinds
                else f"no class derived from {derived}"
            )
            raise ValueError(f": {name!r} in {file} is {fact}")
        if issubclass(given, Formula) and (lacking := given.missing_function()):
            arguments = ", ".join(given.arguments())
            raise ValueError(f": {name}.{lacking} in {file} must be a wp.func of ({arguments})")
        return given

    @contextlib.contextmanager
    def named_errors(self) -> Iterator[None]:
        """Converts errors that are raised in one of the files to an ``ExperimentError`` with file and line."""
        try:
            yield
        except Exception as error:
            for name, file in self._files.items():
                line = _line_of(error, file.path)
                if line is not None:
                    problem = f"line {line}: {_sentence(error)}"
                    raise ExperimentError(str(self.folder / name), [problem]) from error
            raise

    def _load(self, name: str) -> UserFile:
        path = self._path_inside(name)
        for loaded in self._files.values():
            if loaded.path == path:  # under another name
                return loaded
        content = self._read(name)
        if is_run_folder(self.folder):
            if not may_run(content, self.trusted):
                raise _untrusted(self.folder, [name])
            if self.trusted is True:
                record_trusted([content])
        self.on_stage(f"loading {self.folder / name}")
        try:
            return UserFile(path, content, _module(path, content))
        except (Exception, SystemExit) as error:
            raise ValueError(f": {_located_error(error, path, name)}") from None

    def _read(self, name: str) -> bytes:
        """Returns the content of a file."""
        path = self._path_inside(name)
        if not path.exists():
            others = sorted(other.name for other in path.parent.glob("*.py"))
            raise ValueError(f": there is no file {name!r}{suggestion(path.name, others)}")
        try:
            return read_file(self.folder / name)
        except IsADirectoryError:
            raise ValueError(f": {name!r} is not a regular file") from None
        except UnsafeFileError as error:
            raise ValueError(f": {name!r} {error.strerror}") from None
        except OSError as error:
            raise ValueError(f": {name!r} cannot be read: {error.strerror or error}") from None

    def _path_inside(self, name: str) -> Path:
        """Returns the path of a file with links resolved, which must be inside of the folder."""
        folder = self.folder.resolve()
        try:
            path = (folder / name).resolve()
        except (OSError, ValueError, RuntimeError) as error:  # for example a loop of links, or a null character
            raise ValueError(f": {name!r} cannot be read: {error}") from None
        parts = Path(name).parts
        if Path(name).is_absolute() or os.pardir in parts or not path.is_relative_to(folder):
            raise ValueError(f" must name a file inside of the folder of the experiment, got {abbreviated(name)}")
        check_length(": the name of a file", path.name)
        return path


def _files_in(raw: Any) -> Iterator[str]:
    """Iterates over the files that an experiment names, as ``FILE.py:CLASS``, at any depth."""
    if isinstance(raw, str):
        name = raw.rpartition(":")[0]
        if name.endswith(".py"):
            yield name
    elif isinstance(raw, Mapping):
        for value in raw.values():
            yield from _files_in(value)
    elif isinstance(raw, list | tuple):
        for value in raw:
            yield from _files_in(value)


def _untrusted(folder: Path, names: list[str]) -> TrustError:
    return TrustError(
        str(folder),
        [
            f"would run {', '.join(names)}, Python code that no run of this user has written there; read it, then "
            "run it with --trust (Python: trust=True)"
        ],
    )


def _kind_names(bases: Iterable[type]) -> str:
    return " or ".join("force element" if base is SceneElement else base.__name__.lower() for base in bases)


def _is_formula(value: object, bases: tuple[type, ...]) -> bool:
    return isinstance(value, type) and issubclass(value, bases)


def _line_of(error: BaseException, path: Path) -> int | None:
    """Returns the line of file ``path`` in which ``error`` was raised; ``None``: it was raised elsewhere."""
    if isinstance(error, SyntaxError) and error.filename == str(path):
        return error.lineno or None  # 0: no particular line
    frames = traceback.walk_tb(error.__traceback__)
    lines = [line for frame, line in frames if frame.f_code.co_filename == str(path)]
    return lines[-1] if lines else None


def _located_error(error: BaseException, path: Path, name: str) -> str:
    """Returns ``my_laws.py, line 7: ZeroDivisionError: division by zero`` for an error in file ``path``."""
    line = _line_of(error, path)
    place = name if line is None else f"{name}, line {line}"
    return f"{place}: {_sentence(error)}"


def _sentence(error: BaseException) -> str:
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def describe_error(error: BaseException, formula: type) -> str:
    """Returns a sentence on an error in a user-defined class, with the line if it was raised in its file."""
    path = Path(str(sys.modules[formula.__module__].__file__))
    return _located_error(error, path, path.name)


def _module(path: Path, content: bytes) -> ModuleType:
    """Executes ``content`` as the module of file ``path``, or returns the module of an earlier execution."""
    if (path, content) not in _MODULES:
        _MODULES[path, content] = _run(path, content)
    return _MODULES[path, content]


def _run(path: Path, content: bytes) -> ModuleType:
    code = compile(content, str(path), "exec", dont_inherit=True)
    module = ModuleType(f"{FILE_MODULE}{next(_NUMBERS)}_{re.sub(r'[^0-9A-Za-z_]', '_', path.stem)}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses and Warp look up the module here
    # Warp reads the source of functions through linecache when they are defined. The entry provides the executed
    # content, even if the file has changed. Without a modification time, linecache does not compare it with the file.
    lines = io.StringIO(importlib.util.decode_source(content)).readlines()
    linecache.cache[str(path)] = (len(content), None, lines, str(path))
    try:
        exec(code, vars(module))
    except BaseException:
        del sys.modules[module.__name__]
        raise
    finally:
        linecache.cache.pop(str(path), None)
    return module
