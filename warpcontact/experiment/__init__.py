"""Experiments from TOML files or dictionaries: validation, execution and results in a folder."""

from typing import TYPE_CHECKING

from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.experiment import Experiment
from warpcontact.kernels.catalogue.names import lazy_names

if TYPE_CHECKING:
    from warpcontact.experiment.records import RunDataError
    from warpcontact.experiment.run import Run, open_run

__all__ = ["Experiment", "ExperimentError", "Run", "RunDataError", "open_run"]

if not TYPE_CHECKING:  # a type checker would accept any name from __getattr__
    __getattr__, __dir__ = lazy_names(__name__, {"Run": "run", "RunDataError": "records", "open_run": "run"}, {})
