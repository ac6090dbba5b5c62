"""Measures bounds for a step without caches: a closest-point query for every point, and a copy of the state."""

import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import warp as wp

from warpcontact.benchmark.scenes import Array, BenchmarkScene
from warpcontact.kernels.narrowphase.bare_query import kernel
from warpcontact.model.model import DeviceModel
from warpcontact.system.compilation import compile_as_launched

#: Largest number of measurements, each of at least ``SECONDS``, of which the median is used; fewer if they take long.
ROUNDS = 7
SECONDS = 0.01
MIN_SAMPLE_SECONDS = 1.0
#: Sensor with the positions of the queries.
POSITION = "body.position"
# Number of repetitions in one graph of a GPU.
IN_GRAPH = 16


class Limits(NamedTuple):
    """Times per environment of the minimum work of a step [s].

    Attributes:
        query: A closest-point query of Warp for every point.
        copy: A copy of the state on the device.
    """

    query: float
    copy: float


def load_query(device: wp.Device) -> wp.Kernel:
    """Returns the kernel of closest-point queries; compiles it if it is not in the cache."""
    bare_query = kernel()
    compile_as_launched(bare_query, device)
    return bare_query


def limits(model: DeviceModel, scene: BenchmarkScene, threads: int) -> Limits:
    """Measures the bounds for a scene at the current state of its model.

    Args:
        model: Model of the scene.
        scene: The scene.
        threads: Number of CPU threads over which the environments are split; ignored on a GPU.
    """
    device = model.device
    bare_query = load_query(device)  # before threads start
    # In Warp's debug mode, kernels share a pointer and cannot run concurrently.
    parts = 1 if device.is_cuda or wp.config.mode == "debug" else min(threads, model.envs)
    envs = np.array_split(np.arange(model.envs), parts)
    surface = scene.surface
    mesh = wp.Mesh(
        points=wp.array(surface.vertices, dtype=wp.vec3f, device=device),
        indices=wp.array(surface.faces.ravel(), dtype=wp.int32, device=device),
        bvh_constructor="sah",
    )
    places = query_points(model, scene)
    queries, copies, keep_alive = [], [], []
    for part in envs:
        points = wp.array(places[part].reshape(-1, 3), dtype=wp.vec3f, device=device)
        found = wp.zeros(len(points), dtype=wp.int32, device=device)
        launch = wp.launch(
            bare_query, dim=len(points), inputs=[mesh.id, points, found], device=device, record_cmd=True
        )
        queries.append(launch.launch)
        keep_alive.append((points, found))  # a recorded launch does not hold references to its arrays
        source = wp.zeros(len(part) * _state_bytes(model), dtype=wp.uint8, device=device)
        copies.append(_copy(wp.zeros_like(source), source))
    with ThreadPoolExecutor(len(envs)) as pool:
        query, copy = (_seconds(tasks, pool, device) / model.envs for tasks in (queries, copies))
    return Limits(query, copy)


def query_points(model: DeviceModel, scene: BenchmarkScene) -> Array:
    """Returns the positions of the points, (envs, points, 3), world frame [m]."""
    position = model.sensor(POSITION)[:, None]
    if scene.points is None:
        return position
    orientation = model.sensor("body.orientation")[:, None]
    axis, w = orientation[..., :3], orientation[..., 3:]
    turned = np.cross(axis, scene.points) * 2.0
    return position + scene.points + w * turned + np.cross(axis, turned)


def _state_bytes(model: DeviceModel) -> int:
    """Returns the size of the state of an environment [bytes]."""
    state = model.arrays.state
    return sum(getattr(state, name).capacity for name in state._cls.vars) // model.envs


def _copy(target: wp.array, source: wp.array) -> Callable[[], None]:
    return lambda: wp.copy(target, source)


def _seconds(tasks: Sequence[Callable[[], None]], pool: ThreadPoolExecutor, device: wp.Device) -> float:
    """Returns the time of executing all ``tasks`` once, concurrently [s]."""
    if device.is_cuda:
        several = _captured(tasks[0], device)
        return _median(lambda count: _repeat(several, count), device) / IN_GRAPH

    def all_parts(count: int) -> None:
        # Each thread repeats its own work, so that synchronization counts once.
        for future in [pool.submit(_repeat, task, count) for task in tasks]:
            future.result()

    return _median(all_parts, device)


def _captured(task: Callable[[], None], device: wp.Device) -> Callable[[], None]:
    """Returns a graph with ``IN_GRAPH`` repetitions of ``task``, so that launch overhead on the host is negligible."""
    with wp.ScopedCapture(device=device) as capture:
        _repeat(task, IN_GRAPH)
    return lambda: wp.capture_launch(capture.graph)


def _repeat(task: Callable[[], None], count: int) -> None:
    for _ in range(count):
        task()


def _median(repeat: Callable[[int], None], device: wp.Device) -> float:
    """Returns the median time of ``repeat(count)`` per repetition [s]; ``count`` grows until the clock resolves it."""
    repeat(1)
    times: list[float] = []
    count = 1
    while len(times) < ROUNDS and count * sum(times) < MIN_SAMPLE_SECONDS:
        wp.synchronize_device(device)
        start = time.perf_counter()
        repeat(count)
        wp.synchronize_device(device)
        elapsed = time.perf_counter() - start
        if elapsed < SECONDS and not times:
            count *= 2
        else:
            times.append(elapsed / count)
    return statistics.median(times)
