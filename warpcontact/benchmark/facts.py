"""Facts on which measured speeds depend besides the code: device, driver, cores, versions, date."""

import datetime
import platform
import re
import subprocess
from importlib import metadata
from pathlib import Path

from warpcontact._version import __version__
from warpcontact.system.resources import available_threads


def facts(device: str, threads: int) -> dict[str, str | int]:
    """Returns the facts on which a speed measured on a device depends.

    Args:
        device: ``"cpu"``, ``"cuda:0"``, …
        threads: Number of threads of the measured program.
    """
    found: dict[str, str | int] = {
        "device": processor(),
        "system": f"{platform.system()} {platform.machine()}",
        "cores": available_threads(),
        "threads": threads,
        "date": datetime.date.today().isoformat(),
    }
    if device.startswith("cuda"):
        found |= {**_gpu(device), "processor": found["device"]}
    return found


def versions() -> dict[str, str]:
    """Returns the versions of Python and the packages used."""
    return {
        "python": platform.python_version(),
        "warpcontact": __version__,
        **{name: metadata.version(name) for name in ("warp-lang", "numpy")},
    }


def processor() -> str:
    """Returns the name of the processor."""
    info = Path("/proc/cpuinfo")
    match = (
        re.search(r"^model name\s*:\s*(.+)$", info.read_text(encoding="utf-8", errors="replace"), re.MULTILINE)
        if info.is_file()
        else None
    )
    return match[1] if match else platform.processor() or platform.machine()


def _gpu(device: str) -> dict[str, str]:
    """Returns the name of a GPU, and its driver version if nvidia-smi reports it."""
    import warp as wp

    gpu = wp.get_device(device)
    query = "nvidia-smi --query-gpu=driver_version --format=csv,noheader"
    try:
        answer = subprocess.run(
            query.split(), capture_output=True, encoding="utf-8", check=True, timeout=30
        ).stdout
    except (OSError, subprocess.SubprocessError):  # nvidia-smi is missing, as on some boards
        return {"device": gpu.name}
    # One line per GPU, with the same driver.
    return {"device": gpu.name, "driver": answer.split()[0]}
