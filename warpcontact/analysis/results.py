"""What an analysis takes from a run, and the environments of it that can be used."""

from collections.abc import Hashable
from typing import Any, Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.experiment.schema import Settings
from warpcontact.kernels.catalogue.names import stored_name, suggestion
from warpcontact.model.flags import words_of
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

MISSING = ("refuse", "drop")
STOPPED = ("hold", "drop")
# Environments that are named in a message.
NAMED = 5


class ResultSource(Protocol):
    """What was found, whatever was asked.

    Attributes:
        outcome: Summaries (env, …) by name; ``status``, if it is there, tells by its flags which are frozen and
            which stopped, and ``end_time`` when these were.
        series: Sensors (time, env, …) by name.
    """

    @property
    def outcome(self) -> xr.Dataset:
        """Summaries (env, …) by name."""

    @property
    def series(self) -> xr.Dataset:
        """Sensors (time, env, …) by name."""


class ExperimentResults(ResultSource, Protocol):
    """The results of an experiment.

    Attributes:
        settings: The experiment, with all defaults.
    """

    @property
    def settings(self) -> Settings:
        """The experiment, with all defaults."""


def variable(data: xr.Dataset, name: str, what: str, *dims: str) -> xr.DataArray:
    """Returns a variable of numbers with ``dims``, ``"env"`` among them, first.

    Raises:
        ValueError: If there is none, naming ``what`` it should be, or no environment has a value yet.
    """
    known = [str(key) for key, array in data.data_vars.items() if set(dims) <= set(array.dims)]
    wanted, name = name, stored_name(name)
    if name not in known:
        hint = suggestion(wanted, known) or f"; there are: {', '.join(known) or 'none'}"
        raise ValueError(f"{what} must be one of the run, got {wanted!r}{hint}")
    array = data[name]
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{what} must be one of numbers, got {name!r} with {array.dtype}")
    if not array.sizes["env"]:
        state = "begun" if "time" in dims else "finished"
        raise ValueError(f"{what} {name!r} is of no environment yet: none is {state}; resume the run")
    return array.transpose(*dims, ...)


def frozen(outcome: xr.Dataset) -> NDArray[np.int64]:
    """Returns the numbers of the environments that are frozen, as far as ``outcome`` tells."""
    return _in_state(outcome, "FROZEN")[0]


def end_times(outcome: xr.Dataset, envs: NDArray[np.int64]) -> Array:
    """Returns when each of ``envs`` was stopped [s], (env,), as far as ``outcome`` tells; infinite: it was not."""
    at, positions = _in_state(outcome, "STOPPED")
    ends = dict(zip(at.tolist(), outcome["end_time"].values[positions].tolist(), strict=True)) if len(at) else {}
    return np.array([ends.get(env, np.inf) for env in envs.tolist()], dtype=np.float64)


def _in_state(outcome: xr.Dataset, state: str) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Returns the numbers of the environments in a state, as far as ``outcome`` tells, and their places."""
    status = outcome.get("status")
    if status is None:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.intp)
    found = [code for code, word in words_of(status).items() if word.upper() == state]
    positions = np.flatnonzero(np.isin(status.values, found))
    return numbers(status)[positions], positions


def numbers(array: xr.DataArray) -> NDArray[np.int64]:
    """Returns the numbers of the environments of ``array`` (env, …)."""
    return np.asarray(array["env"].values if "env" in array.coords else np.arange(array.sizes["env"]))


def usable_outcome(run: ExperimentResults, outcome: xr.DataArray, missing: str) -> tuple[Array, NDArray[np.bool_]]:
    """Returns an outcome as (envs, numbers), and which environments can be used.

    Args:
        run: Its run.
        outcome: The outcome (env, …).
        missing: ``"refuse"``: all have to.

    Raises:
        ValueError: If they have to and do not; names the first ones.
    """
    checks.choice("missing", missing, MISSING)
    values = outcome.values.astype(np.float64).reshape(outcome.sizes["env"], -1)
    halted = np.isin(numbers(outcome), frozen(run.outcome))
    finite = np.asarray(np.isfinite(values).all(axis=1))
    check_usable(numbers(outcome), halted, finite, str(outcome.name), missing)
    return values, finite & ~halted


def check_usable(
    envs: NDArray[np.int64], halted: NDArray[np.bool_], finite: NDArray[np.bool_], name: str, missing: str
) -> None:
    """Raises ``ValueError`` about environments that are frozen or not finite, unless they may be missing."""
    bad = np.flatnonzero(halted | ~finite)
    if missing == "drop" or not len(bad):
        return
    named = ", ".join(f"{envs[i]} ({'frozen' if halted[i] else 'not finite'})" for i in bad[:NAMED])
    more = f" and {len(bad) - NAMED} more" if len(bad) > NAMED else ""
    raise ValueError(
        f"{name!r} cannot be used in {len(bad)} of {len(envs)} environments: {named}{more}; "
        "missing='drop' leaves them out"
    )


def remaining_dims(
    array: xr.DataArray, *without: str
) -> tuple[tuple[Hashable, ...], tuple[int, ...], dict[Any, Any]]:
    """Returns the dimensions of ``array`` other than those, their sizes, and the coordinates along them."""
    dims = tuple(dim for dim in array.dims if dim not in without)
    coords = {key: coord for key, coord in array.coords.items() if set(coord.dims) <= set(dims)}
    return dims, tuple(array.sizes[dim] for dim in dims), coords


def probability(name: str, value: Any) -> float:
    """Returns ``value`` if it is between 0 and 1, or raises ``ValueError``."""
    number = float(checks.numbers(name, value, ()))
    if not 0.0 < number < 1.0:
        raise ValueError(f"{name} must be greater than 0 and less than 1, got {value!r}")
    return number
