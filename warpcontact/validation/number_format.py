"""Formats numbers and units for people."""

import math
import re
from typing import Any

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Units whose multiples have prefixes, at the start of a unit; not kg, m² or m³.
_PREFIXED = re.compile(r"(m|s|N|J|W|Pa|Hz|rad)(?![²³⁴\w])")
_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 3: "k", 6: "M", 9: "G"}

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB", "PiB")


def number(value: Any, digits: int = 4) -> str:
    """Returns a number with ``digits`` significant digits: ``1.234``, ``−1.2×10⁻⁵``."""
    value = float(value)
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{digits}g}"
    mantissa, e, exponent = text.partition("e")
    if e:
        text = f"{mantissa}×10{str(int(exponent)).translate(_RAISED)}"
    return text.replace("-", "−")


def count(value: int) -> str:
    """Returns an integer in groups of three digits."""
    return f"{value:,}".replace(",", "\u202f")


def quantity(value: Any, unit: str, digits: int = 4) -> str:
    """Returns a number with its unit."""
    return number(value, digits) + unit_suffix(unit)


def unit_suffix(unit: str) -> str:
    """Returns a unit with the space that separates it from a number."""
    return "" if unit in ("", "-") else f"\u202f{unit}"


def several(number_of: int, what: str) -> str:
    """Returns ``1 environment``, ``7 environments``."""
    return f"{count(number_of)} {what}{'' if number_of == 1 else 's'}"


#: Smaller values are not scaled, because powers of ten and their inverses would overflow.
NOTHING = 1.0e-290


def scaled(unit: str, largest: float) -> tuple[float, str]:
    """Returns a factor for numbers up to ``largest`` that makes them easy to read, and the unit of the result."""
    if not math.isfinite(largest) or largest < NOTHING or 0.1 <= largest < 1.0e4:
        return 1.0, "" if unit == "-" else unit
    exponent = 3 * math.floor(math.log10(largest) / 3.0)
    prefix = _PREFIXES.get(exponent, "")
    if prefix and _PREFIXED.match(unit) and not (unit[0] == "s" and exponent > 0):
        return 10.0**-exponent, prefix + unit
    power = f"10{str(exponent).translate(_RAISED)}"
    return 10.0**-exponent, power if unit == "-" else f"{power} {unit}"


def format_bytes(size: float) -> str:
    """Returns a number of bytes as one reads it, such as ``1.50 GiB``."""
    unit = 0
    while abs(size) >= 1024.0 and unit < len(_UNITS) - 1:
        size, unit = size / 1024.0, unit + 1
    return f"{size:.0f} {_UNITS[unit]}" if unit == 0 or size >= 999.5 else f"{size:.3g} {_UNITS[unit]}"


def duration_text(seconds: float) -> str:
    """Returns a time as text, such as ``2 h 5 min``."""
    if seconds < 60.0:
        return f"{seconds:.2g} s"
    minutes = round(seconds / 60.0)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    parts = [(days, "d"), (hours, "h"), (minutes, "min")]
    texts = [f"{count} {unit}" for count, unit in parts if count]
    return " ".join(texts[:2])
