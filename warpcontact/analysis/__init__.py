"""Analysis of the results of many environments: sensitivity indices, quantiles over time, convergence."""

from warpcontact.analysis.fan import quantile_fan
from warpcontact.analysis.picture import write_fan
from warpcontact.analysis.statistics import convergence
from warpcontact.analysis.variance import sensitivity

__all__ = ["convergence", "quantile_fan", "sensitivity", "write_fan"]
