"""Files of benchmark figures: default paths and format."""

import json
import re
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
#: Entry of ``gpu_ratios.py`` in the file that ``compare.py`` writes.
RATIOS = "ratios_to_bare_query"


def default_path(kind: str, device: str, about: dict[str, Any]) -> Path:
    """Returns the file for figures of a device: ``cpu.json`` or the name of the GPU, with ``kind`` as prefix.

    Args:
        kind: Kind of the measurement; "" for the comparison of engines.
        device: ``"cpu"``, ``"cuda:0"``, …
        about: Facts of the device.
    """
    name = "cpu" if device == "cpu" else re.sub(r"[^a-z0-9]+", "-", str(about["device"]).lower()).strip("-")
    return RESULTS / f"{kind and kind + '-'}{name}.json"


def stored(path: Path, *keys: str) -> dict[str, Any]:
    """Returns the entries of a file of figures, all or those of ``keys``; none if there is no file."""
    report = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return {key: value for key, value in report.items() if not keys or key in keys}


def write(path: Path, report: dict[str, Any]) -> None:
    """Writes figures; floats are rounded to four digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    short = json.loads(json.dumps(report), parse_float=lambda text: float(f"{float(text):.4g}"))
    path.write_text(json.dumps(short, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
