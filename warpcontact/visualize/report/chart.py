"""Charts as static SVG elements; colors are defined in the style sheet of the page."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array
from warpcontact.validation.number_format import NOTHING, number, scaled
from warpcontact.visualize.report.markup import Markup, element, joined

WIDTH, HEIGHT = 360, 200
LEFT, RIGHT, TOP, BOTTOM = 50, 12, 10, 36


@dataclass
class Axis:
    """Axis of a chart, which maps values to positions.

    Args:
        low: Smallest value.
        high: Largest value.
        unit: Unit of the values, ``"-"``: none.
        first: Position of the smallest value.
        last: Position of the largest value.
        wanted: Approximate number of ticks.
        whole: Whether to place ticks at integers only.
    """

    low: float
    high: float
    unit: str
    first: float
    last: float
    wanted: int = 6
    whole: bool = False
    factor: float = field(init=False)
    label: str = field(init=False)

    def __post_init__(self) -> None:
        if not self.high - self.low > NOTHING:
            margin = abs(self.low) * 0.05 or 0.5
            self.low, self.high = self.low - margin, self.high + margin
        self.factor, self.label = scaled(self.unit, max(abs(self.low), abs(self.high)))

    def place(self, values: Array) -> Array:
        """Returns the positions of values."""
        return self.first + (np.asarray(values, dtype=np.float64) - self.low) / (self.high - self.low) * (
            self.last - self.first
        )

    def marks(self) -> list[tuple[float, str]]:
        """Returns the ticks as (position, label)."""
        low, high = self.low * self.factor, self.high * self.factor
        rough = (high - low) / self.wanted
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(power * n for n in (1.0, 2.0, 5.0, 10.0) if power * n >= rough * (1.0 - 1.0e-9))
        if self.whole:
            step = max(1.0, math.ceil(step))
        first, last = math.ceil(low / step - 1.0e-9), math.floor(high / step + 1.0e-9)
        values = [n * step for n in range(first, last + 1)]
        digits = max(4, math.ceil(math.log10(max(map(abs, values), default=1.0) / step + 1.0)) + 1)
        return [
            (float(self.place(np.array(value / self.factor))), number(0.0 if value == 0.0 else value, digits))
            for value in values
        ]


def horizontal(low: float, high: float, unit: str, *, whole: bool = False) -> Axis:
    """Returns an axis along the bottom of a chart."""
    return Axis(low, high, unit, LEFT, WIDTH - RIGHT, whole=whole)


def vertical(low: float, high: float, unit: str, *, whole: bool = False) -> Axis:
    """Returns an axis along the left of a chart."""
    return Axis(low, high, unit, HEIGHT - BOTTOM, TOP, whole=whole)


def chart(x: Axis, y: Axis, marks: Sequence[Markup], about: str, x_name: str, **attributes: object) -> Markup:
    """Returns a chart.

    Args:
        x: Horizontal axis.
        y: Vertical axis.
        marks: Elements drawn in the plot.
        about: Text alternative for screen readers.
        x_name: Quantity on the horizontal axis.
        attributes: Attributes of the SVG element.
    """
    parts: list[Markup] = []
    for place, text in y.marks():
        parts.append(_line(LEFT, place, WIDTH - RIGHT, place, "grid"))
        parts.append(_text(LEFT - 6, place + 3.5, text, "tick end"))
    floor = HEIGHT - BOTTOM
    for place, text in x.marks():
        parts.append(_line(place, floor, place, floor + 4, "axis"))
        parts.append(_text(place, floor + 15, text, "tick middle"))
    parts.append(_line(LEFT, floor, WIDTH - RIGHT, floor, "axis"))
    label = f"{x_name} [{x.label}]" if x.label else x_name
    parts.append(_text(0.5 * (LEFT + WIDTH - RIGHT), HEIGHT - 4, label, "label middle"))
    return element(
        "svg",
        joined(parts),
        element("g", joined(marks), class_="marks", clip_path="url(#plot)"),
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        aria_label=about,
        **attributes,
    )


def polyline(x: Array, y: Array, style: str, **attributes: object) -> Markup:
    """Returns a line through points, with gaps at NaN."""
    return element("path", d=_path(x, y), class_=style, **attributes)


def band(x: Array, low: Array, high: Array, style: str) -> Markup:
    """Returns the area between two lines, where both are finite."""
    parts = []
    for run in _runs(np.isfinite(low) & np.isfinite(high)):
        outline = np.concatenate([x[run], x[run][::-1]])
        parts.append(_path(outline, np.concatenate([low[run], high[run][::-1]])) + "Z")
    return element("path", d="".join(parts), class_=style)


def rectangle(left: float, top: float, right: float, bottom: float, style: str, title: str) -> Markup:
    """Returns a rectangle with a title, shown as tooltip."""
    return element(
        "rect",
        element("title", title),
        x=_at(left),
        y=_at(top),
        width=_at(max(0.0, right - left)),
        height=_at(max(0.0, bottom - top)),
        class_=style,
    )


def rule(place: float, style: str) -> Markup:
    """Returns a vertical line through the plot."""
    return _line(place, TOP, place, HEIGHT - BOTTOM, style)


def dots(x: Array, y: Array, style: str) -> Markup:
    """Returns a dot at each point."""
    # Zero-length lines with round caps, the shortest notation.
    places = "".join(f"M{_at(a)} {_at(b)}h0" for a, b in zip(x, y, strict=True))
    return element("path", d=places, class_=style)


def _path(x: Array, y: Array) -> str:
    parts = []
    for some in _runs(np.isfinite(x) & np.isfinite(y)):
        points = " ".join(f"{_at(a)} {_at(b)}" for a, b in zip(x[some], y[some], strict=True))
        parts.append(f"M{points}")
    return "".join(parts)


def _runs(good: NDArray[np.bool_]) -> list[slice]:
    """Returns the slices of consecutive true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _line(x1: float, y1: float, x2: float, y2: float, style: str) -> Markup:
    return element("line", x1=_at(x1), y1=_at(y1), x2=_at(x2), y2=_at(y2), class_=style)


def _text(x: float, y: float, text: str, style: str) -> Markup:
    return element("text", text, x=_at(x), y=_at(y), class_=style)


def _at(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def definitions() -> Markup:
    """Returns the clip path that charts refer to; needed once per page."""
    plot = element("rect", x=LEFT, y=TOP - 2, width=WIDTH - RIGHT - LEFT, height=HEIGHT - BOTTOM - TOP + 2)
    clip = element("clipPath", plot, id="plot")
    return element("svg", clip, class_="definitions", width=0, height=0, aria_hidden="true")
