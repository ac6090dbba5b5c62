"""Sphinx extension: the tree of pages, from the lists of links in ``index.md``, one part per heading."""

import re
from typing import Any

from sphinx.application import Sphinx

PART = re.compile(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"^- \[([^\]]+)\]\(([^)]+)\.(?:md|rst)\)", re.MULTILINE)


def add_tree(app: Sphinx, name: str, text: list[str]) -> None:
    """Adds a tree of the listed pages to each part of the first page."""
    if name == app.config.root_doc:
        text[0] = PART.sub(lambda part: part[0].rstrip() + "\n\n" + tree(part[1], part[2]) + "\n", text[0])


def tree(title: str, entries: str) -> str:
    """Returns the tree of one part as a directive."""
    pages = "\n".join(f"{title} <{page}>" for title, page in ENTRY.findall(entries))
    return f"```{{toctree}}\n:hidden:\n:caption: {title}\n\n{pages}\n```\n"


def setup(app: Sphinx) -> dict[str, Any]:
    """Registers the extension with Sphinx."""
    app.connect("source-read", add_tree, priority=600)  # after links have been redirected
    return {"parallel_read_safe": True}
