"""Result arrays of recorded sensors, and ring buffers on GPUs.

On a CPU, launches copy sensor values to the results, in the same graph as the steps (``frame_copies.py``): stepping
evicts the interpreter from the core's cache, so a call from Python takes longer than copying a slice. On a GPU, frames
are collected in a buffer and copied to the host together when it is full.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.model.environments import Environments
from warpcontact.model.model import DeviceModel
from warpcontact.stepping.frame_copies import FrameCopies
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.resources import HOST

# Size of the buffer of a sensor on a GPU, unless one frame is larger [bytes].
RING_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Frame:
    """Size of one frame of a sensor for one environment.

    Attributes:
        name: Name of the sensor.
        device: Size of the source array on the device [bytes].
        host: Size of the reported values on the host [bytes].
    """

    name: str
    device: int
    host: int

    def slots(self, envs: int, frames: int) -> int:
        """Returns the number of frames of the buffer on the device."""
        return min(frames, max(1, RING_BYTES // max(1, envs * self.device)))

    def memory_items(self, device: str, envs: int, frames: int, blocks: int = 1) -> list[MemoryItem]:
        """Returns the memory of ``blocks`` result arrays on the host and, on a GPU, of the buffer on ``device``."""
        slots, result = self.slots(envs, frames), blocks * frames * self.host
        memory_items = [MemoryItem("recording", HOST, envs * result, result)]
        if not wp.get_device(device).is_cpu:
            # Between 1 and all frames, the buffer has about ``RING_BYTES`` for any number of environments.
            grows = slots in (1, frames)
            memory_items.append(
                MemoryItem("buffers", device, slots * envs * self.device, slots * self.device if grows else 0)
            )
        return memory_items


class Channel:
    """Results of one sensor on the host, and its buffers on GPUs; valid after ``allocate``.

    Attributes:
        result: Result array of the current block (frame, env, …), one of ``results``.
        results: One result array per block of frames.
    """

    def __init__(self, model: Environments, name: str) -> None:
        self.model = model
        self.sensor = model.find_sensor(name)
        source = self.sensor.array(model.parts[0].arrays)
        row = prod(source.shape[1:]) * wp.types.type_size_in_bytes(source.dtype)
        # Reported value of one environment, for shape and dtype.
        self._sample = self.sensor.finish(source[:1].numpy()[None], axis=2)[0, 0]
        self.frame = Frame(name, row, self._sample.nbytes)
        self.result = np.zeros((0, model.envs, *self._sample.shape), dtype=self._sample.dtype)
        self.results = [self.result]
        self.rings: dict[DeviceModel, Ring] = {}

    @shared_capture_lock()
    def allocate(self, frames: int, blocks: Sequence[Mapping[DeviceModel, FrameCopies]]) -> None:
        """Allocates ``frames`` frames per block, and registers the results of parts on the CPU in ``blocks``."""
        shape = (frames, self.model.envs, *self._sample.shape)
        self.results = [np.zeros(shape, dtype=self._sample.dtype) for _ in blocks]
        for part, own in self.model.shares():
            for copies, result in zip(blocks, self.results, strict=True):
                if part in copies:
                    copies[part].add(part.sensors[self.frame.name], result[:, own])
            if not part.device.is_cpu:
                self.rings[part] = Ring(part, self.frame, own, frames)
        self.begin(0)

    def begin(self, block: int) -> None:
        """Selects a block and starts at its first frame. Frames still in device buffers are discarded."""
        self.result = self.results[block]
        self.continue_from(0)

    def drain(self) -> None:
        """Copies all frames in device buffers to the host."""
        for ring in self.rings.values():
            ring.drain(self.result)

    def continue_from(self, count: int) -> None:
        """Sets the number of recorded frames to ``count``. Frames still in device buffers are discarded."""
        for ring in self.rings.values():
            ring.taken = ring.drained = count


class Ring:
    """Buffer on a GPU for the frames of one sensor of a part.

    Args:
        part: The part.
        frame: Sensor and size of a frame.
        own: Range of the part in all environments.
        frames: Maximum number of frames until ``drain``.
    """

    def __init__(self, part: DeviceModel, frame: Frame, own: slice, frames: int) -> None:
        self.sensor = part.sensors[frame.name]
        self.source = self.sensor.array(part.arrays)
        self.own = own
        shape = (frame.slots(part.envs, frames), *self.source.shape)
        self.memory = wp.zeros(shape, dtype=self.source.dtype, device=part.device)
        self.taken = 0
        self.drained = 0

    @shared_capture_lock()
    def take(self, number: int, result: NDArray[Any]) -> None:
        """Copies the sensor into the buffer as frame ``number``; drains to ``result`` if the buffer is full."""
        wp.copy(self.memory[number - self.drained], self.source)
        self.taken = number + 1
        if self.taken - self.drained == len(self.memory):
            self.drain(result)

    def drain(self, result: NDArray[Any]) -> None:
        """Copies the buffered frames to ``result`` (frame, env, …) on the host, which has all environments."""
        count = self.taken - self.drained
        if count:
            values = self.sensor.finish(self.memory.numpy()[:count], axis=2)
            result[self.drained : self.taken, self.own] = values
            self.drained = self.taken
