"""HTML made of texts from anywhere: whatever they hold, a reader sees them as text."""

import html
import json
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

from warpcontact.validation.safe_text import truncate

#: Longer texts are shortened; the whole is in their title, up to ``TITLE`` characters.
SHORT = 60
TITLE = 500

# What has no look of its own, or ends a document: controls but tab and line feed, surrogates, non-characters.
_UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")

# Elements without content, and without an end.
_VOID = ("br", "input", "link", "meta")


class Markup(str):
    """HTML that is sound; any other text is escaped where it is put into a page."""

    __slots__ = ()


def clean(value: Any) -> str:
    """Returns ``value`` as text without characters that no page may hold."""
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
        tag: Its name.
        content: What is in it, one after the other; ``None`` is left out.
        attributes: ``None`` and ``False`` are left out, ``True`` has no value; ``_`` is written ``-``, and left
            out at the end, as in ``class_``.
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
    """Returns parts one after the other."""
    return Markup("".join(map(escaped, parts)))


def name(value: Any, most: int = SHORT) -> Markup:
    """Returns a name of the user's: shortened, and without effect on the direction of what is beside it."""
    text = clean(value)
    title = short(text, TITLE) if len(text) > most else None
    return element("bdi", short(text, most), title=title)


def table(head: Sequence[Any], rows: Iterable[Sequence[Any]], numbers: Iterable[int] = (), **more: Any) -> Markup:
    """Returns a table that scrolls within its place.

    Args:
        head: Names of the columns.
        rows: Cells.
        numbers: Which columns hold numbers.
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
    whole = element("table", element("thead", line("th", head)), element("tbody", body), **more)
    return element("div", whole, class_="scroll", tabindex="0", role="region", aria_label="table")


def data_block(key: str, content: Any) -> Markup:
    """Returns a block of data that scripts of the page read, and nothing executes.

    Args:
        key: Its id.
        content: Texts, numbers, lists and tables; numbers that are not finite become null.
    """
    text = json.dumps(_plain(content), separators=(",", ":"), allow_nan=False)
    # ASCII by now, so that U+2028 is escaped, too; what could end the element or begin a comment is not.
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
