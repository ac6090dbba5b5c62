"""Report section on contact couplings: smallest distances and areas in range."""

from collections.abc import Sequence

import numpy as np

from warpcontact.scene.contact_coupling_report import CouplingReport
from warpcontact.validation.number_format import count, number, quantity
from warpcontact.visualize.report.markup import Markup, element, joined, name, table


def section(reports: Sequence[CouplingReport]) -> Markup | None:
    """Returns the section of the page; ``None`` if there are no contact couplings."""
    if not reports:
        return None
    rows = []
    expected = []
    for report in reports:
        reached = report.in_range
        closest = report.minimum_distance[reached]
        area = report.effective_area[reached]
        rows.append(
            (
                name(report.name),
                f"{count(int(reached.sum()))} of {count(len(reached))}",
                _span(closest),
                _span(area),
                count(int(report.touched.sum())),
                "–" if report.impact is None else count(int(report.passed.sum())),
            )
        )
        if report.impact is not None:
            expected_gap, expected_area = quantity(report.impact.closest, "m"), quantity(report.impact.area, "m²")
            sentences = f": the range was designed for a closest distance of {expected_gap} and an area of {expected_area}."
            expected.append(element("p", name(report.name), sentences, class_="note"))
    head = (
        "coupling",
        "in range",
        "smallest distance [m]",
        "largest area [m²]",
        "in contact",
        "closer than expected",
    )
    return joined([table(head, rows, numbers=range(1, 6)), *expected])


def _span(values: np.ndarray) -> str:
    if not len(values):
        return "–"
    low, high = number(values.min()), number(values.max())
    return low if low == high else f"{low} to {high}"
