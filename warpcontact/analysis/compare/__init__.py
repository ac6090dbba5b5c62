"""Comparison of normal laws and of friction models, measured with the simulator: data sets and plots."""

from warpcontact.analysis.compare.friction_picture import plot_friction_models
from warpcontact.analysis.compare.friction_tests import slips, swings
from warpcontact.analysis.compare.impact import impacts, rebounds
from warpcontact.analysis.compare.law_picture import plot_laws
from warpcontact.files.picture_file import check_path
from warpcontact.kernels.catalogue.names import explain_renamed_in

__all__ = ["check_path", "impacts", "plot_friction_models", "plot_laws", "rebounds", "slips", "swings"]

__getattr__ = explain_renamed_in(__name__, __all__)
