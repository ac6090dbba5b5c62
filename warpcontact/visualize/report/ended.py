"""Report section on frozen, stopped and reset environments."""

import numpy as np
import xarray as xr

from warpcontact.model.flags import words_of
from warpcontact.model.health import Health
from warpcontact.scene.status import FailureCause
from warpcontact.validation.number_format import count, quantity, several
from warpcontact.visualize.report.markup import Markup, element, joined, name, table

# Largest number of rows.
ROWS = 200
_CAUSES = {
    FailureCause.NON_FINITE: "non-finite state",
    FailureCause.TOO_FAST: "a body exceeded scene.max_speed",
    FailureCause.TOO_FAR: "a body exceeded scene.max_distance",
}


def section(health: Health, outcome: xr.Dataset) -> Markup:
    """Returns the section of the page."""
    parts = []
    if health.good:
        parts.append(element("p", "No environment failed.", class_="note"))
    else:
        were = "was" if len(health.frozen) == 1 else "were"
        sentences = (
            f"{several(len(health.frozen), 'environment')} failed and {were} frozen in the last valid state."
        )
        if len(health.frozen) > ROWS:
            sentences += f" The first {ROWS}:"
        rows = [
            (replay_button(int(env)), quantity(time, "s", 6), _CAUSES.get(cause, cause.name))
            for env, cause, time in zip(health.frozen[:ROWS], health.causes, health.times, strict=False)
        ]
        parts += [
            element("p", sentences, class_="note"),
            table(("environment", "frozen at", "cause"), rows, numbers=(1,)),
        ]
    if len(health.stopped):
        parts.append(
            element("p", f"{several(len(health.stopped), 'environment')} stopped by a condition.", class_="note")
        )
        if "stopped_by" in outcome:
            codes = outcome["stopped_by"].values
            words = words_of(outcome["stopped_by"])
            conditions = [(name(words.get(int(c), str(c))), count(int(n))) for c, n in _counts(codes)]
            parts.append(table(("condition", "environments"), conditions, numbers=(1,)))
    resets = outcome["resets"].values if "resets" in outcome else np.zeros(0)
    if resets.any():
        again = int(np.count_nonzero(resets))
        parts.append(
            element(
                "p",
                f"{several(again, 'environment')} failed and restarted, {count(int(resets.sum()))} times in total.",
                class_="note",
            )
        )
    return joined(parts)


def replay_button(env: int) -> Markup:
    """Returns the number of an environment as a button that shows it in the replay."""
    return element("button", str(env), type="button", class_="link", data_replay=env)


def _counts(codes: np.ndarray) -> list[tuple[int, int]]:
    values, numbers = np.unique(codes[codes >= 0], return_counts=True)
    return list(zip(values.tolist(), numbers.tolist(), strict=True))
