"""From the folder of a run to its report."""

from collections.abc import Iterable
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr

from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.records import RunDataError
from warpcontact.experiment.run import Run, open_run
from warpcontact.experiment.status import run_status
from warpcontact.experiment.trust import Trust
from warpcontact.experiment.user_code import TrustError
from warpcontact.files.atomic_files import atomic_file, check_writable
from warpcontact.forces.contact_coupling.report import CouplingReport
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation.checks import entries
from warpcontact.visualize.report import couplings, ended, environments, facts, loops, outcomes, series, viewer
from warpcontact.visualize.report.choice import Choice, choose
from warpcontact.visualize.report.markup import Markup, element, joined, short
from warpcontact.visualize.report.page import Page, Section
from warpcontact.visualize.report.replay import Replay, replay_of

#: Name of the file in the folder of the run.
REPORT = "report.html"
SUFFIXES = (".html", ".htm")


@explain_keywords
def report(
    run: Run | str | PathLike[str],
    path: str | PathLike[str] | None = None,
    *,
    envs: int | Iterable[int] | None = None,
    trust: Trust = False,
) -> Path:
    """Writes a report of a run as one HTML file, which opens anywhere and loads nothing.

    It has what was run, statistics and histograms of the outcomes, quantiles of sensors over time, force over
    penetration of contacts, contact couplings, environments that failed, a table of environments, and a replay.
    Large runs are sampled, and the report says where. Of an unfinished run it has what is committed.

    Args:
        run: A run, or its folder. Files with laws of its own are run to draw it.
        path: File to write, ``.html``; replaced if it exists; ``None``: ``report.html`` in the folder.
        envs: Numbers of the environments that are shown one by one; ``None``: the first 16, some of those that
            failed, and those in which outcomes are smallest and largest, as far as there is room.
        trust: As for ``wc.open_run``, if ``run`` is a folder.

    Returns:
        The path.

    Raises:
        ValueError: If the path or an environment is not allowed, the file is in no folder that exists or cannot be
            written, or the folder holds no run.
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
    add("replay-section", "Replay", viewer.section(replay))
    add("outcomes", "Outcomes", outcomes.section(spreads, more_outcomes, finished, len(health.frozen)))
    if shown is not None and finished:
        curves, more_sensors = series.make_curves(outcome, shown, choice.envs)
        page.data["series"] = series.data(curves)
        add(
            "series",
            "Over time",
            series.section(curves, more_sensors, finished, shown.sizes["time"], health),
        )
        add("loops", "Force over penetration", loops.section(shown, choice.envs))
    add("couplings", "Contact couplings", couplings.section(reports))
    add("failed", "Quarantine", ended.section(health, outcome))
    if finished:
        first = [*choice.envs, *(int(env) for env in health.frozen)]
        content, data = environments.section(run.params, outcome, first)
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
    """Returns what needs the scene, as far as it can be made again."""
    finished = run.outcome.sizes["env"]
    try:
        scene = run.scene
    except TrustError:
        raise
    except (ValueError, OSError) as error:
        reason = short(str(error).splitlines()[0], 400)
        return Replay([f"There is no replay, as the scene cannot be made again: {reason}"]), ()
    reports = run.reports if finished else ()
    if _series(run) is None:
        told = "There is no replay, as nothing was recorded over time: with [record] series = true, the default, "
        return Replay([told + "an experiment records the poses of all bodies."]), reports
    if not finished:
        return Replay(["There is no replay yet: no environment is finished."]), reports
    return replay_of(run.recording, scene, choice), reports


def _select_envs(data: xr.Dataset, envs: xr.DataArray) -> xr.Dataset:
    """Returns the environments ``envs`` of a data set that has these, and maybe more."""
    return data if data.sizes["env"] == envs.size else data.sel(env=envs)
