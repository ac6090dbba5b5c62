"""Formats the catalogue of laws and friction models as text, and finds entries by name."""

import dataclasses
import inspect
import textwrap
from collections.abc import Sequence
from typing import Any

from warpcontact.kernels import friction, laws
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.names import suggestion

WIDTH = 100

#: Meanings of the flags of ``Formula.provenance``.
PROVENANCE = {
    "S": "read in a public source",
    "D": "derived and confirmed by integration",
    "R": "recalled from the literature",
}

LETTERS = (
    "N: normal force, δ: penetration, δ̇: its rate, > 0 on approach, v₀: entry speed, m: effective mass,",
    "F: friction force, v: slip velocity, s = |v|. Units are SI.",
)
LEGEND = (
    "known: provenance of the formula. S: read in a public source, a program or a manual; D: derived and",
    "confirmed by integration; R: recalled from the literature, not checked against a source.",
    "With two letters, the parts of the formula differ.",
)


#: Laws and friction models of nonsmooth contact.
HARD: tuple[type[Formula], ...] = (*laws.RIGID, *friction.RIGID)


class UnknownName(ValueError):
    """A name is not in the catalogue."""


def every() -> dict[str, type[Formula]]:
    """Returns all entries by name, laws first."""
    return {formula.__name__: formula for formula in (*laws.CATALOGUE, *friction.CATALOGUE, *HARD)}


def find(name: str) -> type[Formula]:
    """Returns the law or friction model with this name.

    Raises:
        UnknownName: If there is none; the message suggests the most similar name.
    """
    entries = every()
    if name in entries:
        return entries[name]
    hint = suggestion(name, entries) or "; 'warpcontact laws' lists them"
    raise UnknownName(f"there is no law or friction model {name!r}{hint}")


def catalogue() -> str:
    """Returns the complete catalogue as text."""
    lines = [*LETTERS, *LEGEND]
    for title, formulas in (
        ("LAWS", laws.CATALOGUE),
        ("FRICTION MODELS", friction.CATALOGUE),
        ("NONSMOOTH CONTACT", HARD),
    ):
        lines += ["", title]
        for formula in formulas:
            lines += ["", *entry(formula)]
    return "\n".join(lines)


def entry(formula: type[Formula]) -> Sequence[str]:
    """Returns the lines of a law or friction model in the catalogue."""

    def wrapped(begin: str, text: str) -> list[str]:
        return textwrap.wrap(text, WIDTH, initial_indent=begin, subsequent_indent=" " * len(begin))

    about = formula.formula or (inspect.getdoc(formula) or "").partition("\n\n")[0]
    lines = [f"  {formula.__name__}", *(wrapped("    formula ", about) if about else [])]
    for field in dataclasses.fields(formula):
        limits = formula.limits(field.name)
        given = ""
        if field.default is None and field.name not in formula.exactly_one_of:
            given = "optional"
        elif field.default is not None and field.default is not dataclasses.MISSING:
            given = f"default {field.default:g}"
        columns = f"    {field.name:<17} {limits['unit']:<8}{_range(limits):<14}{given:<14}"
        lines += wrapped(columns, limits["meaning"])
    one_of = f"exactly one of {' and '.join(formula.exactly_one_of)}" if formula.exactly_one_of else ""
    texts = {
        "give": one_of,
        "valid": formula.validity,
        "source": formula.reference,
        "known": provenance(formula),
    }
    for label, text in texts.items():
        lines += wrapped(f"    {label:<8}", text) if text else []
    return lines


def provenance(formula: type[Formula]) -> str:
    """Returns the provenance of a formula as text; empty: not stated."""
    flags = [flag for flag in formula.provenance.split(", ") if flag]
    return ", in part ".join(f"{PROVENANCE[flag]} ({flag})" for flag in flags)


def _range(limits: Any) -> str:
    """Returns an allowed range as short text."""
    infinity = float("inf")
    low = f"> {limits['above']:g}" if limits["above"] > -infinity else ""
    low = f"≥ {limits['at_least']:g}" if limits["at_least"] > -infinity else low
    if limits["at_most"] == infinity:
        return low or "any"
    if limits["at_least"] > -infinity:
        return f"{limits['at_least']:g} … {limits['at_most']:g}"
    return f"{low}, ≤ {limits['at_most']:g}" if low else f"≤ {limits['at_most']:g}"
