"""Access to the results of a run and selection of the environments that an analysis can use."""

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
# Largest number of environments listed in a message.
NAMED = 5


class ResultSource(Protocol):
    """Results of a run.

    Attributes:
        outcome: Summaries (env, …) by name. The optional ``status`` flags frozen and stopped environments;
            ``end_time`` is the time of the stop [s].
        series: Sensors (time, env, …) by name.
    """

    @property
    def outcome(self) -> xr.Dataset:
        """Summaries (env, …) by name."""

    @property
    def series(self) -> xr.Dataset:
        """Sensors (time, env, …) by name."""


class ExperimentResults(ResultSource, Protocol):
    """Results of an experiment.

    Attributes:
        settings: Settings of the experiment, with all defaults.
    """

    @property
    def settings(self) -> Settings:
        """Settings of the experiment, with all defaults."""


def variable(data: xr.Dataset, name: str, what: str, *dims: str) -> xr.DataArray:
    """Returns a numeric variable, transposed to begin with ``dims``, which include ``"env"``.

    Raises:
        ValueError: If there is no such variable, or no environment has a value yet. ``what`` names it in the message.
    """
    available = [str(key) for key, array in data.data_vars.items() if set(dims) <= set(array.dims)]
    requested, name = name, stored_name(name)
    if name not in available:
        hint = suggestion(requested, available) or f"; there are: {', '.join(available) or 'none'}"
        raise ValueError(f"{what} must be one of the run, got {requested!r}{hint}")
    array = data[name]
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{what} must be numeric, got {name!r} with {array.dtype}")
    if not array.sizes["env"]:
        state = "started" if "time" in dims else "finished"
        raise ValueError(f"{what} {name!r} has no values yet, because no environment is {state}; resume the run")
    return array.transpose(*dims, ...)


def frozen(outcome: xr.Dataset) -> NDArray[np.int64]:
    """Returns the numbers of the frozen environments; empty if ``outcome`` has no ``status``."""
    return _in_state(outcome, "FROZEN")[0]


def end_times(outcome: xr.Dataset, envs: NDArray[np.int64]) -> Array:
    """Returns the stop time of each of ``envs`` [s], (env,); infinite if it was not stopped."""
    at, positions = _in_state(outcome, "STOPPED")
    ends = dict(zip(at.tolist(), outcome["end_time"].values[positions].tolist(), strict=True)) if len(at) else {}
    return np.array([ends.get(env, np.inf) for env in envs.tolist()], dtype=np.float64)


def _in_state(outcome: xr.Dataset, state: str) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Returns the numbers of the environments in a state, and their positions in ``outcome``."""
    status = outcome.get("status")
    if status is None:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.intp)
    found = [code for code, word in words_of(status).items() if word.upper() == state]
    positions = np.flatnonzero(np.isin(status.values, found))
    return numbers(status)[positions], positions


def numbers(array: xr.DataArray) -> NDArray[np.int64]:
    """Returns the environment numbers of ``array`` (env, …)."""
    return np.asarray(array["env"].values if "env" in array.coords else np.arange(array.sizes["env"]))


def usable_outcome(run: ExperimentResults, outcome: xr.DataArray, missing: str) -> tuple[Array, NDArray[np.bool_]]:
    """Returns an outcome as (env, number), and which environments can be used.

    Args:
        run: Run with the outcome.
        outcome: Outcome (env, …).
        missing: ``"refuse"``: raise an error if any environment cannot be used. ``"drop"``: do not.

    Raises:
        ValueError: If ``missing`` is ``"refuse"`` and some environments cannot be used; names the first ones.
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
    """Raises ``ValueError`` if environments are frozen or not finite, unless ``missing`` is ``"drop"``."""
    invalid = np.flatnonzero(halted | ~finite)
    if missing == "drop" or not len(invalid):
        return
    named = ", ".join(f"{envs[i]} ({'frozen' if halted[i] else 'not finite'})" for i in invalid[:NAMED])
    more = f" and {len(invalid) - NAMED} more" if len(invalid) > NAMED else ""
    raise ValueError(
        f"{name!r} cannot be used in {len(invalid)} of {len(envs)} environments: {named}{more}; "
        "pass missing='drop' to ignore them"
    )


def remaining_dims(
    array: xr.DataArray, *without: str
) -> tuple[tuple[Hashable, ...], tuple[int, ...], dict[Any, Any]]:
    """Returns the dimensions of ``array`` except ``without``, their sizes, and the coordinates along them."""
    dims = tuple(dim for dim in array.dims if dim not in without)
    coords = {key: coord for key, coord in array.coords.items() if set(coord.dims) <= set(dims)}
    return dims, tuple(array.sizes[dim] for dim in dims), coords


def probability(name: str, value: Any) -> float:
    """Returns ``value`` as a float; raises ``ValueError`` unless 0 < ``value`` < 1."""
    number = float(checks.numbers(name, value, ()))
    if not 0.0 < number < 1.0:
        raise ValueError(f"{name} must be greater than 0 and less than 1, got {value!r}")
    return number
