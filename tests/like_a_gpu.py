"""Has a CPU go the ways of a GPU, with one thread."""

from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.piles import force
from warpcontact.kernels.types import QUEUES

from warpcontact import build, cells, simulation
from warpcontact.schedule import Span


def cells_everywhere(monkeypatch, finest=0.6):
    """Builds face grids for models on the CPU, which otherwise has none.

    ``finest``: Smallest cell size, in edges: one thread fills the grid, so coarser than that of a GPU.
    """
    a_gpu = SimpleNamespace(is_cuda=True)
    monkeypatch.setattr(cells, "FINEST", finest)
    monkeypatch.setattr(build, "grids_about", lambda made, _, t: cells.grids_about(made, a_gpu, t))


def with_queues(monkeypatch):
    """Has contacts looked at as on a GPU."""

    def queued(model, count, cached, ordered, _queued, hard, **own):
        tasks, contacts = model.envs * model.blocks.count, model.envs * model.contact_count
        cache = model.arrays.cache
        cache.waiting_block = wp.zeros(tasks, dtype=wp.int32, device="cpu")
        cache.waiting_contact = wp.zeros((QUEUES, contacts), dtype=wp.int32, device="cpu")
        return Span(model, count, cached, ordered, queued=True, hard=hard, **own)

    monkeypatch.setattr(simulation, "Span", queued)
    # A GPU looks at frames with nothing remembered: its lists are shorter than those of a CPU.
    monkeypatch.setattr(
        "warpcontact.model.Span",
        lambda model, count, _cached, **options: Span(model, count, cached=False, **options),
    )
    monkeypatch.setattr(simulation, "slice_sizes", lambda shares, _: [envs for _, envs in shares])


def sum_by_body(pile):
    """Has touches be added up by body, not as they are found."""
    assert pile._alone
    pile._alone = False
    pile._kernel = force.kernel(pile._parts, pile._form, pile.real, moves=False, alone=False)
