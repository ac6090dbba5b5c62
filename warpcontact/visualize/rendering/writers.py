"""Files that pictures of a film go to, one after the other."""

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

#: Pictures per second that browsers still play as told; they show shorter ones for a tenth of a second.
GIF_FASTEST = 50.0
# A GIF counts time in these [s].
_TICK = 0.01
# Colours of a GIF, one fewer than there can be: the last stands for what did not change.
_COLORS = 255
# Most ticks of a picture.
_LONGEST = 2**16 - 1
# Extension of GIF that lets a film begin again.
_ENDLESS = b"!\xff\x0bNETSCAPE2.0\x03\x01\0\0\0"


def write_gif(
    path: Path, pictures: Iterable[Picture], count: int, fps: float, palette_pictures: Sequence[Picture]
) -> None:
    """Writes an endless GIF, in the 255 colours that suit some pictures of it best.

    Args:
        path: The file.
        pictures: All pictures, (height, width, 3) sRGB.
        count: How many there are.
        fps: How many of them a second has.
        palette_pictures: Some pictures, of one size, to choose colours by.
    """
    from PIL import Image
    from PIL.GifImagePlugin import getdata

    palette = Image.fromarray(_spread(np.concatenate(palette_pictures))).quantize(
        _COLORS, method=Image.Quantize.MEDIANCUT
    )
    colors = bytes(palette.getpalette() or ())
    # Each picture ends at the tick nearest to its time: rounding does not add up.
    ticks = np.diff([round(number / fps / _TICK) for number in range(count + 1)]).tolist()
    frames = (Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    with atomic_file(path) as file:
        for number, (frame, wait) in enumerate(_changes(map(np.asarray, frames), ticks)):
            if not number:
                height, width = frame.indices.shape
                file.write(b"GIF89a" + struct.pack("<HHBBB", width, height, 0xF7, 0, 0) + colors.ljust(768, b"\0"))
                file.write(_ENDLESS)
            indices = frame.indices
            for told in range(0, wait, _LONGEST):
                ticks_of_it = min(wait - told, _LONGEST)
                about = {"duration": 1000.0 * _TICK * ticks_of_it, "transparency": _COLORS, "disposal": 1}
                file.writelines(getdata(Image.fromarray(indices), frame.corner, **about))
                # What is shown for longer than a picture can be goes on as a pixel of nothing new.
                indices = np.full((1, 1), _COLORS, dtype=np.uint8)
        file.write(b";")


@dataclass(frozen=True, eq=False)
class _Change:
    """A part of a picture that is not as before.

    Attributes:
        indices: Numbers of colours, (height, width); ``_COLORS`` where nothing changed.
        corner: Where its upper left pixel is, column and row.
    """

    indices: NDArray[np.uint8]
    corner: tuple[int, int]


def _changes(pictures: Iterable[NDArray[np.uint8]], ticks: Iterable[int]) -> Iterator[tuple[_Change, int]]:
    """Yields the first picture, then what changes from one to the next, each with the ticks that it is shown."""
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
        own = np.where(changed[part], picture[part], np.uint8(_COLORS))
        before, change, shown = picture, _Change(own, (left, top)), wait
    yield change, shown


def write_mp4(path: Path, pictures: Iterable[Picture], fps: float, size: tuple[int, int]) -> None:
    """Writes an H.264 film that browsers play, by the program ffmpeg.

    Args:
        path: The file.
        pictures: All pictures, (height, width, 3) sRGB.
        fps: How many of them a second has.
        size: Width and height of all, even [pixels].

    Raises:
        ValueError: If there is no ffmpeg, or it fails.
    """
    program = shutil.which("ffmpeg")
    if program is None:
        raise ValueError(f"{path}: an .mp4 file needs ffmpeg, which is not on the PATH; .gif needs nothing")
    with atomic_path(path) as part, tempfile.TemporaryFile() as messages:
        command = [
            *(program, "-hide_banner", "-loglevel", "error", "-y"),
            *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:.9g}", "-i", "-"),
            # As displays expect it of a film without further notice.
            *("-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p"),
            *("-color_primaries", "bt709", "-color_trc", "bt709", "-colorspace", "bt709", "-color_range", "tv"),
            *("-c:v", "libx264", "-preset", "medium", "-crf", "18"),
            *("-movflags", "+faststart", "-fflags", "+bitexact", "-flags", "+bitexact", "-f", "mp4"),
            str(part.resolve()),  # a name that begins with "-" would be an option
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
                pass  # it says why
            except BaseException:
                process.kill()
                raise
        if process.returncode:
            messages.seek(0)
            reason = messages.read().decode(errors="replace").strip().splitlines()
            raise ValueError(
                f"{path}: ffmpeg failed: {reason[-1] if reason else f'exit code {process.returncode}'}; "
                ".gif needs no ffmpeg"
            )


def _spread(picture: Picture) -> Picture:
    """Returns a picture of the colours of another, frequent ones more seldom: small things keep theirs."""
    colors, counts = np.unique(picture.reshape(-1, 3) & 0xFC, axis=0, return_counts=True)
    return np.repeat(colors, np.ceil(np.sqrt(counts)).astype(int), axis=0)[None]
