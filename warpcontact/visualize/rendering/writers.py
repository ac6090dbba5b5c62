"""Encoders of films: GIF and MP4, written frame by frame."""

import shutil
import struct
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpcontact.files.atomic_files import atomic_file, atomic_path
from warpcontact.visualize.rendering.painter import Picture

#: Largest frame rate that browsers play; they show shorter frames for a tenth of a second.
GIF_FASTEST = 50.0
# Time unit of a GIF [s].
_TICK = 0.01
# Number of colors of a GIF, one below the maximum: the last index marks unchanged pixels.
_COLORS = 255
# Largest duration of a frame [ticks].
_LONGEST = 2**16 - 1
# GIF extension for endless repetition.
_ENDLESS = b"!\xff\x0bNETSCAPE2.0\x03\x01\0\0\0"


def write_gif(
    path: Path, pictures: Iterable[Picture], count: int, fps: float, palette_pictures: Sequence[Picture]
) -> None:
    """Writes an endless GIF with a palette of 255 colors, chosen from some of its frames.

    Args:
        path: File to write.
        pictures: All frames, (height, width, 3) sRGB.
        count: Number of frames.
        fps: Frames per second.
        palette_pictures: Frames of equal size from which the palette is chosen.
    """
    from PIL import Image
    from PIL.GifImagePlugin import getdata

    palette = Image.fromarray(_spread(np.concatenate(palette_pictures))).quantize(
        _COLORS, method=Image.Quantize.MEDIANCUT
    )
    colors = bytes(palette.getpalette() or ())
    # Each frame ends at the tick nearest to its time, so that rounding does not accumulate.
    ticks = np.diff([round(number / fps / _TICK) for number in range(count + 1)]).tolist()
    frames = (Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    with atomic_file(path) as file:
        for number, (frame, wait) in enumerate(_changes(map(np.asarray, frames), ticks)):
            if not number:
                height, width = frame.indices.shape
                file.write(b"GIF89a" + struct.pack("<HHBBB", width, height, 0xF7, 0, 0) + colors.ljust(768, b"\0"))
                file.write(_ENDLESS)
            indices = frame.indices
            for written in range(0, wait, _LONGEST):
                ticks_of_it = min(wait - written, _LONGEST)
                about = {"duration": 1000.0 * _TICK * ticks_of_it, "transparency": _COLORS, "disposal": 1}
                file.writelines(getdata(Image.fromarray(indices), frame.corner, **about))
                # A duration beyond the limit is continued by single transparent pixels.
                indices = np.full((1, 1), _COLORS, dtype=np.uint8)
        file.write(b";")


@dataclass(frozen=True, eq=False)
class _Change:
    """Changed part of a frame.

    Attributes:
        indices: Palette indices, (height, width); ``_COLORS`` where nothing changed.
        corner: Column and row of its upper left pixel.
    """

    indices: NDArray[np.uint8]
    corner: tuple[int, int]


def _changes(pictures: Iterable[NDArray[np.uint8]], ticks: Iterable[int]) -> Iterator[tuple[_Change, int]]:
    """Yields the first frame, then the changes from frame to frame, each with its duration [ticks]."""
    before: NDArray[np.uint8] | None = None
    change, shown = _Change(np.zeros((0, 0), dtype=np.uint8), (0, 0)), 0
    for picture, wait in zip(pictures, ticks, strict=True):
        if before is None:
            before, change, shown = picture, _Change(picture, (0, 0)), wait
            continue
        changed = picture != before
        if not changed.any():
            shown += wait
            continue
        yield change, shown
        rows, columns = (np.flatnonzero(changed.any(axis=axis)) for axis in (1, 0))
        top, left = int(rows[0]), int(columns[0])
        part = np.s_[top : rows[-1] + 1, left : columns[-1] + 1]
        indices = np.where(changed[part], picture[part], np.uint8(_COLORS))
        before, change, shown = picture, _Change(indices, (left, top)), wait
    yield change, shown


def write_mp4(path: Path, pictures: Iterable[Picture], fps: float, size: tuple[int, int]) -> None:
    """Writes an H.264 film that browsers play, with the program ffmpeg.

    imageio does the same, but ignores the exit code of ffmpeg: on a full disk it would leave an incomplete film.

    Args:
        path: File to write.
        pictures: All frames, (height, width, 3) sRGB.
        fps: Frames per second.
        size: Width and height of the frames, even [pixels].

    Raises:
        ValueError: If ffmpeg is missing, or fails.
    """
    program = shutil.which("ffmpeg")
    if program is None:
        raise ValueError(f"{path}: an .mp4 file needs ffmpeg, which is not on the PATH; use a .gif file instead")
    with atomic_path(path) as part, tempfile.TemporaryFile() as messages:
        command = [
            *(program, "-hide_banner", "-loglevel", "error", "-y"),
            *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:.9g}", "-i", "-"),
            # Color space that players assume by default for video.
            *("-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p"),
            *("-color_primaries", "bt709", "-color_trc", "bt709", "-colorspace", "bt709", "-color_range", "tv"),
            *("-c:v", "libx264", "-preset", "medium", "-crf", "18"),
            *("-movflags", "+faststart", "-fflags", "+bitexact", "-flags", "+bitexact", "-f", "mp4"),
            str(part.resolve()),  # absolute, because a name with a leading "-" is an option
        ]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=messages
        ) as process:
            assert process.stdin is not None
            try:
                for picture in pictures:
                    process.stdin.write(np.ascontiguousarray(picture).data)
                process.stdin.close()
            except BrokenPipeError:
                pass  # ffmpeg reports the reason below
            except BaseException:
                process.kill()
                raise
        if process.returncode:
            messages.seek(0)
            reason = messages.read().decode(errors="replace").strip().splitlines()
            raise ValueError(
                f"{path}: ffmpeg failed: {reason[-1] if reason else f'exit code {process.returncode}'}; "
                "use a .gif file instead"
            )


def _spread(picture: Picture) -> Picture:
    """Returns a row of the colors of a picture, with frequencies damped by a root: small items keep their colors."""
    colors, counts = np.unique(picture.reshape(-1, 3) & 0xFC, axis=0, return_counts=True)
    return np.repeat(colors, np.ceil(np.sqrt(counts)).astype(int), axis=0)[None]
