"""HTML page of the report, with a content security policy that allows only its own script and style."""

import base64
import hashlib
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

from warpcontact._version import __version__
from warpcontact.visualize.report import chart
from warpcontact.visualize.report.markup import Markup, data_block, element, joined, name, short

#: Files next to this module: the script built from ``web/``, and the style sheet.
SCRIPT = "page.js"
STYLE = "page.css"


@dataclass(frozen=True)
class Section:
    """Section of the page.

    Attributes:
        key: Anchor for links.
        title: Title.
        content: HTML content.
    """

    key: str
    title: str
    content: Markup


@dataclass
class Page:
    """HTML page.

    Attributes:
        title: Title.
        head: Content below the title.
        sections: Sections of the page.
        data: Content of the data blocks for the script, by name.
    """

    title: str
    head: Markup
    sections: list[Section] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)

    def html(self) -> str:
        """Returns the complete file content."""
        script, style = asset(SCRIPT), asset(STYLE)
        policy = (
            f"default-src 'none'; script-src '{_sha(script)}'; style-src '{_sha(style)}'; img-src data:; "
            "base-uri 'none'; form-action 'none'"
        )
        head = joined(
            [
                element("meta", charset="utf-8"),
                element("meta", http_equiv="Content-Security-Policy", content=policy),
                element("meta", name="viewport", content="width=device-width, initial-scale=1"),
                element("meta", name="color-scheme", content="light dark"),
                element("meta", name="generator", content=f"warpcontact {__version__}"),
                element("meta", name="referrer", content="no-referrer"),
                element("title", f"{short(self.title, 80)} – warpcontact"),
                element("link", rel="icon", href="data:,"),
                Markup(f"<style>{style}</style>"),
            ]
        )
        blocks = joined(data_block(f"data-{key}", content) for key, content in self.data.items())
        body = element("body", self._body(), blocks, Markup(f"<script>{script}</script>"))
        return f"<!DOCTYPE html>\n{element('html', element('head', head), body, lang='en')}\n"

    def _body(self) -> Markup:
        links = [element("a", one.title, href=f"#{one.key}") for one in self.sections]
        theme = element(
            "button",
            "Dark",
            id="theme",
            type="button",
            class_="quiet",
            aria_pressed="false",
            title="Light or dark",
        )
        header = element(
            "header",
            element("div", element("h1", name(self.title, 80)), theme, class_="title"),
            self.head,
            element("nav", joined(links), aria_label="Sections"),
        )
        parts = [element("section", element("h2", one.title), one.content, id=one.key) for one in self.sections]
        footer = element(
            "footer",
            f"Created by warpcontact {__version__}. Drawn with three.js, © three.js authors, MIT License.",
        )
        return joined([chart.definitions(), header, element("main", joined(parts)), footer])


def asset(file: str) -> str:
    """Returns the text of a file of the page."""
    return resources.files(__package__).joinpath(file).read_text(encoding="utf-8")


def _sha(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
