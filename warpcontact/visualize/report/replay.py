"""Report section of the replay: selected environments and records, their data, and controls.

The scripts ``web/src/replay.js`` and ``web/src/environment.js`` read the data and fill the section.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.building.scene import Scene
from warpcontact.drawing.colors import GAPS
from warpcontact.drawing.drawing import Drawing, Shape, drawing_of
from warpcontact.drawing.reduction import evenly, kept_samples
from warpcontact.validation.checks import Array
from warpcontact.validation.number_format import count
from warpcontact.visualize.report.markup import Markup, element, joined, short
from warpcontact.visualize.report.outcomes import Choice
from warpcontact.visualize.report.packing import Pack, add_shape, drawable_shape
from warpcontact.visualize.report.pressure import PressureData

# Largest number of records; the replay interpolates between them.
FRAMES = 256
# Largest number of poses in memory.
POSES = 2_000_000
# Largest size of all environments in the page [bytes], by default and for environments listed by the user.
MAX_BYTES = 3 * 2**20
MAX_BYTES_REQUESTED = 48 * 2**20
# Position errors below this fraction of the size are invisible.
POSITION_STEP = 1.0e-3

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
    ("P", "areas of body contacts, colored by pressure"),
    ("F", "fit the view"),
    ("?", "this help"),
)


@dataclass
class Replay:
    """Data of the replay.

    Attributes:
        notes: Notes on the replay, or the reason why there is none.
        scene: Content of the data block with the scene; empty if there is no replay.
        packs: Pack of each environment, by number.
    """

    notes: list[str] = field(default_factory=list)
    scene: dict[str, Any] = field(default_factory=dict)
    packs: dict[int, dict[str, Any]] = field(default_factory=dict)


def replay_of(recording: xr.Dataset, scene: Scene, choice: Choice) -> Replay:
    """Returns the replay of the selected environments, as many as fit.

    Args:
        recording: Poses and sensors (time, env, …), read on access.
        scene: Scene of the run.
        choice: Selected environments, in order of importance.

    Raises:
        ValueError: If nothing can be drawn.
    """
    replay = Replay()
    records = recording.sizes["time"]
    items = _items(recording, scene)
    if 2 * items > POSES:
        replay.notes.append(f"No replay: too many bodies and contact points for a page ({count(items)}).")
        return replay
    frames = min(FRAMES, POSES // items)
    envs = choice.envs[: max(1, POSES // (items * min(frames, records)))]
    rows = _frames(recording.sel(env=envs), scene, frames)
    drawing, refused = _drawing(recording.isel(time=rows), scene, envs)
    replay.notes += refused
    if drawing is None:
        return replay
    shapes, replay.scene = _described(drawing)
    pressure = PressureData(drawing)
    replay.scene["pressure"] = pressure.description
    fewest = len(rows)
    remaining_bytes = MAX_BYTES_REQUESTED if choice.requested else MAX_BYTES
    for row, env in enumerate(drawing.envs):
        packed, own_records = _packed(drawing, pressure, row)
        fewest = min(fewest, own_records)
        remaining_bytes -= len(packed["data"])
        if remaining_bytes < 0 and replay.packs:
            break
        replay.packs[env] = packed
    shown = sorted(replay.packs)
    replay.scene["shapes"] = shapes
    replay.scene["envs"] = [{"env": env, "label": short(choice.label(env), 200)} for env in shown]
    if len(shown) < len(choice.envs):
        named = "" if choice.requested else "; select others with warpcontact report DIR --envs N …"
        replay.notes.append(
            f"The replay has space for {count(len(shown))} of {len(choice.envs)} environments{named}."
        )
    if len(rows) < records:
        replay.notes.append(f"{count(len(rows))} of {count(records)} records are drawn.")
    if fewest < len(rows):
        replay.notes.append(
            f"Pressure is drawn at {count(fewest)} or more of {count(len(rows))} records, because of its size."
        )
    return replay


def _frames(recording: xr.Dataset, scene: Scene, most: int) -> NDArray[np.intp]:
    """Returns the records to draw: evenly spaced ones, and those with the largest and smallest forces."""
    records = recording.sizes["time"]
    contacts: list[Any] = [*scene.contacts, *scene.shape_contacts, *scene.body_contacts]
    forces = [recording[name] for one in contacts if (name := f"{one.name}.normal_force") in recording]
    if records <= most or most < 8 or not forces:
        return evenly(records, most)
    largest = np.max([_largest(force) for force in forces], axis=0)
    return np.union1d(evenly(records, most // 2), kept_samples(largest, most // 2))


def _largest(forces: xr.DataArray) -> Array:
    """Returns the largest force of each record (time, env, …), read in blocks of time."""
    records = forces.sizes["time"]
    rows = max(1, POSES * records // max(1, forces.size))
    found = np.zeros(records)
    for first in range(0, records, rows):
        block = forces.isel(time=slice(first, first + rows)).transpose("time", ...).values
        sizes = np.where(np.isfinite(block), np.abs(block), 0.0).reshape(len(block), -1)
        found[first : first + rows] = sizes.max(axis=1)
    return found


def _items(recording: xr.Dataset, scene: Scene) -> int:
    """Returns the number of poses and force points of one record of one environment, at least 1."""
    contacts: list[Any] = [*scene.contacts, *scene.shape_contacts]
    points = sum(contact.count for contact in contacts if f"{contact.name}.point" in recording)
    return max(1, points + sum(body.count for body in scene.bodies))


def _drawing(recording: xr.Dataset, scene: Scene, envs: list[int]) -> tuple[Drawing | None, list[str]]:
    """Returns the drawing of all environments that can be drawn, and notes on the others."""
    chosen = recording.sel(env=envs)
    try:
        return drawing_of(chosen, scene, envs), []
    except ValueError as error:
        if len(envs) == 1:
            return None, [f"There is no replay: {short(error, 300)}."]
    notes, good = [], []
    for env in envs:
        try:
            drawing_of(chosen.sel(env=[env]), scene, [env])
            good.append(env)
        except ValueError as error:
            notes.append(f"Environment {env} is not replayed: {short(error, 300)}.")
    return (drawing_of(chosen.sel(env=good), scene, good) if good else None), notes


def _described(drawing: Drawing) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the shapes as a pack, and the data common to all environments."""
    pack = Pack()
    about: list[dict[str, bool]] = []
    numbers: dict[int, int] = {}
    figures = []
    finest = POSITION_STEP * drawing.size
    kept: list[Shape] = []  # keeps the shapes alive, so that ids stay unique
    for figure in drawing.figures:
        copies = figure.scales.shape[1]
        shape = drawable_shape(figure.shape, copies)
        if id(shape) not in numbers:
            numbers[id(shape)] = len(about)
            about.append(add_shape(pack, shape, finest))
            kept.append(shape)
        figures.append(
            {
                "name": short(figure.name, 200),
                "kind": figure.kind,
                "color": _color(figure.color),
                "shape": numbers[id(shape)],
                "moves": len(figure.positions) > 1 or len(figure.orientations) > 1,
            }
        )
    gaps = [
        contact.gaps[np.isfinite(contact.gaps)] for contact in drawing.contact_forces if contact.gaps is not None
    ]
    every = np.concatenate(gaps) if gaps else np.zeros(0)
    scene = {
        "times": drawing.times.tolist(),
        "size": drawing.size,
        "forceScale": drawing.force_scale,
        "about": about,
        "figures": figures,
        "curves": [{"name": short(curve.name, 200), "color": _color(curve.color)} for curve in drawing.curves],
        "touches": [
            {"name": short(contact.name, 200), "color": _color(contact.color), "gaps": contact.gaps is not None}
            for contact in drawing.contact_forces
        ],
        "deepest": max(0.0, -float(every.min(initial=0.0))),
        "gaps": bool(len(every)),
        "gapColors": GAPS,
        "largestForce": max(
            (
                float(np.linalg.norm(contact.forces, axis=-1).max(initial=0.0))
                for contact in drawing.contact_forces
            ),
            default=0.0,
        ),
    }
    return pack.content(), scene


def _packed(drawing: Drawing, pressure: PressureData, row: int) -> tuple[dict[str, Any], int]:
    """Returns environment ``row`` of a drawing as a pack, and the number of records with areas of contact."""
    pack = Pack()
    finest = POSITION_STEP * drawing.size
    for figure in drawing.figures:
        items = figure.scales.shape[1]
        present = np.broadcast_to(figure.present[row], (items,))
        _add(pack, _env_values(figure.positions, row, items)[:, present], finest)
        rotations = _env_values(figure.orientations, row, items)[:, present]
        if len(rotations) > 1 and present.any():
            pack.rotations(rotations)
        else:
            pack.exact(rotations[:1])
        pack.exact(figure.scales[row, present])
    for curve in drawing.curves:
        _add(pack, _env_values(curve.points, row), finest)
        pack.exact(_env_values(curve.shown[..., None], row))
    for contact in drawing.contact_forces:
        _add(pack, _env_values(contact.points, row), finest)
        _add(pack, _env_values(contact.forces, row), 0.0)
        if contact.gaps is not None:
            _add(pack, _env_values(contact.gaps, row)[..., None], 0.0)
    own_records = pressure.add(pack, row, finest)
    return pack.content(), own_records


def _env_values(values: np.ndarray, row: int, items: int | None = None) -> np.ndarray:
    """Returns environment ``row`` of an array (time|1, env|1, …), broadcast to ``items``."""
    env_values = values[:, row if values.shape[1] > 1 else 0]
    if items is not None and env_values.shape[1] != items:
        env_values = np.broadcast_to(env_values, (len(env_values), items, env_values.shape[2]))
    return env_values


def _add(pack: Pack, values: np.ndarray, finest: float) -> None:
    if len(values) > 1 and values.size:
        pack.series(values, finest)
    else:
        pack.exact(values[:1])


def _color(color: Any) -> list[float]:
    return [round(float(part), 4) for part in np.asarray(color, dtype=np.float64)]


def replay_section(replay: Replay) -> Markup:
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
        _switch("replay-pressure", "Pressure"),
        _button("replay-fit", "Fit", "Fit the view (F)"),
        _button("replay-keys", "?", "Keys (?)"),
        class_="row options",
    )
    return element("div", time, options, class_="controls", role="group", aria_label="Controls of the replay")


def _legend() -> Markup:
    def bar(prefix: str) -> Markup:
        return element(
            "div",
            element("span", id=f"{prefix}-low"),
            element("span", id=f"{prefix}-bar", class_="bar", aria_hidden="true"),
            element("span", id=f"{prefix}-high"),
            class_="scale",
        )

    return element(
        "div",
        element("div", "gap", bar("legend"), id="legend-gap", hidden=True),
        element("div", "pressure", bar("legend-pressure"), id="legend-pressure", hidden=True),
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
