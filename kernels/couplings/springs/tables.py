"""Tables over the distance on the host: rows for the device, values and integrals."""

import numpy as np


def rows_of(pairs: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Returns (n + 1, 4) rows start, value, slope, integral: one before the table, one per interval, one after."""
    x, y = np.array(pairs).T
    slope = np.diff(y) / np.diff(x)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])
    starts = np.concatenate([x[:1], x])
    return np.column_stack(
        [
            starts,
            np.concatenate([y[:1], y]),
            np.concatenate([[0.0], slope, [0.0]]),
            np.concatenate([[0.0], integral]),
        ]
    )


def row_at(pairs: tuple[tuple[float, float], ...], lengths: np.ndarray) -> np.ndarray:
    """Returns the row for each of ``lengths``, (…, 4)."""
    x = np.array(pairs)[:, 0]
    return rows_of(pairs)[np.searchsorted(x, lengths, side="right")]


def area_to(pairs: tuple[tuple[float, float], ...], lengths: np.ndarray) -> np.ndarray:
    """Returns the integral from the first distance of a table to each of ``lengths``; constant value outside."""
    start, value, slope, integral = np.moveaxis(row_at(pairs, lengths), -1, 0)
    d = lengths - start
    return integral + d * (value + 0.5 * slope * d)


def value_of(pairs: tuple[tuple[float, float], ...], lengths: np.ndarray) -> np.ndarray:
    """Returns the value of a table at each of ``lengths``; constant outside."""
    start, value, slope, _ = np.moveaxis(row_at(pairs, lengths), -1, 0)
    return value + slope * (lengths - start)
