"""Sphinx extension: pages made from files elsewhere in the repository, and links to them.

On a git host, links of pages lead to files, such as ``../examples/pendulum.toml``. On the site they lead to the page
that is made from the file.
"""

import os
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
#: Files of the repository that become pages without changes.
PAGES = {
    "README.md": "project/readme.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
}
LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)#\s]+)")


def page_of(path: Path) -> Path | None:
    """Returns the page of a file or folder of the repository; ``None`` if it has none."""
    if path.is_relative_to(DOCS):
        return path
    inside = path.relative_to(ROOT)
    if inside.as_posix() in PAGES:
        return DOCS / PAGES[inside.as_posix()]
    if inside == Path("examples"):
        return DOCS / "gallery" / "index.md"
    if inside.parent == Path("examples"):
        return DOCS / "gallery" / f"{inside.stem}.md"
    return None


def redirected(text: str, source: Path, page: Path) -> str:
    """Returns the Markdown of ``source`` for ``page``, with links to pages of the site."""

    def target(link: re.Match[str]) -> str:
        path = Path(os.path.normpath(source.parent / link[1]))
        if not path.exists() or not path.is_relative_to(ROOT):
            return link[1]  # Sphinx warns about missing targets
        return Path(os.path.relpath(page_of(path) or path, page.parent)).as_posix()

    return LINK.sub(target, text)


def write(page: Path, text: str) -> None:
    """Writes a page if its text changed, so that Sphinx does not read unchanged pages again."""
    if not page.is_file() or page.read_text(encoding="utf-8") != text:
        page.parent.mkdir(exist_ok=True)
        page.write_text(text, encoding="utf-8")


def write_pages(app: Sphinx) -> None:
    """Writes the pages."""
    for name, page in PAGES.items():
        source = ROOT / name
        write(DOCS / page, redirected(source.read_text(encoding="utf-8"), source, DOCS / page))


def redirect(app: Sphinx, name: str, text: list[str]) -> None:
    """Redirects the links of a page of this folder to pages of the site."""
    page = Path(app.env.doc2path(name))
    if page.suffix == ".md":
        text[0] = redirected(text[0], page, page)


def setup(app: Sphinx) -> dict[str, Any]:
    """Registers the extension with Sphinx."""
    app.connect("builder-inited", write_pages)
    app.connect("source-read", redirect)
    return {"parallel_read_safe": True}
