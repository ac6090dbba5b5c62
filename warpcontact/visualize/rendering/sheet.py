"""Layout of several panels in one picture, and labels."""

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.drawing.colors import Scale
from warpcontact.validation import safe_text

Place = tuple[int, int, int, int]

# Space between panels [pixels], and its color.
GAP = 3
GAP_COLOR = (255, 255, 255)
# Preferred ratio of panel width to height.
_SHAPE = 1.4
# Letter height as a fraction of the picture height; preferred minimum and readable minimum [pixels].
_LETTERS, _SMALLEST, _READABLE = 0.034, 13, 7
# Largest width of a text, as a fraction of the panel width.
_WIDEST = 0.45
# Largest number of letters in the name of a color scale.
_LONGEST = 24


def places(count: int, width: int, height: int) -> list[Place]:
    """Returns equally sized panels of a picture, row by row: left, top, right, bottom [pixels].

    Raises:
        ValueError: If they do not fit.
    """

    def side(total: int, parts: int) -> int:
        return (total - GAP * (parts - 1)) // parts

    def mismatch(columns: int) -> float:
        rows = math.ceil(count / columns)
        wide, high = side(width, columns), side(height, rows)
        if wide < 16 or high < 16:
            return math.inf
        # Empty cells are penalized as well.
        return abs(math.log(wide / high / _SHAPE)) + 0.3 * (rows * columns - count) / count

    columns = min(range(1, count + 1), key=mismatch)
    rows = math.ceil(count / columns)
    wide, high = side(width, columns), side(height, rows)
    if mismatch(columns) == math.inf:
        raise ValueError(
            f"size must be sufficient for {count} panels, got {width} × {height} pixels; "
            "together=True draws all environments in one panel"
        )
    # Center the panels in the picture.
    left = (width - columns * wide - GAP * (columns - 1)) // 2
    top = (height - rows * high - GAP * (rows - 1)) // 2
    corners = [divmod(panel, columns) for panel in range(count)]
    starts = [(left + column * (wide + GAP), top + row * (high + GAP)) for row, column in corners]
    return [(x, y, x + wide, y + high) for x, y in starts]


def write(picture: NDArray[np.uint8], panels: list[Place], texts: list[str], last: str) -> None:
    """Writes a text into the upper left corner of each panel, and ``last`` into the lower left of the first.

    Nothing is written if the letters would be too small to read.
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
    """Draws the color scale in the upper right corner, with its lowest and highest number."""
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
    """Returns the letter height at which each of the texts fits into a panel [pixels]."""
    left, top, right, bottom = panel
    wanted = max(_SMALLEST, round(_LETTERS * min(bottom - top, right - left)))
    longest = max(_font(wanted).getlength(text) for text in texts)
    return int(wanted * min(1.0, _WIDEST * (right - left) / max(longest, 1.0)))


def _ink(picture: NDArray[np.uint8], left: int, top: int, letters: int) -> tuple[int, int, int]:
    """Returns a dark or light color, whichever has more contrast with the picture at a position."""
    under = picture[max(top, 0) : top + 2 * letters, max(left, 0) : left + 8 * letters]
    return (25, 28, 32) if under.mean() > 110.0 else (240, 242, 245)


@functools.cache
def _font(letters: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(letters)
