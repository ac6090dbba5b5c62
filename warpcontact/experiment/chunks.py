"""The chunks of the arrays of a store, as bytes: those that Zarr would write, made without its pipeline.

Zarr hands a chunk from thread to thread, compares it with the empty value and copies it, and its file has to be
read again for a check sum. For a block of frames that takes the processor half as long again, and threads that
write twice as long, as to call what Zarr compresses with, Numcodecs and google-crc32c, for a chunk as a whole.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.experiment.expected import ChunkGrid
from warpcontact.experiment.records import RunDataError
from warpcontact.files.direct_io import DirectFile
from warpcontact.files.run_folder import RunPath

if TYPE_CHECKING:
    import xarray as xr
    import zarr
    from zarr.abc.codec import BytesBytesCodec


def compressors(layout: "xr.DataArray") -> "tuple[BytesBytesCodec, ...]":
    """Returns how chunks of an array are compressed, with a check sum: a chunk that was changed is no chunk."""
    from zarr.codecs import BloscCodec, Crc32cCodec, ZstdCodec

    if "item" in layout.dims:
        # Most of many points are in the air, and their values 0: Zstandard leaves a third of what others do.
        return (ZstdCodec(level=1, checksum=True),)
    # Of what moves, bits in the order of their places are shorter, and take half the time.
    return BloscCodec(cname="lz4", clevel=5, shuffle="bitshuffle"), Crc32cCodec()


@dataclass(frozen=True)
class Chunk:
    """Values of a chunk, at its begin; the rest of it is empty.

    Attributes:
        array: Whose chunk it is.
        name: Its file, in the folder of the array.
        values: In the order of the axes of the array.
    """

    array: "ChunkEncoder"
    name: str
    values: NDArray[Any]

    def write(self, path: RunPath) -> tuple[int, str]:
        """Writes the file, in a folder that there is; returns its size [bytes] and SHA-256."""
        size, sha = 0, hashlib.sha256()
        with DirectFile(path.create) as file:
            for part in self.array.encoded(self.values):
                file.write(part)
                sha.update(part)
                size += len(part)
        return size, sha.hexdigest()


class ChunkEncoder:
    """The chunks of an array.

    Args:
        array: The array, which has been made.

    Attributes:
        grid: How the array is divided.

    Raises:
        RunDataError: If it is compressed as no run compresses any.
    """

    def __init__(self, array: "zarr.Array[Any]") -> None:
        self._sizes = array.chunks
        self._dtype, self._empty = array.dtype, array.fill_value
        # As it is stored.
        described: dict[str, Any] = array.metadata.to_dict()
        first, *codecs = (dict(codec) for codec in described["codecs"])
        self._checked = [codec["name"] for codec in codecs[1:]] == ["crc32c"]
        known = first["name"] == "bytes" and len(codecs) == 1 + self._checked
        if not known or codecs[0]["name"] not in ("blosc", "zstd"):
            raise RunDataError(f"{array.store_path}: is compressed by {codecs}, which no run does")
        self._dims: tuple[str, ...] = tuple(described["dimension_names"])
        self.grid = ChunkGrid(self._dims, array.shape, array.chunks)
        self._compressor = _compressor(**codecs[0])

    def split(self, values: NDArray[Any], first_env: int, stop_env: int, first_frame: int) -> Iterator[Chunk]:
        """Yields the chunks that have values other than the empty one, each once.

        Args:
            values: (…, env, …), of environments from ``first_env`` on; with frames (time, env, …) no more than a
                chunk has.
            first_env: The first environment, at the begin of a chunk.
            stop_env: The one behind the last; those from it on are left out.
            first_frame: Number of the first frame, at the begin of a chunk.
        """
        if not values.size:
            return
        axis = self._dims.index("env")
        own = values[(slice(None),) * axis + (slice(stop_env - first_env),)]
        for start in range(0, own.shape[axis], self._sizes[axis]):
            first = {"env": first_env + start, "time": first_frame}
            place = (first.get(dim, 0) // size for dim, size in zip(self._dims, self._sizes, strict=True))
            some = own[(slice(None),) * axis + (slice(start, start + self._sizes[axis]),)]
            if not self._is_empty(some):
                yield Chunk(self, "/".join(("c", *map(str, place))), some)

    def frames_of(self, values: NDArray[Any]) -> int:
        """Returns the number of frames of values; 0 of an array without them."""
        return values.shape[self._dims.index("time")] if "time" in self._dims else 0

    def _is_empty(self, values: NDArray[Any]) -> bool:
        """Whether all values are the empty one: Zarr writes no file of these either."""
        return self._are_empty(values.flat[0]) and self._are_empty(values)

    def _are_empty(self, values: Any) -> bool:
        return bool(np.all(np.isnan(values) if self._dtype.kind == "f" else values == self._empty))

    def encoded(self, values: NDArray[Any]) -> list[bytes]:
        """Returns what stands in the file of a chunk that begins with ``values``, in parts."""
        import google_crc32c

        whole = values
        if values.shape != self._sizes:
            whole = np.full(self._sizes, self._empty, self._dtype)
            whole[tuple(map(slice, values.shape))] = values
        content = self._compressor.encode(np.ascontiguousarray(whole, self._dtype))
        if not self._checked:
            return [content]
        return [content, google_crc32c.value(content).to_bytes(4, "little")]


def _compressor(name: str, configuration: dict[str, Any]) -> Any:
    """Returns what compresses as a codec of Zarr says, by the name and settings that it is stored with."""
    import numcodecs

    if name == "zstd":
        return numcodecs.Zstd(level=configuration["level"], checksum=configuration["checksum"])
    shuffles = {"noshuffle": 0, "shuffle": 1, "bitshuffle": 2}
    # The size of an item is that of the values.
    return numcodecs.Blosc(
        cname=configuration["cname"],
        clevel=configuration["clevel"],
        shuffle=shuffles[configuration["shuffle"]],
        blocksize=configuration["blocksize"],
    )
