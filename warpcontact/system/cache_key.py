"""Computes a key of Warp's kernel cache: a text that changes if kernels must be compiled again.

The first part identifies the machine and the compiler, the second part the source code. A cache with an equal first
part is still useful, because Warp compiles only the modules that changed.
"""

import contextlib
import hashlib
import json
import platform
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import warp as wp

from warpcontact import kernels
from warpcontact._version import __version__
from warpcontact.files.run_folder import read_file
from warpcontact.kernels.lowlevel import switches, unique_kernel
from warpcontact.system.devices import find_devices

HOST = Path(__file__).parents[1]
KERNELS = Path(kernels.__file__).parent

# Host modules with this text determine which kernels a model uses.
_USES_KERNELS = b"warpcontact.kernels"
# Reference to a class in a user file, such as "my_laws.py:Cubic".
_USER_FILE = re.compile(r"[\"']([^\"'\n]+\.py):\w+[\"']")
# Number of hexadecimal digits of each part.
_LENGTH = 16


def cache_key(
    device: str | Sequence[str], files: Iterable[Path] = (), *, host: Path = HOST, kernels: Path = KERNELS
) -> str:
    """Returns the key of the compiled kernels on this machine, such as ``warpcontact-<16 digits>-<16 digits>``.

    Args:
        device: Device or devices, as for ``Scene.build``.
        files: Experiment files. Their content is part of the key, and that of the Python files that they name.
        host: Folder of the package.
        kernels: Folder of its kernels.

    Raises:
        ValueError: If a device does not exist.
        OSError: If a file cannot be read.
    """
    return f"warpcontact-{_digest(machine_facts(device))}-{_digest(_sources(host, kernels, files))}"


def machine_facts(device: str | Sequence[str]) -> dict[str, Any]:
    """Returns everything except the source code that determines the compiled code."""
    gpus = wp.get_cuda_devices()
    used = [one for one in find_devices(device) if one.is_cuda]
    return {
        "warp": wp.config.version,
        "python": sys.version_info[:2],
        "system": platform.system(),
        "machine": platform.machine(),
        "processor": _processor(),
        # With a GPU, Warp compiles kernels for the CPU under other names.
        "gpu": bool(gpus),
        "architectures": sorted({int(one.arch) for one in used}),
        "options": unique_kernel.OPTIONS,
        "quick options": unique_kernel.QUICK_OPTIONS,
        "disabled": sorted(switches.DISABLED),
        "mode": wp.config.mode,
    }


def _sources(host: Path, kernels: Path, files: Iterable[Path]) -> list[Any]:
    """Returns the version and the hashes of all files that determine which kernels are compiled."""
    own = [path for path in _python_files(host) if kernels not in path.parents]
    parts: list[Any] = [__version__]
    parts += [_entry(path.relative_to(kernels), path.read_bytes()) for path in _python_files(kernels)]
    for path in own:
        content = path.read_bytes()
        if _USES_KERNELS in content:
            parts.append(_entry(path.relative_to(host), content))
    for file in files:
        content = read_file(file)
        parts.append(_entry(Path(file.name), content))
        for name in sorted(set(_USER_FILE.findall(content.decode("utf-8", errors="replace")))):
            with contextlib.suppress(FileNotFoundError, NotADirectoryError, IsADirectoryError, ValueError):
                parts.append(_entry(Path(name), read_file(file.parent / name)))
    return parts


def _python_files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.py"))


def _entry(name: Path, content: bytes) -> tuple[str, str]:
    """Returns the name of a file and the hash of its content."""
    return name.as_posix(), hashlib.sha256(content).hexdigest()


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:_LENGTH]


def _processor() -> list[str]:
    """Returns model and features of the processor, because kernels are compiled for it (-march=native)."""
    info = Path("/proc/cpuinfo")
    if not info.is_file():
        return [platform.processor()]
    found = re.findall(
        r"^(?:model name|flags|Features)\s*:\s*(.*)$",
        info.read_text(encoding="utf-8", errors="replace"),
        re.MULTILINE,
    )
    return sorted(set(found))
