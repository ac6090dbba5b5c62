"""Report sections on the run itself: key figures, warnings, facts and settings."""

from collections.abc import Mapping
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from warpcontact.experiment.folder import EXPERIMENT
from warpcontact.experiment.progress import RunStatus
from warpcontact.files.run_folder import RunPath
from warpcontact.validation.number_format import count, duration_text, number, quantity, several
from warpcontact.validation.warning_levels import WarningLevel, split_label
from warpcontact.visualize.report.markup import Markup, clean, element, joined, name, short, table

# Largest numbers of characters of the settings, of notices, and of characters of a notice.
SETTINGS = 100_000
NOTICES = 50
NOTICE = 600
_STATE_TEXTS = {
    "running": "is in progress",
    "stopped": "was stopped externally and can be resumed with --resume",
    "interrupted": "was interrupted and can be resumed with --resume",
    "failed": "failed",
}


def tiles(summary: Mapping[str, Any], status: RunStatus) -> Markup:
    """Returns the key figures of the run."""
    entries = [
        ("environments", count(summary["envs"])),
        ("simulated", quantity(summary["duration"], "s", 6)),
        ("time step", quantity(summary["dt"], "s", 6)),
        ("wall-clock time", duration_text(_wall_time(summary, status))),
        ("env. steps per second", number(_rate(summary, status), 3)),
        ("quarantined", count(status.frozen)),
    ]
    tiles_html = [element("div", element("dt", label), element("dd", value)) for label, value in entries]
    return element("dl", joined(tiles_html), class_="tiles")


def subtitle(summary: Mapping[str, Any]) -> str:
    """Returns the line below the title."""
    entries = [summary.get("device", ""), summary.get("precision", ""), summary.get("integrator", "")]
    return " · ".join(short(word, 80) for word in entries if word)


def notices(summary: Mapping[str, Any], status: RunStatus) -> Markup:
    """Returns notices at the top of the page: unfinished or failed parts, and warnings."""
    parts = []
    if status.state != "finished":
        every = several(summary["envs"], "environment")
        entries = (
            f"This run {_STATE_TEXTS.get(status.state, status.state)}: {count(status.finished_envs)} of {every} "
            f"are finished, in {count(status.finished_shards)} of {several(status.shards, 'shard')}. "
            "The report contains the data committed when it was written."
        )
        parts.append(element("p", entries, class_="notice bad", role="status"))
    for shard, message in summary.get("failed", {}).items():
        parts.append(element("p", name(shard), " failed: ", short(message, NOTICE), class_="notice bad"))
    listed = summary.get("warnings", [])
    warnings = listed if isinstance(listed, list) else []
    lines = [_notice(text) for text in warnings[:NOTICES]]
    if len(warnings) > NOTICES:
        lines.append(element("li", f"… and {count(len(warnings) - NOTICES)} more, in run.json"))
    if lines:
        head = element("summary", several(len(warnings), "notice"))
        parts.append(element("details", head, element("ul", joined(lines)), class_="notice", open=len(lines) <= 3))
    return joined(parts)


def _notice(entry: Any) -> Markup:
    """Returns a warning with its level as label; warnings of earlier versions have no level."""
    level, text = split_label(entry) if isinstance(entry, str) else (WarningLevel.CAUTION, entry)
    return element("li", element("b", f"{level.capitalize()}: "), short(text, NOTICE))


def section(folder: Path, summary: Mapping[str, Any], status: RunStatus) -> Markup:
    """Returns the section of the page with all facts that identify the run and allow repeating it."""
    versions = summary.get("versions")
    programs = versions.items() if isinstance(versions, dict) else ()
    entries: list[tuple[Any, Any]] = [
        ("name", name(summary["name"])),
        ("state", status.state),
        ("environments", count(summary["envs"])),
        ("shards", count(status.shards)),
        ("duration", quantity(summary["duration"], "s", 9)),
        ("time step", quantity(summary["dt"], "s", 9)),
        ("steps", count(summary["steps"])),
        ("integrator", name(summary.get("integrator", "–"))),
        ("precision", name(summary.get("precision", "–"))),
        ("seed", name(summary.get("seed", "–"))),
        ("device", name(summary["device"])),
        ("machine", name(summary.get("machine", "–"))),
        ("started", name(summary.get("started", "–"))),
        ("wall-clock time of stepping", duration_text(_wall_time(summary, status))),
        ("versions", joined(element("div", name(key), " ", name(value)) for key, value in programs)),
        ("fingerprint", element("code", short(summary["fingerprint"], 80), class_="wrap")),
    ]
    for file, sha in summary.get("law_files", {}).items():
        entries.append((name(file), element("code", short(sha, 80), class_="wrap")))
    facts = table(("", "value"), ((element("b", key), value) for key, value in entries), class_="plain")
    return joined([facts, _settings(folder)])


def _settings(folder: Path) -> Markup:
    try:
        with (
            (RunPath(folder) / EXPERIMENT).open_binary() as raw,
            TextIOWrapper(raw, encoding="utf-8", errors="replace") as file,
        ):
            text = file.read(SETTINGS + 1)
    except OSError as error:
        return element("p", f"{EXPERIMENT} cannot be read: {error.strerror or error}", class_="note")
    more = "\n… truncated; the complete file is in the folder of the run" if len(text) > SETTINGS else ""
    head = element("summary", f"Settings ({EXPERIMENT}, with all defaults)")
    return element("details", head, element("pre", clean(text[:SETTINGS]) + more, tabindex="0"))


def _wall_time(summary: Mapping[str, Any], status: RunStatus) -> float:
    entries = summary.get("wall_time")
    return float(entries) if isinstance(entries, int | float) else status.wall_time


def _rate(summary: Mapping[str, Any], status: RunStatus) -> float:
    entries = summary.get("env_steps_per_second")
    return float(entries) if isinstance(entries, int | float) else status.rate
