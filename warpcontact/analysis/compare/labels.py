"""Labels of data sets and plots: values with units, and parameter lists."""

from warpcontact.kernels.catalogue.device_model import Formula

# The unit prefix is chosen so that the largest number on an axis exceeds this.
LEAST = 0.5
PREFIXES = {1.0e6: "M", 1.0e3: "k", 1.0: "", 1.0e-3: "m", 1.0e-6: "µ", 1.0e-9: "n"}


def notes(unit: str, meaning: str) -> dict[str, str]:
    """Returns the attributes of a variable."""
    return {"units": unit, "long_name": meaning}


def number(value: float, unit: str) -> str:
    """Returns a value with its unit as text."""
    return f"{value:.4g}" if unit in ("", "-") else f"{value:.4g} {unit}"


def settings(formula: Formula, without: str | None = None) -> str:
    """Returns the parameters of a law or friction model as text, except ``without``."""
    return ", ".join(
        f"{name} {number(value, formula.limits(name)['unit'])}"
        for name, value in formula.parameters().items()
        if name != without
    )


def titled(label: str, kind: str) -> str:
    """Returns a label, followed by the name of the class if it differs."""
    return label if label == kind else f"{label} ({kind})"


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Returns a factor and a prefixed unit, in which ``largest`` is at least ``LEAST`` if possible."""
    factor = next((factor for factor in PREFIXES if largest >= LEAST * factor), 1.0)
    return 1.0 / factor, PREFIXES[factor] + unit
