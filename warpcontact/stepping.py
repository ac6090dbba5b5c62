"""What stepping takes beside the model: a second buffer of the state, and the prepared launches and graphs."""

import ctypes
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import warp as wp

from warpcontact.arrays import Layout, per_env
from warpcontact.available import HOST
from warpcontact.crew import available_threads
from warpcontact.footprint import Need
from warpcontact.integrators import Integrator, SemiImplicitEuler
from warpcontact.schedule import Span
from warpcontact.slices import Slice, Times

if TYPE_CHECKING:
    from warpcontact.draft import Draft
    from warpcontact.model import Model

# Of the cache of a core that a slice may fill, and what a contact and a body take of it; measured.
CACHE_BYTES = 512 * 1024
CONTACT_BYTES = 300
BODY_BYTES = 400
LARGEST_SLICE = 128

# What a prepared launch takes, a graph, and what is captured in it for each byte of the arguments of its launches,
# which are kept with the places of all pointers among them; measured with Warp 1.19 (tests/test_memory_plan.py).
LAUNCH_BYTES = 1800
GRAPH_BYTES = 50_000
CAPTURED = 2.05
# What a kernel is told of an array: pointers, shape and strides.
ARRAY_BYTES = 56


class _Tally(Span):
    """Lists kernels in place of launches."""

    def prepare(self, kernel: wp.Kernel, items: int, inputs: list[Any], *_: Any, **__: Any) -> list[Any]:
        """Returns the kernel that would be launched; none if there is no work."""
        return [kernel] if items else []


@dataclass(frozen=True)
class Buffers:
    """The arrays of a simulation.

    Attributes:
        other: A state that steps go to and come back from.
        times: Lengths of steps (1, 1) by name, in the order in which they were given, once they are allocated.
    """

    other: Any
    times: dict[str, wp.array]


def declare_buffers(layout: Layout, model: "Model | Draft", lengths: tuple[float, ...] = (0.0,) * 4) -> Buffers:
    """Declares the arrays of a simulation with steps of these lengths [s]."""
    times = SimpleNamespace()
    for number, length in enumerate(lengths):
        layout.content("stepping", times, f"of_{number}", [[length]], model.types.real)
    return Buffers(layout.struct("stepping", model.types.State, per_env(model.body_count)), vars(times))


def slice_size(model: "Model | Draft", envs: int, threads: int) -> int:
    """Returns how many environments a slice has: as many as fit into the cache of a core, and enough slices."""
    if model.device.is_cuda:
        return envs
    per_slice = CONTACT_BYTES * model.contact_count + BODY_BYTES * model.body_count
    return max(1, min(CACHE_BYTES // per_slice, LARGEST_SLICE, -(-envs // threads)))


def stepping_needs(
    model: "Model | Draft",
    envs: int,
    integrator: Integrator | None = None,
    *,
    crossing_steps: int = 1,
    threads: int | None = None,
    distance_cache: bool = True,
    graphs: bool = True,
) -> list[Need]:
    """Returns what a ``Simulation`` takes that steps ``envs`` environments; the options are those of its class."""
    layout = Layout(model.device)
    buffers = declare_buffers(layout, model)
    # Nothing is launched, so that a draft does as well.
    queued = model.device.is_cuda
    span = _Tally(cast("Model", model), 0, 1, distance_cache, ordered=not queued, queued=queued)
    times = Times(None, None, None, None)
    one = Slice(
        span, integrator or SemiImplicitEuler(), times, buffers.other, parts=crossing_steps, captured=graphs
    )
    size = LAUNCH_BYTES * sum(len(launches) for launches in one.launches())
    for steps in one.graph_steps:
        if graph := one.graph(steps):
            size += GRAPH_BYTES + int(CAPTURED * sum(map(_argument_bytes, graph)))
    threads = available_threads() if threads is None else threads
    slices = -(-envs // slice_size(model, envs, threads))
    # The first environments of each thread make its slice longer.
    grows = size / slice_size(model, LARGEST_SLICE * threads, threads) if slices > threads else 0.0
    return [*layout.needs(envs), Need("launches", HOST, slices * size, grows)]


def _argument_bytes(kernel: wp.Kernel) -> int:
    """Returns the size of the arguments of a kernel."""
    return sum(_size(argument.type) for argument in kernel.adj.args)


def _size(kind: Any) -> int:
    if isinstance(kind, wp.array):
        return ARRAY_BYTES
    return ctypes.sizeof(kind.ctype) if hasattr(kind, "ctype") else wp.types.type_size_in_bytes(kind)
