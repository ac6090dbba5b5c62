"""Report section of the replay: canvas, controls and legend, filled by ``web/src/replay.js``."""

from warpcontact.visualize.report.markup import Markup, element, joined
from warpcontact.visualize.report.replay import Replay

# Keys and their functions.
KEYS = (
    ("Space", "play or pause"),
    ("← →", "previous or next record; with Shift 10 records"),
    ("Home End", "first or last record"),
    ("[ ]", "previous or next environment"),
    ("0–9", "environment of this number"),
    ("+ −", "faster or slower"),
    ("A", "arrows of forces"),
    ("G", "contact points, colored by gap"),
    ("F", "fit the view"),
    ("?", "this help"),
)


def section(replay: Replay) -> Markup:
    """Returns the section of the page."""
    notes = joined(element("p", note, class_="note") for note in replay.notes)
    if not replay.packs:
        return notes
    stage = element(
        "div",
        element("canvas", id="replay-canvas", tabindex="0", role="img", aria_label="Replay of the environment"),
        element("div", id="replay-message", class_="message", role="alert", hidden=True),
        _legend(),
        element("div", id="replay-clock", class_="clock", aria_hidden="true"),
        id="replay-stage",
        class_="stage",
    )
    script = element("noscript", element("p", "The replay needs JavaScript and WebGL.", class_="note"))
    return joined(
        [script, element("div", stage, _controls(), id="replay-viewer", class_="viewer"), notes, _help()]
    )


def _controls() -> Markup:
    time = element(
        "div",
        _button("replay-play", "Play", "Play or pause (Space)"),
        element(
            "input", id="replay-time", type="range", min="0", max="1", step="any", value="0", aria_label="Time"
        ),
        element("output", id="replay-time-text", for_="replay-time"),
        class_="row",
    )
    options = element(
        "div",
        element(
            "span",
            element("label", "Environment", for_="replay-env"),
            _button("replay-before", "‹", "Previous environment ([)"),
            element("select", id="replay-env"),
            _button("replay-after", "›", "Next environment (])"),
            class_="group",
        ),
        element(
            "span",
            element("label", "Speed", for_="replay-speed"),
            element("select", id="replay-speed"),
            class_="group",
        ),
        _switch("replay-arrows", "Forces"),
        _switch("replay-gaps", "Gaps"),
        _button("replay-fit", "Fit", "Fit the view (F)"),
        _button("replay-keys", "?", "Keys (?)"),
        class_="row options",
    )
    return element("div", time, options, class_="controls", role="group", aria_label="Controls of the replay")


def _legend() -> Markup:
    bar = element(
        "div",
        element("span", id="legend-low"),
        element("span", id="legend-bar", class_="bar", aria_hidden="true"),
        element("span", id="legend-high"),
        class_="scale",
    )
    return element(
        "div",
        element("div", "gap", bar, id="legend-gap", hidden=True),
        element("div", id="legend-force", hidden=True),
        id="replay-legend",
        class_="legend",
    )


def _help() -> Markup:
    keys = joined(element("div", element("dt", key), element("dd", what)) for key, what in KEYS)
    close = element("form", element("button", "Close", type="submit"), method="dialog")
    mouse = "Drag turns the view, the wheel or two fingers zoom, the right button or two fingers move it."
    return element(
        "dialog",
        element("h3", "Keys of the replay"),
        element("dl", keys, class_="keys"),
        element("p", mouse),
        close,
        id="replay-help",
        aria_label="Keys of the replay",
    )


def _button(key: str, text: str, title: str) -> Markup:
    return element("button", text, id=key, type="button", title=title, aria_label=title)


def _switch(key: str, text: str) -> Markup:
    return element("label", element("input", id=key, type="checkbox", checked=True), text, class_="switch")
