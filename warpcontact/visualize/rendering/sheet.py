"""Several panels in one picture, and what is written into it."""

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.drawing.colors import Scale
from warpcontact.validation import safe_text

Place = tuple[int, int, int, int]

# Between panels [pixels], and its colour.
GAP = 3
GAP_COLOR = (255, 255, 255)
# Width by height that panels come as close to as they can.
_SHAPE = 1.4
# Height of letters, by that of a picture; their least height where there is room, and what can be read [pixels].
_LETTERS, _SMALLEST, _READABLE = 0.034, 13, 7
# Texts take at most this part of the width of a panel.
_WIDEST = 0.45
# Letters of the name of a scale.
_LONGEST = 24


def places(count: int, width: int, height: int) -> list[Place]:
    """Returns where panels of one size are in a picture, row by row: left, top, right, bottom [pixels].

    Raises:
        ValueError: If they do not fit.
    """

    def side(total: int, parts: int) -> int:
        return (total - GAP * (parts - 1)) // parts

    def unlike(columns: int) -> float:
        rows = math.ceil(count / columns)
        wide, high = side(width, columns), side(height, rows)
        if wide < 16 or high < 16:
            return math.inf
        # Panels that stay empty count as well.
        return abs(math.log(wide / high / _SHAPE)) + 0.3 * (rows * columns - count) / count

    columns = min(range(1, count + 1), key=unlike)
    rows = math.ceil(count / columns)
    wide, high = side(width, columns), side(height, rows)
    if unlike(columns) == math.inf:
        raise ValueError(
            f"size must have room for panels of {count} environments, got {width} × {height} pixels; "
            "together shows them in one"
        )
    # What does not divide is shared by both borders.
    left = (width - columns * wide - GAP * (columns - 1)) // 2
    top = (height - rows * high - GAP * (rows - 1)) // 2
    corners = [divmod(panel, columns) for panel in range(count)]
    starts = [(left + column * (wide + GAP), top + row * (high + GAP)) for row, column in corners]
    return [(x, y, x + wide, y + high) for x, y in starts]


def write(picture: NDArray[np.uint8], panels: list[Place], texts: list[str], last: str) -> None:
    """Writes a text into the upper left corner of each panel, and ``last`` into the lower left of the first.

    Panels without room for what can be read have none.
    """
    from PIL import Image, ImageDraw

    if not any(texts) and not last:
        return
    letters = _letters(panels[0], [*texts, last])
    if letters < _READABLE:
        return
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for (left, top, _, bottom), text in zip(panels, texts, strict=True):
        edge = letters // 2
        ink = _ink(picture, left, top, letters)
        draw.text((left + edge, top + edge), text, fill=ink, font=_font(letters))
        if last:
            ink = _ink(picture, left, bottom - 2 * letters, letters)
            draw.text((left + edge, bottom - edge), last, fill=ink, font=_font(letters), anchor="ls")
            last = ""
    picture[:] = np.asarray(image)


def write_scale(picture: NDArray[np.uint8], name: str, scale: Scale) -> None:
    """Draws the scale of colours in the upper right corner: from the lowest to the highest number."""
    from PIL import Image, ImageDraw

    height, width = picture.shape[:2]
    low, high = (scale.low, scale.high) if scale.low <= scale.high else (math.nan, math.nan)
    name, ends = (
        safe_text.truncate(safe_text.single_line(name), _LONGEST, middle=True),
        (f"{low:.3g}", f"{high:.3g}"),
    )
    letters = _letters((0, 0, width, height), [name, "  ".join(ends)])
    if letters < _READABLE:
        return
    font = _font(letters)
    long = max(width // 5, math.ceil(font.getlength("  ".join(ends))))
    thick, edge = max(letters // 2, 4), letters
    right, top = width - edge, edge // 2
    ink = _ink(picture, right - long, top, letters)
    bar = Scale(0.0, 1.0).colors(np.linspace(0.0, 1.0, long))
    below = top + int(1.5 * letters)
    picture[below : below + thick, right - long : right] = (255.0 * bar + 0.5).astype(np.uint8)
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    draw.text((right, top), name, fill=ink, font=font, anchor="ra")
    draw.text((right - long, below + thick + edge // 4), ends[0], fill=ink, font=font)
    draw.text((right, below + thick + edge // 4), ends[1], fill=ink, font=font, anchor="ra")
    picture[:] = np.asarray(image)


def _letters(panel: Place, texts: list[str]) -> int:
    """Returns how high letters are, so that there is room for each of these texts in a panel [pixels]."""
    left, top, right, bottom = panel
    wanted = max(_SMALLEST, round(_LETTERS * min(bottom - top, right - left)))
    longest = max(_font(wanted).getlength(text) for text in texts)
    return int(wanted * min(1.0, _WIDEST * (right - left) / max(longest, 1.0)))


def _ink(picture: NDArray[np.uint8], left: int, top: int, letters: int) -> tuple[int, int, int]:
    """Returns black or white, what is easier to read on a place of a picture."""
    under = picture[max(top, 0) : top + 2 * letters, max(left, 0) : left + 8 * letters]
    return (25, 28, 32) if under.mean() > 110.0 else (240, 242, 245)


@functools.cache
def _font(letters: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(letters)
