"""Prints the lowest version of each dependency that pyproject.toml declares, as constraints of pip."""

import re
import tomllib
from pathlib import Path

project = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]
extras = project["optional-dependencies"].values()
for declared in dict.fromkeys([*project["dependencies"], *(one for extra in extras for one in extra)]):
    if declared.startswith(f"{project['name']}["):  # other extras of the project
        continue
    found = re.fullmatch(r"([\w.-]+)>=([\w.]+)(,<[\w.]+)?( *;.*)?", declared)
    if found is None:
        raise SystemExit(f"pyproject.toml: a dependency must be NAME>=LOWEST, got {declared!r}")
    print(f"{found[1]}=={found[2]}{found[4] or ''}")
