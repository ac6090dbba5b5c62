"""HTML elements with escaped content: text from any source is displayed as text."""

import html
import json
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

from warpcontact.validation.safe_text import truncate

#: Longer texts are shortened; the title then contains up to ``TITLE`` characters.
SHORT = 60
TITLE = 500

# Characters not allowed in HTML: controls except tab and line feed, surrogates, noncharacters.
_UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")

# Elements without content and end tag.
_VOID = ("br", "input", "link", "meta")


class Markup(str):
    """Valid HTML; other text is escaped when it is inserted into a page."""

    __slots__ = ()


def clean(value: Any) -> str:
    """Returns ``value`` as text, with characters that HTML does not allow replaced."""
    return _UNSEEN.sub("\ufffd", str(value))


def escaped(value: Any) -> Markup:
    """Returns ``value`` as HTML."""
    return value if isinstance(value, Markup) else Markup(html.escape(clean(value)))


def short(value: Any, most: int = SHORT) -> str:
    """Returns ``value`` as text of at most ``most`` characters."""
    return truncate(clean(value), most)


def element(tag: str, *content: Any, **attributes: Any) -> Markup:
    """Returns an element.

    Args:
        tag: Tag name.
        content: Content parts; ``None`` is skipped.
        attributes: Attributes. ``None`` and ``False`` are skipped, ``True`` has no value. ``_`` is written as ``-``; a
            trailing one, as in ``class_``, is removed.
    """
    words = [tag]
    for key, value in attributes.items():
        name = key.rstrip("_").replace("_", "-")
        if value is True:
            words.append(name)
        elif value is not None and value is not False:
            words.append(f'{name}="{escaped(value)}"')
    if tag in _VOID:
        return Markup(f"<{' '.join(words)}>")
    inner = "".join(escaped(part) for part in content if part is not None)
    return Markup(f"<{' '.join(words)}>{inner}</{tag}>")


def joined(parts: Iterable[Any]) -> Markup:
    """Returns parts concatenated."""
    return Markup("".join(map(escaped, parts)))


def name(value: Any, most: int = SHORT) -> Markup:
    """Returns a user's name, shortened and isolated, so that its text direction does not affect its surroundings."""
    text = clean(value)
    title = short(text, TITLE) if len(text) > most else None
    return element("bdi", short(text, most), title=title)


def table(head: Sequence[Any], rows: Iterable[Sequence[Any]], numbers: Iterable[int] = (), **more: Any) -> Markup:
    """Returns a table in a scrollable container.

    Args:
        head: Column titles.
        rows: Cells.
        numbers: Indices of numeric columns, which are right-aligned.
        more: Attributes of the table.
    """
    right = set(numbers)

    def line(tag: str, cells: Sequence[Any]) -> Markup:
        attributes: dict[str, Any] = {"scope": "col"} if tag == "th" else {}
        return element(
            "tr",
            *(element(tag, c, class_="number" if i in right else None, **attributes) for i, c in enumerate(cells)),
        )

    body = joined(line("td", row) for row in rows)
    content = element("table", element("thead", line("th", head)), element("tbody", body), **more)
    return element("div", content, class_="scroll", tabindex="0", role="region", aria_label="table")


def data_block(key: str, content: Any) -> Markup:
    """Returns a JSON block that scripts of the page read and that is never executed.

    Args:
        key: Id of the element.
        content: Texts, numbers, lists and dictionaries; non-finite numbers become null.
    """
    text = json.dumps(_plain(content), separators=(",", ":"), allow_nan=False)
    # ``dumps`` escapes non-ASCII characters such as U+2028, but not those that could end the element.
    text = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return Markup(f'<script type="application/json" id="{escaped(key)}">{text}</script>')


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str):
        return clean(value)
    if isinstance(value, dict):
        return {clean(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value
