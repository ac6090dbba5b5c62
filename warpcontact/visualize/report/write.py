"""Writes the report of a run from its folder as one HTML page.

A content security policy allows only the script and the style of the page.
"""

import base64
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from warpcontact._version import __version__
from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.progress import run_status
from warpcontact.experiment.records import RunDataError
from warpcontact.experiment.run import Run, open_run
from warpcontact.experiment.user_code import Trust, TrustError
from warpcontact.files.atomic_files import atomic_file, check_writable
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.scene.contact_coupling import CouplingReport
from warpcontact.validation.checks import entries
from warpcontact.visualize.report import chart, contacts, environments, facts, outcomes, series
from warpcontact.visualize.report.markup import Markup, data_block, element, joined, name, short
from warpcontact.visualize.report.outcomes import Choice, choose
from warpcontact.visualize.report.replay import Replay, replay_of, replay_section

#: Files next to this module: the script built from ``web/``, and the style sheet.
SCRIPT = "page.js"
STYLE = "page.css"

#: Name of the file in the folder of the run.
REPORT = "report.html"
SUFFIXES = (".html", ".htm")


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


@explain_keywords
def report(
    run: Run | str | PathLike[str],
    path: str | PathLike[str] | None = None,
    *,
    envs: int | Iterable[int] | None = None,
    trust: Trust = False,
) -> Path:
    """Writes a report of a run as one HTML file without external resources.

    Contents: run settings, statistics and histograms of outcomes, quantiles of sensors over time, force over penetration
    of contacts, contact couplings, frozen environments, a table of environments, and a replay. Large runs are sampled,
    and the report states this. The report of an unfinished run contains the committed data.

    Args:
        run: A run, or its folder. Files with custom laws are executed to restore the scene.
        path: File to write, ``.html``; an existing file is replaced. ``None``: ``report.html`` in the folder.
        envs: Numbers of the environments shown individually; ``None``: the first 16, some frozen ones, and those with
            the smallest and largest outcomes, as far as they fit.
        trust: As for ``wc.open_run``, if ``run`` is a folder.

    Returns:
        The path.

    Raises:
        ValueError: If the path or an environment is invalid, the file cannot be written, or the folder contains no
            run.
        RunDataError: If results are missing or were changed.
        OSError: If writing fails.
    """
    run = run if isinstance(run, Run) else open_run(run, trust=trust)
    path = run.folder / REPORT if path is None else Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"path must end in {' or '.join(SUFFIXES)}, got {str(path)!r}")
    check_writable(path)
    requested = None if envs is None else entries(envs)
    text = _page(run, requested).html()
    with atomic_file(path) as file:
        file.write(text.encode())
    return path


def _page(run: Run, requested: Iterable[int] | None) -> Page:
    status = run_status(run.folder)
    outcome, health = run.outcome, run.health
    spreads, more_outcomes = outcomes.make_spreads(outcome)
    choice = choose(requested, np.asarray(outcome["env"].values), health, spreads)
    recorded = _series(run)
    shown = None if recorded is None else _select_envs(recorded, outcome["env"])
    replay, reports = _drawn(run, choice)
    title = str(run.summary["name"])
    head = joined(
        [
            element("p", facts.subtitle(run.summary), class_="subtitle"),
            facts.notices(run.summary, status),
            facts.tiles(run.summary, status),
        ]
    )
    page = Page(title, head)
    if replay.packs:
        page.data["replay"] = replay.scene
        page.data |= {f"replay-{env}": pack for env, pack in replay.packs.items()}

    def add(key: str, heading: str, content: Markup | None) -> None:
        if content is not None:
            page.sections.append(Section(key, heading, content))

    finished = outcome.sizes["env"]
    add("replay-section", "Replay", replay_section(replay))
    add("outcomes", "Outcomes", outcomes.section(spreads, more_outcomes, finished, len(health.frozen)))
    if shown is not None and finished:
        curves, more_sensors = series.make_curves(outcome, shown, choice.envs)
        page.data["series"] = series.data(curves)
        add(
            "series",
            "Over time",
            series.section(curves, more_sensors, finished, shown.sizes["time"], health),
        )
        add("loops", "Force over penetration", contacts.loops_section(shown, choice.envs))
    add("couplings", "Contact couplings", contacts.couplings_section(reports))
    add("failed", "Quarantine", environments.quarantine_section(health, outcome))
    if finished:
        first = [*choice.envs, *(int(env) for env in health.frozen)]
        content, data = environments.table_section(run.params, outcome, first)
        page.data["environments"] = data
        add("environments", "Environments", content)
    add("run", "What was run", facts.section(run.folder, run.summary, status))
    return page


def _series(run: Run) -> xr.Dataset | None:
    try:
        found = run.series
    except ValueError as error:
        if isinstance(error, ExperimentError | RunDataError):
            raise
        return None
    return found if found.sizes["time"] else None


def _drawn(run: Run, choice: Choice) -> tuple[Replay, tuple[CouplingReport, ...]]:
    """Returns replay and coupling reports, which need the scene; without them if it cannot be restored."""
    finished = run.outcome.sizes["env"]
    try:
        scene = run.scene
    except TrustError:
        raise
    except (ValueError, OSError) as error:
        reason = short(str(error).splitlines()[0], 400)
        return Replay([f"No replay: the scene cannot be restored: {reason}"]), ()
    reports = run.reports if finished else ()
    if _series(run) is None:
        note = "No replay: no sensors were recorded over time. With [record] series = true, the default, "
        return Replay([note + "an experiment records the poses of all bodies."]), reports
    if not finished:
        return Replay(["No replay yet: no environment is finished."]), reports
    return replay_of(run.recording, scene, choice), reports


def _select_envs(data: xr.Dataset, envs: xr.DataArray) -> xr.Dataset:
    """Returns the environments ``envs`` of a data set."""
    return data if data.sizes["env"] == envs.size else data.sel(env=envs)
