"""Analysis of the results of many environments: sensitivity indices, quantiles over time, convergence."""

from warpcontact.analysis.fan import quantile_fan, write_fan
from warpcontact.analysis.statistics import convergence, sensitivity

__all__ = ["convergence", "quantile_fan", "sensitivity", "write_fan"]
