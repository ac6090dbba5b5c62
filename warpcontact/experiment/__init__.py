"""Experiments from TOML files or dictionaries: checked as a whole, run, and written into a folder."""

from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.experiment import Experiment
from warpcontact.experiment.result import Run

__all__ = ["Experiment", "ExperimentError", "Run"]
