"""Numbers and units as they are read."""

import math
import re
from typing import Any

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Of units that begin with one of these, a multiple has a name of its own; not of kg, nor of m² or m³.
_PREFIXED = re.compile(r"(m|s|N|J|W|Pa|Hz|rad)(?![²³⁴\w])")
_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 3: "k", 6: "M", 9: "G"}

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB", "PiB")


def number(value: Any, digits: int = 4) -> str:
    """Returns a number with so many digits: ``1.234``, ``−1.2×10⁻⁵``."""
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
    """Returns a whole number in groups of three digits."""
    return f"{value:,}".replace(",", "\u202f")


def quantity(value: Any, unit: str, digits: int = 4) -> str:
    """Returns a number with its unit."""
    return number(value, digits) + unit_suffix(unit)


def unit_suffix(unit: str) -> str:
    """Returns a unit as it follows a number."""
    return "" if unit in ("", "-") else f"\u202f{unit}"


def several(number_of: int, what: str) -> str:
    """Returns ``1 environment``, ``7 environments``."""
    return f"{count(number_of)} {what}{'' if number_of == 1 else 's'}"


#: What is smaller is drawn as nothing: powers of ten of it, and their inverses, are beyond numbers.
NOTHING = 1.0e-290


def scaled(unit: str, largest: float) -> tuple[float, str]:
    """Returns by what to multiply numbers up to ``largest`` so that they are easily read, and their unit then."""
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
