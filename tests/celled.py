"""Has meshes get cells on the CPU as well."""

from types import SimpleNamespace

from warpcontact import build, cells


def cells_everywhere(monkeypatch):
    """Makes cells for models on the CPU, which does not search in them."""
    a_gpu = SimpleNamespace(is_cuda=True)
    monkeypatch.setattr(build, "grids_about", lambda made, _, t: cells.grids_about(made, a_gpu, t))
