"""Python interpreters of the engines: one virtual environment each, created on first use."""

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path

REQUIREMENTS = Path(__file__).parent / "requirements"
CACHE = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "warpcontact" / "benchmarks"


def interpreter(file: str, cache: Path = CACHE) -> Path:
    """Returns the interpreter of an engine.

    Args:
        file: Name of the engine's module and of its list of requirements. An engine without a list runs in the
            current interpreter.
        cache: Folder of the virtual environments.
    """
    requirements = REQUIREMENTS / f"{file}.txt"
    if not requirements.is_file():
        return Path(sys.executable)
    kind = f"{sys.version_info.major}.{sys.version_info.minor}\n".encode() + requirements.read_bytes()
    folder = cache / f"{file}-{hashlib.sha256(kind).hexdigest()[:12]}"
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    complete = folder / "complete"
    if not complete.is_file():
        print(f"installing {' '.join(requirements.read_text().split())} into {folder}", file=sys.stderr)
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([python, "-m", "pip", "install", "-qq", "-r", requirements], check=True)
        complete.touch()
    return python
