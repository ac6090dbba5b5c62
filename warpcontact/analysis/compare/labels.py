"""What data sets and pictures say about their numbers: units, and the parameters that were used."""

from warpcontact.kernels.catalogue.device_model import Formula

# Units are shown with the prefix that leaves the largest number of an axis above this.
LEAST = 0.5
PREFIXES = {1.0e6: "M", 1.0e3: "k", 1.0: "", 1.0e-3: "m", 1.0e-6: "µ", 1.0e-9: "n"}


def notes(unit: str, meaning: str) -> dict[str, str]:
    """Returns the attributes of a variable."""
    return {"units": unit, "long_name": meaning}


def number(value: float, unit: str) -> str:
    """Returns a value with its unit."""
    return f"{value:.4g}" if unit in ("", "-") else f"{value:.4g} {unit}"


def settings(formula: Formula, without: str | None = None) -> str:
    """Returns the parameters of a law or friction as one reads them, except for one."""
    return ", ".join(
        f"{name} {number(value, formula.limits(name)['unit'])}"
        for name, value in formula.parameters().items()
        if name != without
    )


def titled(label: str, kind: str) -> str:
    """Returns a label with the name of the class, where that is another."""
    return label if label == kind else f"{label} ({kind})"


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Returns the factor and the unit with a prefix in which ``largest`` is easy to read."""
    factor = next((factor for factor in PREFIXES if largest >= LEAST * factor), 1.0)
    return 1.0 / factor, PREFIXES[factor] + unit
