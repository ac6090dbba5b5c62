"""What figures depend on besides the code: device, driver, cores, date."""

import datetime
import os
import platform
import re
import subprocess
from pathlib import Path


def facts(device: str, threads: int) -> dict[str, str | int]:
    """Returns what a figure measured on a device depends on."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    found: dict[str, str | int] = {
        "device": processor(),
        "system": f"{platform.system()} {platform.machine()}",
        "cores": cores,
        "threads": threads,
        "date": datetime.date.today().isoformat(),
    }
    if device.startswith("cuda"):
        query = f"nvidia-smi --query-gpu=name,driver_version --format=csv,noheader --id={device[5:] or 0}"
        answer = subprocess.run(query.split(), capture_output=True, text=True, check=True).stdout
        name, driver = answer.strip().split(", ")
        found |= {"device": name, "driver": driver, "processor": found["device"]}
    return found


def processor() -> str:
    """Returns the name of the processor."""
    info = Path("/proc/cpuinfo")
    match = re.search(r"^model name\s*:\s*(.+)$", info.read_text(), re.MULTILINE) if info.is_file() else None
    return match[1] if match else platform.processor()


def file_name(device: str, name: str) -> str:
    """Returns the name of the file of results: ``cpu``, or the name of the GPU."""
    return f"{'cpu' if device == 'cpu' else re.sub(r'[^a-z0-9]+', '-', name.lower()).strip('-')}.json"
