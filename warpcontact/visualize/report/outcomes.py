"""Report section on outcomes, and choice of the environments that the report shows individually."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.analysis.results import frozen
from warpcontact.experiment.curves import bin_edges, has_integer_bins
from warpcontact.model.health import Health
from warpcontact.stepping.outcomes.watch import RESERVED
from warpcontact.validation.checks import Array
from warpcontact.validation.number_format import count, number, scaled, several, unit_suffix
from warpcontact.visualize.report import chart
from warpcontact.visualize.report.environments import Column, columns_of, too_many_in
from warpcontact.visualize.report.markup import Markup, element, joined, name, table

# Largest numbers of rows of the table, and of histograms.
ROWS = 60
HISTOGRAMS = 12
QUANTILES = (0.05, 0.5, 0.95)

# Numbers of environments selected by default: the first ones, frozen ones, and outcomes with their extremes.
FIRST = 16
FROZEN = 8
EXTREMES_OF = 6


@dataclass(frozen=True, eq=False)
class OutcomeSpread:
    """Statistics of one outcome over the environments that are not frozen.

    Attributes:
        column: Column of the outcome.
        lowest: Number of the environment with the smallest value; ``None`` if none is finite.
        highest: Number of the environment with the largest value; ``None`` if none is finite.
        row: Cells of the table.
        histogram: Histogram; ``None``: not drawn.
    """

    column: Column
    lowest: int | None
    highest: int | None
    row: tuple[Markup | str, ...]
    histogram: Markup | None


def make_spreads(outcome: xr.Dataset) -> tuple[list[OutcomeSpread], int]:
    """Returns the first ``ROWS`` outcomes, and the number of further ones; a set counts as one."""
    every = columns_of(outcome, without=RESERVED)
    envs = np.asarray(outcome["env"].values)
    halted = np.isin(envs, frozen(outcome))
    found = [_spread(column, envs, halted, drawn=i < HISTOGRAMS) for i, column in enumerate(islice(every, ROWS))]
    return found, sum(1 for _ in every) + len(too_many_in(outcome))


def _spread(column: Column, envs: NDArray[np.int64], halted: NDArray[np.bool_], *, drawn: bool) -> OutcomeSpread:
    values = column.values.astype(np.float64)
    good = np.isfinite(values) & ~halted
    finite, labels = values[good], envs[good]
    if not len(finite):
        unit = "" if column.unit == "-" else column.unit
        return OutcomeSpread(column, None, None, (name(column.name), unit, "0", *["–"] * 7), None)
    factor, unit = scaled(column.unit, float(np.abs(finite).max()))
    least, most = int(finite.argmin()), int(finite.argmax())
    # Subtract an offset, so that squares of large numbers neither overflow nor cancel.
    deviation = float(np.std(finite - finite[0]))
    low, middle, high = np.quantile(finite, QUANTILES)
    sentences = (finite[least], low, middle, finite.mean(), high, finite[most], deviation)
    cells = (name(column.name), unit, count(len(finite)), *(number(factor * value) for value in sentences))
    picture = _histogram(column, finite, int((~halted).sum() - len(finite))) if drawn else None
    return OutcomeSpread(column, int(labels[least]), int(labels[most]), cells, picture)


def section(spreads: list[OutcomeSpread], more: int, envs: int, halted: int) -> Markup:
    """Returns the section of the page.

    Args:
        spreads: Statistics of the outcomes.
        more: Number of further outcomes.
        envs: Number of environments with outcomes.
        halted: Number of frozen environments among these, which are excluded.
    """
    if not spreads:
        text = "The experiment defines no outcomes. Add them in a table [outcome] of its file."
        return element("p", text, class_="note")
    exclusion = f", without {several(halted, 'frozen one')}" if halted else ""
    head = ("outcome", "unit", "finite", "smallest", "5 %", "median", "mean", "95 %", "largest", "std. dev.")
    pictures = [spread.histogram for spread in spreads if spread.histogram is not None]
    notes = [f"Over {several(envs, 'environment')}{exclusion}."]
    if more:
        notes.append(f"{several(more, 'further number')} of outcomes: see warpcontact export DIR --csv FILE.")
    return joined(
        [
            element("p", " ".join(notes), class_="note"),
            table(head, (spread.row for spread in spreads), numbers=range(2, len(head)), class_="facts"),
            element("div", joined(pictures), class_="charts"),
        ]
    )


def _histogram(column: Column, values: Array, missing: int) -> Markup:
    edges = bin_edges(values)
    heights, _ = np.histogram(values, bins=edges)
    x = chart.horizontal(float(edges[0]), float(edges[-1]), column.unit, whole=has_integer_bins(values))
    y = chart.vertical(0.0, float(heights.max()), "-", whole=True)
    unit, factor = x.label or "-", x.factor
    floor, tops, sides = float(y.place(np.zeros(()))), y.place(heights), x.place(edges)
    suffix = unit_suffix(unit)
    bars = []
    for i in np.flatnonzero(heights):
        first, last = (number(factor * edge) for edge in edges[i : i + 2])
        title = f"{first} to {last}{suffix}: {several(int(heights[i]), 'environment')}"
        bars.append(chart.rectangle(sides[i] + 0.4, tops[i], sides[i + 1] - 0.4, floor, "bar", title))
    quantiles = np.quantile(values, QUANTILES)
    low, middle, high = (number(factor * value) for value in quantiles)
    rules = [
        chart.rule(float(x.place(at)), "median" if q == 0.5 else "quantile")
        for q, at in zip(QUANTILES, quantiles, strict=True)
    ]
    about = (
        f"Histogram of {column.name}: 5 % below {low}{suffix}, median {middle}{suffix}, 95 % below {high}{suffix}"
    )
    sentences = f"median {middle}{suffix}; 90 % from {low} to {high}{suffix}"
    if missing:
        sentences += f"; {count(missing)} without a finite value"
    title = element("figcaption", element("strong", name(column.name, 40)), element("span", column.about))
    drawing = chart.chart(x, y, [*bars, *rules], about, "value")
    return element("figure", title, drawing, element("p", sentences, class_="note"), class_="chart")


@dataclass
class Choice:
    """Selected environments, in order of importance if there is no space for all.

    Attributes:
        reasons: Reasons for each environment, by its number.
        requested: Whether the user listed them.
    """

    reasons: dict[int, list[str]] = field(default_factory=dict)
    requested: bool = False

    @property
    def envs(self) -> list[int]:
        """Numbers of the environments, in order of importance."""
        return list(self.reasons)

    def add(self, env: int, reason: str = "") -> None:
        """Adds an environment, or another reason for it."""
        reasons = self.reasons.setdefault(int(env), [])
        if reason:
            reasons.append(reason)

    def label(self, env: int) -> str:
        """Returns the label of an environment: its number and up to three reasons."""
        return ", ".join([str(env), *self.reasons.get(env, [])[:3]])


def choose(
    requested: Iterable[int] | None, numbers: NDArray[np.int64], health: Health, spreads: Sequence[OutcomeSpread]
) -> Choice:
    """Selects the environments that are shown individually.

    Args:
        requested: Environments listed by the user; ``None``: the first ones, some frozen ones, and those with the
            smallest and largest outcomes.
        numbers: Numbers of the available environments.
        health: Frozen environments.
        spreads: Spreads of the outcomes.

    Raises:
        ValueError: If a listed environment is not available, or the list is empty.
    """
    reasons = Choice()
    for env in health.frozen[:FROZEN]:
        reasons.add(env, "failed")
    for spread in spreads[:EXTREMES_OF]:
        if spread.lowest is not None and spread.highest is not None and spread.lowest != spread.highest:
            reasons.add(spread.lowest, f"smallest {spread.column.name}")
            reasons.add(spread.highest, f"largest {spread.column.name}")
    choice = Choice(requested=requested is not None)
    available = set(numbers.tolist())
    if requested is None:
        candidates = [*numbers[:1].tolist(), *reasons.envs, *numbers[:FIRST].tolist()]
    else:
        candidates = list(requested)
        for env in candidates:
            if isinstance(env, bool) or not isinstance(env, int | np.integer):
                raise ValueError(f"envs must be environment numbers, got {env!r}")
            if int(env) not in available:
                available_text = f"{numbers.min()} to {numbers.max()}" if len(numbers) else "none"
                raise ValueError(f"environment {env} has no results to report; there are: {available_text}")
        if not candidates:
            raise ValueError("envs must name at least one environment, got none")
    for env in candidates:
        if int(env) in available:
            choice.add(env)
    for env in choice.envs:
        for reason in reasons.reasons.get(env, []):
            choice.add(env, reason)
    return choice
