"""Every Python sample of the README and the docs runs as written, and prints the numbers that its comments state."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def samples(page):
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


# Pages with Python code.
PAGES = [
    page
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
    if page.is_file() and samples(page)
]


# Pages of one group share a process and its startup.
GROUPS = [PAGES[first::4] for first in range(4)]
RUN = "import runpy, sys\nfor page in sys.argv[1:]: runpy.run_path(page, run_name='__main__')"
# Results that a comment after ``print`` states: numbers and arrays of numbers.
RESULT = re.compile(r"^( *)print\((.*)\)  # ([-+\[\]\d .e]+)$", re.MULTILINE)
VERIFY = """
def _verify(expected, *values):
    import math
    printed = " ".join(str(value) for value in values)
    print(printed)
    found, stated = ([float(x) for x in text.replace("[", " ").replace("]", " ").split()] for text in (printed, expected))
    same = len(found) == len(stated) and all(
        math.isclose(x, y, rel_tol=1e-6, abs_tol=1e-9) for x, y in zip(found, stated)
    )
    assert same, f"prints {printed}, not {expected}"
"""


@pytest.mark.skipif(not PAGES, reason="the pages are in a checkout, not in an installed package")
@pytest.mark.parametrize("pages", GROUPS, ids=lambda pages: " ".join(page.stem for page in pages))
def test_documentation_samples_run_in_page_order(pages, tmp_path):
    scripts = []
    for page in pages:
        script = tmp_path / f"{page.stem}.py"  # Warp reads the source of kernels from a file
        text = RESULT.sub(r"\1_verify('\3', \2)", "\n\n".join(samples(page)))
        script.write_text(VERIFY + text, encoding="utf-8")
        scripts.append(script)
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", RUN, *scripts],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
