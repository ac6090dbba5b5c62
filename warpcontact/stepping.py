"""What stepping takes beside the model: slices of environments, kernels, and memory for launches and graphs."""

import ctypes
import functools
import itertools
from collections.abc import Collection, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any, cast

import warp as wp

from warpcontact.available import HOST, available_threads
from warpcontact.captures import beside_captures
from warpcontact.footprint import Footprint, Need, total
from warpcontact.integrators import Integrator, SemiImplicitEuler
from warpcontact.kernels import recording
from warpcontact.looks import in_parts, look_span, look_stages
from warpcontact.outcomes.watch import ContactEvents, StopCondition, Watch
from warpcontact.schedule import Span
from warpcontact.slices import FRAME_GRAPHS, Buffers, Stepper, Way

if TYPE_CHECKING:
    from warpcontact.draft import PartDraft
    from warpcontact.kernels.outcomes.base import Outcome
    from warpcontact.model import Model

# Of the cache of a core that a slice may fill, and what a contact, a body and a face take of it; measured.
CACHE_BYTES = 512 * 1024
CONTACT_BYTES = 300
BODY_BYTES = 400
FACE_BYTES = 100
LARGEST_SLICE = 256
# For faces alone slices are not made smaller: launches would take more than the cache saves.
SMALLEST_FOR_FACES = 32

# What a prepared launch takes, a graph, and what is captured in it for each byte of the arguments of its launches,
# which are kept with the places of all pointers among them; measured with Warp 1.19 (tests/test_memory_plan.py).
LAUNCH_BYTES = 1800
GRAPH_BYTES = 50_000
CAPTURED = 2.05
# What a kernel is told of an array: pointers, shape and strides.
ARRAY_BYTES = 56


class Tally(Span):
    """Lists kernels in place of launches."""

    def prepare(self, kernel: wp.Kernel, items: int, inputs: list[Any], *_: Any, **__: Any) -> list[Any]:
        """Returns the kernel that would be launched; none if there is no work."""
        return [kernel] if items else []


def slice_sizes(shares: "Sequence[tuple[Model | PartDraft, int]]", threads: int) -> list[int]:
    """Returns how many environments a slice has, by part: as fit into the cache of a core, and enough slices.

    Args:
        shares: The parts, each with how many environments it has.
        threads: How many threads step those on the CPU.
    """
    on_cpu = sum(envs for part, envs in shares if part.device.is_cpu)
    largest = min(LARGEST_SLICE, -(-on_cpu // threads))
    return [max(1, min(_largest_slice(part), largest)) if part.device.is_cpu else envs for part, envs in shares]


def cut(envs: int, size: int) -> list[slice]:
    """Returns ``envs`` environments in slices of ``size``, the last perhaps smaller."""
    return [slice(first, min(first + size, envs)) for first in range(0, envs, size)]


def _largest_slice(part: "Model | PartDraft") -> int:
    """Returns how many environments fit into the cache of a core, of many with the faces that they read."""
    each = _bytes_of(part)
    with_faces = CACHE_BYTES // (each + FACE_BYTES * part.arrays.faces_read)
    return min(CACHE_BYTES // each, max(SMALLEST_FOR_FACES, with_faces))


def _bytes_of(part: "Model | PartDraft") -> int:
    """Returns what an environment takes of a cache."""
    of_contacts = CONTACT_BYTES * (part.contact_count + part.smooth_count) + BODY_BYTES * part.body_count
    return of_contacts + sum(pile.bytes_near for pile in part.piles)


@beside_captures()
def stepping_footprint(
    shares: Sequence[tuple["Model | PartDraft", int]],
    integrator: Integrator | None = None,
    *,
    crossing_substeps: int = 1,
    threads: int | None = None,
    distance_cache: bool = True,
    capture_graphs: bool = True,
    outcomes: "Mapping[str, Outcome] | None" = None,
    stop: Mapping[str, StopCondition] | None = None,
    events: ContactEvents | None = None,
    quarantine: str = "freeze",
    looks: Set[str] | None = None,
    varied: Collection[str] = (),
) -> Footprint:
    """Returns what a ``Simulation`` takes beside the model; the options are those of its class.

    ``shares`` are the parts of the model, each with how many environments it has; the parameters ``varied`` are to
    have a value in each. ``looks`` is what sensors need that are recorded meanwhile; ``None``: none are.
    """
    threads = available_threads() if threads is None else threads
    integrator = SemiImplicitEuler() if integrator is None else integrator
    watch = Watch.of(outcomes, stop, events, quarantine)
    # As many as may have a slice; with few environments some have none.
    members = min(threads, sum(envs for part, envs in shares if part.device.is_cpu))
    footprints = []
    for part, envs in shares:
        buffers = Buffers(part, integrator, watch=watch)
        observer = buffers.observer
        # Nothing is launched, so that a draft does as well.
        queued = part.device.is_cuda
        span = Tally(
            cast("Model", part),
            1,
            distance_cache and not (observer and observer.searches),
            ordered=not queued,
            queued=queued,
            hard=buffers.hard,
        )
        one = Stepper(span, integrator, buffers, parts=crossing_substeps, captured=capture_graphs)
        size = LAUNCH_BYTES * sum(len(launches) for launches in one.launches())
        for steps in (1,) if one.in_place else one.graph_steps:
            size += _captured_bytes(one.graph(Way(steps)))
        if looks is not None and watch.quarantine == "freeze" and in_parts(part.device, buffers.hard, looks):
            tally = look_span(Tally, part, 1, buffers.hard, looks)
            look = [*look_stages(tally, looks, part.no_step, None), recording.take()]
            size += LAUNCH_BYTES * len(look)
            if one.captured:
                # By itself, and with the steps before it.
                looked = [look]
                if one.ready_after_look(looks):
                    first = one.graph(Way(1 + one.in_place, known=True))
                    size += LAUNCH_BYTES * len(first)
                    looked += [first, [*look, *first]] if one.in_place else [first]
                # Few of those that are no steps in place are smaller.
                steps = 1 if one.in_place else FRAME_GRAPHS * one.graph_steps[0]
                looked.append([*look, *one.graph(Way(steps))])
                size += sum(_captured_bytes(graph) for graph in looked)
        launches = Need("launches", HOST, size * (members if part.device.is_cpu else 1))
        needs = [*buffers.layout.needs(envs), launches]
        if observer is not None:
            # What is there already is the model's.
            missing = [name for name in observer.needs if getattr(part.arrays, name, True) is None]
            needs += part.measures_needs(part.device, missing, envs)
        if buffers.hard is not None:
            needs.append(buffers.hard.material_need(part.parameters_by_name, envs, varied))
        footprints.append(Footprint(envs, str(part.device), tuple(needs)))
    return total(footprints)


def kernels_of_steps(part: "Model", stepper: Stepper, looks: Sequence[Set[str]]) -> list[wp.Kernel]:
    """Returns the kernels that steps and frames launch, each once, the largest first.

    Args:
        part: The model.
        stepper: Its stepper, with a ``Tally`` as span.
        looks: The needs of each kind of frame, see ``Sensor.needs``.
    """
    looked = [
        look_stages(look_span(Tally, part, part.envs, part.hard, needs), needs, part.no_step, None)
        for needs in looks
    ]
    for needs in looks:
        stepper.ready_after_look(needs)
    # Looks first: these kernels are the largest.
    return list(dict.fromkeys(itertools.chain(*looked, *stepper.launches())))


def _captured_bytes(launched: list[Any]) -> int:
    """Returns what a graph of kernels takes; none if there are none."""
    return GRAPH_BYTES + int(CAPTURED * sum(map(_argument_bytes, launched))) if launched else 0


@functools.cache
def _argument_bytes(kernel: wp.Kernel) -> int:
    """Returns the size of the arguments of a kernel."""
    return sum(_size(argument.type) for argument in kernel.adj.args)


def _size(kind: Any) -> int:
    if isinstance(kind, wp.array):
        return ARRAY_BYTES
    return ctypes.sizeof(kind.ctype) if hasattr(kind, "ctype") else wp.types.type_size_in_bytes(kind)
