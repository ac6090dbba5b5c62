"""Every Python sample of the README and the docs runs as it stands."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def samples(page):
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


# Those with Python on them.
PAGES = [
    page
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
    if page.is_file() and samples(page)
]


@pytest.mark.skipif(not PAGES, reason="the pages are in a checkout, not in an installed package")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_samples_of_a_page_run_in_order(page, tmp_path):
    script = tmp_path / "sample.py"  # Warp reads the source of kernels from a file
    script.write_text("\n\n".join(samples(page)), encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-W", "error", script], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
