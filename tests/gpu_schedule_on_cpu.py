"""Makes a CPU use the schedules of a GPU, with one thread."""

from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.particles import force
from warpcontact.kernels.types import QUEUE_COUNT

from warpcontact.forces.execution_plan import ExecutionPlan
from warpcontact.geometry import face_grid
from warpcontact.model import build
from warpcontact.stepping import step_preparation


def build_all_face_grids(monkeypatch, finest=0.6):
    """Builds face grids for models on the CPU, which otherwise has none.

    ``finest``: Smallest cell size, relative to the edge length; coarser than on a GPU, because one thread fills
    the grid.
    """
    a_gpu = SimpleNamespace(is_cuda=True)
    monkeypatch.setattr(face_grid, "FINEST", finest)
    monkeypatch.setattr(build, "make_grids", lambda made, _, t: face_grid.make_grids(made, a_gpu, t))


def use_work_queues(monkeypatch):
    """Makes contact detection use the work queues of a GPU."""

    def queued(model, count, cached, ordered, _queued, nonsmooth, **own):
        tasks, contacts = model.envs * model.clusters.count, model.envs * model.contact_count
        cache = model.arrays.cache
        cache.queue_clusters = wp.zeros(tasks, dtype=wp.int32, device="cpu")
        cache.queue_contacts = wp.zeros((QUEUE_COUNT, contacts), dtype=wp.int32, device="cpu")
        return ExecutionPlan(
            model, count, cached, ordered, one_thread_per_contact=True, nonsmooth=nonsmooth, **own
        )

    monkeypatch.setattr(step_preparation, "ExecutionPlan", queued)
    # A GPU evaluates frames without cached distances, because its face caches are smaller than those of a CPU.
    monkeypatch.setattr(
        "warpcontact.model.model.ExecutionPlan",
        lambda model, count, _cached, **options: ExecutionPlan(model, count, uses_cache=False, **options),
    )
    monkeypatch.setattr(step_preparation, "slice_sizes", lambda shares, _: [envs for _, envs in shares])


def sum_by_body(contact_set):
    """Sums contact forces of particles per body, instead of adding each one immediately."""
    assert contact_set._single_thread
    contact_set._single_thread = False
    contact_set._kernel = force.kernel(
        contact_set._parts, contact_set._traits, contact_set.real, has_joints=False, single_thread=False
    )
