"""Experiments from TOML files or dictionaries: checked as a whole, run, and written into a folder."""

from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.experiment import Experiment
from warpcontact.experiment.run import Run, open_run
from warpcontact.experiment.store import StoreError

__all__ = ["Experiment", "ExperimentError", "Run", "StoreError", "open_run"]
