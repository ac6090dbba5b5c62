"""Reads rows of four vectors from face tables with 16-byte loads, because loads dominate the time on a GPU."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.switches import is_enabled


@functools.cache
def row_of(real: type) -> wp.Function:
    """Returns the device function that reads a row of a table with four vectors per row."""
    Table = wp.array2d(dtype={wp.float32: wp.vec3f, wp.float64: wp.vec3d}[real])
    Row = wp.types.matrix(shape=(4, 3), dtype=real)
    scalar = {wp.float32: "wp::float32", wp.float64: "wp::float64"}[real]

    if not is_enabled("vector_loads"):

        @wp.func
        def row_by_vectors(table: Table, row: int):
            vectors = Row()
            for k in range(4):
                vectors[k] = table[row, k]
            return vectors

        return row_by_vectors

    # The size of a row is a multiple of 16 bytes, and tables are separate allocations, so rows are aligned.
    @wp.func_native(
        f"""
        assert(row >= 0 && row < table.shape[0]);
        wp::mat_t<4, 3, {scalar}> read;
        const char* from = reinterpret_cast<const char*>(table.data) + size_t(row) * table.strides[0];
        #if defined(__CUDA_ARCH__)
        #pragma unroll
        for (unsigned at = 0; at < sizeof(read); at += 16) {{
            const float4 some = *reinterpret_cast<const float4*>(from + at);
            memcpy(reinterpret_cast<char*>(&read) + at, &some, 16);
        }}
        #else
        memcpy(&read, from, sizeof(read));
        #endif
        return read;
        """
    )
    def row_of(table: Table, row: int) -> Row: ...

    return row_of
